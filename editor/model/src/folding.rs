//! Parts on the canvas: a folded part is one node with the ports that its file offers; the nodes of an opened one are shown in a frame.
//!
//! The flat graph is what runs. The drawn graph is derived from it, from the parts' interfaces, and from the list of opened parts in `[editor]`.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;

use panoscope_graph::edit::OPENED_PARTS;
use panoscope_graph::{GraphText, NodeOutline, NodeType, Param, ParamKind, PartOutline, PartPort, Port};

use crate::graph_view::{GraphView, NodeView, PartView, Wire};

/// The family of folded parts, for their colour.
const FAMILY: &str = "part";

/// The part that a node belongs to; empty for a node of the graph file.
pub fn parent(id: &str) -> &str {
    id.rsplit_once('/').map_or("", |(parent, _)| parent)
}

/// The opened parts of an `[editor]` table.
pub fn opened(editor: &toml::Table) -> BTreeSet<String> {
    let list = editor.get(OPENED_PARTS).and_then(toml::Value::as_array);
    list.into_iter().flatten().filter_map(toml::Value::as_str).map(str::to_owned).collect()
}

/// Whether all parts around a node are opened.
fn is_visible(id: &str, open: &BTreeSet<String>) -> bool {
    let around = parent(id);
    around.is_empty() || (open.contains(around) && is_visible(around, open))
}

/// The name of the outermost folded part around a node, or of the node itself.
pub(crate) fn shown_as<'i>(id: &'i str, open: &BTreeSet<String>) -> &'i str {
    let ends = id.match_indices('/').map(|(at, _)| &id[..at]);
    ends.into_iter().find(|part| !open.contains(*part)).unwrap_or(id)
}

struct Folding<'a> {
    flat: &'a GraphView,
    parts: &'a [PartOutline],
    open: &'a BTreeSet<String>,
}

