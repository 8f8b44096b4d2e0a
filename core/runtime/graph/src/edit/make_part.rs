//! Makes a part of selected nodes: connections that cross the selection become the part's inputs and outputs.

use super::files::{FileEdits, local, parent, whole};
use super::part::{PartPortKind, free_name};
use super::references::{for_each_reference, mentions, references, replace};
use super::{EditError, GraphEdit, good_id, place_at};
use crate::args::is_no_file;
use crate::catalog::Catalog;
use crate::param::{ParamKind, Pick};
use crate::source::{folder, tidy};
use crate::text::FileKind;
use std::collections::HashMap;
use std::path::{Component, Path, PathBuf};
use toml_edit::{Array, InlineTable, Item, Table, Value as EditValue};

/// Offer of a part under construction: name, targets (`node.port`), and the value that the graph hands to it.
#[derive(Default)]
struct Ports {
    entries: Vec<(String, Vec<String>, Option<EditValue>)>,
}

impl Ports {
    /// The name of `node.port`; added when it is not offered yet.
    fn offer(&mut self, node: &str, port: &str) -> &mut (String, Vec<String>, Option<EditValue>) {
        let target = format!("{node}.{port}");
        let known = self.entries.iter().position(|(_, targets, _)| targets.contains(&target));
        let index = known.unwrap_or_else(|| {
            let name = free_name(node, port, |name| self.entries.iter().any(|(known, ..)| known == name));
            self.entries.push((name, vec![target], None));
            self.entries.len() - 1
        });
        &mut self.entries[index]
    }

    fn table(&self) -> InlineTable {
        let entry = |(name, targets, _): &(String, Vec<String>, Option<EditValue>)| match &targets[..] {
            [one] => (name.clone(), EditValue::from(one.as_str())),
            several => (name.clone(), EditValue::Array(several.iter().map(String::as_str).collect::<Array>())),
        };
        self.entries.iter().map(entry).collect()
    }

    /// The values that the graph hands over, by name.
    fn given(&self) -> InlineTable {
        let given = self.entries.iter().filter_map(|(name, _, value)| Some((name.as_str(), value.clone()?)));
        given.collect()
    }
}

/// What a part under construction offers.
#[derive(Default)]
struct PartPorts {
    inputs: Ports,
    outputs: Ports,
    params: Ports,
}

impl PartPorts {
    fn of(&mut self, kind: PartPortKind) -> &mut Ports {
        match kind {
            PartPortKind::Input => &mut self.inputs,
            PartPortKind::Output => &mut self.outputs,
            PartPortKind::Param => &mut self.params,
        }
    }
}

