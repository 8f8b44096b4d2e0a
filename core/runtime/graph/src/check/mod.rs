//! Checks that need the catalog: names, types, limits, and how ticks flow through the wiring.

mod files;
mod flow;
mod inputs;
mod isolate;
mod nodes;
mod params;
mod preset;
mod types;

use crate::catalog::{Catalog, NodeType};
use crate::checked::{Align, Deny, Edge, Graph, Node, Preset};
use crate::diagnostic::{Diagnostic, Diagnostics, Severity};
use crate::param::ParamValue;
use crate::text::GraphText;
use std::collections::{HashMap, HashSet};
use std::ops::Range;

/// Outcome of [`check`].
#[derive(Clone, Debug)]
pub struct Checked {
    /// The graph, when there is no error.
    pub graph: Option<Graph>,
    /// All errors and warnings, sorted by position.
    pub diagnostics: Diagnostics,
}

impl Checked {
    /// The graph and its warnings, or all diagnostics.
    pub fn into_result(self) -> Result<(Graph, Diagnostics), Diagnostics> {
        match self.graph {
            Some(graph) => Ok((graph, self.diagnostics)),
            None => Err(self.diagnostics),
        }
    }
}

/// Checks a graph against the node types of this machine: the catalog may hold more than the plugins the graph lists.
/// Reports every mistake at once, those of [`GraphText::parse`] and [`GraphText::set`] included.
pub fn check(text: &GraphText, catalog: &Catalog) -> Checked {
    let text = &*text.fitted(catalog);
    let mut checker = Checker {
        text,
        catalog,
        diagnostics: text.diagnostics.clone(),
        ids: HashMap::new(),
        doubled: HashSet::new(),
        sound: vec![true; text.flat.nodes.len()],
        listed: text
            .flat
            .plugins
            .iter()
            .map(|(file, list)| (*file, list.iter().map(|p| p.value.as_str()).collect()))
            .collect(),
        types: Vec::new(),
        links: Vec::new(),
    };
    text.missing_diagnostics().for_each(|d| _ = checker.diagnostics.push(d.clone()));
    for (index, node) in text.flat.nodes.iter().enumerate() {
        if *checker.ids.entry(node.id.value.as_str()).or_insert(index) != index {
            checker.doubled.insert(&node.id.value);
        }
    }
    checker.plugins();
    checker.plugin_paths();
    checker.types = text.flat.nodes.iter().map(|node| checker.node_type(node)).collect();
    checker.empty();
    let params = checker.params();
    checker.inputs();
    checker.exports();
    let order = checker.flow();
    let pinned = checker.pins();
    checker.files(&params);
    checker.isolation();
    checker.nodes(&params);
    checker.finish(params, order, pinned)
}

/// A connection as far as it could be resolved.
struct Link<'a> {
    from_node: usize,
    from_port: Option<usize>,
    to_node: usize,
    to_port: Option<usize>,
    /// Name of the input as written.
    to_name: &'a str,
    list_index: usize,
    align: Align,
    max_age_ms: Option<f64>,
    guide: bool,
    queue: Option<u32>,
    delay: u8,
    trigger: Option<&'a Range<usize>>,
    convert: bool,
    span: &'a Range<usize>,
}

struct Checker<'a> {
    text: &'a GraphText,
    catalog: &'a Catalog,
    diagnostics: Diagnostics,
    /// Position of each node; the first of several of one name.
    ids: HashMap<&'a str, usize>,
    /// Names that several nodes have; references to them are ambiguous.
    doubled: HashSet<&'a str>,
    /// Per node, whether its parameters and inputs are without errors so far.
    sound: Vec<bool>,
    /// Plugins that each file lists, by its position among the sources.
    listed: HashMap<usize, HashSet<&'a str>>,
    /// Per node, its type's position in the catalog.
    types: Vec<Option<usize>>,
    links: Vec<Link<'a>>,
}

impl<'a> Checker<'a> {
    fn error(&mut self, code: &'static str, span: &Range<usize>, message: String) -> &mut Diagnostic {
        self.diagnostics.push(Diagnostic::new(Severity::Error, code, self.text.sources.of(span), span, message))
    }

    fn warning(&mut self, code: &'static str, span: &Range<usize>, message: String) -> &mut Diagnostic {
        self.diagnostics.push(Diagnostic::new(Severity::Warning, code, self.text.sources.of(span), span, message))
    }

