//! Distances, depths and angles of surface points, each with the error that is to be expected (thesis, figs 3.14 and 3.15).

use super::{CalibrationError, SurfacePoint};

/// What is not known exactly about a rig and its matching; standard deviations. Those of the calibration are for one that does not state its own error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Of a filtered disparity, added as a square to the scatter around the point, px.
    pub disparity_px: f64,
    /// Of the calibration's disparity offset, px; its reprojection error is used when larger.
    pub offset_px: f64,
    /// Of the calibration's baseline, mm.
    pub baseline_mm: f64,
    /// Of the calibration's focal length, percent.
    pub focal_percent: f64,
}

impl Noise {
    /// A carefully calibrated rig, and views that are matched at their full size.
    pub const USUAL: Self = Self { disparity_px: 0.05, offset_px: 0.05, baseline_mm: 0.05, focal_percent: 0.1 };
}

/// Errors that every measurement inherits; standard deviations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Errors {
    /// Inverse depth of a pixel of disparity, in 1/mm.
    pub inverse_depth_per_px: f64,
    /// Of one point's disparity, added as a square to the scatter around it, px.
    pub disparity_px: f64,
    /// Of one point's inverse depth by the calibration, in 1/mm.
    pub point_inverse_depth: f64,
    /// Of all inverse depths alike (the calibration's disparity offset), in 1/mm.
    pub common_inverse_depth: f64,
    /// Depth at which that changes no length, mm.
    pub neutral_mm: f64,
    /// Of all lengths alike (baseline), relative.
    pub scale: f64,
    /// Of all depths against widths (focal length), relative.
    pub depth_scale: f64,
}

impl Errors {
    /// Of rectified views with this focal length and baseline. `rms_px` is the calibration's reprojection error, NaN when unknown; `stated` what it says of
    /// its own error, which goes before `rms_px` and the calibration's part of `noise`.
    pub fn of(focal_px: f64, baseline_mm: f64, rms_px: f64, stated: Option<CalibrationError>, noise: &Noise) -> Self {
        let inverse_depth_per_px = 1.0 / (focal_px * baseline_mm);
        let disparity_px = noise.disparity_px;
        match stated {
            Some(stated) => Self {
                inverse_depth_per_px,
                disparity_px,
                point_inverse_depth: stated.point_px * inverse_depth_per_px,
                common_inverse_depth: stated.offset_px * inverse_depth_per_px,
                neutral_mm: stated.neutral_mm,
                scale: stated.scale_percent / 100.0,
                depth_scale: 0.0,
            },
            None => Self {
                inverse_depth_per_px,
                disparity_px,
                point_inverse_depth: 0.0,
                // `max` drops NaN.
                common_inverse_depth: noise.offset_px.max(rms_px) * inverse_depth_per_px,
                neutral_mm: 0.0,
                scale: noise.baseline_mm / baseline_mm,
                depth_scale: noise.focal_percent / 100.0,
            },
        }
    }

    /// Of the inverse depth of a point, by its own match and what the calibration adds to it alone, in 1/mm.
    ///
    /// Neither scatter nor confidence alone says how wrong a match is: a filter smooths patches that are matched wrongly under smoke and blood, and a
    /// surface that is matched well may be rough. So they are multiplied.
    fn of_point(&self, point: &SurfacePoint) -> f64 {
        let scatter_px = (point.scatter / self.inverse_depth_per_px).hypot(self.disparity_px);
        let doubt = point.confidence.map_or(UNKNOWN_DOUBT, |confidence| 1.0 - confidence);
        let by_doubt = (doubt + LEAST_DOUBT).powf(DOUBT_POWER) * (DOUBT_RISE * doubt.powi(3)).exp();
        (MATCH_PX * scatter_px.powf(SCATTER_POWER) * by_doubt * self.inverse_depth_per_px)
            .hypot(self.point_inverse_depth)
    }
}

// How wrong a match is: fitted to the quantile of 96 % of the depths on rendered pairs, those of the tuning seeds and boards and tissue of the phantom, and 5 %
// wider, so that none of 60 cells of the tuning seeds (four chains of matching and filtering in fifteen conditions) is below 90 %.

/// Standard deviation at a scatter of 1 px and a doubt of 1 but for [`DOUBT_RISE`], px.
const MATCH_PX: f64 = 4.2;
/// Power of the scatter.
const SCATTER_POWER: f64 = 0.765;
/// Power of what is missing to full confidence.
const DOUBT_POWER: f64 = 0.575;
/// What is missing to full confidence at least.
const LEAST_DOUBT: f64 = 0.02;
/// Natural logarithm of how much more a point without any confidence is in doubt: whole patches are matched wrongly there.
const DOUBT_RISE: f64 = 2.15;
/// What is missing to full confidence where it is not known.
const UNKNOWN_DOUBT: f64 = 0.5;

