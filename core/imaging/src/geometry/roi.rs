//! Rectangles in pixels and the overlap of two frames (thesis, chapter 2, Alg. 2.2).

use super::homography::Homography;

/// A rectangle of whole pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Rect {
    /// First column, in pixels.
    pub x: usize,
    /// First row, in pixels.
    pub y: usize,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl Rect {
    /// A rectangle from its corner and size.
    pub fn new(x: usize, y: usize, width: usize, height: usize) -> Self {
        Self { x, y, width, height }
    }

    /// Whether it holds no pixel.
    pub fn is_empty(&self) -> bool {
        self.width == 0 || self.height == 0
    }

    /// Pixels inside.
    pub fn area(&self) -> usize {
        self.width * self.height
    }

    /// What both rectangles cover; empty when they do not meet.
    pub fn intersect(&self, other: &Rect) -> Rect {
        let (x, y) = (self.x.max(other.x), self.y.max(other.y));
        let right = self.x.saturating_add(self.width).min(other.x.saturating_add(other.width));
        let bottom = self.y.saturating_add(self.height).min(other.y.saturating_add(other.height));
        Rect { x, y, width: right.saturating_sub(x), height: bottom.saturating_sub(y) }
    }

    /// Moved outwards by `margin` pixels on each side and clipped to a frame of `width` x `height`.
    pub fn grown(&self, margin: usize, width: usize, height: usize) -> Rect {
        let (x, y) = (self.x.saturating_sub(margin), self.y.saturating_sub(margin));
        let right = self.x.saturating_add(self.width).saturating_add(margin);
        let bottom = self.y.saturating_add(self.height).saturating_add(margin);
        Rect { x, y, width: right.saturating_sub(x), height: bottom.saturating_sub(y) }
            .intersect(&Rect::new(0, 0, width, height))
    }
}

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
