//! What a user does to a graph, as edits of its text. No egui here. Each is one step of history.

use panoscope_graph::edit::{EditError, GraphEdit};
use panoscope_graph::{GraphText, NodeType};

use crate::document::{Document, FRAMES, NOTES, View, Wire};
use crate::history::By;
use crate::mark::Mark;
use crate::observe::Output;

/// Sets a parameter, or with `None` takes it out of the file. Changes of one parameter in a row are one step.
pub fn set_param(doc: &mut Document, node: &str, param: &str, value: Option<&toml::Value>) -> Result<(), EditError> {
    let label = format!("{node}.{param}");
    let merge = value.map(|_| label.clone());
    doc.edit_params(By::Hand, &label, merge.as_deref(), &[(node, param, value)])
}

/// Makes exactly the first `at` changes of the history be in force, as one edit; answers how many values that set.
///
/// # Errors
/// A node or parameter of it is gone from the text; nothing is changed then.
pub fn step_to(doc: &mut Document, at: usize) -> Result<usize, EditError> {
    let values = doc.history().values_at(at);
    let here = |node: &str| doc.view().node(node).is_some();
    let values: Vec<_> = values.into_iter().filter(|(node, ..)| here(node)).collect();
    let changes: Vec<_> =
        values.iter().map(|(node, param, value)| (node.as_str(), param.as_str(), value.as_ref())).collect();
    doc.edit_params(By::History, "step through the history", None, &changes)?;
    doc.stepped_to(at);
    Ok(values.len())
}

fn is_list(view: &View, node: &str, input: &str) -> bool {
    view.node(node).and_then(|n| view.nodes[n].input(input)).is_some_and(|p| p.list)
}

/// Wires an output to an input. A list takes it as one more place, or at `index`; another input gives up the wire it had. `moved` is the
/// connection that the wire was pulled off.
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

/// Takes a wire off.
pub fn unwire(doc: &mut Document, node: &str, input: &str, index: usize) -> Result<(), EditError> {
    doc.edit(&format!("unwire {node}.{input}"), None, |edit| edit.disconnect(node, input, index))
}

/// Removes nodes with all their wires.
pub fn remove(doc: &mut Document, nodes: &[String]) -> Result<(), EditError> {
    let label = format!("delete {}", nodes.join(", "));
    doc.edit(&label, None, |edit| nodes.iter().try_for_each(|id| edit.remove_node(id)))
}

/// A name that no node has yet: `base`, `base_2`, ...
pub fn free_name(view: &View, base: &str) -> String {
    let mut names = std::iter::once(base.to_owned()).chain((2..).map(|k| format!("{base}_{k}")));
    names.find(|name| view.node(name).is_none()).unwrap_or_default()
}

/// A name without the number at its end.
fn stem(name: &str) -> &str {
    let stem = name.trim_end_matches(|c: char| c.is_ascii_digit());
    if stem.len() < name.len() && stem.ends_with('_') { stem.trim_end_matches('_') } else { name }
}

/// Copies nodes beside themselves; answers the copies' names. Wires among them join the copies; others go where they went.
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

/// Nodes as text that can be pasted into this graph or another one.
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

/// Adds nodes that were copied as text, around a place; answers their names.
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

/// The input of a node that may take the place of its output: same packets, connected.
fn stand_in<'v>(view: &'v View, node: usize, output: &str) -> Option<&'v Wire> {
    let packet = &view.nodes[node].output(output)?.packet;
    let inputs = &view.nodes[node].node_type.as_ref()?.inputs;
    let fits = inputs.iter().filter(|p| p.packet.name == packet.name || packet.fits(&p.packet).is_ok());
    fits.filter_map(|p| view.wires.iter().find(|w| w.to == node && w.input == p.name && !w.delayed))
        .find(|w| view.packet(w.from, &w.output).is_some_and(|p| p.name == packet.name))
}

/// A wire that a bypass led around a node: consumer, input, place, what it read before and what it reads now.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Detour {
    /// Consumer, its input, place in a list.
    pub to: (String, String, usize),
    /// What it read.
    pub was: Output,
    /// What it reads instead.
    pub now: Output,
}

/// Leads the readers of a node's outputs around it, to what feeds it. The node stays in the file.
///
/// # Errors
/// In words, when an output that is read has no input of its kind.
pub fn bypass(doc: &mut Document, id: &str) -> Result<Vec<Detour>, String> {
    let view = doc.view().clone();
    let node = view.node(id).ok_or_else(|| format!("there is no node `{id}`"))?;
    let mut detours = Vec::new();
    for wire in view.wires.iter().filter(|w| w.from == node && w.to != node) {
        let Some(instead) = stand_in(&view, node, &wire.output) else {
            return Err(format!("`{id}` cannot be bypassed: no input could stand in for `{}`", wire.output));
        };
        detours.push(Detour {
            to: (view.nodes[wire.to].id().to_owned(), wire.input.clone(), wire.index),
            was: Output::new(id, &wire.output),
            now: Output::new(view.nodes[instead.from].id(), &instead.output),
        });
    }
    if detours.is_empty() {
        return Err(format!("nothing reads `{id}`"));
    }
    lead(doc, &format!("bypass {id}"), detours.iter().map(|d| (&d.to, &d.now))).map_err(|e| e.to_string())?;
    Ok(detours)
}

