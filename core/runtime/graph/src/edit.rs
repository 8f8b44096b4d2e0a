//! Changes to a graph file that leave every other byte as it was: comments, order, spacing. For the editor and `lock`.
//! Two things are tidied by `toml_edit`: spaces inside a table's header, and a mixture of line ends.

mod dissolve;
mod files;
mod make_part;
mod part;
mod references;

use crate::value::{Kind, Value};
use references::{for_each_table, mentions, rename_reference, rename_references, rename_view, shows, without};

use toml_edit::{Array, DocumentMut, InlineTable, Item, Table, TableLike, Value as EditValue};

pub use crate::edit_error::{EditError, NoHome};
pub use files::FileEdits;
pub use part::PartPortKind;

/// Key in `[editor]` for the list of parts whose nodes the editor shows; no node can have this name.
pub const OPENED_PARTS: &str = ":open";

/// A graph file under edit.
#[derive(Clone, Debug, Default)]
pub struct GraphEdit {
    document: DocumentMut,
    /// Whether the file ends its lines with CR LF, which `toml_edit` reads as LF.
    crlf: bool,
    /// Whether the last line has a line end; `toml_edit` always writes one.
    final_newline: bool,
}

impl GraphEdit {
    /// Opens the text of a graph file. It must be TOML; it need not be a valid graph.
    pub fn parse(text: &str) -> Result<Self, EditError> {
        let document =
            text.parse().map_err(|e: toml_edit::TomlError| EditError::Syntax { message: e.message().to_owned() })?;
        let crlf = text.contains("\r\n");
        let final_newline = text.is_empty() || text.ends_with('\n');
        Ok(Self { document, crlf, final_newline })
    }

    /// The text with all changes so far.
    pub fn text(&self) -> String {
        let mut text = self.document.to_string();
        if !self.final_newline && text.ends_with('\n') {
            text.pop();
        }
        if self.crlf { text.replace("\r\n", "\n").replace('\n', "\r\n") } else { text }
    }

    /// Sets a parameter of a node, keeping a comment behind the old value.
    pub fn set_param(&mut self, id: &str, param: &str, value: &toml::Value) -> Result<(), EditError> {
        self.put(id, "params", param, edit_value(value))
    }

    /// Removes a parameter, so that its default holds again. Nothing happens when it is not there.
    pub fn unset_param(&mut self, id: &str, param: &str) -> Result<(), EditError> {
        self.take(id, "params", param)?;
        self.drop_if_empty(id, "params")
    }

    /// Sets the default of an argument, or with `None` removes it, so that the argument is required.
    ///
    /// # Errors
    /// There is no such argument.
    pub fn set_arg_default(&mut self, arg: &str, value: Option<&toml::Value>) -> Result<(), EditError> {
        let none = || EditError::NoArg { name: arg.to_owned() };
        let args = self.document.get_mut("args").and_then(Item::as_table_like_mut).ok_or_else(none)?;
        let table = args.get_mut(arg).and_then(Item::as_table_like_mut).ok_or_else(none)?;
        match value {
            Some(value) => set(table, "default", edit_value(value)),
            None => _ = table.remove("default"),
        }
        Ok(())
    }

    /// Connects an input: one reference as `"node.port"`, several as a list.
    pub fn set_input(&mut self, id: &str, input: &str, from: &[&str]) -> Result<(), EditError> {
        let value = match from {
            [one] => EditValue::from(*one),
            several => EditValue::Array(several.iter().copied().collect::<Array>()),
        };
        self.put(id, "inputs", input, value)
    }

    /// Disconnects an input. Nothing happens when it is not there.
    pub fn remove_input(&mut self, id: &str, input: &str) -> Result<(), EditError> {
        self.take(id, "inputs", input)?;
        self.drop_if_empty(id, "inputs")
    }

    /// Connects one entry of an input and keeps its other settings (`align`, `delay`). `index` is its position in a
    /// list; beyond the end, or for an absent input, the connection is added.
    pub fn connect(&mut self, id: &str, input: &str, list: bool, index: usize, from: &str) -> Result<(), EditError> {
        let Some(item) = self.table_of(id, "inputs")?.get_mut(input) else {
            if !list {
                return self.set_input(id, input, &[from]);
            }
            return self.put(id, "inputs", input, EditValue::Array(std::iter::once(from).collect::<Array>()));
        };
        if let Some(array) = item.as_array_mut() {
            match array.get_mut(index) {
                Some(place) => point_at(place, from),
                None => array.push(from),
            }
            return Ok(());
        }
        if let Some(table) = item.as_table_like_mut() {
            set(table, "from", from.into());
            return Ok(());
        }
        match item.as_str().filter(|_| list && index > 0).map(str::to_owned) {
            // One connection of a list may be written without brackets.
            Some(first) => self.set_input(id, input, &[&first, from]),
            None => self.set_input(id, input, &[from]),
        }
    }

