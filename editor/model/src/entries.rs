//! What the entries of a graph's files give: parameters, pins, and the nodes that diagnostics are about.

use std::collections::HashMap;

use panoscope_graph::{Diagnostic, GraphText};

use crate::graph_view::{GraphView, NodeView};

/// Parameters that the files give, by node or part.
pub(crate) fn params_of(text: &GraphText) -> HashMap<String, toml::Table> {
    let nodes = text.outline().into_iter().map(|n| (n.id, n.params));
    nodes.chain(text.parts().into_iter().map(|p| (p.id, p.given_params))).collect()
}

/// Parameters that the preset pins: node, parameter, label.
pub(crate) fn pins_of(text: &str, parsed: &GraphText, view: &GraphView) -> Vec<(String, String, String)> {
    let Ok(table) = text.parse::<toml::Table>() else { return Vec::new() };
    let pins = table.get("preset").and_then(|p| p.get("pinned")).and_then(toml::Value::as_array);
    let pin = |pin: &toml::Value| {
        let written = pin.get("param")?.as_str()?;
        let (node, param) = written.split_once('.')?;
        let label = pin.get("label").and_then(toml::Value::as_str).unwrap_or(param).to_owned();
        let whole = if view.node(node).is_some() { written.to_owned() } else { parsed.resolve_param(written) };
        let (node, param) = whole.split_once('.')?;
        Some((node.to_owned(), param.to_owned(), label))
    };
    pins.into_iter().flatten().filter_map(pin).collect()
}

/// The nodes that a diagnostic is about: those whose entry in the diagnostic's file it is in.
pub(crate) fn nodes_of(parsed: &GraphText, view: &GraphView, diagnostic: &Diagnostic) -> Vec<String> {
    let files = parsed.files();
    let Some(file) = files.iter().find(|f| f.path == diagnostic.file) else { return Vec::new() };
    let lines: Vec<&str> = file.text.lines().take(diagnostic.line).collect();
    let header = lines.iter().rev().find(|line| line.starts_with('['));
    let name = header.and_then(|line| line.trim_start_matches('[').split(']').next()?.strip_prefix("nodes."));
    let Some(name) = name.and_then(|inside| inside.split('.').next()) else { return Vec::new() };
    let (name, key) = (name.trim_matches('"'), file.key());
    let is = |id: &&str| parsed.node_home(id).is_some_and(|home| home.local == name && home.file == key);
    let mut found: Vec<String> = view.nodes.iter().map(NodeView::id).filter(is).map(str::to_owned).collect();
    // An entry of a part: its nodes carry the mistake, and the part shows it while it is folded.
    for part in parsed.parts().iter().filter(|p| is(&p.id.as_str())) {
        let inside = view.nodes.iter().find(|n| n.id().strip_prefix(&part.id).is_some_and(|r| r.starts_with('/')));
        found.extend(inside.map(|n| n.id().to_owned()));
    }
    found
}
