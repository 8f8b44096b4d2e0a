//! Reduces a graph to the part that a measure needs.

use panoscope_graph::{Catalog, Graph};
use toml::Table;

use super::error::{PartError, SweepError};
use crate::inputs::references::for_evaluation;

/// Joins names for a sentence.
pub(super) fn list(names: &[&str]) -> String {
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

pub(super) fn no_node(graph: &Graph, id: &str) -> String {
    let ids: Vec<&str> = graph.nodes.iter().map(|n| n.id.as_str()).collect();
    format!("there is no node `{id}`; nodes are {}", list(&ids))
}

/// For each node, whether it is one of `nodes` or upstream of one.
pub(super) fn needed(graph: &Graph, nodes: &[usize]) -> Vec<bool> {
    let mut needed = vec![false; graph.nodes.len()];
    let mut open = nodes.to_vec();
    while let Some(node) = open.pop() {
        if !std::mem::replace(&mut needed[node], true) {
            open.extend(graph.inputs_of(node).iter().map(|edge| edge.from_node));
        }
    }
    needed
}

/// Refuses a part of a graph with side effects.
pub(super) fn refuse_acting(graph: &Graph, catalog: &Catalog, kept: &[bool], measure: &str) -> Result<(), SweepError> {
    let acts = |n: &usize| kept[*n] && graph.nodes[*n].node_type(catalog).side_effects;
    match (0..graph.nodes.len()).find(acts) {
        Some(acting) => Err(SweepError::Acts { measure: measure.to_owned(), node: graph.nodes[acting].id.clone() }),
        None => Ok(()),
    }
}

/// The text of a graph with only these nodes, in batch.
pub(super) fn text(whole: &str, graph: &Graph, kept: &[bool]) -> Result<String, PartError> {
    let mut table: Table = whole.parse()?;
    if let Some(nodes) = for_evaluation(&mut table) {
        nodes.retain(|id, _| graph.node(id).is_some_and(|node| kept[node]));
    }
    Ok(toml::to_string(&table)?)
}
