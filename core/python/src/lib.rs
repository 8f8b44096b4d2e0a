//! The native part of the Python package `panoscope`: runs node classes in the process of isolated nodes, and graphs in
//! a Python process ([`host`]).
//!
//! The host starts `python -m panoscope.child GROUP`, whose main thread serves the host ([`serve`]). The file of a
//! plugin is run there once; its node classes become descriptors of the plugin interface ([`describe`]), whose
//! functions call Python ([`instance`]). Frames reach Python as arrays over the host's shared memory ([`view`]).
#![allow(unsafe_code)]

mod call;
mod classes;
mod describe;
mod host;
mod instance;
mod view;

use std::convert::Infallible;
use std::path::Path;

use panoscope_abi::NodeType;
use panoscope_host::isolate::child::LoadError;
use panoscope_host::loader::isolated;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

/// Module of the package that loads files and runs instances.
const RUNNER: &str = "panoscope.runner";

/// Serves the host until it closes the connection; does not return.
#[pyfunction]
fn serve(py: Python<'_>) {
    py.detach(|| -> Infallible { panoscope_host::isolate::child::serve(load) });
}

/// Loads a plugin: a Python file, or a library whose nodes share the process.
fn load(image: &Path, file: &Path) -> Result<Vec<&'static NodeType>, LoadError> {
    if file.extension().is_none_or(|extension| extension != "py") {
        return isolated::load(image, file);
    }
    let source = std::fs::read(image).map_err(|cause| LoadError { message: cause.to_string() })?;
    instance::attach(|py| {
        let load = || -> PyResult<Vec<&'static NodeType>> {
            let types = py.import(RUNNER)?.call_method1("load", (PyBytes::new(py, &source), file.as_os_str()))?;
            types.try_iter()?.map(|node_type| describe::node_type(&node_type?)).collect()
        };
        load().map_err(|error| LoadError { message: explain(py, &error) })
    })
}

/// An exception with its traceback, as text.
fn explain(py: Python<'_>, error: &PyErr) -> String {
    let explained =
        || -> PyResult<String> { py.import(RUNNER)?.call_method1("explain", (error.value(py),))?.extract() };
    explained().unwrap_or_else(|_| error.to_string())
}

/// The native part of the package.
#[pymodule]
fn _native(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<view::View>()?;
    module.add_class::<call::Call>()?;
    module.add_function(wrap_pyfunction!(serve, module)?)?;
    host::add_to(module)
}