    /// Disconnects one entry of an input; removes the input with its last entry. Does nothing when there is no such
    /// entry.
    pub fn disconnect(&mut self, id: &str, input: &str, index: usize) -> Result<(), EditError> {
        if let Some(array) = self.table_of(id, "inputs")?.get_mut(input).and_then(Item::as_array_mut)
            && array.len() > 1
        {
            if index < array.len() {
                let gone = array.remove(index);
                // The list begins as it began.
                if let Some(first) = array.get_mut(0).filter(|_| index == 0) {
                    first.decor_mut().set_prefix(gone.decor().prefix().cloned().unwrap_or_default());
                }
            }
            return Ok(());
        }
        if index == 0 { self.remove_input(id, input) } else { Ok(()) }
    }

    /// Adds a copy of a node, with its inputs and parameters, behind the last one.
    pub fn duplicate_node(&mut self, id: &str, copy: &str) -> Result<(), EditError> {
        good_id(copy)?;
        let last = self.last_node_position();
        let nodes = self.nodes()?;
        if nodes.contains_key(copy) {
            return Err(EditError::NodeExists { id: copy.to_owned() });
        }
        let mut item = nodes.get(id).cloned().ok_or_else(|| EditError::NoNode { id: id.to_owned() })?;
        if let Item::Table(table) = &mut item {
            place_at(table, last);
            table.decor_mut().set_prefix("\n");
        }
        nodes.insert(copy, item);
        Ok(())
    }

    /// Adds nodes of another file under the names given, behind the last one. Connections among them lead to the
    /// copies; other connections stay as written.
    pub fn paste_nodes(&mut self, from: &GraphEdit, names: &[(String, String)]) -> Result<(), EditError> {
        for (old, new) in names {
            good_id(new)?;
            let last = self.last_node_position();
            let nodes = self.nodes()?;
            if nodes.contains_key(new) {
                return Err(EditError::NodeExists { id: new.clone() });
            }
            let mut item = from
                .document
                .get("nodes")
                .and_then(|n| n.get(old))
                .cloned()
                .ok_or_else(|| EditError::NoNode { id: old.clone() })?;
            if let Item::Table(table) = &mut item {
                place_at(table, last);
                table.decor_mut().set_prefix(if last.is_some() { "\n" } else { "" });
            }
            nodes.insert(new, item);
        }
        for (_, new) in names {
            if let Some(inputs) = self.node(new)?.get_mut("inputs").and_then(Item::as_table_like_mut) {
                for (_, item) in inputs.iter_mut() {
                    names.iter().for_each(|(old, new)| rename_references(item, old, new));
                }
            }
        }
        Ok(())
    }

    /// Names of the nodes, in file order.
    pub fn node_names(&self) -> Vec<String> {
        let nodes = self.document.get("nodes").and_then(Item::as_table_like);
        nodes.into_iter().flat_map(|n| n.iter()).map(|(id, _)| id.to_owned()).collect()
    }

    /// Adds a node behind the last one. Its plugin is not added to `plugins`; see [`add_plugin`](Self::add_plugin).
    pub fn add_node(&mut self, id: &str, type_name: &str) -> Result<(), EditError> {
        good_id(id)?;
        let last = self.last_node_position();
        let nodes = self.nodes()?;
        if nodes.contains_key(id) {
            return Err(EditError::NodeExists { id: id.to_owned() });
        }
        let mut node = Table::new();
        node.insert("type", toml_edit::value(type_name));
        node.decor_mut().set_prefix("\n");
        // Tables of one position keep their order, so the new one lands behind the last node and before what follows.
        node.set_position(last);
        nodes.insert(id, Item::Table(node));
        Ok(())
    }

    /// Lists a plugin, unless it is listed already.
    pub fn add_plugin(&mut self, plugin: &str) -> Result<(), EditError> {
        let root = self.document.as_table_mut();
        let item = root.entry("plugins").or_insert_with(|| toml_edit::value(Array::new()));
        let array = item.as_array_mut().ok_or(EditError::Shape { place: "plugins".to_owned(), expected: "a list" })?;
        if !array.iter().any(|p| p.as_str() == Some(plugin)) {
            array.push(plugin);
        }
        Ok(())
    }

