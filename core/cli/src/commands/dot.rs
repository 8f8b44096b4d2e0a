//! `panoscope dot`.

use std::path::PathBuf;

use anyhow::Result;
use panoscope_graph::GraphOptions;

use crate::End;
use crate::given::Given;
use crate::terminal::{raw, stderr_color};
use panoscope_eval::graph_file;

/// Arguments of `dot`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Graph file.
    graph: PathBuf,
    #[command(flatten)]
    given: Given,
}

/// Writes a graph for Graphviz: `panoscope dot graph.toml | dot -Tsvg > graph.svg`.
pub fn run(arguments: &Arguments) -> Result<End> {
    let options = GraphOptions { allow_missing_args: true, ..arguments.given.options(&[]) };
    match graph_file::open(&arguments.graph, &options) {
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
