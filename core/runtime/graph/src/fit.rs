//! Optional connections, views and pins: left out where an overlay replaced the node that they name and the new one
//! does not have what they name. Optional connections are also left out where the type of a node at one of their ends
//! lacks the port, as after a swap of its algorithm.

use std::borrow::Cow;
use std::collections::HashSet;

use crate::catalog::{Catalog, NodeType};
use crate::file::{InputText, NodeText, RefText};
use crate::text::GraphText;

/// Nodes and ports that overlays removed.
struct Absent<'a> {
    text: &'a GraphText,
    catalog: &'a Catalog,
    /// Nodes that were left out because all their connections were.
    nodes: HashSet<String>,
}

impl Absent<'_> {
    /// Whether the node was replaced and none of the types that it may have has `name`. An unknown type is reported
    /// elsewhere.
    fn lacks(&self, id: &str, has: impl Fn(&NodeType) -> bool) -> bool {
        if self.nodes.contains(id) {
            return true;
        }
        if !self.text.flat.replaced.contains_key(id) {
            return false;
        }
        let node = self.text.flat.nodes.iter().find(|n| n.id.value == id);
        let Some(type_name) = node.and_then(|n| n.type_name.as_ref()) else { return false };
        let types = self.catalog.find(&type_name.value);
        !types.is_empty() && !types.into_iter().any(|t| has(&self.catalog.node_types[t]))
    }

    fn reference(&self, reference: &RefText) -> bool {
        let output = |t: &NodeType| t.output(&reference.port).is_some();
        let is_gone = || {
            let node = self.text.flat.nodes.iter().find(|node| node.id.value == reference.node);
            self.lacks(&reference.node, output) || node.is_some_and(|node| self.only_others_have(node, output))
        };
        reference.absent || reference.optional && is_gone()
    }

    /// Whether the input is optional and the type of its node has none of this name.
    fn input(&self, node: &NodeText, input: &InputText) -> bool {
        is_optional(input) && self.only_others_have(node, |t| t.input(&input.port.value).is_some())
    }

    /// Whether the node's type lacks a name that another type has. A name that no type has is a spelling mistake.
    fn only_others_have(&self, node: &NodeText, has: impl Fn(&NodeType) -> bool) -> bool {
        let types = node.type_name.as_ref().map_or_else(Vec::new, |name| self.catalog.find(&name.value));
        !types.is_empty()
            && !types.into_iter().any(|t| has(&self.catalog.node_types[t]))
            && self.catalog.node_types.iter().any(has)
    }

    /// Whether a node had connections and has lost all of them.
    fn node(&self, node: &NodeText) -> bool {
        let mut all = node.inputs.iter().flat_map(|i| &i.refs).peekable();
        all.peek().is_some() && all.all(|r| self.reference(r))
    }
}

fn is_optional(input: &InputText) -> bool {
    !input.refs.is_empty() && input.refs.iter().all(|reference| reference.optional)
}

impl GraphText {
    /// The graph with its optional connections, views and pins as far as they exist. A node that loses its only
    /// connections is left out too.
    pub(crate) fn fitted(&self, catalog: &Catalog) -> Cow<'_, Self> {
        if self.flat.replaced.is_empty() && !self.flat.nodes.iter().flat_map(|node| &node.inputs).any(is_optional) {
            return Cow::Borrowed(self);
        }
        let mut absent = Absent { text: self, catalog, nodes: HashSet::new() };
        loop {
            let lost = self.flat.nodes.iter().filter(|n| absent.node(n)).map(|n| n.id.value.clone());
            let lost: HashSet<String> = lost.collect();
            if lost.len() == absent.nodes.len() {
                break;
            }
            absent.nodes = lost;
        }
        let mut fitted = self.clone();
        fitted.flat.nodes.retain(|n| !absent.nodes.contains(&n.id.value));
        for node in &mut fitted.flat.nodes {
            let mut unknown = node.inputs.iter().map(|input| absent.input(node, input)).collect::<Vec<_>>().into_iter();
            node.inputs.retain_mut(|input: &mut InputText| {
                if unknown.next() == Some(true) {
                    return false;
                }
                let before = input.refs.len();
                input.refs.retain(|r| !absent.reference(r));
                before == 0 || !input.refs.is_empty()
            });
        }
        fitted.views.retain(|view| !absent.reference(&view.from));
        fitted.pins.retain(|pin| {
            let lacks = |(id, param): (&str, &str)| absent.lacks(id, |t| t.param(param).is_some());
            !(pin.absent || pin.optional && pin.param.value.split_once('.').is_some_and(lacks))
        });
        Cow::Owned(fitted)
    }
}
