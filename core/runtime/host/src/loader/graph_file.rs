//! From a path on the command line to a checked graph, and from there to a running one.

use std::path::Path;
use std::sync::Arc;

use panoscope_engine::{Engine, Options, StartError};
use panoscope_graph::{Catalog, Diagnostics, Graph, GraphOptions, GraphText, check};

use crate::loader::live::Live;
use crate::loader::seal::{NotLocked, Seal};
use crate::loader::search::{Loader, search_path};

/// A checked graph that did not start.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The graph runs under its lock, and reads another file.
    #[error(transparent)]
    NotLocked(#[from] NotLocked),
    /// The engine did not start.
    #[error(transparent)]
    Start(#[from] StartError),
}

/// A checked graph with its text, catalogue and loader.
pub struct Ready {
    /// The text that was read.
    pub text: GraphText,
    /// The graph.
    pub graph: Graph,
    /// Node types of its plugins.
    pub catalog: Catalog,
    /// Loader of its plugins.
    pub loader: Arc<Loader>,
    /// Warnings of the check.
    pub warnings: Diagnostics,
    /// The files that its nodes may read, if it runs under its lock.
    pub seal: Option<Arc<Seal>>,
}

impl Ready {
    /// Opens all nodes and starts them, with relative paths from the graph's folder. Under a lock the nodes read the
    /// sealed copies from here on: a recording's head is made before, so that it names the files.
    ///
    /// # Errors
    /// See [`RunError`].
    pub fn start(mut self, options: Options) -> Result<Live, RunError> {
        if let Some(seal) = &self.seal {
            seal.apply(&mut self.graph, &self.catalog)?;
        }
        let Self { text, graph, catalog, loader, seal, .. } = self;
        let path = text.path().to_owned();
        let graph_dir = path.parent().unwrap_or(Path::new("")).to_owned();
        let engine = Arc::new(Engine::start(graph, &catalog, &loader, Options { graph_dir, ..options })?);
        let (settings, text) = (text.settings(), text.flattened(&catalog).into_owned());
        Ok(Live { engine, path, text, settings, loader, seal })
    }
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
pub fn ready_with(text: &GraphText, loader: impl Into<Arc<Loader>>) -> Result<Ready, Diagnostics> {
    let loader = loader.into();
    let catalog = loader.catalog_of(text);
    let (graph, warnings) = check(text, &catalog).into_result()?;
    Ok(Ready { text: text.clone(), graph, catalog, loader, warnings, seal: None })
}

/// Finds all plugins of this machine without loading them.
pub fn all_plugins() -> Loader {
    Loader::search(&search_path(&[]))
}