/// Takes a bypass back, where its wires are as it left them; answers whether any was.
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
    lead(doc, &format!("end bypass of {id}"), back.iter().map(|d| (&d.to, &d.was)))?;
    Ok(!back.is_empty())
}

fn lead<'d>(
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

/// One end of a wire that waits for the node that is added.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Waiting {
    /// An output that the new node shall read.
    Output(Output),
    /// An input (node, port) that shall read the new node.
    Input(String, String),
}

/// The first port of a type that fits a waiting end.
pub fn fitting_port(view: &View, node_type: &NodeType, waiting: &Waiting) -> Option<String> {
    let port = match waiting {
        Waiting::Output(output) => {
            let packet = view.packet(view.node(&output.node)?, &output.port)?;
            node_type.inputs.iter().find(|p| packet.fits(&p.packet).is_ok())
        }
        Waiting::Input(node, input) => {
            let wants = &view.nodes[view.node(node)?].input(input)?.packet;
            node_type.outputs.iter().find(|p| p.packet.fits(wants).is_ok())
        }
    };
    port.map(|p| p.name.clone())
}

/// Adds a node with its wire; answers its name.
pub fn add(
    doc: &mut Document,
    node_type: &NodeType,
    at: (f32, f32),
    waiting: Option<&Waiting>,
) -> Result<String, EditError> {
    let view = doc.view().clone();
    let id = free_name(&view, &node_type.name);
    // Two plugins may offer the same name.
    let twins = doc.catalog().node_types.iter().filter(|t| t.name == node_type.name && t.plugin != node_type.plugin);
    let type_name =
        if twins.count() == 0 { node_type.name.clone() } else { format!("{}/{}", node_type.plugin, node_type.name) };
    let port = waiting.and_then(|w| Some((w, fitting_port(&view, node_type, w)?)));
    doc.edit(&format!("add {id}"), None, |edit| {
        edit.add_plugin(&node_type.plugin)?;
        edit.add_node(&id, &type_name)?;
        edit.set_position(&id, f64::from(at.0), f64::from(at.1));
        match port {
            Some((Waiting::Output(output), port)) => {
                let list = node_type.inputs.iter().any(|p| p.name == port && p.list);
                edit.connect(&id, &port, list, 0, &output.to_string())
            }
            Some((Waiting::Input(node, input), port)) => {
                let list = is_list(&view, node, input);
                let end = view.node(node).map_or(0, |n| view.wires_into(n, input).count());
                edit.connect(node, input, list, if list { end } else { 0 }, &format!("{id}.{port}"))
            }
            None => Ok(()),
        }
    })?;
    Ok(id)
}

/// Puts a node into a wire: it reads what the wire read, and the wire's end reads it.
///
/// # Errors
/// In words, when no input or output of the node fits.
pub fn insert(doc: &mut Document, id: &str, to: (&str, &str, usize)) -> Result<(), String> {
    let view = doc.view().clone();
    let (consumer, input, index) = to;
    let node = view.node(id).ok_or_else(|| format!("there is no node `{id}`"))?;
    let end = view.node(consumer).ok_or_else(|| format!("there is no node `{consumer}`"))?;
    let wire = view.wires_into(end, input).find(|w| w.index == index).ok_or("the wire is gone")?;
    let packet = view.packet(wire.from, &wire.output).ok_or("the wire's type is not known")?;
    let wants = view.nodes[end].input(input).ok_or("the wire's end is not known")?;
    let node_type = view.nodes[node].node_type.as_ref().ok_or_else(|| format!("the type of `{id}` is not known"))?;
    let takes = node_type.inputs.iter().find(|p| packet.fits(&p.packet).is_ok());
    let gives = node_type.outputs.iter().find(|p| p.packet.fits(&wants.packet).is_ok());
    let (Some(takes), Some(gives)) = (takes, gives) else {
        return Err(format!("`{id}` does not fit into a wire of {}", packet.name));
    };
    let from = format!("{}.{}", view.nodes[wire.from].id(), wire.output);
    doc.edit(&format!("insert {id}"), None, |edit| {
        edit.connect(id, &takes.name, takes.list, 0, &from)?;
        edit.connect(consumer, input, wants.list, index, &format!("{id}.{}", gives.name))
    })
    .map_err(|e| e.to_string())
}

/// Writes places of nodes into the file.
pub fn move_nodes(doc: &mut Document, places: &[(String, (f32, f32))]) -> Result<(), EditError> {
    put_nodes(doc, places, None)
}

/// As [`move_nodes`]; moves of the same nodes that follow one another are one step of undo.
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

/// Gives a node another name everywhere.
pub fn rename(doc: &mut Document, old: &str, new: &str) -> Result<(), EditError> {
    doc.edit(&format!("rename {old} to {new}"), None, |edit| edit.rename_node(old, new))
}

/// Puts frames and notes in place of those that are there, and moves nodes with them.
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
