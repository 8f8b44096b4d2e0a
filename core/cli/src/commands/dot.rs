//! `panoscope dot`.

use std::path::PathBuf;

use anyhow::Result;
use panoscope_graph::GraphOptions;

use crate::End;
use crate::given::Given;
use crate::terminal::{raw, stderr_color};
use crate::trust::OwnPlugins;

/// Arguments of `dot`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Graph file.
    graph: PathBuf,
    #[command(flatten)]
    given: Given,
    #[command(flatten)]
    own_plugins: OwnPlugins,
}

/// Writes a graph for Graphviz: `panoscope dot graph.toml | dot -Tsvg > graph.svg`.
pub fn run(arguments: &Arguments) -> Result<End> {
    let options = GraphOptions { allow_missing_args: true, ..arguments.given.options(&[]) };
    match arguments.own_plugins.open(&arguments.graph, &options) {
        Ok(ready) => {
            raw(&panoscope_graph::to_dot(&ready.graph, &ready.catalog));
            Ok(End::Done)
        }
        Err(diagnostics) => {
            crate::terminal::log!("{}", diagnostics.render(stderr_color()).trim_end());
            Ok(End::Wrong)
        }
    }
}
