//! The node types of this machine, for graphs that are built in Python.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use panoscope_graph::{GraphOptions, GraphText, check};
use panoscope_host::loader::{self as loader, Loader};
use pyo3::prelude::*;
use serde_json::json;

use super::error::Problem;

/// The plugins that were found; each is loaded with the first request for one of its node types.
#[pyclass(frozen, module = "panoscope._native")]
pub struct Catalogue {
    loader: Mutex<Loader>,
}

impl Catalogue {
    fn with<R>(&self, work: impl FnOnce(&Loader) -> R) -> R {
        work(&self.loader.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

#[pymethods]
impl Catalogue {
    /// Finds the plugins in `folders` and in those that every graph may use.
    #[new]
    fn open(py: Python<'_>, folders: Vec<PathBuf>) -> Self {
        py.detach(|| Self { loader: Mutex::new(Loader::search(&loader::search_path(&folders))) })
    }

    /// Plugin and name of all node types; no plugin is loaded.
    fn names(&self) -> Vec<(String, String)> {
        let of = |loader: &Loader| {
            let types = loader
                .found()
                .flat_map(|found| found.note.node_types.iter().map(|name| (found.note.name.clone(), name.clone())));
            types.collect()
        };
        self.with(of)
    }

    /// A node type in the form of `panoscope describe --json`.
    fn describe(&self, py: Python<'_>, plugin: &str, node_type: &str) -> PyResult<Option<String>> {
        let describe = || {
            let loaded = self.with(|loader| loader.load(plugin));
            let loaded = loaded.map_err(|problem| Problem::Use(format!("{} {}", problem.message, problem.help)))?;
            Ok(loaded.node_types.iter().find(|of| of.name == node_type).map(|found| json!(found).to_string()))
        };
        py.detach(describe).map_err(|problem: Problem| problem.raise(py))
    }

    /// Checks an unfinished text. Returns mistakes and warnings as JSON.
    fn check(&self, py: Python<'_>, path: PathBuf, text: &str) -> String {
        let check = || {
            let options = GraphOptions { allow_missing_args: true, ..GraphOptions::default() };
            let text = GraphText::parse_with(&path, text, &options);
            self.with(|loader| json!(check(&text, &loader.catalog_of(&text)).diagnostics).to_string())
        };
        py.detach(check)
    }
}
