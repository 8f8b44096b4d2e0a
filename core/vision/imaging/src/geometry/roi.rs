//! The overlap of two frames (thesis, chapter 2, Alg. 2.2).

use super::homography::Homography;
use crate::Rect;

/// The part of a frame of `width` x `height` inside the bounding rectangle of another frame's warped corners.
///
/// `this_from_other` maps the other frame's pixels (`other_width` x `other_height`) to this one's. Empty when
/// they do not meet or a corner lies at or behind the horizon.
pub fn overlap_roi(
    this_from_other: &Homography,
    other_width: usize,
    other_height: usize,
    width: usize,
    height: usize,
) -> Rect {
    let Some(corners) = this_from_other.map_corners(other_width, other_height) else {
        return Rect::default();
    };
    let bound = |axis: usize, limit: usize| {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for corner in corners {
            (low, high) = (low.min(corner[axis]), high.max(corner[axis]));
        }
        let low = low.floor().clamp(0.0, limit as f64) as usize;
        let high = (high.ceil() + 1.0).clamp(0.0, limit as f64) as usize;
        (low, high.saturating_sub(low))
    };
    let ((x, columns), (y, rows)) = (bound(0, width), bound(1, height));
    Rect { x, y, width: columns, height: rows }
}

/// Search regions of the next frame pair: the overlap seen in the left and in the right frame (Alg. 2.2).
///
/// `left_from_right` maps right-frame pixels to left-frame pixels; sizes are (width, height).
pub fn overlap_rois(left_from_right: &Homography, left: (usize, usize), right: (usize, usize)) -> (Rect, Rect) {
    let in_left = overlap_roi(left_from_right, right.0, right.1, left.0, left.1);
    let in_right = left_from_right
        .inverse()
        .map_or(Rect::default(), |right_from_left| overlap_roi(&right_from_left, left.0, left.1, right.0, right.1));
    (in_left, in_right)
}
