//! `panoscope check`.

use std::path::PathBuf;

use anyhow::Result;
use panoscope_graph::{Arg, GraphOptions, GraphText, Listening, listening};
use panoscope_host::loader::graph_file::Ready;
use serde_json::json;

use crate::given::Given;
use crate::terminal::{out, raw, stdout_color};
use crate::trust::OwnPlugins;
use crate::{End, models};

/// Arguments of `check`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Graph files.
    #[arg(required = true, value_name = "GRAPH")]
    graphs: Vec<PathBuf>,
    #[command(flatten)]
    given: Given,
    #[command(flatten)]
    own_plugins: OwnPlugins,
    /// One JSON object per file: its name, whether it is fine, and all diagnostics.
    #[arg(long)]
    json: bool,
}

/// The report of a correct graph.
struct Facts {
    nodes: usize,
    edges: usize,
    /// Options of arguments without a value; nodes that depend on them were not checked.
    missing: Vec<String>,
    listening: Vec<Listening>,
}

impl Facts {
    fn of(ready: &Ready) -> Self {
        let missing = |arg: &&Arg| ready.text.missing_args().contains(&arg.name.as_str());
        Self {
            nodes: ready.graph.nodes.len(),
            edges: ready.graph.edges.len(),
            missing: ready.text.args().iter().filter(missing).map(Arg::option).collect(),
            listening: listening(&ready.graph, &ready.catalog),
        }
    }
}

/// Checks every file, even after errors.
pub fn run(arguments: &Arguments) -> Result<End> {
    let mut end = End::Done;
    for path in &arguments.graphs {
        let name = path.display();
        let options = GraphOptions { allow_missing_args: true, ..arguments.given.options(&[]) };
        let checked = GraphText::load_with(path, &options).and_then(|text| {
            let ready = arguments.own_plugins.ready(&text)?;
            // A model can only be judged by opening it.
            let mut diagnostics = ready.warnings.clone();
            diagnostics.extend(models::check(path, &text, &ready));
            if diagnostics.has_errors() { Err(diagnostics) } else { Ok((ready, diagnostics)) }
        });
        let (facts, diagnostics) = match checked {
            Ok((ready, warnings)) => (Some(Facts::of(&ready)), warnings),
            Err(diagnostics) => (None, diagnostics),
        };
        if facts.is_none() {
            end = End::Wrong;
        }
        if arguments.json {
            let ok = facts.is_some();
            let missing = facts.map(|f| f.missing).unwrap_or_default();
            out!(
                "{}",
                json!({ "file": name.to_string(), "ok": ok, "missing_args": missing, "diagnostics": diagnostics })
            );
            continue;
        }
        raw(&diagnostics.render(stdout_color()));
        if let Some(Facts { nodes, edges, missing, listening }) = facts {
            let missing = match missing.is_empty() {
                true => String::new(),
                false => format!("; to run it needs {}", missing.join(", ")),
            };
            out!("{name}: ok ({nodes} nodes, {edges} connections{missing})");
            for one in listening {
                out!("  `{}` ({}) listens at {}: {}", one.node, one.type_name, one.at, one.reach());
            }
        }
    }
    Ok(end)
}
