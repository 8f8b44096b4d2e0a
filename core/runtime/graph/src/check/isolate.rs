//! Which nodes run in separate processes, and which cannot.

use std::path::PathBuf;

use super::Checker;
use crate::catalog::{NodeKind, NodeType};
use crate::checked::{Deny, Machine, Mode};
use crate::file::NodeText;
use crate::nearest::{list, nearest};
use crate::text::GraphText;
use crate::value::Spanned;

impl GraphText {
    /// The group that a node of a plugin runs in: that of its machine, its own, else that of its plugin.
    pub(crate) fn group_of<'t>(&'t self, node: &'t NodeText, plugin: &str) -> Option<&'t Spanned<String>> {
        let of_plugin = || self.isolate.iter().rev().find(|(name, _)| name.value == plugin).map(|(_, group)| group);
        node.on.as_ref().or(node.isolate.as_ref()).or_else(of_plugin)
    }

    /// The group that a node runs in: as [`Self::group_of`], else, if another program runs it, a group of its plugin's
    /// name.
    pub(crate) fn group_name<'t>(&'t self, node: &'t NodeText, node_type: &'t NodeType) -> Option<&'t str> {
        let of_plugin = || node_type.interpreter.as_ref().map(|_| node_type.plugin.as_str());
        self.group_of(node, &node_type.plugin).map(|group| group.value.as_str()).or_else(of_plugin)
    }

    /// The machine that a node runs on, if it is another one; of two entries of a machine the last counts.
    pub(crate) fn machine_of(&self, node: &NodeText) -> Option<&Machine> {
        let name = &node.on.as_ref()?.value;
        self.machines.iter().rev().find(|known| known.name.value == *name).map(|known| &known.machine)
    }

    /// Denied permissions of a group.
    pub(crate) fn denied_to(&self, group: &str) -> Deny {
        let entry = self.deny.iter().rev().find(|(name, _)| name.value == group);
        entry.map(|(_, deny)| *deny).unwrap_or_default()
    }
}

