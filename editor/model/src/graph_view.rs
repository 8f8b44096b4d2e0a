//! A graph as the windows draw it: nodes, wires, frames, notes and diagnostics, derived from its text.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use panoscope_graph::{Diagnostic, NodeOutline, NodeType, PacketType, Port, Severity};

use crate::mark::Mark;
use crate::output::{Output, WireEnd};

/// A node as it is drawn.
#[derive(Clone, Debug)]
pub struct NodeView {
    /// The node's entry in the file.
    pub outline: NodeOutline,
    /// Its type; `None` when no plugin of the graph has it.
    pub node_type: Option<Arc<NodeType>>,
    /// Its position in the file's `[editor]` table; in an opened part, from the corner of the part's frame.
    pub position: Option<(f32, f32)>,
    /// Messages of the errors in this node.
    pub mistakes: Vec<String>,
    /// Whether it is a folded part; its type then has the ports that the part's file offers.
    pub is_part: bool,
}

/// A part of the graph, folded or opened.
#[derive(Clone, Debug, PartialEq)]
pub struct PartView {
    /// Its name in the graph.
    pub id: String,
    /// Its file as written.
    pub file: String,
    /// Absolute path of its file; `None` when the file cannot be used.
    pub path: Option<PathBuf>,
    /// All nodes of the graph that use the file, this one included.
    pub users: Vec<String>,
    /// Whether its nodes are shown.
    pub open: bool,
    /// Its position in the file's `[editor]` table.
    pub position: Option<(f32, f32)>,
}

impl NodeView {
    /// Its name in the graph.
    pub fn id(&self) -> &str {
        &self.outline.id
    }

    /// Its family; `unknown` when its type is not known.
    pub fn family(&self) -> &str {
        self.node_type.as_ref().map_or("unknown", |t| &t.family)
    }

    /// An input by name.
    pub fn input(&self, name: &str) -> Option<&Port> {
        self.node_type.as_ref()?.inputs.iter().find(|p| p.name == name)
    }

    /// An output by name.
    pub fn output(&self, name: &str) -> Option<&Port> {
        self.node_type.as_ref()?.outputs.iter().find(|p| p.name == name)
    }
}

/// A connection as it is drawn.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Wire {
    /// Producing node: index in [`GraphView::nodes`].
    pub from: usize,
    /// Its output.
    pub output: String,
    /// Consuming node: index in [`GraphView::nodes`].
    pub to: usize,
    /// Its input.
    pub input: String,
    /// Index in a list input.
    pub index: usize,
    /// Whether it carries the value of the previous tick.
    pub delayed: bool,
}

/// The graph as it is drawn, derived from a text.
#[derive(Clone, Debug, Default)]
pub struct GraphView {
    /// Nodes in file order.
    pub nodes: Vec<NodeView>,
    /// Connections whose nodes both exist.
    pub wires: Vec<Wire>,
    /// Errors and warnings.
    pub diagnostics: Vec<Diagnostic>,
    /// Whether the text has no errors and can run.
    pub valid: bool,
    /// Name of the graph.
    pub name: String,
    /// The graph file, as diagnostics name it; others are of parts and overlays.
    pub file: String,
    /// Frames and notes.
    pub marks: Vec<Mark>,
    /// Parts that are not inside a folded one.
    pub parts: Vec<PartView>,
    /// The graph that runs, without folded parts; `None` where this is it.
    pub flat: Option<Arc<GraphView>>,
    /// Ports of nodes that the ports of parts stand for: by part, port, and whether it is an input.
    pub(crate) targets: BTreeMap<(String, String, bool), Vec<(String, String)>>,
}

/// Codes of errors of a graph that is being built: an input without a wire, and a node that nothing makes run.
const UNFINISHED: [&str; 2] = ["missing-input", "never-runs"];

/// A message about a node without the node's name, for a place that shows the name already.
pub fn without_name(message: &str, id: &str) -> String {
    let local = id.rsplit('/').next().unwrap_or(id);
    let named = [id, local].map(|name| format!("`{name}`"));
    let patterns = named.iter().flat_map(|name| {
        [
            format!("node {name}: "),
            format!("{name}: "),
            format!(" of {name}"),
            format!(" in {name}"),
            format!(" at {name}"),
        ]
    });
    patterns.fold(message.to_owned(), |message, pattern| message.replacen(&pattern, "", 1))
}

