//! From a path on the command line to a checked graph.

use std::path::Path;

use crate::error::Result;
use panoscope_graph::{Catalog, Diagnostics, Graph, GraphOptions, GraphText, check};
use panoscope_loader::{self as loader, Loader};

/// A checked graph with what it was checked against.
pub struct Ready {
    /// What was read.
    pub text: GraphText,
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
    open(path, &GraphOptions { set: settings.to_vec(), ..GraphOptions::default() })
}

/// Reads a graph file with overlays and arguments, loads its plugins and checks it.
pub fn open(path: &Path, options: &GraphOptions) -> Result<Ready, Diagnostics> {
    ready(&GraphText::load_with(path, options)?)
}

/// Loads the plugins of a graph and checks it.
pub fn ready(text: &GraphText) -> Result<Ready, Diagnostics> {
    let loader = Loader::search(&loader::search_path(&text.plugin_paths()));
    let catalog = loader.catalog(&text.plugins());
    let (graph, warnings) = check(text, &catalog).into_result()?;
    Ok(Ready { text: text.clone(), graph, catalog, loader, warnings })
}

/// All plugins of this machine, found and not loaded.
pub fn all_plugins() -> Loader {
    Loader::search(&loader::search_path(&[]))
}
