//! Area that the keyframes cover together.

use super::keyframe::Keyframe;
use super::outline::distance;
use super::rim::Lit;

/// Samples of a keyframe along its width and height.
const SAMPLES: (usize, usize) = (32, 24);

/// Area of keyframe `index` that no earlier keyframe covers, in square pixels of the mosaic. Only what is `lit` of frames
/// counts, as if it were all of them.
pub(super) fn own_area(keyframes: &[Keyframe], index: usize, size: (usize, usize), lit: Option<&Lit>) -> f64 {
    let own = &keyframes[index];
    let reach = |other: &Keyframe| 2.0 * (own.outline.area.sqrt() + other.outline.area.sqrt());
    let (step_x, step_y) = (size.0 as f64 / SAMPLES.0 as f64, size.1 as f64 / SAMPLES.1 as f64);
    let (mut total, mut free) = (0.0, 0.0);
    for row in 0..SAMPLES.1 {
        for column in 0..SAMPLES.0 {
            let point = [(column as f64 + 0.5) * step_x - 0.5, (row as f64 + 0.5) * step_y - 0.5];
            if lit.is_some_and(|lit| !lit.contains(point)) {
                continue;
            }
            let position = own.mosaic_from_frame.map(point);
            // The map's determinant is this over the cube of the weight, times the same number for all samples.
            let part = own.mosaic_from_frame.weight(point).abs().powi(-3);
            total += part;
            let shows = |other: &Keyframe| {
                lit.is_none_or(|lit| {
                    other.mosaic_from_frame.inverse().is_some_and(|back| lit.contains(back.map(position)))
                })
            };
            let taken = keyframes[..index].iter().any(|other| {
                let is_near = distance(other.outline.centre, own.outline.centre) < reach(other);
                is_near && other.outline.contains(position) && shows(other)
            });
            if !taken {
                free += part;
            }
        }
    }
    if total > 0.0 { own.outline.area * free / total } else { 0.0 }
}
