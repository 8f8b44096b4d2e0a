//! `panoscope check`.

use std::path::PathBuf;

use anyhow::Result;
use panoscope_graph::GraphText;
use serde_json::json;

use crate::terminal::{out, raw, stdout_color};
use crate::{End, probe};
use panoscope_eval::graph_file;

/// Arguments of `check`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Graph files.
    #[arg(required = true, value_name = "GRAPH")]
    graphs: Vec<PathBuf>,
    /// One JSON object per file: its name, whether it is fine, and all diagnostics.
    #[arg(long)]
    json: bool,
}

/// Checks every file, however many are wrong.
pub fn run(arguments: &Arguments) -> Result<End> {
    let mut end = End::Done;
    for path in &arguments.graphs {
        let name = path.display();
        let checked = GraphText::load(path).and_then(|text| {
            let ready = graph_file::ready(&text)?;
            // A model can only be judged by opening it.
            let mut diagnostics = ready.warnings.clone();
            diagnostics.extend(probe::models(path, &text, &ready));
            if diagnostics.has_errors() { Err(diagnostics) } else { Ok((ready, diagnostics)) }
        });
        let (facts, diagnostics) = match checked {
            Ok((ready, warnings)) => (Some((ready.graph.nodes.len(), ready.graph.edges.len())), warnings),
            Err(diagnostics) => (None, diagnostics),
        };
        if facts.is_none() {
            end = End::Wrong;
        }
        if arguments.json {
            out!("{}", json!({ "file": name.to_string(), "ok": facts.is_some(), "diagnostics": diagnostics }));
            continue;
        }
        raw(&diagnostics.render(stdout_color()));
        if let Some((nodes, edges)) = facts {
            out!("{name}: ok ({nodes} nodes, {edges} connections)");
        }
    }
    Ok(end)
}
