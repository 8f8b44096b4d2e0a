//! Measured numbers as text, with significant digits that match their error.

use std::fmt::Write;

/// Maximum number of digits after the decimal point.
const MAX_PLACES: i32 = 4;

/// Writes `26.8 ± 1.2 mm`: the 95 % error bound with two significant digits, rounded up, and the value with the same number of decimals.
///
/// A value that is not finite is written as `-`; a bound that is not finite or not above 0 as `error unknown`.
pub fn write_with_error(out: &mut String, value: f64, bound: f64, unit: &str) {
    if !value.is_finite() {
        out.push('-');
        return;
    }
    if !(bound.is_finite() && bound > 0.0) {
        let _ = write!(out, "{value:.1} {unit}, error unknown");
        return;
    }
    // A bound of 9.96 has two significant digits as 10: its place is found after rounding. A hair less: 1.2 / 0.1 is a little above 12.
    let rounded_up = |place: f64| (bound / place - 1e-6).ceil() * place;
    let place_of = |number: f64| 10f64.powf(number.log10().floor() - 1.0);
    let place = place_of(rounded_up(place_of(bound)).max(bound)).max(10f64.powi(-MAX_PLACES));
    let places = (-place.log10().round()).max(0.0) as usize;
    let _ = write!(out, "{:.places$} ± {:.places$} {unit}", (value / place).round() * place, rounded_up(place));
}

/// Index of the column that holds the 95 % error bound of column `index`: the next one, if it is called `error_UNIT` or `WHAT_error_UNIT`.
pub fn error_column<'a>(mut names: impl Iterator<Item = &'a str>, index: usize) -> Option<usize> {
    let (what, unit) = names.nth(index)?.rsplit_once('_')?;
    if what == "error" || what.starts_with("error_") || what.ends_with("_error") {
        return None;
    }
    let (beside, its_unit) = names.next()?.rsplit_once('_')?;
    let belongs = beside == "error" || beside.strip_suffix("_error").is_some_and(|of| of == what);
    (belongs && its_unit == unit).then_some(index + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digits_end_where_the_error_begins() {
        for (value, bound, want) in [
            (26.834, 1.2, "26.8 ± 1.2 mm"),
            (26.834, 1.21, "26.8 ± 1.3 mm"),
            (26.834, 0.118, "26.83 ± 0.12 mm"),
            (26.834, 12.3, "27 ± 13 mm"),
            (267.9, 119.0, "270 ± 120 mm"),
            (26.834, 9.96, "27 ± 10 mm"),
            (-3.26, 0.5, "-3.26 ± 0.50 mm"),
            (0.0, 1e-9, "0.0000 ± 0.0001 mm"),
            (26.834, f64::NAN, "26.8 mm, error unknown"),
            (26.834, 0.0, "26.8 mm, error unknown"),
            (f64::NAN, 1.0, "-"),
        ] {
            let mut written = String::new();
            write_with_error(&mut written, value, bound, "mm");
            assert_eq!(written, want, "{value} {bound}");
        }
    }

    #[test]
    fn a_bound_belongs_to_the_column_before_it() {
        let of = |names: &[&str], index| error_column(names.iter().copied(), index);
        assert_eq!(of(&["u_px", "distance_mm", "error_mm"], 1), Some(2));
        assert_eq!(of(&["u_px", "distance_mm", "error_mm"], 0), None);
        let polyline = ["segment_mm", "segment_error_mm", "length_mm", "error_mm"];
        assert_eq!((of(&polyline, 0), of(&polyline, 1), of(&polyline, 2)), (Some(1), None, Some(3)));
        // The controller's columns are errors themselves.
        assert_eq!(of(&["error_distance_mm", "error_mm"], 0), None);
        assert_eq!(of(&["angle_deg", "error_mm"], 0), None, "of another unit");
        assert_eq!(of(&["distance_mm"], 0), None);
    }
}