impl Checker<'_> {
    pub(super) fn isolation(&mut self) {
        let text = self.text;
        let plugins = text.plugins();
        for (plugin, _) in &text.isolate {
            if plugins.contains(&plugin.value) || text.incomplete {
                continue;
            }
            let near = nearest(&plugin.value, plugins.iter().map(String::as_str));
            let help = format!("plugins of the graph: {}", list(plugins.iter().map(String::as_str), 12, "and"));
            let message = format!("`isolate` names `{}`, which is no plugin of the graph", plugin.value);
            self.error("unknown-isolated-plugin", &plugin.span, message)
                .label(near.map(|n| format!("did you mean `{n}`?")).unwrap_or_default())
                .help(help);
        }
        let nodes = text.flat.nodes.iter().filter_map(|node| node.isolate.as_ref());
        let groups: Vec<&str> =
            text.isolate.iter().map(|(_, group)| group).chain(nodes).map(|group| group.value.as_str()).collect();
        let used = (0..text.flat.nodes.len()).filter_map(|index| self.type_of(index));
        let interpreted = used.filter(|node_type| node_type.interpreter.is_some());
        let groups: Vec<&str> =
            groups.into_iter().chain(interpreted.map(|node_type| node_type.plugin.as_str())).collect();
        for (group, _) in &text.deny {
            if groups.contains(&group.value.as_str()) || text.incomplete {
                continue;
            }
            let near = nearest(&group.value, groups.iter().copied());
            let message = format!("`deny` names `{}`, which is no group of isolated nodes", group.value);
            self.error("unknown-group", &group.span, message)
                .label(near.map(|n| format!("did you mean `{n}`?")).unwrap_or_default())
                .help("groups are what `isolate` names");
        }
        self.interpreters();
        self.machines();
        self.coded_pixels();
        for (index, node) in text.flat.nodes.iter().enumerate() {
            let Some(node_type) = self.type_of(index) else { continue };
            let Some(group) = text.group_of(node, &node_type.plugin) else { continue };
            let id = self.id(index);
            if node.on.is_some() {
                continue;
            }
            if node_type.kind == NodeKind::Realtime {
                let message =
                    format!("`{id}` ({}) is a control loop, which cannot run in another process", node_type.name);
                self.error("isolated-realtime", &group.span, message)
                    .label("its period would depend on that process")
                    .help("isolate the nodes that it depends on, and leave out this one: write `isolate` at nodes, not for the plugin");
            }
            if node.cpu.is_some() {
                let message =
                    format!("`{id}` has `cpu` and `isolate`; the thread that works for it is in another process");
                self.error("isolated-cpu", &group.span, message).help("remove one of the two");
            }
        }
    }

    /// Checks which nodes run on which machine.
    fn machines(&mut self) {
        let text = self.text;
        let machines = || text.machines.iter().map(|known| known.name.value.as_str());
        for (index, node) in text.flat.nodes.iter().enumerate() {
            let Some(on) = &node.on else { continue };
            let id = self.id(index);
            if text.machine_of(node).is_none() && !text.incomplete {
                let near = nearest(&on.value, machines());
                let message = format!("`{id}` runs on `{}`, which is no machine of the graph", on.value);
                let help = match text.machines.is_empty() {
                    true => format!("add [machines.{}] with address = \"tls/10.0.0.2:7447\"", on.value),
                    false => format!("machines of the graph: {}", list(machines(), 12, "and")),
                };
                self.error("unknown-machine", &on.span, message)
                    .label(near.map(|n| format!("did you mean `{n}`?")).unwrap_or_default())
                    .help(help);
                continue;
            }
            if let Some(group) = &node.isolate {
                let message = format!("`{id}` has `on` and `isolate`");
                self.error("machine-and-group", &group.span, message)
                    .help("all nodes of a machine share one process there; remove `isolate`");
            }
            let Some(node_type) = self.type_of(index) else { continue };
            if node_type.kind == NodeKind::Realtime {
                let message =
                    format!("`{id}` ({}) is a control loop, which cannot run on another machine", node_type.name);
                self.error("remote-realtime", &on.span, message)
                    .label("its period would depend on the network")
                    .help("remove `on`");
            }
            if node.cpu.is_some() {
                let message = format!("`{id}` has `cpu` and `on`; the thread that works for it is on another machine");
                self.error("remote-cpu", &on.span, message).help("remove one of the two");
            }
            if node_type.interpreter.is_some() {
                let message = format!("`{id}` ({}) is in Python, which no other machine runs yet", node_type.name);
                self.error("remote-python", &on.span, message).help("remove `on`");
            }
        }
        let on: Vec<&str> = text.flat.nodes.iter().filter_map(|node| Some(node.on.as_ref()?.value.as_str())).collect();
        let groups = text.isolate.iter().map(|(_, group)| group);
        let groups = groups.chain(text.flat.nodes.iter().filter_map(|node| node.isolate.as_ref()));
        let clashes: Vec<&Spanned<String>> = groups.filter(|group| on.contains(&group.value.as_str())).collect();
        for group in clashes {
            let message = format!("`{}` is a machine, so no group of isolated nodes can have this name", group.value);
            self.error("group-named-as-machine", &group.span, message).help("choose another name for the group");
        }
    }

    /// Warns of lossy H.264 pixels at nodes of machines and downstream of them.
    fn coded_pixels(&mut self) {
        let text = self.text;
        let nodes = &text.flat.nodes;
        for known in text.machines.iter().filter(|known| known.machine.pixels.is_lossy()) {
            let name = &known.name;
            if nodes.iter().all(|node| node.on.as_ref().is_none_or(|on| on.value != name.value)) {
                continue;
            }
            if text.mode == Mode::Batch {
                let message = format!("pixels of `{}` travel as H.264, and the graph is a batch", name.value);
                self.error("coded-batch", &name.span, message)
                    .label("a batch gives the same bytes wherever its nodes run")
                    .help("write pixels = \"lz4\", which compresses without loss, or mode = \"live\"");
                continue;
            }
            let mut coded: Vec<bool> =
                nodes.iter().map(|node| node.on.as_ref().is_some_and(|on| on.value == name.value)).collect();
            // Nodes that read what a coded one made, one step further with each round.
            for _ in 0..nodes.len() {
                let before = coded.clone();
                for link in self.links.iter().filter(|link| before[link.from_node]) {
                    coded[link.to_node] = true;
                }
                if coded == before {
                    break;
                }
            }
            let measures = |index: &usize| {
                let outputs = self.type_of(*index).map_or(&[][..], |node_type| &node_type.outputs);
                outputs.iter().any(|port| port.packet.name != "image")
            };
            let behind: Vec<usize> = (0..nodes.len()).filter(|index| coded[*index]).filter(measures).collect();
            if behind.is_empty() {
                continue;
            }
            let names = list(behind.iter().map(|index| self.id(*index)), 8, "and");
            let message = format!("H.264 may change the pixels that {names} measure in");
            self.warning("coded-pixels", &name.span, message)
                .label("colour pictures to and from this machine lose detail")
                .help("write pixels = \"lz4\" where numbers count");
        }
    }

    /// Checks that one program can run each group: nodes of two Python environments, or of Python and of a library,
    /// cannot share it.
    fn interpreters(&mut self) {
        let text = self.text;
        let mut first: Vec<(&str, &Option<PathBuf>, String)> = Vec::new();
        let mut errors = Vec::new();
        for (index, node) in text.flat.nodes.iter().enumerate() {
            let Some(node_type) = self.type_of(index) else { continue };
            let Some(group) = text.group_name(node, node_type) else { continue };
            let Some((_, program, other)) = first.iter().find(|(known, ..)| *known == group) else {
                first.push((group, &node_type.interpreter, self.id(index).to_owned()));
                continue;
            };
            if **program != node_type.interpreter {
                let message = format!(
                    "`{}` and `{other}` are in group `{group}`, but different programs run them",
                    self.id(index)
                );
                let runs = |program: &Option<PathBuf>| {
                    program.as_ref().map_or("panoscope".to_owned(), |program| program.display().to_string())
                };
                let label = format!("{} here, {} there", runs(&node_type.interpreter), runs(program));
                errors.push((node.id.span.clone(), message, label));
            }
        }
        for (span, message, label) in errors {
            self.error("group-of-two-programs", &span, message)
                .label(label)
                .help("give them different groups with `isolate`");
        }
    }
}
