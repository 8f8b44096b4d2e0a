//! Reads parameters from TOML text, with the checks and messages of a graph file.

use std::path::Path;

use panoscope_graph::{Catalog, GraphText, NodeType, ParamValue, Severity, check};

use super::error::HarnessError;

/// Lines of the generated graph before the test's text.
const HEAD_LINES: usize = 3;

/// Checks `toml`, the text under `[nodes.NAME]` of a graph file, as far as it concerns parameters.
pub(super) fn read(node_type: &NodeType, graph_dir: &Path, toml: &str) -> Result<Vec<ParamValue>, HarnessError> {
    let plugin = &node_type.plugin;
    let text = format!("plugins = [\"{plugin}\"]\n[nodes.node]\ntype = \"{}\"\n{toml}", node_type.name);
    // Tests give inputs by hand, so the graph is checked without connections. The node's own check runs in `open`.
    let alone = NodeType { inputs: Vec::new(), source: true, side_effects: true, validator: None, ..node_type.clone() };
    let catalog = Catalog { plugins: vec![plugin.clone()], node_types: vec![alone], ..Catalog::default() };
    let checked = check(&GraphText::parse(&graph_dir.join("node.toml"), &text), &catalog);
    if let Some(graph) = checked.graph {
        return Ok(graph.nodes.into_iter().next().map(|node| node.params).unwrap_or_default());
    }
    let mut rendered = String::new();
    for diagnostic in checked.diagnostics.iter().filter(|d| d.severity == Severity::Error) {
        let mut shown = diagnostic.clone();
        shown.file = "node.toml".to_owned();
        shown.line = shown.line.saturating_sub(HEAD_LINES);
        shown.notes.iter_mut().for_each(|note| note.line = note.line.saturating_sub(HEAD_LINES));
        rendered.push_str(&shown.render(false));
    }
    Err(HarnessError::Params { rendered })
}
