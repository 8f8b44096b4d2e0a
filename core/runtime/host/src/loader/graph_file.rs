//! From a path on the command line to a checked graph.

use std::path::Path;

use panoscope_graph::{Catalog, Diagnostics, Graph, GraphOptions, GraphText, check};

use crate::loader::search::{Loader, search_path};

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

/// Reads a graph file with overlays and arguments, loads its plugins and checks it.
pub fn open(path: &Path, options: &GraphOptions) -> Result<Ready, Diagnostics> {
    ready(&GraphText::load_with(path, options)?)
}

/// Loads the plugins of a graph and checks it.
pub fn ready(text: &GraphText) -> Result<Ready, Diagnostics> {
    ready_with(text, Loader::search(&search_path(&text.plugin_paths())))
}

/// As [`ready`], with the plugins that `loader` finds and may load.
pub fn ready_with(text: &GraphText, loader: Loader) -> Result<Ready, Diagnostics> {
    let catalog = loader.catalog_of(text);
    let (graph, warnings) = check(text, &catalog).into_result()?;
    Ok(Ready { text: text.clone(), graph, catalog, loader, warnings })
}

/// All plugins of this machine, found and not loaded.
pub fn all_plugins() -> Loader {
    Loader::search(&search_path(&[]))
}
