//! The process of a group of isolated nodes.

use std::path::Path;

use crate::isolate::child::LoadError;
use panoscope_abi::NodeType;

use crate::loader::map::load_image;

/// Runs the nodes of another process's graph until that process is gone. A program calls this first thing in `main`
/// when its first argument is [`COMMAND`](crate::isolate::COMMAND).
pub fn serve() -> ! {
    crate::isolate::child::serve(load)
}

/// Loads a plugin in the process of a group: a path to its bytes, and its file for messages. Returns its node types in
/// order.
///
/// # Errors
/// It cannot be loaded.
pub fn load(image: &Path, file: &Path) -> Result<Vec<&'static NodeType>, LoadError> {
    load_image(image, file).map(|loaded| loaded.entries).map_err(|error| LoadError { message: error.to_string() })
}
