//! The `[part]` table of a part: the names that it offers and what they stand for.

use super::references::{mentions, rename_reference, replace};
use super::{EditError, GraphEdit, put_entry, take_entry};
use toml_edit::{Array, InlineTable, Item, Table, TableLike, Value as EditValue};

/// Kind of a name that a part offers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PartPortKind {
    /// An input.
    Input,
    /// An output.
    Output,
    /// A parameter.
    Param,
}

impl PartPortKind {
    pub(super) const ALL: [Self; 3] = [Self::Input, Self::Output, Self::Param];

    /// Name of its table inside `[part]`.
    fn key(self) -> &'static str {
        match self {
            Self::Input => "inputs",
            Self::Output => "outputs",
            Self::Param => "params",
        }
    }
}

impl GraphEdit {
    fn part_ports(&self, kind: PartPortKind) -> Option<&dyn TableLike> {
        self.document.get("part")?.get(kind.key())?.as_table_like()
    }

    fn part_ports_mut(&mut self, kind: PartPortKind) -> Option<&mut dyn TableLike> {
        self.document.get_mut("part")?.get_mut(kind.key())?.as_table_like_mut()
    }

    /// Names of one kind that the part offers, in file order.
    pub fn part_port_names(&self, kind: PartPortKind) -> Vec<String> {
        self.part_ports(kind).into_iter().flat_map(|ports| ports.iter()).map(|(name, _)| name.to_owned()).collect()
    }

    /// Targets of a name of the part, each as `node.port`.
    pub fn part_targets(&self, kind: PartPortKind, name: &str) -> Vec<String> {
        let item = self.part_ports(kind).and_then(|ports| ports.get(name));
        match item.and_then(Item::as_value) {
            Some(EditValue::Array(list)) => list.iter().filter_map(EditValue::as_str).map(str::to_owned).collect(),
            Some(value) => value.as_str().map(str::to_owned).into_iter().collect(),
            None => Vec::new(),
        }
    }

    /// The name that stands for `node.port`, alone or with others.
    pub fn part_port_of(&self, kind: PartPortKind, target: &str) -> Option<String> {
        let stands = |name: &String| self.part_targets(kind, name).iter().any(|t| t == target);
        self.part_port_names(kind).into_iter().find(stands)
    }

    /// Sets what a name of the part stands for; without targets the name is removed.
    pub fn set_part_port(&mut self, kind: PartPortKind, name: &str, targets: &[String]) {
        let value = match targets {
            [] => {
                if let Some(ports) = self.document.get_mut("part").and_then(|part| part.get_mut(kind.key())) {
                    take_entry(ports, name);
                }
                return;
            }
            [one] => EditValue::from(one.as_str()),
            several => EditValue::Array(several.iter().map(String::as_str).collect::<Array>()),
        };
        let root = self.document.as_table_mut();
        let part = root.entry("part").or_insert_with(|| Item::Table(Table::new()));
        let Some(part) = part.as_table_like_mut() else { return };
        if !part.contains_key(kind.key()) {
            part.insert(kind.key(), Item::Value(EditValue::InlineTable(InlineTable::new())));
        }
        if let Some(ports) = part.get_mut(kind.key()) {
            put_entry(ports, name, value);
        }
    }

    /// A name that the part does not offer yet: `port`, `node_port`, `node_port_2`, ...
    pub fn free_part_port(&self, kind: PartPortKind, node: &str, port: &str) -> String {
        let taken = self.part_port_names(kind);
        free_name(node, port, |name| taken.iter().any(|t| t == name))
    }

    /// Removes what the names of the part stand for in a node; returns the names that then stand for nothing; they are
    /// removed.
    pub(super) fn remove_part_targets(&mut self, node: &str) -> Vec<(PartPortKind, String)> {
        let mut removed = Vec::new();
        for kind in PartPortKind::ALL {
            for name in self.part_port_names(kind) {
                let mut targets = self.part_targets(kind, &name);
                let before = targets.len();
                targets.retain(|t| !t.split_once('.').is_some_and(|(n, _)| mentions(n, node)));
                if targets.len() < before {
                    self.set_part_port(kind, &name, &targets);
                    if targets.is_empty() {
                        removed.push((kind, name));
                    }
                }
            }
        }
        removed
    }

    /// Renames a node in what the names of the part stand for.
    pub(super) fn rename_part_targets(&mut self, old: &str, new: &str) {
        self.each_part_target(&mut |value| rename_reference(value, old, new));
    }

    /// Calls `act` with each `node.port` of `[part]`.
    pub(super) fn each_part_target(&mut self, act: &mut dyn FnMut(&mut EditValue)) {
        for kind in PartPortKind::ALL {
            let Some(ports) = self.part_ports_mut(kind) else { continue };
            for (_, item) in ports.iter_mut() {
                match item.as_value_mut() {
                    Some(EditValue::Array(list)) => list.iter_mut().for_each(&mut *act),
                    Some(value) => act(value),
                    None => {}
                }
            }
        }
    }

