//! The user's operations on a graph, as edits of its text. Each is one undo step.

mod building;

use std::path::{Path, PathBuf};

use panoscope_graph::edit::{EditError, GraphEdit, OPENED_PARTS};
use panoscope_graph::{GraphText, NodeType};

use crate::document::Document;
use crate::folding::{opened, parent, position};
use crate::graph_view::{FRAMES, GraphView, NOTES, Wire};
use crate::history::Origin;
use crate::mark::Mark;
use crate::observe::Output;

pub use building::{NewWire, add_part, arrange_all, connect_all, is_placed_by_hand, wires_by_name, wires_to};

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
    let here = |node: &str| doc.view().flat().node(node).is_some();
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
    doc.edit_files(Origin::Hand, &format!("wire {from} to {node}.{input}"), None, |files, _| {
        files.connect((&from.node, &from.port), to, list, at)?;
        moved.map_or(Ok(()), |(node, input, index)| files.disconnect(node, input, index))
    })
}

/// Removes a wire.
pub fn unwire(doc: &mut Document, node: &str, input: &str, index: usize) -> Result<(), EditError> {
    let label = format!("unwire {node}.{input}");
    doc.edit_files(Origin::Hand, &label, None, |files, _| files.disconnect(node, input, index))
}

/// Removes nodes with all their wires. A node of a part is removed from the part's file; the file of a removed part stays.
pub fn remove(doc: &mut Document, nodes: &[String]) -> Result<(), EditError> {
    let label = format!("delete {}", nodes.join(", "));
    // A node goes with the part around it.
    let inside = |id: &&String| {
        let mut around = nodes.iter().filter(|part| id.strip_prefix(part.as_str()).is_some_and(|r| r.starts_with('/')));
        around.next().is_none()
    };
    doc.edit_files(Origin::Hand, &label, None, |files, parsed| {
        nodes.iter().filter(inside).try_for_each(|id| files.remove_node(id))?;
        let gone = |part: &str| nodes.iter().any(|id| within(part, id));
        set_opened(files.root()?, parsed, |open| open.retain(|part| !gone(part)));
        Ok(())
    })
}

/// A name that no node of a part has, or no node of the graph where `part` is empty: `base`, `base_2`, ...
pub fn free_name(view: &GraphView, part: &str, base: &str) -> String {
    let mut names = std::iter::once(base.to_owned()).chain((2..).map(|k| format!("{base}_{k}")));
    names.find(|name| !view.is_taken(&whole(part, name))).unwrap_or_default()
}

/// The whole name of a node of a part.
fn whole(part: &str, name: &str) -> String {
    if part.is_empty() { name.to_owned() } else { format!("{part}/{name}") }
}

/// Whether a node is `part` or inside it.
fn within(id: &str, part: &str) -> bool {
    id.strip_prefix(part).is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
}

/// A name without a number at its end.
fn stem(name: &str) -> &str {
    let stem = name.trim_end_matches(|c: char| c.is_ascii_digit());
    if stem.len() < name.len() && stem.ends_with('_') { stem.trim_end_matches('_') } else { name }
}

/// Copies nodes and returns the names of the copies: beside the position that is given, else laid out with the others. Wires between the nodes
/// connect their copies; other wires are copied.
pub fn duplicate(doc: &mut Document, nodes: &[(String, Option<(f32, f32)>)]) -> Result<Vec<String>, EditError> {
    let view = doc.view().clone();
    let mut copies: Vec<(String, String)> = Vec::new();
    for (id, _) in nodes {
        let (part, name) = (parent(id), id.rsplit('/').next().unwrap_or(id));
        let taken = |copy: &str| view.is_taken(copy) || copies.iter().any(|(_, known)| known == copy);
        let mut numbered = (2..).map(|k| whole(part, &format!("{}_{k}", stem(name))));
        copies.push((id.clone(), numbered.find(|copy| !taken(copy)).unwrap_or_default()));
    }
    let copy_of = |id: &str| copies.iter().find(|(old, _)| old == id).map(|(_, new)| new.as_str());
    doc.edit_files(Origin::Hand, "duplicate", None, |files, _| {
        for ((id, copy), (_, at)) in copies.iter().zip(nodes) {
            files.duplicate_node(id, copy.rsplit('/').next().unwrap_or(copy))?;
            if let Some((x, y)) = at {
                files.root()?.set_position(copy, f64::from(*x + 40.0), f64::from(*y + 40.0));
            }
        }
        for wire in &view.wires {
            let (from, to) = (view.nodes[wire.from].id(), view.nodes[wire.to].id());
            if let (Some(from), Some(to)) = (copy_of(from), copy_of(to)) {
                let list = is_list(&view, view.nodes[wire.to].id(), &wire.input);
                files.connect((from, &wire.output), (to, &wire.input), list, wire.index)?;
            }
        }
        Ok(())
    })?;
    Ok(copies.into_iter().map(|(_, copy)| copy).collect())
}

