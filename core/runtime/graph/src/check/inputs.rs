//! Connections: ports that exist, packets that fit, inputs that are needed.

use super::{Checker, Link};
use crate::catalog::{NodeType, Port};
use crate::checked::Align;
use crate::diagnostic::{Diagnostic, Severity};
use crate::file::{InputText, NodeText, RefText, Supply};
use crate::nearest::{list, nearest};
use crate::packet::{Fit, PacketType};
use std::ops::Range;

impl<'a> Checker<'a> {
    pub(super) fn inputs(&mut self) {
        let text = self.text;
        for (index, node) in text.flat.nodes.iter().enumerate() {
            let errors = self.diagnostics.errors();
            let node_type = self.type_of(index);
            // Inputs that a misspelt name was probably meant for are not missing as well.
            let mut meant = Vec::new();
            for input in &node.inputs {
                let port = node_type.and_then(|t| t.input(&input.port.value));
                if let (Some(node_type), None) = (node_type, port) {
                    meant.extend(self.unknown_input(node, node_type, input));
                }
                let declared = node_type.zip(port).map(|(t, p)| &t.inputs[p]);
                self.shape(input, declared);
                for (list_index, reference) in input.refs.iter().enumerate() {
                    self.reference(index, port, declared, input, list_index, reference);
                }
            }
            if let Some(node_type) = node_type {
                self.missing(index, node, node_type, &meant);
            }
            self.triggers(index);
            self.sound[index] &= self.diagnostics.errors() == errors;
        }
    }

