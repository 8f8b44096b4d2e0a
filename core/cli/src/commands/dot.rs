//! `panoscope dot`.

use std::path::PathBuf;

use anyhow::Result;

use crate::End;
use crate::terminal::{raw, stderr_color};
use panoscope_eval::graph_file;

/// Arguments of `dot`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Graph file.
    graph: PathBuf,
}

/// Writes a graph for Graphviz: `panoscope dot graph.toml | dot -Tsvg > graph.svg`.
pub fn run(arguments: &Arguments) -> Result<End> {
    match graph_file::load(&arguments.graph, &[]) {
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
