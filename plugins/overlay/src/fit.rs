//! Sizes of images in cells, and the range of the numbers in a map.

use panoscope_node::abi::{FORMAT_BGR8, FORMAT_GRAY8, FORMAT_RGBA8};
use panoscope_node::{AnyImage, Bgr8, Gray8, Rgba8, View};

/// The largest size with the proportions of `from` (width, height in px) that fits into `cell`.
pub fn fitted_size(from: (usize, usize), cell: (usize, usize)) -> (usize, usize) {
    if from.0 == 0 || from.1 == 0 {
        return (0, 0);
    }
    let scale = (cell.0 as f64 / from.0 as f64).min(cell.1 as f64 / from.1 as f64);
    let side = |length: usize, limit: usize| ((length as f64 * scale).round() as usize).clamp(1, limit.max(1));
    (side(from.0, cell.0), side(from.1, cell.1))
}

/// Maximum factor by which an image is enlarged before text is written next to it.
const MAX_ENLARGEMENT: f64 = 4.0;

/// Integer factor by which an image's width comes nearest to the wanted one.
pub fn enlargement(width: usize, wanted_width: usize) -> usize {
    (wanted_width as f64 / width.max(1) as f64).round().clamp(1.0, MAX_ENLARGEMENT) as usize
}

/// Columns and rows of an 8-bit image of any channels; `None` of other images.
pub fn bytes_size(image: &AnyImage<'_>) -> Option<(usize, usize)> {
    let formats = [FORMAT_BGR8, FORMAT_GRAY8, FORMAT_RGBA8];
    formats.contains(&image.format()).then(|| (image.width(), image.height()))
}

/// The pixels of an 8-bit image of any channels.
pub fn bytes<'f>(image: &AnyImage<'f>) -> Option<View<'f, u8>> {
    if let Some(plane) = image.as_plane::<Bgr8>() {
        return Some(plane.view());
    }
    if let Some(plane) = image.as_plane::<Gray8>() {
        return Some(plane.view());
    }
    image.as_plane::<Rgba8>().map(|plane| plane.view())
}

/// The 2 % and 98 % quantiles of the finite values of `plane`, sampled at every `step`-th value in both directions. `work` is reused. `None` when no
/// value is finite.
pub fn usual_range(plane: &View<'_, f32>, step: usize, work: &mut Vec<f32>) -> Option<(f32, f32)> {
    work.clear();
    for y in (0..plane.height).step_by(step.max(1)) {
        work.extend(plane.row(y).iter().step_by(step.max(1)).filter(|v| v.is_finite()));
    }
    if work.is_empty() {
        return None;
    }
    let at = |share: usize| (work.len() - 1) * share / 100;
    let (low, high) = (at(2), at(98));
    let low = *work.select_nth_unstable_by(low, f32::total_cmp).1;
    let high = *work.select_nth_unstable_by(high, f32::total_cmp).1;
    Some((low, high))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_keep_their_proportions() {
        assert_eq!(fitted_size((640, 480), (320, 320)), (320, 240));
        assert_eq!(fitted_size((100, 400), (320, 320)), (80, 320));
        assert_eq!(fitted_size((0, 4), (320, 320)), (0, 0));
        assert_eq!(fitted_size((10_000, 1), (10, 10)), (10, 1));
    }

    #[test]
    fn outliers_and_unknown_places_do_not_count() {
        let mut plane: Vec<f32> = (0..1000).map(|i| i as f32).collect();
        plane[0] = f32::NAN;
        plane[999] = f32::INFINITY;
        plane[998] = 1e9;
        let (low, high) = usual_range(&View::new(&plane, 50, 20, 1), 1, &mut Vec::new()).unwrap();
        assert!((15.0..25.0).contains(&low) && (970.0..990.0).contains(&high), "{low} {high}");
        assert!(usual_range(&View::new(&[f32::NAN], 1, 1, 1), 1, &mut Vec::new()).is_none());
    }
}
