//! References between nodes of a graph as a TOML table.

use std::collections::BTreeSet;

use toml::{Table, Value};

/// The output that an input reads, as `node.port`.
pub fn from(value: &Value) -> Option<&str> {
    match value {
        Value::String(text) => Some(text),
        Value::Table(table) => table.get("from")?.as_str(),
        _ => None,
    }
}

/// The node of `node.port`.
pub fn node_of(reference: &str) -> &str {
    reference.split_once('.').map_or(reference, |(node, _)| node)
}

/// Type of a node, without the name of its plugin.
pub fn kind_of(node: &Value) -> &str {
    let name = node.get("type").and_then(Value::as_str).unwrap_or_default();
    name.rsplit('/').next().unwrap_or(name)
}

/// Makes a graph process every frame, without what only windows need, and returns its nodes; `None` if it has none.
pub fn for_evaluation(graph: &mut Table) -> Option<&mut Table> {
    graph.remove("preset");
    graph.remove("editor");
    graph.insert("mode".to_owned(), "batch".into());
    graph.get_mut("nodes")?.as_table_mut()
}

/// Removes the nodes that write files or show a preview.
pub fn remove_sinks(nodes: &mut Table) {
    nodes.retain(|_, node| !kind_of(node).starts_with("write_") && kind_of(node) != "preview");
}

/// All outputs that a node reads.
pub fn references(node: &Value) -> Vec<String> {
    let inputs = node.get("inputs").and_then(Value::as_table);
    let mut all = Vec::new();
    for value in inputs.into_iter().flat_map(Table::values) {
        match value {
            Value::Array(list) => all.extend(list.iter().filter_map(from).map(str::to_owned)),
            one => all.extend(from(one).map(str::to_owned)),
        }
    }
    all
}

/// Names of all nodes upstream of these outputs, up to the node `stop`, exclusive.
pub fn upstream(nodes: &Table, outputs: &[&str], stop: Option<&str>) -> BTreeSet<String> {
    let mut all = BTreeSet::new();
    let mut next: Vec<String> = outputs.iter().map(|output| node_of(output).to_owned()).collect();
    while let Some(id) = next.pop() {
        if stop == Some(id.as_str()) {
            continue;
        }
        let inputs = nodes.get(&id).map(references).unwrap_or_default();
        next.extend(inputs.iter().map(|r| node_of(r).to_owned()).filter(|n| !all.contains(n)));
        all.insert(id);
    }
    all
}
