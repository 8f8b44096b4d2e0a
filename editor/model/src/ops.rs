//! The user's operations on a graph, as edits of its text. Each is one undo step.

use panoscope_graph::edit::{EditError, GraphEdit};
use panoscope_graph::{GraphText, NodeType};

use crate::document::Document;
use crate::graph_view::{FRAMES, GraphView, NOTES, Wire};
use crate::history::Origin;
use crate::mark::Mark;
use crate::observe::Output;

/// Sets a parameter; `None` removes it from the file, so that the default applies. Consecutive changes of one parameter are one undo step.
pub fn set_param(doc: &mut Document, node: &str, param: &str, value: Option<&toml::Value>) -> Result<(), EditError> {
    let label = format!("{node}.{param}");
    let merge = value.map(|_| label.clone());
    doc.edit_params(Origin::Hand, &label, merge.as_deref(), &[(node, param, value)])
}

/// Sets values so that exactly the first `at` changes of the history are applied, as one edit. Returns the number of values set.
///
/// # Errors
/// A node or parameter of the history no longer exists; nothing is changed.
pub fn step_to(doc: &mut Document, at: usize) -> Result<usize, EditError> {
    let values = doc.history().values_at(at);
    let here = |node: &str| doc.view().node(node).is_some();
    let values: Vec<_> = values.into_iter().filter(|(node, ..)| here(node)).collect();
    let changes: Vec<_> =
        values.iter().map(|(node, param, value)| (node.as_str(), param.as_str(), value.as_ref())).collect();
    doc.edit_params(Origin::History, "step through the history", None, &changes)?;
    doc.set_position(at);
    Ok(values.len())
}

fn is_list(view: &GraphView, node: &str, input: &str) -> bool {
    view.node(node).and_then(|n| view.nodes[n].input(input)).is_some_and(|p| p.list)
}

/// Connects an output to an input. A list input gets a new entry, or replaces the one at `index`; any other input replaces its wire. `moved`
/// is the connection that the wire was dragged from, which is removed.
pub fn wire(
    doc: &mut Document,
    from: &Output,
    to: (&str, &str),
    index: Option<usize>,
    moved: Option<(&str, &str, usize)>,
) -> Result<(), EditError> {
    let view = doc.view().clone();
    let (node, input) = to;
    let list = is_list(&view, node, input);
    let end = view.node(node).map_or(0, |n| view.wires_into(n, input).count());
    let at = if list { index.unwrap_or(end) } else { 0 };
    doc.edit(&format!("wire {from} to {node}.{input}"), None, |edit| {
        edit.connect(node, input, list, at, &from.to_string())?;
        moved.map_or(Ok(()), |(node, input, index)| edit.disconnect(node, input, index))
    })
}

/// Removes a wire.
pub fn unwire(doc: &mut Document, node: &str, input: &str, index: usize) -> Result<(), EditError> {
    doc.edit(&format!("unwire {node}.{input}"), None, |edit| edit.disconnect(node, input, index))
}

/// Removes nodes with all their wires.
pub fn remove(doc: &mut Document, nodes: &[String]) -> Result<(), EditError> {
    let label = format!("delete {}", nodes.join(", "));
    doc.edit(&label, None, |edit| nodes.iter().try_for_each(|id| edit.remove_node(id)))
}

/// A name that no node has: `base`, `base_2`, ...
pub fn free_name(view: &GraphView, base: &str) -> String {
    let mut names = std::iter::once(base.to_owned()).chain((2..).map(|k| format!("{base}_{k}")));
    names.find(|name| view.node(name).is_none()).unwrap_or_default()
}

/// A name without a number at its end.
fn stem(name: &str) -> &str {
    let stem = name.trim_end_matches(|c: char| c.is_ascii_digit());
    if stem.len() < name.len() && stem.ends_with('_') { stem.trim_end_matches('_') } else { name }
}

/// Copies nodes beside themselves and returns the names of the copies. Wires between the nodes connect their copies; other wires are copied.
pub fn duplicate(doc: &mut Document, nodes: &[(String, (f32, f32))]) -> Result<Vec<String>, EditError> {
    let view = doc.view().clone();
    let mut copies: Vec<(String, String)> = Vec::new();
    for (id, _) in nodes {
        let taken = |name: &str| view.node(name).is_some() || copies.iter().any(|(_, copy)| copy == name);
        let copy = (2..).map(|k| format!("{}_{k}", stem(id))).find(|name| !taken(name)).unwrap_or_default();
        copies.push((id.clone(), copy));
    }
    let copy_of = |id: &str| copies.iter().find(|(old, _)| old == id).map(|(_, new)| new.as_str());
    doc.edit("duplicate", None, |edit| {
        for ((id, copy), (_, (x, y))) in copies.iter().zip(nodes) {
            edit.duplicate_node(id, copy)?;
            edit.set_position(copy, f64::from(*x + 40.0), f64::from(*y + 40.0));
        }
        for wire in &view.wires {
            let (from, to) = (view.nodes[wire.from].id(), view.nodes[wire.to].id());
            if let (Some(from), Some(to)) = (copy_of(from), copy_of(to)) {
                let list = is_list(&view, view.nodes[wire.to].id(), &wire.input);
                edit.connect(to, &wire.input, list, wire.index, &format!("{from}.{}", wire.output))?;
            }
        }
        Ok(())
    })?;
    Ok(copies.into_iter().map(|(_, copy)| copy).collect())
}

