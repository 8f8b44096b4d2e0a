//! Reduces a graph to the nodes that some of its outputs need.

use std::collections::BTreeSet;

use crate::catalog::Offer;
use crate::text::GraphText;

impl GraphText {
    /// Names of these nodes and of all nodes that they read, directly or not. Unknown names are left out.
    fn needed(&self, nodes: &[&str]) -> BTreeSet<String> {
        let mut needed = BTreeSet::new();
        let mut open: Vec<&str> = nodes.to_vec();
        while let Some(id) = open.pop() {
            let Some(node) = self.flat.nodes.iter().find(|node| node.id.value == id) else { continue };
            if needed.insert(id.to_owned()) {
                open.extend(node.inputs.iter().flat_map(|input| &input.refs).map(|from| from.node.as_str()));
            }
        }
        needed
    }

    /// Removes nodes that these nodes do not need, and plugins that then have no node left. Diagnostics keep their
    /// locations in the files.
    ///
    /// `offers` has the node types of the plugins; a plugin that it does not have stays.
    pub fn reduce_to(&mut self, nodes: &[&str], offers: &[Offer]) {
        let needed = self.needed(nodes);
        let has = |id: &str| needed.contains(id);
        self.flat.nodes.retain(|node| has(&node.id.value));
        let node_of = |reference: &str| reference.rsplit_once('.').map_or(reference, |(node, _)| node).to_owned();
        self.pins.retain(|pin| has(&node_of(&pin.param.value)));
        self.views.retain(|view| has(&view.from.node));
        self.overrides.retain(|setting| has(&setting.node.value));
        let types: BTreeSet<&str> =
            self.flat.nodes.iter().filter_map(|node| Some(node.type_name.as_ref()?.value.as_str())).collect();
        let is_of = |offer: &Offer, written: &str| match written.split_once('/') {
            Some((plugin, name)) => offer.plugin == plugin && offer.node_types.iter().any(|known| known == name),
            None => offer.node_types.iter().any(|known| known == written),
        };
        let is_used = |plugin: &str| {
            let offer = offers.iter().find(|offer| offer.plugin == plugin);
            offer.is_none_or(|offer| types.iter().any(|written| is_of(offer, written)))
        };
        self.flat.plugins.iter_mut().for_each(|(_, plugins)| plugins.retain(|plugin| is_used(&plugin.value)));
        let plugins = self.plugins();
        self.isolate.retain(|(plugin, _)| plugins.contains(&plugin.value));
        let groups: BTreeSet<&str> = self.isolate.iter().map(|(_, group)| group.value.as_str()).collect();
        let nodes = || self.flat.nodes.iter().filter_map(|node| node.isolate.as_ref());
        let is_group = |name: &str| groups.contains(name) || nodes().any(|group| group.value == name);
        let flat = &self.flat;
        let is_on = |name: &str| flat.nodes.iter().any(|node| node.on.as_ref().is_some_and(|on| on.value == name));
        self.machines.retain(|machine| is_on(&machine.name.value));
        let denied: Vec<_> = self.deny.iter().filter(|(group, _)| is_group(&group.value)).cloned().collect();
        self.deny = denied;
        self.is_reduced = true;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = r#"
plugins = ["made", "written", "unknown"]
[nodes.source]
type = "source"
[nodes.filter]
type = "filter"
inputs = { image = { from = "source.image", delay = 1 } }
[nodes.file]
type = "write"
inputs = { image = "filter.image" }
params = { path = "a.png" }
[isolate]
written = "writes"
[deny]
writes = ["network"]
[preset]
pinned = [{ param = "file.path" }, { param = "filter.gain" }]
views = [{ from = "source.image" }]
"#;

    #[test]
    fn what_an_output_does_not_need_is_left_out() {
        let offer = |plugin: &str, types: &[&str]| Offer {
            plugin: plugin.to_owned(),
            node_types: types.iter().map(|name| (*name).to_owned()).collect(),
        };
        let offers = [offer("made", &["source", "filter"]), offer("written", &["write"])];
        let mut text = GraphText::parse("a.toml".as_ref(), TEXT);
        text.set("file.path=b.png");
        text.set("filter.gain=2");
        text.reduce_to(&["filter", "no_such_node"], &offers);
        let ids: Vec<String> = text.outline().into_iter().map(|node| node.id).collect();
        assert_eq!(ids, ["source", "filter"]);
        assert_eq!(text.plugins(), ["made", "unknown"]);
        assert!(text.isolate.is_empty() && text.deny.is_empty(), "of a plugin that is left out");
        assert_eq!((text.pins.len(), text.views.len()), (1, 1));
        assert_eq!(text.settings(), ["filter.gain=2"]);
        let flattened = text.flattened(&crate::Catalog::default()).into_owned();
        assert!(!flattened.contains("a.png") && flattened.contains("source.image"), "{flattened}");
    }
}
