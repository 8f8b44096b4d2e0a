//! Maps and clouds beside the truth: errors of each tick as scalars and as a row of a table.

mod cloud;
mod depth;
mod disparity;

pub use cloud::EvaluateCloud;
pub use depth::EvaluateDepth;
pub use disparity::EvaluateDisparity;

use panoscope_node::{Validation, View};

/// Reports an evaluated input that nothing is connected to: every tick would count as unknown.
fn needs(check: &mut Validation<'_>, name: &str) {
    if check.is_connected(name) == Some(false) {
        check.node_error(format!("`{name}` is not connected: there is nothing to evaluate"), "connect it");
    }
}

/// Percent of a share; NaN where no truth is known.
fn percent(share: f64, pixels: usize) -> f64 {
    if pixels == 0 { f64::NAN } else { 100.0 * share }
}

/// A map of the truth's size without any known pixel, in place of one that is missing.
fn unknown<'a>(memory: &'a mut Vec<f32>, truth: &View<'_, f32>) -> View<'a, f32> {
    memory.resize(truth.width * truth.height, f32::NAN);
    View::new(memory, truth.width, truth.height, 1)
}
