//! `panoscope list`.

use anyhow::Result;
use panoscope_host::loader::graph_file;
use serde_json::json;

use crate::End;
use crate::terminal::{log, out};

/// Arguments of `list`.
#[derive(clap::Args)]
pub struct Arguments {
    /// As JSON: plugins, their node types, and files that could not be used.
    #[arg(long)]
    json: bool,
}

/// Lists what the plugins' notes say; no plugin is loaded.
pub fn run(arguments: &Arguments) -> Result<End> {
    let loader = graph_file::all_plugins();
    if arguments.json {
        let plugins: Vec<_> = loader
            .found()
            .map(|found| {
                json!({
                    "plugin": found.note.name,
                    "version": found.note.version,
                    "abi": format!("{}.{}", found.note.abi_major, found.note.abi_minor),
                    "file": found.file,
                    "node_types": found.note.node_types,
                })
            })
            .collect();
        let all = json!({ "plugins": plugins, "problems": loader.problems() });
        out!("{}", serde_json::to_string_pretty(&all)?);
        return Ok(End::Done);
    }
    let mut any = false;
    for found in loader.found() {
        any = true;
        out!("{} {}  ({})", found.note.name, found.note.version, found.file.display());
        for node_type in &found.note.node_types {
            out!("    {node_type}");
        }
    }
    for problem in loader.problems() {
        log!("warning: {}", problem.message);
        if !problem.help.is_empty() {
            log!("    help: {}", problem.help);
        }
    }
    if !any {
        log!("no plugins were found; folders searched:");
        for folder in panoscope_host::loader::search_path(&[]) {
            log!("    {}", folder.display());
        }
    }
    Ok(End::Done)
}