impl FileEdits<'_> {
    /// Moves nodes of one level into a new file `file`, and puts one node `name` in their place. Inputs, outputs and
    /// parameters of the part follow from the wires, pins and arguments that cross the selection. Relative paths are
    /// rewritten for the folder of the new file. Returns the part's whole name.
    ///
    /// # Errors
    /// The nodes are on several levels or an overlay's, the name is taken, or a value cannot cross the boundary of a
    /// part.
    pub fn make_part(
        &mut self,
        catalog: &Catalog,
        nodes: &[String],
        name: &str,
        file: &Path,
    ) -> Result<String, EditError> {
        good_id(name)?;
        let first = nodes.first().ok_or(EditError::NothingSelected)?;
        let level = parent(first).to_owned();
        let home = self.own_home(first)?.file;
        for id in nodes {
            if parent(id) != level {
                return Err(EditError::SeveralLevels { id: id.clone() });
            }
            self.refuse_overlays_inside(id)?;
        }
        let file = tidy(file);
        let (from_dir, to_dir) = (folder(&home), folder(&file));
        let plugins = self.plugins_of(catalog, nodes);
        let paths: HashMap<(String, String), bool> = self.path_params(catalog, nodes);
        let edit = self.file(&home)?;
        // In the order of the file.
        let order = edit.node_names();
        let mut names: Vec<&str> = nodes.iter().map(|id| local(id)).collect();
        names.sort_by_key(|name| order.iter().position(|known| known == name));
        names.dedup();
        if order.iter().any(|known| known == name) && !names.contains(&name) {
            return Err(EditError::NodeExists { id: name.to_owned() });
        }
        let inside = |reference: &str| {
            reference.split_once('.').is_some_and(|(node, _)| names.iter().any(|name| mentions(node, name)))
        };
        let mut part = GraphEdit { final_newline: true, crlf: edit.crlf, ..GraphEdit::default() };
        let mut ports = PartPorts::default();
        keep_offers(edit, &inside, &mut ports);
        let mut position = None;
        let mut moved: Vec<(String, Item)> = Vec::new();
        for &id in &names {
            let no_node = || EditError::NoNode { id: id.to_owned() };
            let mut item = edit.nodes()?.remove(id).ok_or_else(no_node)?;
            position = position.or(item.as_table().and_then(Table::position));
            refuse_arguments(id, &item)?;
            take_inputs(id, &mut item, &inside, &mut ports.inputs)?;
            take_params(id, &mut item, &mut ports.params, &paths, (&from_dir, &to_dir));
            moved.push((id.to_owned(), item));
        }
        redirect_readers(edit, name, &inside, &mut ports)?;
        edit.each_part_target(&mut |value| {
            if let Some(port) = value.as_str().and_then(|text| text.strip_prefix("{}.")) {
                let text = format!("{name}.{port}");
                replace(value, &text);
            }
        });
        part.write_part(name, &plugins, [&ports.inputs, &ports.outputs, &ports.params], moved);
        // The part's node stands where the first of them stood.
        let mut node = Table::new();
        node.insert("graph", toml_edit::value(relative(&to_dir.join(file.file_name().unwrap_or_default()), &from_dir)));
        for (key, ports) in [("inputs", &ports.inputs), ("params", &ports.params)] {
            let given = ports.given();
            if !given.is_empty() {
                node.insert(key, toml_edit::value(given));
            }
        }
        let blank = if position.is_some_and(|p| p > 0) { "\n" } else { "" };
        node.decor_mut().set_prefix(blank);
        node.set_position(position);
        edit.nodes()?.insert(name, Item::Table(node));
        self.create(file, part.text());
        Ok(whole(&level, name))
    }

    /// Refuses a node that an overlay gives, or in which an overlay gives one.
    pub(super) fn refuse_overlays_inside(&mut self, id: &str) -> Result<(), EditError> {
        self.own_home(id)?;
        let outline = self.graph.outline();
        let parts = self.parts.iter().map(|p| p.id.clone());
        let inside: Vec<String> =
            outline.into_iter().map(|n| n.id).chain(parts).filter(|n| mentions(n, id) && n != id).collect();
        for node in inside {
            if self.graph.node_home(&node).is_some_and(|home| home.kind == FileKind::Overlay) {
                self.own_home(&node)?;
            }
        }
        Ok(())
    }

    /// The plugins of nodes, in the order of the nodes. A part among them lists its own.
    fn plugins_of(&self, catalog: &Catalog, nodes: &[String]) -> Vec<String> {
        let mut plugins: Vec<String> = Vec::new();
        for node in self.graph.outline().iter().filter(|n| nodes.contains(&n.id)) {
            if let Some(index) = node.type_index(catalog)
                && !plugins.contains(&catalog.node_types[index].plugin)
            {
                plugins.push(catalog.node_types[index].plugin.clone());
            }
        }
        plugins
    }

    /// Parameters of nodes that are paths, by the node's local name, and whether a value may name several files.
    pub(super) fn path_params(&self, catalog: &Catalog, nodes: &[String]) -> HashMap<(String, String), bool> {
        let outline = self.graph.outline();
        let kind = |node: &str, param: &str| {
            let node = outline.iter().find(|n| n.id == node)?;
            let node_type = &catalog.node_types[node.type_index(catalog)?];
            let param = &node_type.params[node_type.param(param)?];
            match (&param.kind, param.pick) {
                (ParamKind::Path { .. }, _) => Some(false),
                (_, Pick::File) => Some(true),
                _ => None,
            }
        };
        let mut found = HashMap::new();
        for id in nodes {
            let own = outline.iter().find(|n| n.id == *id).map(|n| &n.params);
            let part = self.parts.iter().find(|p| p.id == *id).map(|p| &p.given_params);
            for param in own.into_iter().chain(part).flat_map(toml::Table::keys) {
                let target = self.graph.flat.param_targets(id, param).and_then(|t| t.into_iter().next());
                let several = match target {
                    Some(target) => kind(&target.node, &target.port.value),
                    None => kind(id, param),
                };
                if let Some(several) = several {
                    found.insert((local(id).to_owned(), param.clone()), several);
                }
            }
        }
        found
    }
}