    /// Type of a node, if it is known.
    fn type_of(&self, node: usize) -> Option<&'a NodeType> {
        self.types[node].map(|t| &self.catalog.node_types[t])
    }

    fn id(&self, node: usize) -> &'a str {
        &self.text.flat.nodes[node].id.value
    }

    fn empty(&mut self) {
        if self.text.flat.nodes.is_empty()
            && self.text.flat.parts.is_empty()
            && !self.text.incomplete
            && !self.diagnostics.has_errors()
        {
            self.error("empty-graph", &(0..0), "this graph has no nodes".to_owned())
                .help("add one, as in\n[nodes.scope]\ntype = \"phantom\"");
        }
    }

    /// Checks that outputs and parameters named by parts exist.
    fn exports(&mut self) {
        let flat = &self.text.flat;
        for target in &flat.outputs {
            let Some(node_type) = self.ids.get(target.node.as_str()).and_then(|&n| self.type_of(n)) else { continue };
            if node_type.output(&target.port.value).is_none() {
                self.unknown_output_at(&target.port.span, &target.node, &target.port.value, node_type, None);
            }
        }
        for target in &flat.params {
            let Some(node_type) = self.ids.get(target.node.as_str()).and_then(|&n| self.type_of(n)) else { continue };
            if node_type.param(&target.port.value).is_none() {
                self.unknown_param(&target.port.span, node_type, &target.port.value);
            }
        }
    }

    /// Moves diagnostics about the value of an argument to where the value was given.
    fn move_to_arguments(&mut self) {
        let text = self.text;
        for d in self.diagnostics.iter_mut() {
            let use_ = text.arg_uses.get(&d.global().start).filter(|u| u.span == *d.global());
            if let Some(origin) = use_.and_then(|u| u.origin.as_ref()) {
                d.move_to(&text.sources, origin, "used here");
            }
        }
    }

    fn finish(mut self, params: Vec<Vec<ParamValue>>, order: Vec<usize>, pinned: Preset) -> Checked {
        self.move_to_arguments();
        self.diagnostics.finish(&self.text.sources.first().name);
        if self.diagnostics.has_errors() {
            return Checked { graph: None, diagnostics: self.diagnostics };
        }
        let mut nodes = Vec::with_capacity(self.text.flat.nodes.len());
        for ((node, type_index), params) in self.text.flat.nodes.iter().zip(&self.types).zip(params) {
            // Without errors every type is known.
            let Some(type_index) = *type_index else { continue };
            let node_type = &self.catalog.node_types[type_index];
            let group = self.text.group_name(node, node_type).map(str::to_owned);
            nodes.push(Node {
                id: node.id.value.clone(),
                type_index,
                type_name: node_type.name.clone(),
                plugin: node_type.plugin.clone(),
                params,
                on_fault: node.on_fault,
                budget_ms: node.budget_ms,
                max_rate_hz: node.max_rate_hz,
                cpu: node.cpu,
                deny: group.as_deref().map_or_else(Deny::default, |group| self.text.denied_to(group)),
                machine: self.text.machine_of(node).cloned(),
                isolate: group,
                span: self.text.sources.of(&node.id.span).local(&node.id.span),
                line: self.text.sources.line(&node.id.span),
            });
        }
        let mut edges: Vec<Edge> = self.links.iter().filter_map(edge).collect();
        edges.sort_by_key(|e| (e.to_node, e.to_port, e.list_index));
        let isolated_plugins = self.text.plugins().into_iter().filter(|plugin| {
            let mut nodes = nodes.iter().filter(|node| node.plugin == *plugin).peekable();
            let is_named = self.text.isolate.iter().any(|(name, _)| name.value == *plugin);
            is_named || (nodes.peek().is_some() && nodes.all(|node| node.isolate.is_some()))
        });
        let isolated_plugins = isolated_plugins.collect();
        let graph = Graph {
            name: self.text.name().to_owned(),
            mode: self.text.mode,
            plugins: self.text.plugins(),
            isolated_plugins,
            nodes,
            edges,
            order,
            preset: pinned,
            editor: self.text.editor.clone(),
        };
        Checked { graph: Some(graph), diagnostics: self.diagnostics }
    }
}

fn edge(link: &Link<'_>) -> Option<Edge> {
    Some(Edge {
        from_node: link.from_node,
        from_port: link.from_port?,
        to_node: link.to_node,
        to_port: link.to_port?,
        list_index: link.list_index,
        align: link.align,
        max_age_ms: link.max_age_ms,
        guide: link.guide,
        queue: link.queue,
        delay: link.delay,
        trigger: link.trigger.is_some(),
        convert: link.convert,
        span: link.span.clone(),
    })
}
