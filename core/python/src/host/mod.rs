//! Graphs and recordings from Python; in the rest of this crate, the engine calls nodes.
//!
//! This module never calls Python on a thread of the engine: packets wait in an
//! [`Inbox`](panoscope_engine::inbox::Inbox) until Python asks for them, and the interpreter's lock is released while
//! it waits.

mod catalogue;
mod error;
mod graph;
mod recording;
mod running;
mod values;
mod watched;

use pyo3::prelude::*;

/// Adds the classes to the native module.
pub fn add_to(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<catalogue::Catalogue>()?;
    module.add_class::<graph::GraphFile>()?;
    module.add_class::<running::Running>()?;
    module.add_class::<recording::RecordingFile>()?;
    module.add_function(wrap_pyfunction!(graph::file_hash, module)?)?;
    module.add_function(wrap_pyfunction!(graph::replay, module)?)
}