impl Folding<'_> {
    fn part(&self, id: &str) -> Option<&PartOutline> {
        self.parts.iter().find(|p| p.id == id)
    }

    /// The nodes' ports that a port stands for, through parts of parts.
    fn targets(&self, id: &str, port: &str, ports: fn(&PartOutline) -> &[PartPort]) -> Vec<(String, String)> {
        let Some(part) = self.part(id) else { return vec![(id.to_owned(), port.to_owned())] };
        let targets = PartOutline::find(ports(part), port).map(|p| p.targets.as_slice()).unwrap_or_default();
        targets.iter().flat_map(|(node, port)| self.targets(node, port, ports)).collect()
    }

    /// The drawn output that a reference comes from.
    fn source(&self, node: &str, port: &str) -> (String, String) {
        let (mut node, mut port) = (node.to_owned(), port.to_owned());
        while let Some(part) = self.part(&node).filter(|p| self.open.contains(&p.id)) {
            let Some((inner, inner_port)) = PartOutline::find(&part.outputs, &port).and_then(|p| p.targets.first())
            else {
                break;
            };
            (node, port) = (inner.clone(), inner_port.clone());
        }
        let shown = shown_as(&node, self.open).to_owned();
        if shown != node
            && let Some(part) = self.part(&shown)
        {
            // A node inside a folded part, named directly: the part's name for its output.
            let name = part
                .outputs
                .iter()
                .find(|p| self.targets(&shown, &p.name, |p| &p.outputs).contains(&(node.clone(), port.clone())));
            port = name.map_or(port, |p| p.name.clone());
        }
        (shown, port)
    }

    /// What an input of a part reads: from its user, or from the user of the part around it.
    fn supply(&self, id: &str, input: &str) -> Vec<(String, String, bool)> {
        let Some(part) = self.part(id) else { return Vec::new() };
        if let Some(given) = part.given.iter().find(|i| i.port == input) {
            return given.from.iter().map(|r| (r.node.clone(), r.port.clone(), r.delay > 0)).collect();
        }
        let target = (id.to_owned(), input.to_owned());
        let outer = self.part(parent(id));
        let name = outer.and_then(|outer| outer.inputs.iter().find(|p| p.targets.contains(&target)));
        outer.zip(name).map(|(outer, name)| self.supply(&outer.id, &name.name)).unwrap_or_default()
    }

    /// A folded part as a node type: the ports of the nodes inside under the names that the part offers.
    fn node_type(&self, part: &PartOutline, doc: &str) -> NodeType {
        let flat = |(node, port): &(String, String)| Some((self.flat.node(node)?, port.clone()));
        let mut inputs = Vec::new();
        for port in &part.inputs {
            let targets = self.targets(&part.id, &port.name, |p| &p.inputs);
            let inner = targets.iter().filter_map(flat).filter_map(|(n, p)| self.flat.nodes[n].input(&p));
            let inner: Vec<&Port> = inner.collect();
            if let Some(first) = inner.first() {
                let optional = inner.iter().all(|p| p.optional);
                inputs.push(Port { name: port.name.clone(), optional, ..(*first).clone() });
            }
        }
        let outputs = part.outputs.iter().filter_map(|port| {
            let (node, inner) = flat(self.targets(&part.id, &port.name, |p| &p.outputs).first()?)?;
            Some(Port { name: port.name.clone(), ..self.flat.nodes[node].output(&inner)?.clone() })
        });
        let params = part.params.iter().filter_map(|port| {
            let (node, inner) = flat(self.targets(&part.id, &port.name, |p| &p.params).first()?)?;
            let node = &self.flat.nodes[node];
            let param = node.node_type.as_ref()?.params.iter().find(|p| p.name == inner)?;
            // What the part's file says holds while its user says nothing.
            let value = node.outline.params.get(&inner).filter(|_| !part.given_params.contains_key(&port.name));
            let kind = value.map_or_else(|| param.kind.clone(), |value| with_default(&param.kind, value));
            Some(Param { name: port.name.clone(), kind, ..param.clone() })
        });
        NodeType {
            name: part.file.clone(),
            plugin: "part".to_owned(),
            family: FAMILY.to_owned(),
            doc: doc.to_owned(),
            outputs: outputs.collect(),
            params: params.collect(),
            inputs,
            ..NodeType::default()
        }
    }

    /// The node that stands for a folded part.
    fn as_node(&self, part: &PartOutline, parsed: &GraphText) -> NodeView {
        let file = part.path.as_ref().and_then(|path| parsed.files().into_iter().skip(1).find(|f| f.key() == *path));
        let doc = file.map(|file| opening(file.text)).unwrap_or_default();
        let inside = |n: &&NodeView| n.id().strip_prefix(&part.id).is_some_and(|rest| rest.starts_with('/'));
        NodeView {
            outline: NodeOutline {
                id: part.id.clone(),
                type_name: part.file.clone(),
                inputs: part.given.clone(),
                params: part.given_params.clone(),
                line: part.line,
            },
            node_type: Some(Arc::new(self.node_type(part, &doc))),
            position: position(parsed.editor(), &part.id),
            mistakes: self.flat.nodes.iter().filter(inside).flat_map(|n| n.mistakes.clone()).collect(),
            is_part: true,
        }
    }

    /// The drawn nodes.
    fn nodes(&self, parsed: &GraphText) -> Vec<NodeView> {
        let mut nodes: Vec<NodeView> = Vec::new();
        for node in &self.flat.nodes {
            let shown = shown_as(node.id(), self.open);
            if shown == node.id() {
                nodes.push(node.clone());
            } else if !nodes.iter().any(|n| n.id() == shown)
                && let Some(part) = self.part(shown)
            {
                nodes.push(self.as_node(part, parsed));
            }
        }
        // Parts without nodes, and those whose file cannot be used.
        for part in self.parts.iter().filter(|p| is_visible(&p.id, self.open) && !self.open.contains(&p.id)) {
            if !nodes.iter().any(|n| n.id() == part.id) {
                nodes.push(self.as_node(part, parsed));
            }
        }
        nodes
    }

    /// The wires between drawn nodes.
    fn wires(&self, nodes: &[NodeView]) -> Vec<Wire> {
        let index: HashMap<&str, usize> = nodes.iter().enumerate().map(|(n, node)| (node.id(), n)).collect();
        let mut wires = Vec::new();
        for (to, node) in nodes.iter().enumerate() {
            let mut add = |input: &str, sources: Vec<(String, String, bool)>| {
                for (k, (source, port, delayed)) in sources.into_iter().enumerate() {
                    let (source, output) = self.source(&source, &port);
                    if let Some(&from) = index.get(source.as_str()) {
                        wires.push(Wire { from, output, to, input: input.to_owned(), index: k, delayed });
                    }
                }
            };
            if node.is_part {
                let part = self.part(node.id());
                part.into_iter().flat_map(|p| &p.inputs).for_each(|p| add(&p.name, self.supply(node.id(), &p.name)));
                continue;
            }
            for input in &node.outline.inputs {
                let written = |r: &panoscope_graph::Reference| {
                    let (node, port) = r.written.clone().unwrap_or_else(|| (r.node.clone(), r.port.clone()));
                    (node, port, r.delay > 0)
                };
                add(&input.port, input.from.iter().map(written).collect());
            }
        }
        wires
    }
}