/// The text of nodes, to be pasted into this graph or another one.
pub fn copy(doc: &Document, nodes: &[String]) -> Result<String, EditError> {
    let whole = GraphEdit::parse(doc.text())?;
    let mut part = GraphEdit::parse("")?;
    let view = doc.view();
    for node_type in nodes.iter().filter_map(|id| view.nodes[view.node(id)?].node_type.as_ref()) {
        part.add_plugin(&node_type.plugin)?;
    }
    let same: Vec<(String, String)> = nodes.iter().map(|id| (id.clone(), id.clone())).collect();
    part.paste_nodes(&whole, &same)?;
    Ok(part.text())
}

/// Adds nodes from copied text beside each other from `at` on; returns their names.
pub fn paste(doc: &mut Document, text: &str, at: (f32, f32)) -> Result<Vec<String>, EditError> {
    let view = doc.view().clone();
    let part = GraphEdit::parse(text)?;
    let mut names: Vec<(String, String)> = Vec::new();
    for id in part.node_names() {
        let taken = |name: &str| view.node(name).is_some() || names.iter().any(|(_, new)| new == name);
        let others = (2..).map(|k| format!("{}_{k}", stem(&id)));
        let new = std::iter::once(id.clone()).chain(others).find(|name| !taken(name)).unwrap_or_default();
        names.push((id, new));
    }
    let plugins = GraphText::parse("pasted".as_ref(), text).plugins();
    doc.edit("paste", None, |edit| {
        plugins.iter().try_for_each(|plugin| edit.add_plugin(plugin))?;
        edit.paste_nodes(&part, &names)?;
        for (k, (_, new)) in names.iter().enumerate() {
            edit.set_position(new, f64::from(at.0) + 240.0 * k as f64, f64::from(at.1));
        }
        Ok(())
    })?;
    Ok(names.into_iter().map(|(_, new)| new).collect())
}

/// The wire into a node that can replace its output in a bypass: same packet type, connected, not delayed.
fn stand_in<'v>(view: &'v GraphView, node: usize, output: &str) -> Option<&'v Wire> {
    let packet = &view.nodes[node].output(output)?.packet;
    let inputs = &view.nodes[node].node_type.as_ref()?.inputs;
    let fits = inputs.iter().filter(|p| p.packet.name == packet.name || packet.fits(&p.packet).is_ok());
    fits.filter_map(|p| view.wires.iter().find(|w| w.to == node && w.input == p.name && !w.delayed))
        .find(|w| view.packet(w.from, &w.output).is_some_and(|p| p.name == packet.name))
}

/// A wire that a bypass redirected around a node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Detour {
    /// Consumer, its input, index in a list.
    pub to: (String, String, usize),
    /// The output that it read before.
    pub was: Output,
    /// The output that it reads during the bypass.
    pub now: Output,
}

