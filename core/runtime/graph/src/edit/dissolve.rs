//! A part dissolved into its nodes: the way back from [`FileEdits::make_part`].

use super::files::{FileEdits, local, parent, whole};
use super::make_part::{rebase, relative};
use super::part::{PartPortKind, free_name};
use super::references::{for_each_reference, references, rename_references, replace};
use super::{EditError, GraphEdit, place_at};
use crate::catalog::Catalog;
use crate::source::folder;
use std::collections::HashMap;
use std::path::Path;
use toml_edit::{Item, Table, Value as EditValue};

impl FileEdits<'_> {
    /// Replaces a part by its nodes. The part's file stays as it is. Returns the whole names of the nodes, before and
    /// after.
    ///
    /// # Errors
    /// There is no such part, an overlay changes it, or an input is connected both inside and outside.
    pub fn dissolve(&mut self, catalog: &Catalog, id: &str) -> Result<Vec<(String, String)>, EditError> {
        self.refuse_overlays_inside(id)?;
        let (home, inner) = (self.own_home(id)?.file, self.level_file(id)?);
        let (level, name) = (parent(id).to_owned(), local(id).to_owned());
        let (from_dir, to_dir) = (folder(&inner), folder(&home));
        let part = self.file(&inner)?.clone();
        let own = part.node_names();
        let paths = self.path_params(catalog, &own.iter().map(|n| whole(id, n)).collect::<Vec<_>>());
        let edit = self.file(&home)?;
        let user = edit.nodes()?.remove(&name).ok_or_else(|| EditError::NoPart { id: id.to_owned() })?;
        let taken = edit.node_names();
        let mut names: Vec<(String, String)> = Vec::new();
        for node in &own {
            let used = |new: &str| taken.iter().any(|t| t == new) || names.iter().any(|(_, n)| n == new);
            let new = free_name(&name, node, used);
            names.push((node.clone(), new));
        }
        let dissolved = Dissolved { part: &part, user, name, names };
        let position = dissolved.user.as_table().and_then(Table::position);
        for (k, (old, new)) in dissolved.names.iter().enumerate() {
            let mut item = dissolved.node(old, &paths, (&from_dir, &to_dir));
            if let Item::Table(table) = &mut item {
                place_at(table, position);
                if k == 0 {
                    dissolved.keep_comment(table);
                }
            }
            edit.nodes()?.insert(new, item);
        }
        dissolved.connect_inputs(edit, id)?;
        dissolved.set_params(edit)?;
        dissolved.redirect_readers(edit)?;
        for plugin in texts(&part, "plugins") {
            edit.add_plugin(&plugin)?;
        }
        for folder in texts(&part, "plugin_paths") {
            edit.add_plugin_path(&rebased_folder(&folder, &from_dir, &to_dir));
        }
        let whole_names = |(old, new): (String, String)| (whole(id, &old), whole(&level, &new));
        Ok(dissolved.names.into_iter().map(whole_names).collect())
    }
}

/// The texts of a list at the top of a file.
fn texts(part: &GraphEdit, key: &str) -> Vec<String> {
    let list = part.document.get(key).and_then(Item::as_array);
    list.into_iter().flatten().filter_map(EditValue::as_str).map(str::to_owned).collect()
}

/// A part that becomes nodes of the graph's file.
struct Dissolved<'p> {
    part: &'p GraphEdit,
    /// Its node in the graph's file: what the graph gives to it.
    user: Item,
    /// Name of that node.
    name: String,
    /// Names of its nodes, in the part's file and in the graph's.
    names: Vec<(String, String)>,
}

