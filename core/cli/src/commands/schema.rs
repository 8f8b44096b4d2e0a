//! `panoscope schema`.

use anyhow::Result;
use panoscope_host::loader::graph_file;

use crate::End;
use crate::terminal::{log, out};

/// Writes the JSON Schema of graph files for all plugins of this machine.
pub fn run() -> Result<End> {
    let loader = graph_file::all_plugins();
    let names: Vec<String> = loader.found().map(|f| f.note.name.clone()).collect();
    let catalog = loader.catalog(&names);
    for problem in &catalog.problems {
        log!("warning: {}", problem.message);
    }
    out!("{}", serde_json::to_string_pretty(&panoscope_graph::json_schema(&catalog))?);
    Ok(End::Done)
}
