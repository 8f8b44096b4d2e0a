//! The wide image: its size, and its position relative to the first camera's image.

use super::params::PhantomError;

/// Maximum side of the wide image, px.
pub const MAX_WIDE_PX: usize = 8192;

/// Size and position of a wide image: pixel `(u, v)` of it is pixel `(u - offset_x, v - offset_y)` of the first camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Canvas {
    /// Columns, px.
    pub width: usize,
    /// Rows, px.
    pub height: usize,
    /// Column of the first camera's first pixel, px.
    pub offset_x: f64,
    /// Row of the first camera's first pixel, px.
    pub offset_y: f64,
}

impl Canvas {
    /// Refuses sizes that cannot be drawn.
    pub(super) fn check(&self) -> Result<(), PhantomError> {
        for (name, value, low) in [("canvas width", self.width, 8.0), ("canvas height", self.height, 8.0)] {
            let high = MAX_WIDE_PX as f64;
            if !(low..=high).contains(&(value as f64)) {
                return Err(PhantomError::OutOfRange { name, value: value as f64, low, high });
            }
        }
        Ok(())
    }
}