    /// Lists a folder to look for plugins in, unless it is listed already.
    fn add_plugin_path(&mut self, folder: &str) {
        let root = self.document.as_table_mut();
        let item = root.entry("plugin_paths").or_insert_with(|| toml_edit::value(Array::new()));
        if let Some(array) = item.as_array_mut()
            && !array.iter().any(|p| p.as_str() == Some(folder))
        {
            array.push(folder);
        }
    }

    /// Removes a node with its table, every connection that reads it, its pins and views in the preset and its position
    /// in the editor.
    pub fn remove_node(&mut self, id: &str) -> Result<(), EditError> {
        let nodes = self.nodes()?;
        if nodes.remove(id).is_none() {
            return Err(match id.contains('/') {
                true => EditError::InPart { id: id.to_owned() },
                false => EditError::NoNode { id: id.to_owned() },
            });
        }
        self.remove_mentions(id)
    }

    /// Removes references to a node outside its own table: connections, preset, `[part]` and `[editor]`.
    pub(crate) fn remove_mentions(&mut self, id: &str) -> Result<(), EditError> {
        let pins = |value: &EditValue| {
            let param = value.as_inline_table().and_then(|t| t.get("param")).and_then(EditValue::as_str);
            param.and_then(|p| p.split_once('.')).is_some_and(|(node, _)| mentions(node, id))
        };
        if let Some(pinned) = self.document.get_mut("preset").and_then(|p| p.get_mut("pinned"))
            && let Some(pinned) = pinned.as_array_mut()
        {
            pinned.retain(|value| !pins(value));
        }
        if let Some(views) = self.document.get_mut("preset").and_then(|p| p.get_mut("views"))
            && let Some(views) = views.as_array_mut()
        {
            views.retain(|view| !shows(view, id));
        }
        if let Some(editor) = self.document.get_mut("editor").and_then(Item::as_table_like_mut) {
            let gone: Vec<String> =
                editor.iter().map(|(key, _)| key.to_owned()).filter(|key| mentions(key, id)).collect();
            for key in gone {
                editor.remove(&key);
            }
        }
        self.remove_part_targets(id);
        self.each_input(|inputs| {
            let gone: Vec<String> =
                inputs.iter_mut().filter_map(|(key, item)| without(item, id).then(|| key.get().to_owned())).collect();
            for key in gone {
                inputs.remove(&key);
            }
        })
    }

    /// Gives a node another name, in its table, in every connection that reads it, and in the preset.
    pub fn rename_node(&mut self, old: &str, new: &str) -> Result<(), EditError> {
        good_id(new)?;
        let nodes = self.nodes()?;
        if !nodes.contains_key(old) {
            return Err(EditError::NoNode { id: old.to_owned() });
        }
        if old == new {
            return Ok(());
        }
        if nodes.contains_key(new) {
            return Err(EditError::NodeExists { id: new.to_owned() });
        }
        rename_key(nodes, old, new);
        self.rename_mentions(old, new)
    }

    /// Gives a node another name in all references outside its own table: connections, preset, `[part]` and `[editor]`.
    pub(crate) fn rename_mentions(&mut self, old: &str, new: &str) -> Result<(), EditError> {
        self.rename_part_targets(old, new);
        self.each_input(|inputs| {
            for (_, item) in inputs.iter_mut() {
                rename_references(item, old, new);
            }
        })?;
        if let Some(pinned) = self.document.get_mut("preset").and_then(|p| p.get_mut("pinned")) {
            for_each_table(pinned, |pin| {
                if let Some(value) = pin.get_mut("param").and_then(Item::as_value_mut) {
                    rename_reference(value, old, new);
                }
            });
        }
        if let Some(views) = self.document.get_mut("preset").and_then(|p| p.get_mut("views"))
            && let Some(views) = views.as_array_mut()
        {
            views.iter_mut().for_each(|view| rename_view(view, old, new));
        }
        self.rename_positions(old, new);
        Ok(())
    }

    /// Gives a node and the nodes inside it other names in `[editor]`.
    pub fn rename_positions(&mut self, old: &str, new: &str) {
        if let Some(editor) = self.document.get_mut("editor").and_then(Item::as_table_like_mut) {
            let keys: Vec<String> =
                editor.iter().map(|(key, _)| key.to_owned()).filter(|key| mentions(key, old)).collect();
            for key in keys {
                let renamed = format!("{new}{}", &key[old.len()..]);
                if !editor.contains_key(&renamed)
                    && let Some(item) = editor.remove(&key)
                {
                    editor.insert(&renamed, item);
                }
            }
        }
    }