    /// Replaces `node.port` among what the names of one kind stand for by several others.
    pub(super) fn replace_part_target(&mut self, kind: PartPortKind, old: &str, new: &[String]) {
        for name in self.part_port_names(kind) {
            let targets = self.part_targets(kind, &name);
            if !targets.iter().any(|t| t == old) {
                continue;
            }
            if let ([_], [one]) = (&targets[..], new) {
                let ports = self.part_ports_mut(kind);
                if let Some(value) = ports.and_then(|p| p.get_mut(&name)).and_then(Item::as_value_mut) {
                    replace(value, one);
                }
                continue;
            }
            let mut all: Vec<String> = Vec::new();
            for target in targets {
                let with = if target == old { new.to_vec() } else { vec![target] };
                with.into_iter().for_each(|t| {
                    if !all.contains(&t) {
                        all.push(t)
                    }
                });
            }
            self.set_part_port(kind, &name, &all);
        }
    }

    /// Removes uses of a name that the file's node `user`, a part, no longer offers. Returns the names of this file's
    /// own `[part]` that then stand for nothing; they are removed too.
    pub(super) fn forget_port(
        &mut self,
        user: &str,
        kind: PartPortKind,
        name: &str,
    ) -> Result<Vec<(PartPortKind, String)>, EditError> {
        let target = format!("{user}.{name}");
        match kind {
            PartPortKind::Input => self.remove_input(user, name)?,
            PartPortKind::Param => self.unset_param(user, name)?,
            PartPortKind::Output => self.each_input(|inputs| {
                let gone: Vec<String> = inputs
                    .iter_mut()
                    .filter_map(|(key, item)| without_output(item, &target).then(|| key.get().to_owned()))
                    .collect();
                for key in gone {
                    inputs.remove(&key);
                }
            })?,
        }
        let preset = self.document.get_mut("preset");
        let (list, key) = match kind {
            PartPortKind::Output => ("views", "from"),
            _ => ("pinned", "param"),
        };
        if kind != PartPortKind::Input
            && let Some(entries) = preset.and_then(|p| p.get_mut(list)).and_then(Item::as_array_mut)
        {
            let named = |value: &EditValue| {
                let text = value.as_inline_table().map_or(Some(value), |table| table.get(key));
                text.and_then(EditValue::as_str).is_some_and(|text| text == target)
            };
            entries.retain(|value| !named(value));
        }
        let Some(port) = self.part_port_of(kind, &target) else { return Ok(Vec::new()) };
        let mut targets = self.part_targets(kind, &port);
        targets.retain(|t| *t != target);
        self.set_part_port(kind, &port, &targets);
        Ok(if targets.is_empty() { vec![(kind, port)] } else { Vec::new() })
    }

    /// The references of an input as written; `None` where the node has no entry for it.
    pub fn input_references(&self, id: &str, input: &str) -> Option<Vec<String>> {
        let item = self.document.get("nodes")?.get(id)?.get("inputs")?.get(input)?;
        Some(super::references::references(item))
    }

    /// Copies an entry of a node's inputs under another name.
    pub(super) fn copy_input(&mut self, id: &str, input: &str, copy: &str) -> Result<(), EditError> {
        let value = self.document.get("nodes").and_then(|n| n.get(id)?.get("inputs")?.get(input)?.as_value().cloned());
        value.map_or(Ok(()), |mut value| {
            value.decor_mut().clear();
            self.put(id, "inputs", copy, value)
        })
    }
}

/// Removes connections that read one output from an input. Returns whether nothing is left of it.
fn without_output(item: &mut Item, output: &str) -> bool {
    let reads = |value: &EditValue| {
        let text = value.as_inline_table().map_or(Some(value), |table| table.get("from"));
        text.and_then(EditValue::as_str) == Some(output)
    };
    match item {
        Item::Value(EditValue::Array(list)) => {
            list.retain(|value| !reads(value));
            list.is_empty()
        }
        Item::Value(value) => reads(value),
        Item::Table(table) => table.get("from").and_then(Item::as_str) == Some(output),
        _ => false,
    }
}

/// `port`, `node_port`, `node_port_2`, ...: the first that is free.
pub(super) fn free_name(node: &str, port: &str, taken: impl Fn(&str) -> bool) -> String {
    let long = format!("{node}_{port}").replace('/', "_");
    let numbered = (2..).map(|k| format!("{long}_{k}"));
    let mut names = [port.to_owned(), long.clone()].into_iter().chain(numbered);
    names.find(|name| !taken(name)).unwrap_or(long)
}
