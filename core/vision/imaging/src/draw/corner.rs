//! The corners of a surface that is drawn.

use super::Color;

/// A point of the surface.
#[derive(Clone, Copy)]
pub struct Corner {
    /// Pixel and depth from the viewer; NaN where unknown.
    pub place: [f32; 3],
    /// Place in the camera's frame, mm.
    pub world: [f32; 3],
    pub color: Color,
    /// Brightness, 0 to 1.
    pub light: f32,
    /// Whether it was filled in, not measured.
    pub is_filled: bool,
}

pub const NOWHERE: Corner =
    Corner { place: [f32::NAN; 3], world: [f32::NAN; 3], color: [0; 3], light: 1.0, is_filled: false };

/// Whether there is a point of a surface.
pub fn is_known(corner: &Corner) -> bool {
    !corner.place[0].is_nan()
}