/// Keys in `[editor]` for frames and notes; no node can have these names.
pub(crate) const FRAMES: &str = ":frames";
pub(crate) const NOTES: &str = ":notes";

/// Frames and notes of an `[editor]` table; invalid entries are skipped.
pub(crate) fn marks_of(editor: &toml::Table) -> Vec<Mark> {
    let list = |key: &str| editor.get(key).and_then(toml::Value::as_array).cloned().unwrap_or_default();
    let mark = |value: &toml::Value, frame: bool| {
        let number = |key: &str| {
            let v = value.get(key)?;
            v.as_float().or(v.as_integer().map(|i| i as f64)).map(|v| v as f32)
        };
        let text = value.get("text")?.as_str()?.to_owned();
        let size = if frame { Some((number("width")?, number("height")?)) } else { None };
        Some(Mark { text, at: (number("x")?, number("y")?), size })
    };
    let frames = list(FRAMES).into_iter().filter_map(|v| mark(&v, true)).collect::<Vec<_>>();
    frames.into_iter().chain(list(NOTES).into_iter().filter_map(|v| mark(&v, false))).collect()
}

/// Why an output may not be connected to an input.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum WireError {
    /// A node does not exist.
    #[error("there is no node `{node}`")]
    NoNode {
        /// The node.
        node: String,
    },
    /// The producer has no such output.
    #[error("`{node}` has no output `{output}`")]
    NoOutput {
        /// The producer.
        node: String,
        /// The output.
        output: String,
    },
    /// The consumer has no such input.
    #[error("`{node}` has no input `{input}`")]
    NoInput {
        /// The consumer.
        node: String,
        /// The input.
        input: String,
    },
    /// The packets of the output do not fit the input.
    #[error("{reason}")]
    Packets {
        /// The checker's message.
        reason: String,
    },
    /// The wire would close a loop without delay.
    #[error("the wire would close a loop; a loop needs `delay = 1` in the file")]
    Loop,
}

impl GraphView {
    /// Whether the only errors are inputs that are not connected yet: a graph that is being built.
    pub fn is_unfinished(&self) -> bool {
        let mut errors = self.errors().peekable();
        errors.peek().is_some() && errors.all(|d| UNFINISHED.contains(&d.code))
    }

    /// Whether the only errors of a node are inputs that are not connected yet.
    pub fn is_unfinished_at(&self, node: usize) -> bool {
        let mistakes = &self.nodes[node].mistakes;
        let is_open = |words: &String| self.errors().any(|d| UNFINISHED.contains(&d.code) && d.message == *words);
        !mistakes.is_empty() && mistakes.iter().all(is_open)
    }

    /// Number of inputs that must be connected and are not.
    pub fn open_inputs(&self) -> usize {
        self.errors().filter(|d| d.code == UNFINISHED[0]).count()
    }

    fn errors(&self) -> impl Iterator<Item = &Diagnostic> {
        self.diagnostics.iter().filter(|d| d.severity == Severity::Error)
    }

    /// Index of the node called `id`.
    pub fn node(&self, id: &str) -> Option<usize> {
        self.nodes.iter().position(|n| n.id() == id)
    }

    /// A part by name.
    pub fn part(&self, id: &str) -> Option<&PartView> {
        self.parts.iter().find(|p| p.id == id)
    }

    /// The graph that runs.
    pub fn flat(&self) -> &GraphView {
        self.flat.as_deref().unwrap_or(self)
    }

    /// Whether a name is that of a node or part, shown or not.
    pub fn is_taken(&self, id: &str) -> bool {
        self.node(id).is_some() || self.flat().node(id).is_some() || self.part(id).is_some()
    }

    /// The output of a running node that an output stands for.
    pub fn running_output(&self, node: &str, port: &str) -> Output {
        let targets = self.targets.get(&(node.to_owned(), port.to_owned(), false));
        let first = targets.and_then(|t| t.first());
        first.map_or_else(|| Output::new(node, port), |(node, port)| Output::new(node, port))
    }

    /// Packet type of an output of a node that is shown, or of one inside a folded part.
    pub fn packet_of(&self, output: &Output) -> Option<&PacketType> {
        let own = self.node(&output.node).and_then(|n| self.packet(n, &output.port));
        let inside = || Some(&self.flat.as_ref()?.nodes).and_then(|nodes| nodes.iter().find(|n| n.id() == output.node));
        own.or_else(|| Some(&inside()?.output(&output.port)?.packet))
    }

