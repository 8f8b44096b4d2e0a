//! Rectangles of whole pixels.

/// A rectangle of whole pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Rect {
    /// First column, in pixels.
    pub x: usize,
    /// First row, in pixels.
    pub y: usize,
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
}

impl Rect {
    /// A rectangle from its corner and size.
    pub fn new(x: usize, y: usize, width: usize, height: usize) -> Self {
        Self { x, y, width, height }
    }

    /// The whole of an image.
    pub fn whole(width: usize, height: usize) -> Self {
        Self { x: 0, y: 0, width, height }
    }

    /// Whether it holds no pixel.
    pub fn is_empty(&self) -> bool {
        self.width == 0 || self.height == 0
    }

    /// Pixels inside.
    pub fn area(&self) -> usize {
        self.width * self.height
    }

    /// Intersection of both rectangles; empty when they do not meet.
    pub fn intersect(&self, other: &Rect) -> Rect {
        let (x, y) = (self.x.max(other.x), self.y.max(other.y));
        let right = self.x.saturating_add(self.width).min(other.x.saturating_add(other.width));
        let bottom = self.y.saturating_add(self.height).min(other.y.saturating_add(other.height));
        Rect { x, y, width: right.saturating_sub(x), height: bottom.saturating_sub(y) }
    }

    /// The part of this rectangle inside an image of `width` x `height`.
    pub fn clamped(self, width: usize, height: usize) -> Self {
        let (x, y) = (self.x.min(width), self.y.min(height));
        Self { x, y, width: self.width.min(width - x), height: self.height.min(height - y) }
    }

    /// Moved outwards by `margin` pixels on each side and clipped to a frame of `width` x `height`.
    pub fn grown(&self, margin: usize, width: usize, height: usize) -> Rect {
        let (x, y) = (self.x.saturating_sub(margin), self.y.saturating_sub(margin));
        let right = self.x.saturating_add(self.width).saturating_add(margin);
        let bottom = self.y.saturating_add(self.height).saturating_add(margin);
        Rect { x, y, width: right.saturating_sub(x), height: bottom.saturating_sub(y) }
            .intersect(&Rect::whole(width, height))
    }
}
