//! From a path on the command line to a checked graph.

use std::path::Path;

use panoscope_graph::{Catalog, Diagnostics, Graph, GraphOptions, GraphText, check};

use crate::loader::search::{Loader, search_path};

/// A checked graph with its text, catalogue and loader.
pub struct Ready {
    /// The text that was read.
    pub text: GraphText,
    /// The graph.
    pub graph: Graph,
    /// Node types of its plugins.
    pub catalog: Catalog,
    /// Loader of its plugins.
    pub loader: Loader,
    /// Warnings of the check.
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

/// Finds all plugins of this machine without loading them.
pub fn all_plugins() -> Loader {
    Loader::search(&search_path(&[]))
}