/// The text of nodes, to be pasted into this graph or another one.
pub fn copy(doc: &Document, nodes: &[String]) -> Result<String, EditError> {
    let mut copied = GraphEdit::parse("")?;
    let view = doc.view();
    for node_type in
        nodes.iter().filter_map(|id| view.nodes[view.node(id)?].node_type.as_ref().filter(|t| t.plugin != PART))
    {
        copied.add_plugin(&node_type.plugin)?;
    }
    doc.read_files(|files| {
        for id in nodes {
            let (edit, name) = files.entry(id)?;
            copied.paste_nodes(edit, &[(name.clone(), name)])?;
        }
        Ok(())
    })?;
    Ok(copied.text())
}

/// Adds nodes from copied text, beside each other from `at` on, else laid out with the others; returns their names.
pub fn paste(doc: &mut Document, text: &str, at: Option<(f32, f32)>) -> Result<Vec<String>, EditError> {
    let view = doc.view().clone();
    let part = GraphEdit::parse(text)?;
    let mut names: Vec<(String, String)> = Vec::new();
    for id in part.node_names() {
        let taken = |name: &str| view.is_taken(name) || names.iter().any(|(_, new)| new == name);
        let others = (2..).map(|k| format!("{}_{k}", stem(&id)));
        let new = std::iter::once(id.clone()).chain(others).find(|name| !taken(name)).unwrap_or_default();
        names.push((id, new));
    }
    let plugins = GraphText::parse("pasted".as_ref(), text).plugins();
    doc.edit("paste", None, |edit| {
        plugins.iter().try_for_each(|plugin| edit.add_plugin(plugin))?;
        edit.paste_nodes(&part, &names)?;
        for (k, (_, new)) in names.iter().enumerate() {
            if let Some((x, y)) = at {
                edit.set_position(new, f64::from(x) + 240.0 * k as f64, f64::from(y));
            }
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
    doc.edit_files(Origin::Hand, label, None, |files, _| {
        for ((node, input, index), from) in wires {
            files.connect((&from.node, &from.port), (node, input), is_list(&view, node, input), *index)?;
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

/// Adds a node to a part, or to the graph where `part` is empty; connects it to the end of a wire if there is one, and returns its whole name.
/// Without a position it is laid out with the others.
pub fn add(
    doc: &mut Document,
    part: &str,
    node_type: &NodeType,
    at: Option<(f32, f32)>,
    pending: Option<&PendingWire>,
) -> Result<String, EditError> {
    let view = doc.view().clone();
    let name = free_name(&view, part, &node_type.name);
    let id = whole(part, &name);
    // Two plugins may have node types of the same name.
    let twins = doc.catalog().node_types.iter().filter(|t| t.name == node_type.name && t.plugin != node_type.plugin);
    let type_name =
        if twins.count() == 0 { node_type.name.clone() } else { format!("{}/{}", node_type.plugin, node_type.name) };
    let port = pending.and_then(|w| Some((w, fitting_port(&view, node_type, w)?)));
    doc.edit_files(Origin::Hand, &format!("add {id}"), None, |files, _| {
        files.add_node(part, &name, &type_name, &node_type.plugin)?;
        if let Some((x, y)) = at {
            files.root()?.set_position(&id, f64::from(x), f64::from(y));
        }
        match port {
            Some((PendingWire::Output(output), port)) => {
                let list = node_type.inputs.iter().any(|p| p.name == port && p.list);
                files.connect((&output.node, &output.port), (&id, &port), list, 0)
            }
            Some((PendingWire::Input(node, input), port)) => {
                let list = is_list(&view, node, input);
                let end = view.node(node).map_or(0, |n| view.wires_into(n, input).count());
                files.connect((&id, &port), (node, input), list, if list { end } else { 0 })
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
    let from = (view.nodes[wire.from].id(), wire.output.as_str());
    doc.edit_files(Origin::Hand, &format!("insert {id}"), None, |files, _| {
        files.connect(from, (id, &takes.name), takes.list, 0)?;
        files.connect((id, &gives.name), (consumer, input), wants.list, index)
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

/// Renames a node in all files; returns its new whole name.
pub fn rename(doc: &mut Document, old: &str, new: &str) -> Result<String, EditError> {
    doc.edit_files(Origin::Hand, &format!("rename {old} to {new}"), None, |files, parsed| {
        let renamed = files.rename_node(old, new)?;
        set_opened(files.root()?, parsed, |open| {
            for part in open.iter_mut().filter(|part| within(part, old)) {
                *part = format!("{renamed}{}", &part[old.len()..]);
            }
        });
        Ok(renamed)
    })
}

/// The plugin of the types of folded parts.
const PART: &str = "part";

/// Changes the list of opened parts in `[editor]`.
fn set_opened(edit: &mut GraphEdit, parsed: &GraphText, change: impl FnOnce(&mut Vec<String>)) {
    let before: Vec<String> = opened(parsed.editor()).into_iter().collect();
    let mut open = before.clone();
    change(&mut open);
    open.sort();
    open.dedup();
    if open != before {
        let list = toml::Value::from(open);
        edit.set_editor(OPENED_PARTS, Some(&list).filter(|list| list.as_array().is_some_and(|l| !l.is_empty())));
    }
}

/// Opens a part, so that its nodes are shown in a frame, or folds it.
pub fn set_open(doc: &mut Document, part: &str, open: bool) -> Result<(), EditError> {
    let label = format!("{} {part}", if open { "open" } else { "fold" });
    doc.edit_files(Origin::Hand, &label, None, |files, parsed| {
        set_opened(files.root()?, parsed, |list| match open {
            true => list.push(part.to_owned()),
            false => list.retain(|known| known != part),
        });
        Ok(())
    })
}

/// Where the file of a new part goes: `parts/NAME.toml` beside the graph, or beside the graph itself where that is a part.
pub fn part_file(doc: &Document, name: &str) -> PathBuf {
    let folder = doc.path().parent().unwrap_or(Path::new(""));
    let inside = folder.file_name().is_some_and(|name| name == "parts");
    let folder = if inside { folder.to_owned() } else { folder.join("parts") };
    folder.join(format!("{name}.toml"))
}

/// Moves nodes into the file of a new part, and puts the part in their place; returns its whole name. The file is written when the graph is saved.
pub fn make_part(doc: &mut Document, nodes: &[String], name: &str) -> Result<String, EditError> {
    let (catalog, file) = (doc.catalog().clone(), part_file(doc, name));
    doc.edit_files(Origin::Hand, &format!("make part {name}"), None, |files, parsed| {
        let id = files.make_part(&catalog, nodes, name, &file)?;
        let editor = parsed.editor();
        let places: Vec<(&String, (f32, f32))> =
            nodes.iter().filter_map(|node| Some((node, position(editor, node)?))).collect();
        let corner = places.iter().map(|(_, at)| *at).reduce(|a, b| (a.0.min(b.0), a.1.min(b.1)));
        let root = files.root()?;
        for node in nodes {
            let moved = format!("{id}/{}", node.rsplit('/').next().unwrap_or(node));
            root.rename_positions(node, &moved);
        }
        if let Some(corner) = corner {
            for (node, (x, y)) in places {
                let moved = format!("{id}/{}", node.rsplit('/').next().unwrap_or(node));
                root.set_position(&moved, f64::from(x - corner.0), f64::from(y - corner.1));
            }
            root.set_position(&id, f64::from(corner.0), f64::from(corner.1));
        }
        // Parts among the nodes stay opened.
        set_opened(files.root()?, parsed, |open| {
            for part in open.iter_mut() {
                if let Some(node) = nodes.iter().find(|node| within(part, node)) {
                    *part = format!("{id}/{}{}", node.rsplit('/').next().unwrap_or(node), &part[node.len()..]);
                }
            }
        });
        Ok(id)
    })
}

/// Puts the nodes of a part in its place; returns their whole names. The part's file stays.
pub fn dissolve(doc: &mut Document, part: &str) -> Result<Vec<String>, EditError> {
    let catalog = doc.catalog().clone();
    doc.edit_files(Origin::Hand, &format!("dissolve {part}"), None, |files, parsed| {
        let names = files.dissolve(&catalog, part)?;
        let editor = parsed.editor();
        let corner = position(editor, part);
        let root = files.root()?;
        root.set_editor(part, None);
        for (old, new) in &names {
            root.rename_positions(old, new);
            match (corner, position(editor, old)) {
                (Some(corner), Some((x, y))) => {
                    root.set_position(new, f64::from(x + corner.0), f64::from(y + corner.1))
                }
                _ => root.set_editor(new, None),
            }
        }
        set_opened(files.root()?, parsed, |open| {
            open.retain(|known| known != part);
            for known in open.iter_mut() {
                if let Some((old, new)) = names.iter().find(|(old, _)| within(known, old)) {
                    *known = format!("{new}{}", &known[old.len()..]);
                }
            }
        });
        Ok(names.into_iter().map(|(_, new)| new).collect())
    })
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
