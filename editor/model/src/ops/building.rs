//! Larger steps of building a graph: shipped parts, all wires of a node by the names of its ports, nodes arranged anew.

use std::collections::BTreeSet;
use std::path::Path;

use panoscope_graph::edit::{EditError, GraphEdit};

use super::{free_name, is_list};
use crate::document::Document;
use crate::folding::parent;
use crate::graph_view::GraphView;
use crate::history::Origin;
use crate::observe::Output;

/// A wire that can be added: an output, and the node and input that will read it.
pub type NewWire = (Output, (String, String));

/// Names and positions of all nodes and opened parts that are shown.
fn placed(view: &GraphView) -> impl Iterator<Item = (&str, Option<(f32, f32)>)> {
    let nodes = view.nodes.iter().map(|node| (node.id(), node.position));
    nodes.chain(view.parts.iter().map(|part| (part.id.as_str(), part.position)))
}

/// Whether any node of a part, or of the graph where `part` is empty, has a position in the file. Else all of them are laid out automatically.
pub fn is_placed_by_hand(view: &GraphView, part: &str) -> bool {
    placed(view).any(|(id, position)| position.is_some() && parent(id) == part)
}

/// Takes the positions of all nodes out of the file, so that they are laid out automatically; returns how many there were.
pub fn arrange_all(doc: &mut Document) -> Result<usize, EditError> {
    let view = doc.view().clone();
    let inside = view.flat().nodes.iter().map(|node| (node.id(), node.position));
    let all = placed(&view).chain(inside).filter(|(_, position)| position.is_some());
    let placed: BTreeSet<&str> = all.map(|(id, _)| id).collect();
    if !placed.is_empty() {
        doc.edit("arrange all", None, |edit| {
            placed.iter().for_each(|id| edit.set_editor(id, None));
            Ok(())
        })?;
    }
    Ok(placed.len())
}

/// The wires that give each unconnected input of a node an output of the same name that fits. Of several producers the one latest in the flow counts:
/// what was made of a source's outputs, and not those themselves; then the one with most of the names, then the last one in the file.
pub fn wires_by_name(view: &GraphView, node: usize) -> Vec<NewWire> {
    let (free, depth) = (free_inputs(view, node), depths(view));
    let gives = |from: usize| free.iter().filter(|input| view.check_wire(from, input, node, input).is_ok()).count();
    let mut producers: Vec<(usize, usize, usize)> =
        (0..view.nodes.len()).filter(|from| *from != node).map(|from| (depth[from], gives(from), from)).collect();
    producers.retain(|(_, count, _)| *count > 0);
    producers.sort_by(|a, b| b.cmp(a));
    let wire = |input: &String| {
        let (.., from) = producers.iter().find(|(.., from)| view.check_wire(*from, input, node, input).is_ok())?;
        Some((Output::new(view.nodes[*from].id(), input), (view.nodes[node].id().to_owned(), input.clone())))
    };
    free.iter().filter_map(wire).collect()
}

/// Number of nodes before each one on the longest path from a source. Loops count once around at most.
fn depths(view: &GraphView) -> Vec<usize> {
    let mut depth = vec![0; view.nodes.len()];
    for _ in 0..view.nodes.len() {
        let mut changed = false;
        for wire in view.wires.iter().filter(|wire| !wire.delayed) {
            let after = (depth[wire.from] + 1).min(view.nodes.len());
            changed |= depth[wire.to] < after;
            depth[wire.to] = depth[wire.to].max(after);
        }
        if !changed {
            break;
        }
    }
    depth
}

/// The wires by which a node supplies unconnected inputs of another one whose names its outputs have.
pub fn wires_to(view: &GraphView, from: usize, to: usize) -> Vec<NewWire> {
    let fits = |input: &String| view.check_wire(from, input, to, input).is_ok();
    let wire = |input: String| (Output::new(view.nodes[from].id(), &input), (view.nodes[to].id().to_owned(), input));
    free_inputs(view, to).into_iter().filter(fits).map(wire).collect()
}

/// Names of the inputs of a node without a wire, in the order of the type.
fn free_inputs(view: &GraphView, node: usize) -> Vec<String> {
    let inputs = view.nodes[node].node_type.iter().flat_map(|t| &t.inputs);
    let names = inputs.map(|port| port.name.clone());
    names.filter(|name| view.wires_into(node, name).next().is_none()).collect()
}

/// Adds wires as one undo step. An input that takes a list gets one entry more.
pub fn connect_all(doc: &mut Document, wires: &[NewWire]) -> Result<(), EditError> {
    let view = doc.view().clone();
    let inputs: Vec<String> = wires.iter().map(|(_, (node, input))| format!("{node}.{input}")).collect();
    doc.edit_files(Origin::Hand, &format!("connect {}", inputs.join(", ")), None, |files, _| {
        wires.iter().try_for_each(|(from, (node, input))| {
            let end = view.node(node).map_or(0, |n| view.wires_into(n, input).count());
            let list = is_list(&view, node, input);
            files.connect((&from.node, &from.port), (node, input), list, if list { end } else { 0 })
        })
    })
}

/// Adds a part to the graph by its file, relative to the graph's folder or absolute; returns its name. Without a position it is laid out with the
/// other nodes.
pub fn add_part(doc: &mut Document, file: &Path, at: Option<(f32, f32)>) -> Result<String, EditError> {
    let base = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let id = free_name(doc.view(), "", &base);
    let graph = toml::Value::from(file.to_string_lossy().into_owned());
    let added = GraphEdit::parse(&format!("[nodes.part]\ngraph = {graph}\n"))?;
    doc.edit(&format!("add {id}"), None, |edit| {
        edit.paste_nodes(&added, &[("part".to_owned(), id.clone())])?;
        if let Some((x, y)) = at {
            edit.set_position(&id, f64::from(x), f64::from(y));
        }
        Ok(())
    })?;
    Ok(id)
}