    /// Sets a key of `[editor]`, or with `None` removes it.
    pub fn set_editor(&mut self, key: &str, value: Option<&toml::Value>) {
        let root = self.document.as_table_mut();
        match value {
            Some(value) => {
                let editor = root.entry("editor").or_insert_with(|| Item::Table(Table::new()));
                if let Some(editor) = editor.as_table_like_mut() {
                    set(editor, key, edit_value(value));
                }
            }
            None => {
                if let Some(editor) = root.get_mut("editor").and_then(Item::as_table_like_mut)
                    && editor.remove(key).is_some()
                    && editor.is_empty()
                {
                    root.remove("editor");
                }
            }
        }
    }

    /// Sets where the editor draws a node, in `[editor]`.
    pub fn set_position(&mut self, id: &str, x: f64, y: f64) {
        let mut at = InlineTable::new();
        at.insert("x", x.into());
        at.insert("y", y.into());
        let root = self.document.as_table_mut();
        let editor = root.entry("editor").or_insert_with(|| Item::Table(Table::new()));
        if let Some(table) = editor.as_table_like_mut() {
            set(table, id, EditValue::InlineTable(at));
        }
        // Behind all positions, so that removing and adding the list changes nothing else.
        if let Some(table) = editor.as_table_mut()
            && table.iter().last().is_some_and(|(key, _)| key != OPENED_PARTS)
            && let Some((key, list)) = table.remove_entry(OPENED_PARTS)
        {
            table.insert_formatted(&key, list);
        }
    }

    fn nodes(&mut self) -> Result<&mut Table, EditError> {
        let nodes = self.document.as_table_mut().entry("nodes").or_insert_with(|| {
            let mut table = Table::new();
            table.set_implicit(true);
            Item::Table(table)
        });
        nodes
            .as_table_mut()
            .ok_or(EditError::Shape { place: "nodes".to_owned(), expected: "a table such as [nodes.scope]" })
    }

    fn node(&mut self, id: &str) -> Result<&mut dyn TableLike, EditError> {
        let missing = || match id.contains('/') {
            true => EditError::InPart { id: id.to_owned() },
            false => EditError::NoNode { id: id.to_owned() },
        };
        let node = self.nodes()?.get_mut(id).ok_or_else(missing)?;
        node.as_table_like_mut().ok_or_else(|| EditError::Shape { place: format!("nodes.{id}"), expected: "a table" })
    }

    /// `inputs` or `params` of a node, made when absent.
    fn table_of(&mut self, id: &str, part: &str) -> Result<&mut dyn TableLike, EditError> {
        let node = self.node(id)?;
        if !node.contains_key(part) {
            node.insert(part, Item::Value(EditValue::InlineTable(InlineTable::new())));
        }
        node.get_mut(part)
            .and_then(Item::as_table_like_mut)
            .ok_or_else(|| EditError::Shape { place: format!("nodes.{id}.{part}"), expected: "a table" })
    }

    /// Sets an entry of `inputs` or `params`.
    fn put(&mut self, id: &str, part: &str, key: &str, value: EditValue) -> Result<(), EditError> {
        self.table_of(id, part)?;
        if let Some(entries) = self.node(id)?.get_mut(part) {
            put_entry(entries, key, value);
        }
        Ok(())
    }

    /// Removes an entry of `inputs` or `params`; the space before the closing brace stays there.
    fn take(&mut self, id: &str, part: &str, key: &str) -> Result<(), EditError> {
        self.table_of(id, part)?;
        if let Some(entries) = self.node(id)?.get_mut(part) {
            take_entry(entries, key);
        }
        Ok(())
    }

    fn drop_if_empty(&mut self, id: &str, part: &str) -> Result<(), EditError> {
        let node = self.node(id)?;
        if node.get(part).and_then(Item::as_table_like).is_some_and(|t| t.is_empty()) {
            node.remove(part);
        }
        Ok(())
    }

    fn each_input(&mut self, mut change: impl FnMut(&mut dyn TableLike)) -> Result<(), EditError> {
        let mut emptied = Vec::new();
        for (key, node) in self.nodes()?.iter_mut() {
            let Some(node) = node.as_table_like_mut() else { continue };
            let Some(inputs) = node.get_mut("inputs").and_then(Item::as_table_like_mut) else { continue };
            let had = !inputs.is_empty();
            change(inputs);
            if had && inputs.is_empty() {
                emptied.push(key.get().to_owned());
            }
        }
        emptied.into_iter().try_for_each(|id| self.drop_if_empty(&id, "inputs"))
    }

