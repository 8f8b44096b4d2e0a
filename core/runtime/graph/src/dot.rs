//! A checked graph as Graphviz text.

use crate::catalog::{Catalog, NodeKind};
use crate::checked::{Align, Edge, Graph};
use std::fmt::Write as _;

/// Graphviz text of a graph: nodes as records with their ports, edges labelled with what is not the default. The
/// catalog must be the one the graph was checked against.
pub fn to_dot(graph: &Graph, catalog: &Catalog) -> String {
    let mut out = String::new();
    let _ = writeln!(out, "digraph {} {{", quoted(&graph.name));
    out.push_str("    rankdir = LR;\n    node [shape = record, fontname = \"sans-serif\", fontsize = 10];\n");
    out.push_str("    edge [fontname = \"sans-serif\", fontsize = 8];\n");
    let all: Vec<usize> = (0..graph.nodes.len()).collect();
    cluster(&mut out, graph, catalog, &all, "");
    for edge in &graph.edges {
        let _ = writeln!(
            out,
            "    n{}:o{} -> n{}:i{}{};",
            edge.from_node,
            edge.from_port,
            edge.to_node,
            edge.to_port,
            attributes(edge)
        );
    }
    out.push_str("}\n");
    out
}

/// Writes nodes whose names begin with `prefix`; those of nested parts go into separate clusters.
fn cluster(out: &mut String, graph: &Graph, catalog: &Catalog, nodes: &[usize], prefix: &str) {
    let indent = "    ".repeat(1 + prefix.matches('/').count());
    let mut parts: Vec<&str> = Vec::new();
    let mut groups: Vec<&str> = Vec::new();
    for &index in nodes {
        let local = &graph.nodes[index].id[prefix.len()..];
        match local.split_once('/') {
            None => match graph.nodes[index].isolate.as_deref() {
                None => write_node(out, graph, catalog, index, local, &indent),
                Some(group) if groups.contains(&group) => {}
                Some(group) => {
                    groups.push(group);
                    let name = quoted(&format!("cluster_process_{prefix}{group}"));
                    let what = if graph.nodes[index].machine.is_some() { "machine" } else { "process" };
                    let label = quoted(&format!("{what} {group}"));
                    let _ = writeln!(out, "{indent}subgraph {name} {{\n{indent}    label = {label}; style = dashed;");
                    for &node in nodes.iter().filter(|&&n| graph.nodes[n].isolate.as_deref() == Some(group)) {
                        let local = &graph.nodes[node].id[prefix.len()..];
                        if !local.contains('/') {
                            write_node(out, graph, catalog, node, local, &format!("{indent}    "));
                        }
                    }
                    let _ = writeln!(out, "{indent}}}");
                }
            },
            Some((part, _)) if parts.contains(&part) => {}
            Some((part, _)) => {
                parts.push(part);
                let inner = format!("{prefix}{part}/");
                let inside: Vec<usize> =
                    nodes.iter().copied().filter(|&n| graph.nodes[n].id.starts_with(&inner)).collect();
                let name = quoted(&format!("cluster_{prefix}{part}"));
                let _ = writeln!(out, "{indent}subgraph {name} {{\n{indent}    label = {};", quoted(part));
                cluster(out, graph, catalog, &inside, &inner);
                let _ = writeln!(out, "{indent}}}");
            }
        }
    }
}

fn write_node(out: &mut String, graph: &Graph, catalog: &Catalog, index: usize, name: &str, indent: &str) {
    let node = &graph.nodes[index];
    let node_type = node.node_type(catalog);
    let used = |port: usize| graph.inputs_of(index).iter().any(|e| e.to_port == port);
    let inputs: Vec<String> = (0..node_type.inputs.len())
        .filter(|&p| used(p))
        .map(|p| format!("<i{p}> {}", escaped(&node_type.inputs[p].name)))
        .collect();
    let read = |port: usize| graph.outputs_of(index).any(|e| e.from_port == port);
    let outputs: Vec<String> = (0..node_type.outputs.len())
        .filter(|&p| read(p))
        .map(|p| format!("<o{p}> {}", escaped(&node_type.outputs[p].name)))
        .collect();
    let mut columns = Vec::new();
    if !inputs.is_empty() {
        columns.push(format!("{{{}}}", inputs.join("|")));
    }
    columns.push(format!("{}\\n{}/{}", escaped(name), escaped(&node.plugin), escaped(&node.type_name)));
    if !outputs.is_empty() {
        columns.push(format!("{{{}}}", outputs.join("|")));
    }
    let style = match (node_type.source, node_type.side_effects || node_type.outputs.is_empty(), node_type.kind) {
        (true, _, _) => ", style = filled, fillcolor = \"#d8ecd8\"",
        (_, true, _) => ", style = filled, fillcolor = \"#f4e0cc\"",
        (_, _, NodeKind::Compute) => "",
        _ => ", style = filled, fillcolor = \"#dce4f4\"",
    };
    let _ = writeln!(out, "{indent}n{index} [label = \"{}\"{style}];", columns.join("|"));
}

fn attributes(edge: &Edge) -> String {
    let mut words = Vec::new();
    match edge.align {
        Align::Exact => {}
        Align::Latest => words.push("latest".to_owned()),
        Align::Nearest { tolerance_ms } => words.push(format!("nearest {tolerance_ms} ms")),
    }
    if let Some(max_age_ms) = edge.max_age_ms {
        words.push(format!("at most {max_age_ms} ms old"));
    }
    if edge.guide {
        words.push("guide".to_owned());
    }
    if edge.delay > 0 {
        words.push(format!("delay {}", edge.delay));
    }
    if edge.trigger {
        words.push("trigger".to_owned());
    }
    if edge.convert {
        words.push("to gray8".to_owned());
    }
    let style = match (edge.delay > 0, edge.align == Align::Exact) {
        (true, _) => Some("style = dashed, constraint = false"),
        (false, false) => Some("style = dotted"),
        (false, true) => None,
    };
    let label = (!words.is_empty()).then(|| format!("label = {}", quoted(&words.join(", "))));
    let parts: Vec<&str> = label.as_deref().into_iter().chain(style).collect();
    if parts.is_empty() { String::new() } else { format!(" [{}]", parts.join(", ")) }
}

fn quoted(text: &str) -> String {
    format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\""))
}

/// Text inside a record's label.
fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        if "\\\"{}|<> ".contains(c) {
            out.push('\\');
        }
        out.push(c);
    }
    out
}
