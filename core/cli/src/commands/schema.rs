//! `panoscope schema`.

use anyhow::Result;
use panoscope_host::loader::graph_file;

use crate::End;
use crate::commands::schema_python;
use crate::terminal::{log, out};

/// Arguments of `schema`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Node types as a stub for graphs that are built in Python, `catalogue.pyi` of the package, instead of the JSON
    /// Schema.
    #[arg(long)]
    python: bool,
}

/// Writes the JSON Schema of graph files, or the stub for Python, for all plugins of this machine.
pub fn run(arguments: &Arguments) -> Result<End> {
    let loader = graph_file::all_plugins();
    let names: Vec<String> = loader.found().map(|f| f.note.name.clone()).collect();
    let catalog = loader.catalog(&names);
    for problem in &catalog.problems {
        log!("warning: {}", problem.message);
    }
    if arguments.python {
        out!("{}", schema_python::stub(&catalog).trim_end());
        return Ok(End::Done);
    }
    out!("{}", serde_json::to_string_pretty(&panoscope_graph::json_schema(&catalog))?);
    Ok(End::Done)
}