/// How many standard deviations are stated: 95 % of true errors lie within.
const STATED_DEVIATIONS: f64 = 2.0;

/// Maximum number of points of one measured item.
pub const MAX_POINTS: usize = 3;

fn between(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [b[0] - a[0], b[1] - a[1], b[2] - a[2]]
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Depth of the first of one or more points, mm.
pub fn depth(points: &[[f64; 3]]) -> f64 {
    points[0][2]
}

/// Distance of the first two of two or more points, mm.
pub fn distance(points: &[[f64; 3]]) -> f64 {
    let line = between(points[0], points[1]);
    dot(line, line).sqrt()
}

/// Angle at the second of three points, degrees; NaN when two coincide.
pub fn angle(points: &[[f64; 3]]) -> f64 {
    let (a, b) = (between(points[1], points[0]), between(points[1], points[2]));
    let cosine = dot(a, b) / (dot(a, a) * dot(b, b)).sqrt();
    cosine.clamp(-1.0, 1.0).acos().to_degrees()
}

/// `measure` of the points and its stated error: every cause is tried alone, the changes add up as squares.
/// The error is NaN when `errors` is `None`.
pub fn with_error(points: &[SurfacePoint], errors: Option<&Errors>, measure: fn(&[[f64; 3]]) -> f64) -> (f64, f64) {
    let count = points.len().min(MAX_POINTS);
    let mut places = [[0.0; 3]; MAX_POINTS];
    for (place, point) in places.iter_mut().zip(points) {
        *place = point.xyz_mm(0.0);
    }
    let value = measure(&places[..count]);
    let Some(errors) = errors else { return (value, f64::NAN) };
    let mut squares = 0.0;
    let mut add = |changed: &[[f64; 3]; MAX_POINTS]| squares += (measure(&changed[..count]) - value).powi(2);
    for (index, point) in points[..count].iter().enumerate() {
        let mut changed = places;
        changed[index] = point.xyz_mm(errors.of_point(point));
        add(&changed);
    }
    let mut changed = places;
    for (place, point) in changed.iter_mut().zip(points) {
        let scale = 1.0 + errors.common_inverse_depth * errors.neutral_mm;
        *place = point.xyz_mm(errors.common_inverse_depth).map(|part| part * scale);
    }
    add(&changed);
    add(&places.map(|place| place.map(|part| part * (1.0 + errors.scale))));
    add(&places.map(|[x, y, z]| [x, y, z * (1.0 + errors.depth_scale)]));
    (value, STATED_DEVIATIONS * squares.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_error_grows_as_the_confidence_falls_and_is_wide_where_it_is_unknown() {
        let errors = Errors::of(750.0, 15.0, f64::NAN, None, &Noise::USUAL);
        let stated = |confidence: Option<f64>| {
            let point = |x: f64, z_mm: f64| SurfacePoint {
                ray: [x, 0.0],
                inverse_depth: 1.0 / z_mm,
                scatter: 1e-5,
                confidence: Some(1.0),
            };
            let ends = [SurfacePoint { confidence, ..point(-0.1, 50.0) }, point(0.1, 65.0)];
            with_error(&ends, Some(&errors), distance).1
        };
        let [full, half, none, unknown] = [Some(1.0), Some(0.5), Some(0.0), None].map(stated);
        assert!(full < 1.0 && unknown > 1.5 * full, "{full} mm, {unknown} mm");
        assert!(half > 1.5 * full && none > 2.0 * half, "{full}, {half}, {none} mm");
    }

    #[test]
    fn what_a_calibration_states_goes_before_its_residual() {
        let stated = CalibrationError { offset_px: 0.5, scale_percent: 0.1, point_px: 0.001, neutral_mm: 60.0 };
        let bound = |z_mm: f64, rms_px: f64, stated: Option<CalibrationError>| {
            let noise = Noise { disparity_px: 0.0, ..Noise::USUAL };
            let errors = Errors::of(750.0, 15.0, rms_px, stated, &noise);
            // Without scatter the match adds nothing.
            let end =
                |x: f64| SurfacePoint { ray: [x, 0.0], inverse_depth: 1.0 / z_mm, scatter: 0.0, confidence: Some(1.0) };
            with_error(&[end(-0.2), end(0.2)], Some(&errors), distance)
        };
        let (length, at_neutral) = bound(60.0, 0.5, Some(stated));
        assert!((at_neutral / length - 0.002).abs() < 2e-4, "twice the scale's error, not {at_neutral} of {length} mm");
        assert!(bound(90.0, 0.5, Some(stated)).1 / 36.0 > 0.003, "the offset counts away from the neutral depth");
        let (_, unstated) = bound(60.0, 0.5, None);
        assert!(unstated > 2.5 * at_neutral, "{unstated} {at_neutral}");
        assert_eq!(bound(60.0, f64::NAN, Some(stated)).1, at_neutral);
    }
}