/// Why a node cannot be bypassed.
#[derive(Debug, thiserror::Error)]
pub enum BypassError {
    /// The node does not exist.
    #[error("there is no node `{node}`")]
    NoNode {
        /// The node.
        node: String,
    },
    /// An output that is read has no input of the same packet type.
    #[error("`{node}` cannot be bypassed: it has no connected input that can replace its output `{output}`")]
    NoReplacement {
        /// The node.
        node: String,
        /// The output.
        output: String,
    },
    /// No output of the node is read.
    #[error("`{node}` cannot be bypassed: no node reads its outputs")]
    NoReader {
        /// The node.
        node: String,
    },
    /// The edit does not fit the text.
    #[error(transparent)]
    Edit(#[from] EditError),
}

/// Redirects the readers of a node's outputs to the outputs that the node reads. The node stays in the file.
///
/// # Errors
/// See [`BypassError`]; nothing is changed.
pub fn bypass(doc: &mut Document, id: &str) -> Result<Vec<Detour>, BypassError> {
    let view = doc.view().clone();
    let node = view.node(id).ok_or_else(|| BypassError::NoNode { node: id.to_owned() })?;
    let mut detours = Vec::new();
    for wire in view.wires.iter().filter(|w| w.from == node && w.to != node) {
        let Some(instead) = stand_in(&view, node, &wire.output) else {
            return Err(BypassError::NoReplacement { node: id.to_owned(), output: wire.output.clone() });
        };
        detours.push(Detour {
            to: (view.nodes[wire.to].id().to_owned(), wire.input.clone(), wire.index),
            was: Output::new(id, &wire.output),
            now: Output::new(view.nodes[instead.from].id(), &instead.output),
        });
    }
    if detours.is_empty() {
        return Err(BypassError::NoReader { node: id.to_owned() });
    }
    rewire(doc, &format!("bypass {id}"), detours.iter().map(|d| (&d.to, &d.now)))?;
    Ok(detours)
}

/// Ends a bypass: restores the wires that are still as the bypass left them. Returns whether there were any.
pub fn end_bypass(doc: &mut Document, id: &str, detours: &[Detour]) -> Result<bool, EditError> {
    let view = doc.view().clone();
    let still = |d: &&Detour| {
        let at = view.node(&d.to.0);
        at.is_some_and(|n| {
            view.wires_into(n, &d.to.1)
                .any(|w| w.index == d.to.2 && view.nodes[w.from].id() == d.now.node && w.output == d.now.port)
        })
    };
    let back: Vec<&Detour> = detours.iter().filter(still).collect();
    rewire(doc, &format!("end bypass of {id}"), back.iter().map(|d| (&d.to, &d.was)))?;
    Ok(!back.is_empty())
}

/// Connects each input to its output, as one undo step.
fn rewire<'d>(
    doc: &mut Document,
    label: &str,
    wires: impl Iterator<Item = (&'d (String, String, usize), &'d Output)>,
) -> Result<(), EditError> {
    let view = doc.view().clone();
    doc.edit(label, None, |edit| {
        for ((node, input, index), from) in wires {
            edit.connect(node, input, is_list(&view, node, input), *index, &from.to_string())?;
        }
        Ok(())
    })
}

/// The existing end of a wire whose other end will be a new node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PendingWire {
    /// An output that the new node will read.
    Output(Output),
    /// An input (node, port) that will read the new node.
    Input(String, String),
}

/// The first port of a node type that fits the end of a wire.
pub fn fitting_port(view: &GraphView, node_type: &NodeType, pending: &PendingWire) -> Option<String> {
    let port = match pending {
        PendingWire::Output(output) => {
            let packet = view.packet(view.node(&output.node)?, &output.port)?;
            node_type.inputs.iter().find(|p| packet.fits(&p.packet).is_ok())
        }
        PendingWire::Input(node, input) => {
            let wants = &view.nodes[view.node(node)?].input(input)?.packet;
            node_type.outputs.iter().find(|p| p.packet.fits(wants).is_ok())
        }
    };
    port.map(|p| p.name.clone())
}

/// Adds a node, connects it to the end of a wire if there is one, and returns its name.
pub fn add(
    doc: &mut Document,
    node_type: &NodeType,
    at: (f32, f32),
    pending: Option<&PendingWire>,
) -> Result<String, EditError> {
    let view = doc.view().clone();
    let id = free_name(&view, &node_type.name);
    // Two plugins may have node types of the same name.
    let twins = doc.catalog().node_types.iter().filter(|t| t.name == node_type.name && t.plugin != node_type.plugin);
    let type_name =
        if twins.count() == 0 { node_type.name.clone() } else { format!("{}/{}", node_type.plugin, node_type.name) };
    let port = pending.and_then(|w| Some((w, fitting_port(&view, node_type, w)?)));
    doc.edit(&format!("add {id}"), None, |edit| {
        edit.add_plugin(&node_type.plugin)?;
        edit.add_node(&id, &type_name)?;
        edit.set_position(&id, f64::from(at.0), f64::from(at.1));
        match port {
            Some((PendingWire::Output(output), port)) => {
                let list = node_type.inputs.iter().any(|p| p.name == port && p.list);
                edit.connect(&id, &port, list, 0, &output.to_string())
            }
            Some((PendingWire::Input(node, input), port)) => {
                let list = is_list(&view, node, input);
                let end = view.node(node).map_or(0, |n| view.wires_into(n, input).count());
                edit.connect(node, input, list, if list { end } else { 0 }, &format!("{id}.{port}"))
            }
            None => Ok(()),
        }
    })?;
    Ok(id)
}