    /// The name of the node that a diagnostic refers to.
    pub fn node_of(&self, diagnostic: &Diagnostic, text: &str) -> Option<String> {
        if self.file != diagnostic.file {
            return None;
        }
        let lines: Vec<&str> = text.lines().take(diagnostic.line).collect();
        let header = lines.iter().rev().find(|line| line.starts_with('['))?;
        let inside = header.trim_start_matches('[').split(']').next()?;
        let id = inside.strip_prefix("nodes.")?.split('.').next()?.trim_matches('"');
        self.node(id).map(|_| id.to_owned())
    }

    /// Wires into an input, in list order.
    pub fn wires_into<'a>(&'a self, node: usize, input: &'a str) -> impl Iterator<Item = &'a Wire> {
        self.wires.iter().filter(move |w| w.to == node && w.input == input)
    }

    /// A wire's description, such as `a.image to b.image`, from its end.
    pub fn wire_name(&self, end: &WireEnd) -> String {
        if let Some(flat) = &self.flat {
            return flat.wire_name(end);
        }
        let Some(node) = self.node(&end.node) else { return end.node.clone() };
        let port = self.nodes[node].node_type.as_ref().and_then(|t| t.inputs.get(end.port));
        let Some(port) = port else { return end.node.clone() };
        let wire = self.wires_into(node, &port.name).find(|w| w.index == end.index);
        let from = wire.map(|w| format!("{}.{}", self.nodes[w.from].id(), w.output)).unwrap_or_default();
        format!("{from} to {}.{}", end.node, port.name)
    }

    /// Packet type of an output; `None` when it is not known.
    pub fn packet(&self, node: usize, output: &str) -> Option<&PacketType> {
        Some(&self.nodes[node].output(output)?.packet)
    }

    /// Whether a wire from an output to an input would close a loop without delay. A path around a loop must run through nodes: a part may carry
    /// two paths that do not meet.
    fn wire_closes_loop(&self, from: usize, output: &str, to: usize, input: &str) -> bool {
        let Some(flat) = &self.flat else { return self.closes_loop(from, to) };
        let from = self.running_output(self.nodes[from].id(), output).node;
        let key = (self.nodes[to].id().to_owned(), input.to_owned(), true);
        let ends = self.targets.get(&key).cloned().unwrap_or_else(|| vec![(key.0, key.1)]);
        let index = |id: &str| flat.node(id);
        ends.iter().any(|(to, _)| index(&from).zip(index(to)).is_some_and(|(from, to)| flat.closes_loop(from, to)))
    }

    /// Whether a wire from node `from` to node `to` would close a loop without delay.
    pub fn closes_loop(&self, from: usize, to: usize) -> bool {
        let (mut open, mut seen) = (vec![to], vec![false; self.nodes.len()]);
        while let Some(node) = open.pop() {
            if node == from {
                return true;
            }
            if !std::mem::replace(&mut seen[node], true) {
                open.extend(self.wires.iter().filter(|w| w.from == node && !w.delayed).map(|w| w.to));
            }
        }
        false
    }

    /// Checks whether an output may be connected to an input.
    ///
    /// # Errors
    /// Why it may not.
    pub fn check_wire(&self, from: usize, output: &str, to: usize, input: &str) -> Result<(), WireError> {
        let (source, target) = (&self.nodes[from], &self.nodes[to]);
        let no_output = || WireError::NoOutput { node: source.id().to_owned(), output: output.to_owned() };
        let no_input = || WireError::NoInput { node: target.id().to_owned(), input: input.to_owned() };
        let (packet, wants) =
            (&source.output(output).ok_or_else(no_output)?.packet, &target.input(input).ok_or_else(no_input)?.packet);
        packet.fits(wants).map_err(|reason| WireError::Packets { reason: reason.to_string() })?;
        if self.wire_closes_loop(from, output, to, input) {
            return Err(WireError::Loop);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_beside_a_name_do_not_repeat_it() {
        let cases = [
            ("input `image` of `calm/mean` is not connected", "input `image` is not connected"),
            ("`mean`: no such file", "no such file"),
            ("node `calm/mean`: no such file", "no such file"),
            ("input `image` of `sink` is not connected", "input `image` of `sink` is not connected"),
        ];
        for (message, expected) in cases {
            assert_eq!(without_name(message, "calm/mean"), expected);
        }
    }
}