impl GraphEdit {
    /// Writes the text of a new part.
    fn write_part(&mut self, name: &str, plugins: &[String], ports: [&Ports; 3], nodes: Vec<(String, Item)>) {
        let root = self.document.as_table_mut();
        root.insert("name", toml_edit::value(name));
        root.insert("plugins", toml_edit::value(plugins.iter().map(String::as_str).collect::<Array>()));
        let mut part = Table::new();
        part.decor_mut().set_prefix("\n");
        part.set_position(Some(1));
        for (key, ports) in ["inputs", "outputs", "params"].into_iter().zip(ports) {
            if !ports.entries.is_empty() {
                part.insert(key, toml_edit::value(ports.table()));
            }
        }
        root.insert("part", Item::Table(part));
        let mut all = Table::new();
        all.set_implicit(true);
        for (k, (id, mut item)) in nodes.into_iter().enumerate() {
            if let Item::Table(table) = &mut item {
                place_at(table, isize::try_from(k + 2).ok());
                let prefix = table.decor().prefix().and_then(|p| p.as_str()).unwrap_or_default();
                let prefix = format!("\n{}", prefix.trim_start_matches(['\r', '\n']));
                table.decor_mut().set_prefix(prefix);
            }
            all.insert(&id, item);
        }
        root.insert("nodes", Item::Table(all));
    }
}

/// Offers what the file's own `[part]` offers of nodes inside; its targets become `{}.port` until the part has its node.
fn keep_offers(edit: &mut GraphEdit, inside: &dyn Fn(&str) -> bool, ports: &mut PartPorts) {
    for kind in PartPortKind::ALL {
        for port in edit.part_port_names(kind) {
            for target in edit.part_targets(kind, &port).iter().filter(|t| inside(t)) {
                if let Some((node, port)) = target.split_once('.') {
                    let (name, ..) = ports.of(kind).offer(node, port);
                    let new = format!("{{}}.{name}");
                    edit.replace_part_target(kind, target, &[new]);
                }
            }
        }
    }
}

/// Lets inputs, views and pinned parameters that named a node inside name the part `name`.
fn redirect_readers(
    edit: &mut GraphEdit,
    name: &str,
    inside: &dyn Fn(&str) -> bool,
    ports: &mut PartPorts,
) -> Result<(), EditError> {
    let redirect = |value: &mut EditValue, ports: &mut Ports| {
        let Some(reference) = value.as_str().filter(|text| inside(text)).map(str::to_owned) else { return };
        if let Some((node, port)) = reference.split_once('.') {
            let (port, ..) = ports.offer(node, port);
            replace(value, &format!("{name}.{port}"));
        }
    };
    let mut to_output = |value: &mut EditValue| redirect(value, &mut ports.outputs);
    edit.each_input(|entries| entries.iter_mut().for_each(|(_, item)| for_each_reference(item, &mut to_output)))?;
    if let Some(views) = edit.document.get_mut("preset").and_then(|p| p.get_mut("views")) {
        for_each_reference(views, &mut to_output);
    }
    if let Some(pinned) = edit.document.get_mut("preset").and_then(|p| p.get_mut("pinned")) {
        super::for_each_table(pinned, |pin| {
            if let Some(value) = pin.get_mut("param").and_then(Item::as_value_mut) {
                redirect(value, &mut ports.params);
            }
        });
    }
    Ok(())
}

/// Offers the parameters of a node whose values are arguments of the graph; paths of the others are rewritten for the part's folder.
fn take_params(
    id: &str,
    node: &mut Item,
    params: &mut Ports,
    paths: &HashMap<(String, String), bool>,
    (from_dir, to_dir): (&Path, &Path),
) {
    if let Some(values) = node.get_mut("params").and_then(Item::as_table_like_mut) {
        let is_handed = |item: &Item| item.as_value().is_some_and(has_argument);
        let handed = values.iter().filter(|(_, item)| is_handed(item)).map(|(key, _)| key.to_owned());
        for key in handed.collect::<Vec<_>>() {
            let value = values.remove(&key).and_then(|item| item.into_value().ok());
            params.offer(id, &key).2 = value.map(plain);
        }
        for (key, item) in values.iter_mut() {
            let several = paths.get(&(id.to_owned(), key.get().to_owned()));
            if let (Some(several), Some(value)) = (several, item.as_value_mut()) {
                rebase(value, *several, from_dir, to_dir);
            }
        }
    }
    drop_if_empty(node, "params");
    if let Some(graph) = node.get_mut("graph").and_then(Item::as_value_mut) {
        rebase(graph, false, from_dir, to_dir);
    }
}

