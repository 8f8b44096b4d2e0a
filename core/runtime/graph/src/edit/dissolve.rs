//! A part dissolved into its nodes: the way back from [`FileEdits::make_part`].

use super::files::{FileEdits, local, parent, whole};
use super::make_part::{rebase, relative};
use super::part::{PartPortKind, free_name};
use super::references::{for_each_reference, references, rename_references, replace};
use super::{EditError, place_at};
use crate::catalog::Catalog;
use crate::source::folder;
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
        let folders: Vec<String> = part
            .document
            .get("plugin_paths")
            .and_then(Item::as_array)
            .map(|list| list.iter().filter_map(EditValue::as_str).map(str::to_owned).collect())
            .unwrap_or_default();
        let plugins: Vec<String> = part
            .document
            .get("plugins")
            .and_then(Item::as_array)
            .map(|list| list.iter().filter_map(EditValue::as_str).map(str::to_owned).collect())
            .unwrap_or_default();
        let edit = self.file(&home)?;
        let user = edit.nodes()?.remove(&name).ok_or_else(|| EditError::NoPart { id: id.to_owned() })?;
        let taken = edit.node_names();
        let mut names: Vec<(String, String)> = Vec::new();
        for node in &own {
            let used = |new: &str| taken.iter().any(|t| t == new) || names.iter().any(|(_, n)| n == new);
            let new = free_name(&name, node, used);
            names.push((node.clone(), new));
        }
        let new_name = |node: &str| names.iter().find(|(old, _)| old == node).map(|(_, new)| new.clone());
        // `node.port` of the part's file as the graph's file names it now.
        let moved = |target: &str| {
            let (node, port) = target.split_once('.')?;
            Some(format!("{}.{port}", new_name(node)?))
        };
        let position = user.as_table().and_then(Table::position);
        for (k, (old, new)) in names.iter().enumerate() {
            let mut item = part.document.get("nodes").and_then(|n| n.get(old)).cloned().unwrap_or_default();
            if let Some(inputs) = item.get_mut("inputs").and_then(Item::as_table_like_mut) {
                for (_, entry) in inputs.iter_mut() {
                    rename_all(entry, &names);
                }
            }
            if let Some(values) = item.get_mut("params").and_then(Item::as_table_like_mut) {
                for (key, entry) in values.iter_mut() {
                    let several = paths.get(&(old.clone(), key.get().to_owned()));
                    if let (Some(several), Some(value)) = (several, entry.as_value_mut()) {
                        rebase(value, *several, &from_dir, &to_dir);
                    }
                }
            }
            if let Some(graph) = item.get_mut("graph").and_then(Item::as_value_mut) {
                rebase(graph, false, &from_dir, &to_dir);
            }
            for key in ["isolate", "on"] {
                if let (Some(name), Some(table)) = (user.get(key), item.as_table_like_mut()) {
                    table.insert(key, name.clone());
                    if key == "on" {
                        table.remove("isolate");
                    }
                }
            }
            if let Item::Table(table) = &mut item {
                place_at(table, position);
                if k == 0 {
                    let first = user.as_table().and_then(|t| t.decor().prefix().cloned()).unwrap_or_default();
                    let own = table.decor().prefix().and_then(|p| p.as_str()).unwrap_or_default().trim_start();
                    let prefix = format!("{}{own}", first.as_str().unwrap_or("\n"));
                    table.decor_mut().set_prefix(prefix);
                }
            }
            edit.nodes()?.insert(new, item);
        }
        // What the graph gave to the part it gives to the nodes.
        for port in part.part_port_names(PartPortKind::Input) {
            let Some(value) = value_of(&user, "inputs", &port) else { continue };
            for target in part.part_targets(PartPortKind::Input, &port) {
                let Some((node, input)) = target.split_once('.') else { continue };
                let Some(node) = new_name(node) else { continue };
                let inside = edit.input_references(&node, input).unwrap_or_default();
                if !inside.is_empty() {
                    return Err(EditError::MixedInput { id: whole(id, &node), input: input.to_owned() });
                }
                let mut entry = Item::Value(value.clone());
                // A wire from the part to itself.
                for_each_reference(&mut entry, &mut |value| {
                    let own = value.as_str().and_then(|text| text.strip_prefix(&format!("{name}.")));
                    let own = own.and_then(|port| moved(part.part_targets(PartPortKind::Output, port).first()?));
                    if let Some(own) = own {
                        replace(value, &own);
                    }
                });
                if let Item::Value(value) = entry {
                    edit.put(&node, "inputs", input, value)?;
                }
            }
        }
        for port in part.part_port_names(PartPortKind::Param) {
            let Some(value) = value_of(&user, "params", &port) else { continue };
            for target in part.part_targets(PartPortKind::Param, &port) {
                let Some((node, param)) = target.split_once('.') else { continue };
                if let Some(node) = new_name(node) {
                    edit.put(&node, "params", param, value.clone())?;
                }
            }
        }
        // Who read the part reads the nodes.
        let of_part = |text: &str, kind: PartPortKind| -> Vec<String> {
            let Some((node, port)) = text.split_once('.') else { return Vec::new() };
            match node.strip_prefix(&name) {
                Some("") => part.part_targets(kind, port).iter().filter_map(|t| moved(t)).collect(),
                // A node inside that is named from outside.
                Some(inner) if inner.starts_with('/') => {
                    let (first, rest) =
                        inner[1..].split_once('/').map_or((&inner[1..], String::new()), |(f, r)| (f, format!("/{r}")));
                    new_name(first).map(|new| format!("{new}{rest}.{port}")).into_iter().collect()
                }
                _ => Vec::new(),
            }
        };
        let mut redirect = |value: &mut EditValue| {
            let target = value.as_str().and_then(|text| of_part(text, PartPortKind::Output).into_iter().next());
            if let Some(target) = target {
                replace(value, &target);
            }
        };
        edit.each_input(|entries| entries.iter_mut().for_each(|(_, item)| for_each_reference(item, &mut redirect)))?;
        if let Some(views) = edit.document.get_mut("preset").and_then(|p| p.get_mut("views")) {
            for_each_reference(views, &mut redirect);
        }
        if let Some(pinned) = edit.document.get_mut("preset").and_then(|p| p.get_mut("pinned")) {
            super::for_each_table(pinned, |pin| {
                let Some(value) = pin.get_mut("param").and_then(Item::as_value_mut) else { return };
                let target = value.as_str().and_then(|text| of_part(text, PartPortKind::Param).into_iter().next());
                if let Some(target) = target {
                    replace(value, &target);
                }
            });
        }
        for kind in PartPortKind::ALL {
            for port in part.part_port_names(kind) {
                let targets: Vec<String> = part.part_targets(kind, &port).iter().filter_map(|t| moved(t)).collect();
                edit.replace_part_target(kind, &format!("{name}.{port}"), &targets);
            }
        }
        for plugin in plugins {
            edit.add_plugin(&plugin)?;
        }
        for folder in folders {
            edit.add_plugin_path(&rebased_folder(&folder, &from_dir, &to_dir));
        }
        Ok(names.into_iter().map(|(old, new)| (whole(id, &old), whole(&level, &new))).collect())
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
