//! References to nodes in the values of a file: finding, renaming and removing them.

use toml_edit::{Item, TableLike, Value as EditValue};

fn reads(value: &EditValue, id: &str) -> bool {
    let text = match value {
        EditValue::InlineTable(table) => table.get("from").and_then(EditValue::as_str),
        other => other.as_str(),
    };
    text.and_then(|t| t.split_once('.')).is_some_and(|(node, _)| mentions(node, id))
}

/// Removes connections that read `id` from an input. Returns whether nothing is left of it.
pub(super) fn without(item: &mut Item, id: &str) -> bool {
    if let Some(array) = item.as_array_mut() {
        array.retain(|v| !reads(v, id));
        return array.is_empty();
    }
    match item {
        Item::Value(value) => reads(value, id),
        Item::Table(table) => table
            .get("from")
            .and_then(Item::as_str)
            .and_then(|t| t.split_once('.'))
            .is_some_and(|(n, _)| mentions(n, id)),
        _ => false,
    }
}

/// Renames a node in the references of an input.
pub(super) fn rename_references(item: &mut Item, old: &str, new: &str) {
    for_each_reference(item, &mut |value| rename_reference(value, old, new));
}

/// Whether an entry of the preset's `views` shows an output of `node`.
pub(super) fn shows(view: &EditValue, node: &str) -> bool {
    let from = view.as_inline_table().map_or(Some(view), |table| table.get("from"));
    from.and_then(EditValue::as_str).and_then(|t| t.split_once('.')).is_some_and(|(n, _)| mentions(n, node))
}

pub(super) fn rename_view(view: &mut EditValue, old: &str, new: &str) {
    let EditValue::InlineTable(table) = view else { return rename_reference(view, old, new) };
    if let Some(from) = table.get_mut("from") {
        rename_reference(from, old, new);
    }
}

/// `old.port` becomes `new.port` and `old/inner.port` becomes `new/inner.port`, with the spaces around it kept.
pub(super) fn rename_reference(value: &mut EditValue, old: &str, new: &str) {
    let renamed = value.as_str().and_then(|t| t.split_once('.')).filter(|(node, _)| mentions(node, old));
    let Some(renamed) = renamed.map(|(node, port)| format!("{new}{}.{port}", &node[old.len()..])) else { return };
    replace(value, &renamed);
}

/// Replaces a value by a text, with the spaces around it kept.
pub(super) fn replace(value: &mut EditValue, text: &str) {
    let mut new = EditValue::from(text);
    *new.decor_mut() = value.decor().clone();
    *value = new;
}

/// Whether a name is that of a node or of a node inside it, as `depth/match` is inside `depth`.
pub(super) fn mentions(name: &str, node: &str) -> bool {
    name.strip_prefix(node).is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
}

/// Calls `act` with every reference (`node.port`) of an input or of a list of views.
pub(super) fn for_each_reference(item: &mut Item, act: &mut dyn FnMut(&mut EditValue)) {
    if let Some(array) = item.as_array_mut() {
        array.iter_mut().for_each(|value| reference_of(value, act));
    } else if let Some(value) = item.as_value_mut() {
        reference_of(value, act);
    } else if let Some(from) = item.as_table_mut().and_then(|t| t.get_mut("from")).and_then(Item::as_value_mut) {
        act(from);
    }
}

fn reference_of(value: &mut EditValue, act: &mut dyn FnMut(&mut EditValue)) {
    match value {
        EditValue::InlineTable(table) => table.get_mut("from").into_iter().for_each(act),
        other => act(other),
    }
}

/// The references of an input, as written.
pub(super) fn references(item: &Item) -> Vec<String> {
    let mut found = Vec::new();
    for_each_reference(&mut item.clone(), &mut |value| found.extend(value.as_str().map(str::to_owned)));
    found
}

pub(super) fn for_each_table(item: &mut Item, mut act: impl FnMut(&mut dyn TableLike)) {
    if let Some(array) = item.as_array_mut() {
        for value in array.iter_mut() {
            if let EditValue::InlineTable(table) = value {
                act(table);
            }
        }
    } else if let Some(tables) = item.as_array_of_tables_mut() {
        for table in tables.iter_mut() {
            act(table);
        }
    }
}
