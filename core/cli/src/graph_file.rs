//! From a path on the command line to a checked graph.

use std::path::{Path, PathBuf};

use panoscope_graph::{Catalog, Diagnostics, Graph, GraphOptions, GraphText, check, command_line};
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

/// What a command line gives to a graph besides settings. Arguments that the graph declares are among them, see [`command_line`].
#[derive(clap::Args, Clone, Debug, Default)]
pub struct Given {
    /// Overlay file: replaces nodes of the same name and defaults of arguments. May be given again.
    #[arg(long, value_name = "OVERLAY")]
    with: Vec<PathBuf>,
    #[arg(long = "graph-arg", value_name = "NAME=VALUE", hide = true)]
    graph_args: Vec<String>,
}

impl Given {
    /// As options to open the graph, with `node.param=value` settings.
    pub fn options(&self, settings: &[String]) -> GraphOptions {
        GraphOptions {
            with: self.with.clone(),
            args: self.graph_args.iter().map(|text| command_line::split(text)).collect(),
            set: settings.to_vec(),
            ..GraphOptions::default()
        }
    }

    /// The same as words of a command line.
    pub fn words(&self) -> Vec<String> {
        let with = self.with.iter().map(|file| format!("--with={}", file.display()));
        with.chain(self.graph_args.iter().map(|arg| format!("--graph-arg={arg}"))).collect()
    }
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
