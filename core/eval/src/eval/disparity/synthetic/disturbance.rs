//! What makes a synthetic condition hard.

/// What makes a condition hard.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Disturbance {
    /// A good camera: slight blur, little noise.
    None,
    /// Four times the noise.
    Noise,
    /// Out of focus, the right view more than the left.
    Blur,
    /// The right view is darker, with another black level.
    Exposure,
    /// The right camera looks 0.3 px past its rows.
    Rows,
    /// Smoke, unlike in both views.
    Smoke,
    /// Stains of blood that hide the texture.
    Blood,
    /// Wet tissue that mirrors the lamp.
    Highlights,
}

impl Disturbance {
    /// How far the right camera looks past its rows, px.
    pub fn right_rows_px(self) -> f64 {
        if self == Self::Rows { 0.3 } else { 0.0 }
    }

    /// Standard deviation of the blur, px.
    pub fn blur_px(self, is_right: bool) -> f32 {
        match (self, is_right) {
            (Self::Blur, false) => 1.8,
            (Self::Blur, true) => 2.2,
            _ => 0.5,
        }
    }

    /// Standard deviation of the noise, levels.
    pub fn noise(self) -> f32 {
        if self == Self::Noise { 6.0 } else { 1.5 }
    }

    /// Gain and black level.
    pub fn exposure(self, is_right: bool) -> (f32, f32) {
        if self == Self::Exposure && is_right { (0.72, 9.0) } else { (1.0, 0.0) }
    }
}