    /// Position of the last table that belongs to a node.
    fn last_node_position(&self) -> Option<isize> {
        fn deepest(table: &Table) -> Option<isize> {
            let below = table.iter().filter_map(|(_, item)| item.as_table()).filter_map(deepest).max();
            table.position().max(below)
        }
        self.document.get("nodes").and_then(Item::as_table).and_then(deepest)
    }
}

/// Makes a connection read another output, keeping its other settings.
fn point_at(place: &mut EditValue, from: &str) {
    match place {
        EditValue::InlineTable(table) => set(table, "from", from.into()),
        other => {
            let mut value = EditValue::from(from);
            *value.decor_mut() = other.decor().clone();
            *other = value;
        }
    }
}

/// Sets an entry of a table. The space before the closing brace stays there when an entry is added.
fn put_entry(table: &mut Item, key: &str, mut value: EditValue) {
    if let Some(inline) = table.as_inline_table_mut()
        && !inline.contains_key(key)
        && let Some((_, last)) = inline.iter_mut().last()
    {
        let space = last.decor().suffix().cloned().unwrap_or_default();
        last.decor_mut().set_suffix("");
        *value.decor_mut() = toml_edit::Decor::new(" ", space);
    }
    if let Some(table) = table.as_table_like_mut() {
        set(table, key, value);
    }
}

/// Removes an entry of a table; the space before the closing brace stays there.
fn take_entry(table: &mut Item, key: &str) {
    if let Some(inline) = table.as_inline_table_mut()
        && inline.iter().last().is_some_and(|(last, _)| last == key)
        && let Some(gone) = inline.remove(key)
    {
        if let Some((_, last)) = inline.iter_mut().last() {
            last.decor_mut().set_suffix(gone.decor().suffix().cloned().unwrap_or_default());
        }
        return;
    }
    if let Some(table) = table.as_table_like_mut() {
        table.remove(key);
    }
}

/// Moves a table and those below it to one position.
fn place_at(table: &mut Table, position: Option<isize>) {
    table.set_position(position);
    for (_, item) in table.iter_mut() {
        if let Item::Table(below) = item {
            place_at(below, position);
        }
    }
}

fn good_id(id: &str) -> Result<(), EditError> {
    let start = id.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_');
    if start && id.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-') {
        Ok(())
    } else {
        Err(EditError::BadId { id: id.to_owned() })
    }
}

/// Sets a value, keeping the spaces and the comment around the old one.
fn set(table: &mut dyn TableLike, key: &str, mut value: EditValue) {
    match table.get_mut(key) {
        Some(item) => {
            if let Some(old) = item.as_value() {
                *value.decor_mut() = old.decor().clone();
            }
            *item = Item::Value(value);
        }
        None => {
            table.insert(key, Item::Value(value));
        }
    }
}

pub(crate) fn edit_value(value: &toml::Value) -> EditValue {
    match value {
        toml::Value::String(text) => text.as_str().into(),
        toml::Value::Integer(i) => (*i).into(),
        toml::Value::Float(f) => (*f).into(),
        toml::Value::Boolean(b) => (*b).into(),
        // No parameter takes a date; its text is refused by the check like any other.
        toml::Value::Datetime(d) => d.to_string().into(),
        toml::Value::Array(items) => EditValue::Array(items.iter().map(edit_value).collect()),
        toml::Value::Table(table) => {
            EditValue::InlineTable(table.iter().map(|(k, v)| (k.as_str(), edit_value(v))).collect())
        }
    }
}

/// Renames a key in place: the order of the others stays.
fn rename_key(table: &mut Table, old: &str, new: &str) {
    let order: Vec<String> = table.iter().map(|(k, _)| k.to_owned()).collect();
    let mut taken = Vec::with_capacity(order.len());
    for key in order {
        if let Some((mut name, item)) = table.remove_entry(&key) {
            if key == old {
                let renamed = toml_edit::Key::new(new)
                    .with_leaf_decor(name.leaf_decor().clone())
                    .with_dotted_decor(name.dotted_decor().clone());
                name = renamed;
            }
            taken.push((name, item));
        }
    }
    for (name, item) in taken {
        table.insert_formatted(&name, item);
    }
}

/// A value of the command line or the editor, for [`GraphEdit::set_param`].
pub fn parse_value(text: &str) -> toml::Value {
    match crate::parse::parse_value(text) {
        Some(Value { value: Kind::HugeInt(_), .. }) | None => toml::Value::String(text.to_owned()),
        Some(value) => value.value.plain(),
    }
}
