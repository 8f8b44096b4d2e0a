//! Rendered stereo pairs whose disparity is known exactly, of surfaces that no other part of this repository renders.
//!
//! A scene is a list of layers. A layer is a surface given as a disparity over the left view's pixels, the part of the view that it covers,
//! and a texture that is a function of the surface point. The left view looks layers up; the right view solves `x - d(x, y) = x_right` for each
//! of them. In both views the largest disparity, the nearest surface, hides the others. So truth and occlusion are exact in both views, and no
//! picture is resampled. The same condition and seed give the same pair whatever the number of threads.

mod camera;
mod disturb;
mod disturbance;
mod relief;
mod render;
mod rows;
mod scenes;
#[cfg(test)]
mod tests;
mod texture;

pub use camera::{BASELINE_MM, FOCAL_PX, centre};
pub use scenes::{CONDITIONS, Condition, HELD_OUT_SEEDS, TUNING_SEEDS};

use panoscope_base::Parallel;

/// One view with its truth.
pub struct SyntheticView {
    /// Columns and rows.
    pub size: (usize, usize),
    /// Blue, green, red bytes, row by row.
    pub bgr: Vec<u8>,
    /// Exact disparity of the pixel's centre, px, positive; known everywhere.
    pub disparity: Vec<f32>,
    /// 255 where the other camera sees the same point, else 0.
    pub visible: Vec<u8>,
}

/// A rectified pair: left, right. `x_left = x_right + disparity`. Depth in mm is 4000 over disparity in px.
pub struct SyntheticPair(pub [SyntheticView; 2]);

/// Renders the pair of a condition. Different seeds give different scenes of the same kind.
pub fn render(condition: &Condition, seed: u64, pool: &dyn Parallel) -> SyntheticPair {
    let scene = scenes::scene(condition, seed);
    let views = render::render(&scene, pool);
    SyntheticPair(disturb::develop(views, condition.disturbance, seed, pool))
}