    fn unknown_input(&mut self, node: &NodeText, node_type: &'a NodeType, input: &InputText) -> Option<&'a str> {
        let name = &input.port.value;
        let given = |port: &str| node.inputs.iter().any(|i| i.port.value == port);
        let free = || node_type.inputs.iter().map(|p| p.name.as_str()).filter(|p| !given(p));
        // One input left and one name too many: they belong together, however they are spelt.
        let mut required = node_type.inputs.iter().filter(|p| !p.optional && !given(&p.name));
        let only = required.next().filter(|_| required.next().is_none()).map(|p| p.name.as_str());
        let near = nearest(name, free());
        let label = match near {
            Some(near) => format!("did you mean `{near}`?"),
            None if node_type.param(name).is_some() => "a parameter: it belongs under `params`".to_owned(),
            None => String::new(),
        };
        let help = if node_type.inputs.is_empty() {
            format!("`{}` has no inputs", node_type.name)
        } else {
            let names: Vec<String> = node_type.inputs.iter().map(describe).collect();
            format!("inputs: {}", names.join(", "))
        };
        self.error("unknown-input", &input.port.span, format!("`{}` has no input `{name}`", node_type.name))
            .label(label)
            .help(help);
        near.or(only)
    }

    /// Checks whether the input may be written as a list.
    fn shape(&mut self, input: &InputText, declared: Option<&Port>) {
        let Some(port) = declared else { return };
        if input.is_list && !port.list {
            let message = format!("input `{}` takes one connection, not a list", port.name);
            let help = match input.refs.as_slice() {
                [] => "write \"node.port\", or remove the input".to_owned(),
                [first, ..] => format!("write {} = \"{}.{}\"", port.name, first.node, first.port),
            };
            self.error("list-given", &input.span, message).label("expected \"node.port\"").help(help);
        } else if input.is_list && input.refs.is_empty() && !input.broken && !port.optional {
            let help = self.help_fitting(port, usize::MAX);
            let message = format!("input `{}` needs at least one connection", port.name);
            self.error("missing-input", &input.span, message).help(help);
        }
    }

    fn reference(
        &mut self,
        to_node: usize,
        to_port: Option<usize>,
        declared: Option<&Port>,
        input: &'a InputText,
        list_index: usize,
        reference: &'a RefText,
    ) {
        let Some(&from_node) = self.ids.get(reference.node.as_str()) else {
            self.unknown_node(&reference.span, &reference.node);
            return;
        };
        // Which of the two is meant is not known; that there are two is reported.
        if self.doubled.contains(reference.node.as_str()) {
            return;
        }
        let from_type = self.type_of(from_node);
        let from_port = from_type.and_then(|t| t.output(&reference.port));
        let mut convert = false;
        match (from_type, from_port) {
            (Some(_), None) if reference.through_part => {}
            (Some(from_type), None) => self.unknown_output(reference, from_type, declared),
            (Some(from_type), Some(port)) => {
                if let Some(declared) = declared {
                    convert = self.packets(to_node, reference, from_node, &from_type.outputs[port], declared);
                }
            }
            (None, _) => {}
        }
        self.links.push(Link {
            from_node,
            from_port,
            to_node,
            to_port,
            to_name: &input.port.value,
            list_index,
            align: reference.align,
            max_age_ms: reference.max_age_ms,
            guide: reference.guide,
            queue: reference.queue,
            delay: reference.delay,
            trigger: reference.trigger.as_ref(),
            convert,
            span: &reference.span,
        });
    }

    pub(super) fn unknown_output(&mut self, reference: &RefText, from_type: &NodeType, declared: Option<&Port>) {
        self.unknown_output_at(&reference.span, &reference.node, &reference.port, from_type, declared);
    }

    /// `span` is that of the whole reference.
    pub(super) fn unknown_output_at(
        &mut self,
        span: &Range<usize>,
        node: &str,
        name: &str,
        from_type: &NodeType,
        declared: Option<&Port>,
    ) {
        let names = || from_type.outputs.iter().map(|p| p.name.as_str());
        let fits = |p: &&Port| declared.is_some_and(|d| matches!(p.packet.fit(&d.packet), Fit::Yes | Fit::Convert));
        let mut fitting = from_type.outputs.iter().filter(fits);
        let only = fitting.next().filter(|_| fitting.next().is_none()).map(|p| p.name.as_str());
        let label = match (nearest(name, names()), only) {
            (Some(near), _) => format!("did you mean `{near}`?"),
            (None, Some(only)) => format!("did you mean `{only}`?"),
            (None, None) if from_type.input(name).is_some() => "an input, not an output".to_owned(),
            (None, None) => String::new(),
        };
        let help = if from_type.outputs.is_empty() {
            format!("`{}` has no outputs", from_type.name)
        } else {
            format!("outputs of `{node}`: {}", list(names(), 20, "and"))
        };
        let dot = self.text.sources.text(span).rfind('.').map_or(0, |dot| dot + 1);
        let message = format!("`{node}` ({}) has no output `{name}`", from_type.name);
        let (text, span) = (self.text, span.start + dot..span.end);
        let mut d = Diagnostic::new(Severity::Error, "unknown-output", text.sources.of(&span), &span, message);
        d.label(label).help(help);
        if let Some(overlay) = text.flat.replaced.get(node) {
            d.note(&text.sources, overlay, "replaced here");
        }
        self.diagnostics.push(d);
    }

    /// Checks that the packets fit. Returns whether the host converts.
    fn packets(&mut self, to_node: usize, reference: &RefText, from_node: usize, output: &Port, input: &Port) -> bool {
        let (sent, taken) = (&output.packet, &input.packet);
        let from = format!("{}.{}", reference.node, reference.port);
        let to = format!("{}.{}", self.id(to_node), input.name);
        match sent.fit(taken) {
            Fit::Yes => false,
            Fit::Convert => true,
            Fit::Type => {
                let message = format!("`{to}` takes {}, `{from}` sends {}", packet(taken), packet(sent));
                let fitting: Vec<String> = self
                    .type_of(from_node)
                    .into_iter()
                    .flat_map(|t| &t.outputs)
                    .filter(|p| matches!(p.packet.fit(taken), Fit::Yes | Fit::Convert))
                    .map(|p| format!("{}.{}", reference.node, p.name))
                    .collect();
                let help = if fitting.is_empty() {
                    self.help_fitting(input, to_node)
                } else {
                    format!(
                        "outputs of `{}` that fit: {}",
                        reference.node,
                        list(fitting.iter().map(String::as_str), 8, "and")
                    )
                };
                let label = format!("expected {}", packet(taken));
                self.error("wrong-packet", &reference.span, message).label(label).help(help);
                false
            }
            Fit::Format => {
                let message = format!(
                    "`{to}` takes {} images, `{from}` sends {}",
                    taken.formats.join(" or "),
                    sent.formats.join(" or ")
                );
                self.error("wrong-format", &reference.span, message)
                    .label(format!("expected {}", taken.formats.join(" or ")))
                    .help("the host itself converts only bgr8 to gray8; put a node that converts between the two");
                false
            }
            Fit::Layout => {
                let message = format!(
                    "`{from}` and `{to}` both call their packets `{}`, but lay them out differently ({:016x} and {:016x})",
                    sent.name, sent.layout_hash, taken.layout_hash
                );
                let producer = self.type_of(from_node).map_or("", |t| t.plugin.as_str());
                let consumer = self.type_of(to_node).map_or("", |t| t.plugin.as_str());
                let help = format!(
                    "build plugins `{producer}` and `{consumer}` against the same definition of `{}`",
                    sent.name
                );
                self.error("wrong-layout", &reference.span, message).help(help);
                false
            }
        }
    }

    /// Outputs of the graph that an input could take.
    fn help_fitting(&self, input: &Port, not_of: usize) -> String {
        let mut names = Vec::new();
        for (index, node) in self.text.flat.nodes.iter().enumerate().filter(|(i, _)| *i != not_of) {
            for output in self.type_of(index).into_iter().flat_map(|t| &t.outputs) {
                if matches!(output.packet.fit(&input.packet), Fit::Yes | Fit::Convert) {
                    names.push(format!("{}.{}", node.id.value, output.name));
                }
            }
        }
        if names.is_empty() {
            let mut types: Vec<&str> = self
                .catalog
                .node_types
                .iter()
                .filter(|t| t.outputs.iter().any(|o| o.packet.fit(&input.packet) == Fit::Yes))
                .map(|t| t.name.as_str())
                .collect();
            types.sort_unstable();
            types.dedup();
            return match types.is_empty() {
                true => format!("no known node sends {}", packet(&input.packet)),
                false => format!(
                    "no node of this graph sends {}; node types that do: {}",
                    packet(&input.packet),
                    list(types, 8, "and")
                ),
            };
        }
        format!("outputs that fit: {}", list(names.iter().map(String::as_str), 8, "and"))
    }

    fn missing(&mut self, index: usize, node: &'a NodeText, node_type: &'a NodeType, meant: &[&str]) {
        if self.text.incomplete {
            return;
        }
        let mut any_missing = false;
        for port in node_type.inputs.iter().filter(|p| !p.optional) {
            let input = node.inputs.iter().find(|i| i.port.value == port.name);
            if let Some(Supply::Unconnected { span, part, input }) = input.map(|i| &i.supply) {
                any_missing = true;
                let message = format!("input `{input}` of part `{part}` is not connected");
                let help = self.help_fitting(port, index);
                let sources = &self.text.sources;
                let label = format!("`{}` inside needs {}", node.local, describe(port));
                self.error("missing-input", span, message).label(label).help(help).note(sources, &node.id.span, "");
                continue;
            }
            let given = input.is_some();
            if given || meant.contains(&port.name.as_str()) {
                continue;
            }
            any_missing = true;
            let message = format!("input `{}` of `{}` is not connected", port.name, node.id.value);
            let help = self.help_fitting(port, index);
            self.error("missing-input", &node.id.span, message)
                .label(format!("`{}` needs {}", node_type.name, describe(port)))
                .help(help);
        }
        let unconnected = |i: &InputText| matches!(i.supply, Supply::Unconnected { .. });
        if !any_missing && node.inputs.iter().all(unconnected) && !node_type.source {
            let message =
                format!("nothing makes `{}` run: it is no source and none of its inputs is connected", node.id.value);
            let help = match node_type.inputs.first() {
                Some(first) => self.help_fitting(first, index),
                None => format!("`{}` has no inputs at all: its plugin must declare it a source", node_type.name),
            };
            let label = match node_type.inputs.is_empty() {
                true => String::new(),
                false => format!("inputs: {}", node_type.inputs.iter().map(describe).collect::<Vec<_>>().join(", ")),
            };
            self.error("never-runs", &node.id.span, message).label(label).help(help);
        }
    }

    fn triggers(&mut self, node: usize) {
        let start = self.links.iter().rposition(|l| l.to_node != node).map_or(0, |i| i + 1);
        let mut first = None;
        let mut found = Vec::new();
        for link in &self.links[start..] {
            let Some(trigger) = link.trigger else { continue };
            match first {
                Some(first) => found.push((trigger, Some(first), None)),
                None => {
                    first = Some(trigger);
                    let other = self.links[start..].iter().find(|l| l.align != Align::Latest);
                    found.push((trigger, None, other.map(|l| (l.to_name, l.align.word(), l.span))));
                }
            }
        }
        let sources = &self.text.sources;
        for (trigger, first, other) in found {
            if let Some(first) = first {
                self.error("several-triggers", trigger, format!("`{}` has more than one trigger", self.id(node)))
                    .label("again here")
                    .help("keep the one input whose packets make the node run")
                    .note(sources, first, "first here");
            } else if let Some((name, word, span)) = other {
                let id = self.id(node);
                let message = format!("a trigger has no meaning for `{id}`: its input `{name}` is `{word}`");
                let label = format!("`{word}`, so this decides when `{id}` runs");
                let d = self.error("useless-trigger", trigger, message);
                d.help("remove `trigger`, or make all inputs of the node align = \"latest\"");
                // On a single line both are in view already.
                if sources.line(span) != sources.line(trigger) {
                    d.note(sources, span, label);
                }
            }
        }
    }
}

/// `left (image)`, `roi (roi, optional)`.
fn describe(port: &Port) -> String {
    let optional = if port.optional { ", optional" } else { "" };
    let list = if port.list { ", list" } else { "" };
    format!("`{}` ({}{list}{optional})", port.name, packet(&port.packet))
}

/// `image` or `gray8 image`.
fn packet(packet: &PacketType) -> String {
    match packet.formats.as_slice() {
        [] => packet.name.clone(),
        formats => format!("{} {}", formats.join(" or "), packet.name),
    }
}
