//! The part of a graph that a measure needs.

use panoscope_graph::Graph;
use toml::{Table, Value};

use super::error::PartError;

/// Names in a sentence.
pub(super) fn list(names: &[&str]) -> String {
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

pub(super) fn no_node(graph: &Graph, id: &str) -> String {
    let ids: Vec<&str> = graph.nodes.iter().map(|n| n.id.as_str()).collect();
    format!("there is no node `{id}`; nodes are {}", list(&ids))
}

/// Which nodes a node needs: itself, and all that it reads, however far.
pub(super) fn needed(graph: &Graph, node: usize) -> Vec<bool> {
    let mut needed = vec![false; graph.nodes.len()];
    let mut open = vec![node];
    while let Some(node) = open.pop() {
        if !std::mem::replace(&mut needed[node], true) {
            open.extend(graph.inputs_of(node).iter().map(|edge| edge.from_node));
        }
    }
    needed
}

/// The text of a graph with only these nodes, in batch.
pub(super) fn text(whole: &str, graph: &Graph, kept: &[bool]) -> Result<String, PartError> {
    let mut table: Table = whole.parse()?;
    table.remove("preset");
    table.remove("editor");
    table.insert("mode".to_owned(), "batch".into());
    if let Some(nodes) = table.get_mut("nodes").and_then(Value::as_table_mut) {
        nodes.retain(|id, _| graph.node(id).is_some_and(|node| kept[node]));
    }
    Ok(toml::to_string(&table)?)
}