/// Why a node cannot be inserted into a wire.
#[derive(Debug, thiserror::Error)]
pub enum InsertError {
    /// A node does not exist.
    #[error("there is no node `{node}`")]
    NoNode {
        /// The node.
        node: String,
    },
    /// The wire no longer exists.
    #[error("the wire into `{node}.{input}` does not exist any more")]
    NoWire {
        /// The consumer.
        node: String,
        /// Its input.
        input: String,
    },
    /// The type of the node, or of a node at an end of the wire, is not known.
    #[error("the type of `{node}` is not known")]
    UnknownType {
        /// The node.
        node: String,
    },
    /// The node has no input or no output of the wire's packet type.
    #[error("`{node}` does not fit into a wire of {packet}")]
    NoFit {
        /// The node.
        node: String,
        /// Packet type of the wire.
        packet: String,
    },
    /// The edit does not fit the text.
    #[error(transparent)]
    Edit(#[from] EditError),
}

/// Inserts a node into a wire: it reads the wire's output, and the wire's input reads it.
///
/// # Errors
/// See [`InsertError`]; nothing is changed.
pub fn insert(doc: &mut Document, id: &str, to: (&str, &str, usize)) -> Result<(), InsertError> {
    let view = doc.view().clone();
    let (consumer, input, index) = to;
    let find = |id: &str| view.node(id).ok_or_else(|| InsertError::NoNode { node: id.to_owned() });
    let unknown = |node: usize| InsertError::UnknownType { node: view.nodes[node].id().to_owned() };
    let (node, end) = (find(id)?, find(consumer)?);
    let no_wire = || InsertError::NoWire { node: consumer.to_owned(), input: input.to_owned() };
    let wire = view.wires_into(end, input).find(|w| w.index == index).ok_or_else(no_wire)?;
    let packet = view.packet(wire.from, &wire.output).ok_or_else(|| unknown(wire.from))?;
    let wants = view.nodes[end].input(input).ok_or_else(|| unknown(end))?;
    let node_type = view.nodes[node].node_type.as_ref().ok_or_else(|| unknown(node))?;
    let takes = node_type.inputs.iter().find(|p| packet.fits(&p.packet).is_ok());
    let gives = node_type.outputs.iter().find(|p| p.packet.fits(&wants.packet).is_ok());
    let (Some(takes), Some(gives)) = (takes, gives) else {
        return Err(InsertError::NoFit { node: id.to_owned(), packet: packet.name.clone() });
    };
    let from = format!("{}.{}", view.nodes[wire.from].id(), wire.output);
    doc.edit(&format!("insert {id}"), None, |edit| {
        edit.connect(id, &takes.name, takes.list, 0, &from)?;
        edit.connect(consumer, input, wants.list, index, &format!("{id}.{}", gives.name))
    })?;
    Ok(())
}

/// Sets the positions of nodes in the file.
pub fn move_nodes(doc: &mut Document, places: &[(String, (f32, f32))]) -> Result<(), EditError> {
    put_nodes(doc, places, None)
}

/// As [`move_nodes`]; consecutive moves of the same nodes are one undo step.
pub fn nudge_nodes(doc: &mut Document, places: &[(String, (f32, f32))]) -> Result<(), EditError> {
    let names: Vec<&str> = places.iter().map(|(id, _)| id.as_str()).collect();
    put_nodes(doc, places, Some(&format!("nudge {}", names.join(" "))))
}

fn put_nodes(doc: &mut Document, places: &[(String, (f32, f32))], merge: Option<&str>) -> Result<(), EditError> {
    doc.edit("move", merge, |edit| {
        for (id, (x, y)) in places {
            edit.set_position(id, f64::from(*x), f64::from(*y));
        }
        Ok(())
    })
}

/// Renames a node everywhere in the file.
pub fn rename(doc: &mut Document, old: &str, new: &str) -> Result<(), EditError> {
    doc.edit(&format!("rename {old} to {new}"), None, |edit| edit.rename_node(old, new))
}

/// Replaces all frames and notes, and moves nodes with them.
pub fn set_marks(doc: &mut Document, marks: &[Mark], moved: &[(String, (f32, f32))]) -> Result<(), EditError> {
    let table = |mark: &Mark| {
        let mut table = toml::Table::new();
        table.insert("text".to_owned(), mark.text.as_str().into());
        let (w, h) = mark.size.unzip();
        let numbers = [("x", Some(mark.at.0)), ("y", Some(mark.at.1)), ("width", w), ("height", h)];
        for (key, value) in numbers {
            if let Some(value) = value {
                table.insert(key.to_owned(), f64::from(value).into());
            }
        }
        toml::Value::Table(table)
    };
    let list =
        |frames: bool| -> Vec<toml::Value> { marks.iter().filter(|m| m.size.is_some() == frames).map(table).collect() };
    doc.edit("frames and notes", None, |edit| {
        for (key, list) in [(FRAMES, list(true)), (NOTES, list(false))] {
            edit.set_editor(key, (!list.is_empty()).then(|| list.into()).as_ref());
        }
        moved.iter().for_each(|(id, (x, y))| edit.set_position(id, f64::from(*x), f64::from(*y)));
        Ok(())
    })
}