/// Removes inputs that are supplied from outside from a node.
fn take_inputs(id: &str, node: &mut Item, inside: &dyn Fn(&str) -> bool, inputs: &mut Ports) -> Result<(), EditError> {
    let Some(entries) = node.get_mut("inputs").and_then(Item::as_table_like_mut) else { return Ok(()) };
    let mut crossing = Vec::new();
    for (key, item) in entries.iter() {
        let all = references(item);
        let within = all.iter().filter(|reference| inside(reference)).count();
        if within > 0 && within < all.len() {
            return Err(EditError::MixedInput { id: id.to_owned(), input: key.to_owned() });
        }
        if within == 0 {
            crossing.push(key.to_owned());
        }
    }
    for key in crossing {
        let Some(value) = entries.remove(&key).and_then(|item| item.into_value().ok()).map(plain) else { continue };
        // Inputs that read the same in the same way are one input of the part.
        let text = value.to_string();
        let same = inputs.entries.iter_mut().find(|(.., given)| given.as_ref().is_some_and(|v| v.to_string() == text));
        match same {
            Some((_, targets, _)) => targets.push(format!("{id}.{key}")),
            None => inputs.offer(id, &key).2 = Some(value),
        }
    }
    drop_if_empty(node, "inputs");
    Ok(())
}

fn drop_if_empty(node: &mut Item, key: &str) {
    if node.get(key).and_then(Item::as_table_like).is_some_and(|t| t.is_empty())
        && let Some(table) = node.as_table_like_mut()
    {
        table.remove(key);
    }
}

/// A value without the spaces and comments around it.
fn plain(mut value: EditValue) -> EditValue {
    value.decor_mut().clear();
    value
}

/// Whether a value is an argument of the graph, or has one inside.
fn has_argument(value: &EditValue) -> bool {
    match value {
        EditValue::InlineTable(table) => {
            (table.len() == 1 && table.get("arg").is_some_and(EditValue::is_str))
                || table.iter().any(|(_, value)| has_argument(value))
        }
        EditValue::Array(list) => list.iter().any(has_argument),
        _ => false,
    }
}

/// Refuses arguments in entries of a node that cannot become parameters of a part.
fn refuse_arguments(id: &str, node: &Item) -> Result<(), EditError> {
    let entries = node.as_table_like().into_iter().flat_map(|t| t.iter());
    for (key, item) in entries.filter(|(key, _)| !matches!(*key, "inputs" | "params")) {
        if item.as_value().is_some_and(has_argument) {
            return Err(EditError::ArgInPart { id: id.to_owned(), key: key.to_owned() });
        }
    }
    Ok(())
}

/// Rewrites a relative path, or several separated by `;`, for a file in another folder.
pub(super) fn rebase(value: &mut EditValue, several: bool, from_dir: &Path, to_dir: &Path) {
    let Some(text) = value.as_str().filter(|text| !text.is_empty() && from_dir != to_dir) else { return };
    if is_no_file(text) && several {
        return;
    }
    let one = |part: &str| match Path::new(part.trim()) {
        path if path.is_absolute() || (several && is_no_file(part.trim())) => part.to_owned(),
        path => relative(&from_dir.join(path), to_dir),
    };
    let moved = if several { text.split(';').map(one).collect::<Vec<_>>().join(";") } else { one(text) };
    replace(value, &moved);
}

/// A path as a file in `dir` writes it.
pub(super) fn relative(path: &Path, dir: &Path) -> String {
    let (path, dir) = (tidy(path), tidy(dir));
    let (path, dir): (Vec<Component<'_>>, Vec<Component<'_>>) =
        (path.components().collect(), dir.components().collect());
    let common = path.iter().zip(&dir).take_while(|(a, b)| a == b).count();
    let up = std::iter::repeat_n(Component::ParentDir, dir.len() - common);
    let out: PathBuf = up.chain(path[common..].iter().copied()).collect();
    out.display().to_string()
}
