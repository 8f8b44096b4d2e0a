//! Graph options of a command line: overlays and values of arguments.

use std::path::PathBuf;

use panoscope_graph::{GraphOptions, command_line};

/// Graph options of a command line, without settings. It includes the arguments that the graph declares, see
/// [`command_line`].
#[derive(clap::Args, Clone, Debug, Default)]
pub struct Given {
    /// Overlay file: replaces nodes of the same name and defaults of arguments. Repeatable.
    #[arg(long, value_name = "OVERLAY")]
    with: Vec<PathBuf>,
    #[arg(long = "graph-arg", value_name = "NAME=VALUE", hide = true)]
    graph_args: Vec<String>,
}

impl Given {
    /// Options to open the graph, with `node.param=value` settings.
    pub fn options(&self, settings: &[String]) -> GraphOptions {
        command_line::options(&self.with, &self.graph_args, settings)
    }

    /// Whether the command line gives nothing.
    pub fn is_empty(&self) -> bool {
        self.with.is_empty() && self.graph_args.is_empty()
    }
}
