//! From a path on the command line to a checked graph.

use std::path::Path;

use crate::error::Result;
use panoscope_graph::{Catalog, Diagnostics, Graph, GraphText, check};
use panoscope_loader::{self as loader, Loader};

/// A checked graph with what it was checked against.
pub struct Ready {
    /// The graph.
    pub graph: Graph,
    /// Node types of its plugins.
    pub catalog: Catalog,
    /// Where its plugins came from.
    pub loader: Loader,
    /// What was odd but not wrong.
    pub warnings: Diagnostics,
}

/// Reads a graph file, loads its plugins and checks it with the given `node.param=value` settings.
pub fn load(path: &Path, settings: &[String]) -> Result<Ready, Diagnostics> {
    let mut text = GraphText::load(path)?;
    for setting in settings {
        text.set(setting);
    }
    ready(&text)
}

/// Loads the plugins of a graph and checks it.
pub fn ready(text: &GraphText) -> Result<Ready, Diagnostics> {
    let loader = Loader::search(&loader::search_path(&text.plugin_paths()));
    let catalog = loader.catalog(&text.plugins());
    let (graph, warnings) = check(text, &catalog).into_result()?;
    Ok(Ready { graph, catalog, loader, warnings })
}

/// All plugins of this machine, found and not loaded.
pub fn all_plugins() -> Loader {
    Loader::search(&loader::search_path(&[]))
}