impl Dissolved<'_> {
    fn new_name(&self, node: &str) -> Option<&str> {
        self.names.iter().find(|(old, _)| old == node).map(|(_, new)| new.as_str())
    }

    /// `node.port` of the part's file as the graph's file names it now.
    fn moved(&self, target: &str) -> Option<String> {
        let (node, port) = target.split_once('.')?;
        Some(format!("{}.{port}", self.new_name(node)?))
    }

    /// A node of the part with new names, and with paths that hold in the graph's folder. `paths` has the parameters that are paths.
    fn node(&self, old: &str, paths: &HashMap<(String, String), bool>, (from_dir, to_dir): (&Path, &Path)) -> Item {
        let mut item = self.part.document.get("nodes").and_then(|n| n.get(old)).cloned().unwrap_or_default();
        if let Some(inputs) = item.get_mut("inputs").and_then(Item::as_table_like_mut) {
            for (_, entry) in inputs.iter_mut() {
                rename_all(entry, &self.names);
            }
        }
        if let Some(values) = item.get_mut("params").and_then(Item::as_table_like_mut) {
            for (key, entry) in values.iter_mut() {
                let several = paths.get(&(old.to_owned(), key.get().to_owned()));
                if let (Some(several), Some(value)) = (several, entry.as_value_mut()) {
                    rebase(value, *several, from_dir, to_dir);
                }
            }
        }
        if let Some(graph) = item.get_mut("graph").and_then(Item::as_value_mut) {
            rebase(graph, false, from_dir, to_dir);
        }
        for key in ["isolate", "on"] {
            if let (Some(name), Some(table)) = (self.user.get(key), item.as_table_like_mut()) {
                table.insert(key, name.clone());
                if key == "on" {
                    table.remove("isolate");
                }
            }
        }
        item
    }

    /// The comment above the part stays above its first node.
    fn keep_comment(&self, first: &mut Table) {
        let above = self.user.as_table().and_then(|t| t.decor().prefix().cloned()).unwrap_or_default();
        let own = first.decor().prefix().and_then(|p| p.as_str()).unwrap_or_default().trim_start();
        let prefix = format!("{}{own}", above.as_str().unwrap_or("\n"));
        first.decor_mut().set_prefix(prefix);
    }

    /// Connects the nodes to what the graph connected the part `id` to.
    fn connect_inputs(&self, edit: &mut GraphEdit, id: &str) -> Result<(), EditError> {
        for port in self.part.part_port_names(PartPortKind::Input) {
            let Some(value) = value_of(&self.user, "inputs", &port) else { continue };
            for target in self.part.part_targets(PartPortKind::Input, &port) {
                let Some((old, input)) = target.split_once('.') else { continue };
                let Some(node) = self.new_name(old) else { continue };
                let inside = edit.input_references(node, input).unwrap_or_default();
                if !inside.is_empty() {
                    return Err(EditError::MixedInput { id: whole(id, old), input: input.to_owned() });
                }
                let mut entry = Item::Value(value.clone());
                // A wire from the part to itself.
                for_each_reference(&mut entry, &mut |value| {
                    let own = value.as_str().and_then(|text| text.strip_prefix(&format!("{}.", self.name)));
                    let target =
                        own.and_then(|port| self.moved(self.part.part_targets(PartPortKind::Output, port).first()?));
                    if let Some(target) = target {
                        replace(value, &target);
                    }
                });
                if let Item::Value(value) = entry {
                    edit.put(node, "inputs", input, value)?;
                }
            }
        }
        Ok(())
    }

    /// Gives the nodes the values that the graph gave to the part.
    fn set_params(&self, edit: &mut GraphEdit) -> Result<(), EditError> {
        for port in self.part.part_port_names(PartPortKind::Param) {
            let Some(value) = value_of(&self.user, "params", &port) else { continue };
            for target in self.part.part_targets(PartPortKind::Param, &port) {
                let Some((node, param)) = target.split_once('.') else { continue };
                if let Some(node) = self.new_name(node) {
                    edit.put(node, "params", param, value.clone())?;
                }
            }
        }
        Ok(())
    }

    /// The ports of nodes that a reference to a port of the part means.
    fn targets_of(&self, text: &str, kind: PartPortKind) -> Vec<String> {
        let Some((node, port)) = text.split_once('.') else { return Vec::new() };
        match node.strip_prefix(&self.name) {
            Some("") => self.part.part_targets(kind, port).iter().filter_map(|t| self.moved(t)).collect(),
            // A node inside that is named from outside.
            Some(inner) if inner.starts_with('/') => {
                let (first, rest) =
                    inner[1..].split_once('/').map_or((&inner[1..], String::new()), |(f, r)| (f, format!("/{r}")));
                self.new_name(first).map(|new| format!("{new}{rest}.{port}")).into_iter().collect()
            }
            _ => Vec::new(),
        }
    }

    fn redirect(&self, value: &mut EditValue, kind: PartPortKind) {
        let target = value.as_str().and_then(|text| self.targets_of(text, kind).into_iter().next());
        if let Some(target) = target {
            replace(value, &target);
        }
    }

    /// Lets inputs, views and pinned parameters that named the part name its nodes.
    fn redirect_readers(&self, edit: &mut GraphEdit) -> Result<(), EditError> {
        let mut redirect = |value: &mut EditValue| self.redirect(value, PartPortKind::Output);
        edit.each_input(|entries| entries.iter_mut().for_each(|(_, item)| for_each_reference(item, &mut redirect)))?;
        if let Some(views) = edit.document.get_mut("preset").and_then(|p| p.get_mut("views")) {
            for_each_reference(views, &mut redirect);
        }
        if let Some(pinned) = edit.document.get_mut("preset").and_then(|p| p.get_mut("pinned")) {
            super::for_each_table(pinned, |pin| {
                if let Some(value) = pin.get_mut("param").and_then(Item::as_value_mut) {
                    self.redirect(value, PartPortKind::Param);
                }
            });
        }
        for kind in PartPortKind::ALL {
            for port in self.part.part_port_names(kind) {
                let targets = self.part.part_targets(kind, &port);
                let targets: Vec<String> = targets.iter().filter_map(|t| self.moved(t)).collect();
                edit.replace_part_target(kind, &format!("{}.{port}", self.name), &targets);
            }
        }
        Ok(())
    }
}

/// Renames all nodes at once, so that a new name that is another node's old one is not renamed again.
fn rename_all(entry: &mut Item, names: &[(String, String)]) {
    if references(entry).is_empty() {
        return;
    }
    let between = |k: usize| format!("\u{1}{k}");
    for (k, (old, _)) in names.iter().enumerate() {
        rename_references(entry, old, &between(k));
    }
    for (k, (_, new)) in names.iter().enumerate() {
        rename_references(entry, &between(k), new);
    }
}

/// A value that the user of a part gives, without the spaces around it.
fn value_of(user: &Item, table: &str, key: &str) -> Option<EditValue> {
    let mut value = user.get(table)?.get(key)?.clone().into_value().ok()?;
    value.decor_mut().clear();
    Some(value)
}

fn rebased_folder(folder: &str, from_dir: &Path, to_dir: &Path) -> String {
    match Path::new(folder).is_absolute() {
        true => folder.to_owned(),
        false => relative(&from_dir.join(folder), to_dir),
    }
}