fn with_default(kind: &ParamKind, value: &toml::Value) -> ParamKind {
    let mut kind = kind.clone();
    match &mut kind {
        ParamKind::Bool { default } => *default = value.as_bool().unwrap_or(*default),
        ParamKind::Int { default, .. } => *default = value.as_integer().unwrap_or(*default),
        ParamKind::Float { default, .. } => {
            *default = value.as_float().or(value.as_integer().map(|i| i as f64)).unwrap_or(*default);
        }
        ParamKind::Choice { default, .. } | ParamKind::Text { default } | ParamKind::Path { default, .. } => {
            if let Some(text) = value.as_str() {
                text.clone_into(default);
            }
        }
        ParamKind::Floats { default, .. } => {
            if let Some(list) = value.as_array() {
                *default = list.iter().filter_map(|v| v.as_float().or(v.as_integer().map(|i| i as f64))).collect();
            }
        }
    }
    kind
}

/// The drawn graph: the flat one with folded parts in place of their nodes.
pub(crate) fn drawn(flat: GraphView, parsed: &GraphText) -> GraphView {
    let parts = parsed.parts();
    if parts.is_empty() {
        return flat;
    }
    let editor = parsed.editor();
    let open: BTreeSet<String> =
        opened(editor).into_iter().filter(|id| parts.iter().any(|p| p.id == *id && p.path.is_some())).collect();
    let flat = Arc::new(flat);
    let folding = Folding { flat: &flat, parts: &parts, open: &open };
    let nodes = folding.nodes(parsed);
    let wires = folding.wires(&nodes);
    let mut targets = BTreeMap::new();
    for part in &parts {
        for (ports, of, input) in [
            (&part.inputs, (|p: &PartOutline| p.inputs.as_slice()) as fn(&PartOutline) -> &[PartPort], true),
            (&part.outputs, |p: &PartOutline| p.outputs.as_slice(), false),
        ] {
            for port in ports {
                targets.insert((part.id.clone(), port.name.clone(), input), folding.targets(&part.id, &port.name, of));
            }
        }
    }
    let visible = parts.iter().filter(|p| is_visible(&p.id, &open)).map(|part| PartView {
        id: part.id.clone(),
        file: part.file.clone(),
        users: part.path.as_ref().map(|path| parsed.part_users(path)).unwrap_or_default(),
        path: part.path.clone(),
        open: open.contains(&part.id),
        position: position(editor, &part.id),
    });
    GraphView {
        nodes,
        wires,
        parts: visible.collect(),
        targets,
        diagnostics: flat.diagnostics.clone(),
        marks: flat.marks.clone(),
        name: flat.name.clone(),
        file: flat.file.clone(),
        valid: flat.valid,
        flat: Some(flat),
    }
}

/// The position of a node in an `[editor]` table; of a node of a part, from the part's corner.
pub(crate) fn position(editor: &toml::Table, id: &str) -> Option<(f32, f32)> {
    let number = |v: &toml::Value| v.as_float().or(v.as_integer().map(|i| i as f64)).map(|v| v as f32);
    let at = |axis: &str| editor.get(id)?.get(axis).and_then(number);
    at("x").zip(at("y"))
}

/// The comment at the beginning of a file.
pub fn opening(text: &str) -> String {
    let lines = text.lines().take_while(|line| line.starts_with('#'));
    lines.map(|line| line.trim_start_matches('#').trim()).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_opening_comment_is_one_text() {
        assert_eq!(opening("# Wide view\n# from two.\nname = \"x\"\n# not this"), "Wide view from two.");
    }

    #[test]
    fn a_node_shows_as_the_outermost_folded_part_around_it() {
        let open = BTreeSet::from(["a".to_owned(), "a/b".to_owned(), "c/d".to_owned()]);
        let shown = ["a/b/n", "a/x/n", "c/d/n", "n"].map(|id| shown_as(id, &open));
        assert_eq!(shown, ["a/b/n", "a/x", "c", "n"]);
        assert!(is_visible("a/b/n", &open) && !is_visible("c/d/n", &open));
    }
}
