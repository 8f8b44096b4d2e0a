//! Graph files, checked and prepared for evaluation.

use std::path::Path;

use panoscope_graph::GraphOptions;
use panoscope_host::loader::graph_file;

use crate::error::{EvalError, Result};
use crate::inputs::wiring::Wiring;

pub use crate::inputs::wiring::setting;

/// Reads a graph file with its parts, overlays, arguments and settings, checks it and parses it.
///
/// # Errors
/// The graph has mistakes, or it has nothing to evaluate.
pub fn wiring(path: &Path, options: &GraphOptions) -> Result<Wiring> {
    // All mistakes of the files as they stand, with their lines.
    let ready = match graph_file::open(path, options) {
        Ok(ready) => ready,
        Err(diagnostics) => return Err(EvalError::Check { diagnostics }),
    };
    Wiring::of(&ready.text, &ready.catalog)
        .map_err(|error| EvalError::Options { reason: format!("{}: {error}", path.display()) })
}
