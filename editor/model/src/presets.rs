//! Presets: named sets of parameter values, in a file beside the graph. Applying one, and morphing between two, are edits of the graph.
//!
//! A preset holds the numbers, switches, choices and lists of all nodes. Texts and paths are not part of it, so that applying one never writes
//! into another file.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use panoscope_base::files;
use panoscope_graph::edit::EditError;
use panoscope_graph::{Param, ParamKind, ParamValue, ValueError};
use serde::{Deserialize, Serialize};
use toml::Value;

use crate::disk;
use crate::document::{Document, default_value};
use crate::graph_view::GraphView;
use crate::history::Origin;

/// Maximum size of a file of presets, bytes.
const MAX_BYTES: u64 = 1 << 20;
/// From this ratio of its limits on a parameter is morphed by its logarithm, as its slider moves.
const WIDE: f64 = 1000.0;

/// A named set of values.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Preset {
    /// Its name.
    pub name: String,
    /// Values by `node.param`.
    #[serde(default)]
    pub values: BTreeMap<String, Value>,
}

#[derive(Default, Serialize, Deserialize)]
struct Contents {
    #[serde(default)]
    preset: Vec<Preset>,
}

/// Why presets were not read or stored.
#[derive(Debug, thiserror::Error)]
pub enum PresetError {
    /// The file cannot be read.
    #[error("{} cannot be read: {cause}", .path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The operating system's error.
        cause: std::io::Error,
    },
    /// The file is larger than a file of presets can be.
    #[error("{} has more than 1 MiB: it is not a file of presets", .path.display())]
    Size {
        /// The file.
        path: PathBuf,
    },
    /// The file is not a file of presets.
    #[error("{} is not a file of presets: {reason}; correct or move it, then store again", .path.display())]
    Contents {
        /// The file.
        path: PathBuf,
        /// What is wrong, with the line.
        reason: String,
    },
    /// The file cannot be written.
    #[error("{} was not written: {cause}", .path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The operating system's error.
        cause: std::io::Error,
    },
    /// The name is empty.
    #[error("type a name for the preset first")]
    NoName,
    /// There is no such preset.
    #[error("there is no preset `{name}`")]
    Unknown {
        /// The name.
        name: String,
    },
}

/// The presets of a graph, and their file.
#[derive(Clone, Debug, Default)]
pub struct Presets {
    path: PathBuf,
    list: Vec<Preset>,
}

/// The file of presets of a graph: `depth.presets.toml` beside `depth.toml`.
pub fn file_of(graph: &Path) -> PathBuf {
    graph.with_extension("presets.toml")
}

/// Reads the text of a file of presets.
///
/// # Errors
/// What is wrong, with the line.
pub fn parse(text: &str) -> Result<Vec<Preset>, toml::de::Error> {
    let contents: Contents = toml::from_str(text)?;
    Ok(contents.preset)
}

/// The text of a file of presets.
///
/// # Errors
/// A value that TOML cannot hold.
pub fn text_of(presets: &[Preset]) -> Result<String, toml::ser::Error> {
    toml::to_string(&Contents { preset: presets.to_vec() })
}

impl Presets {
    /// Reads the presets of a graph; none where it has no file.
    ///
    /// # Errors
    /// The file cannot be read, or is not a file of presets.
    pub fn load(graph: &Path) -> Result<Self, PresetError> {
        let path = file_of(graph);
        let text = match disk::read_text(&path, MAX_BYTES) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Self { path, list: Vec::new() }),
            Err(cause) => return Err(PresetError::Read { path, cause }),
            Ok(None) => return Err(PresetError::Size { path }),
            Ok(Some(text)) => text,
        };
        match parse(&text) {
            Ok(list) => Ok(Self { path, list }),
            Err(error) => Err(PresetError::Contents { path, reason: error.to_string().trim().to_owned() }),
        }
    }

    /// The presets, in the order in which they were stored.
    pub fn list(&self) -> &[Preset] {
        &self.list
    }

    /// The preset of this name.
    ///
    /// # Errors
    /// There is none.
    pub fn get(&self, name: &str) -> Result<&Preset, PresetError> {
        let unknown = || PresetError::Unknown { name: name.to_owned() };
        self.list.iter().find(|preset| preset.name == name).ok_or_else(unknown)
    }

    /// Stores the values of a graph under a name; replaces the preset that has it.
    ///
    /// # Errors
    /// The name is empty, or the file cannot be written; the presets are as before.
    pub fn store(&mut self, name: &str, view: &GraphView) -> Result<(), PresetError> {
        let name = name.trim();
        if name.is_empty() {
            return Err(PresetError::NoName);
        }
        let preset = Preset { name: name.to_owned(), values: values_of(view) };
        let mut list = self.list.clone();
        match list.iter_mut().find(|known| known.name == name) {
            Some(known) => *known = preset,
            None => list.push(preset),
        }
        self.write(list)
    }

    /// Removes a preset.
    ///
    /// # Errors
    /// There is none of this name, or the file cannot be written; the presets are as before.
    pub fn remove(&mut self, name: &str) -> Result<(), PresetError> {
        self.get(name)?;
        let list = self.list.iter().filter(|preset| preset.name != name).cloned().collect();
        self.write(list)
    }

    fn write(&mut self, list: Vec<Preset>) -> Result<(), PresetError> {
        let fail = |cause| PresetError::Write { path: self.path.clone(), cause };
        let text = text_of(&list).map_err(|error| fail(std::io::Error::other(error)))?;
        files::replace(&self.path, text.as_bytes()).map_err(fail)?;
        self.list = list;
        Ok(())
    }
}

/// The changes that give a graph some values, and the values that it cannot take.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Changes {
    /// Node, parameter and value, only where the value is another one now.
    pub changes: Vec<(String, String, Value)>,
    /// Values that were left out, each with the reason.
    pub skipped: Vec<String>,
}

/// The values of all nodes that a preset holds, by `node.param`.
pub fn values_of(view: &GraphView) -> BTreeMap<String, Value> {
    let nodes = view.flat().nodes.iter();
    let params = nodes.flat_map(|node| node.node_type.iter().flat_map(|t| &t.params).map(move |param| (node, param)));
    let held = params.filter(|(_, param)| is_held(&param.kind));
    held.map(|(node, param)| {
        let value = node.outline.params.get(&param.name).cloned().unwrap_or_else(|| default_value(&param.kind));
        (format!("{}.{}", node.id(), param.name), value)
    })
    .collect()
}

/// Whether a preset holds parameters of this kind.
fn is_held(kind: &ParamKind) -> bool {
    !matches!(kind, ParamKind::Text { .. } | ParamKind::Path { .. })
}

/// The changes that give a graph the values of a preset.
pub fn changes_to(view: &GraphView, values: &BTreeMap<String, Value>) -> Changes {
    let mut all = Changes::default();
    for (address, value) in values {
        match change_to(view, address, value) {
            Ok(change) => all.changes.extend(change),
            Err(error) => all.skipped.push(format!("{address}: {error}")),
        }
    }
    all
}

/// Why a value of a preset is left out.
#[derive(Debug, thiserror::Error)]
enum ChangeError {
    /// Its name is not `node.param`.
    #[error("a node and a parameter are expected")]
    Address,
    /// The node was removed or renamed.
    #[error("the graph has no such node")]
    NoNode,
    /// The node has another type now, or the parameter is a text or path.
    #[error("the node has no such parameter")]
    NoParam,
    /// The value has another type than the parameter.
    #[error("{expected} is expected")]
    Type { expected: &'static str },
    /// The parameter does not take the value.
    #[error(transparent)]
    Value(#[from] ValueError),
}

fn change_to(view: &GraphView, address: &str, value: &Value) -> Result<Option<(String, String, Value)>, ChangeError> {
    let (node, param, declared) = find(view, address)?;
    let expected = || ChangeError::Type { expected: declared.kind.expected() };
    let wanted = typed(&declared.kind, value).ok_or_else(expected)?;
    declared.kind.accepts(&wanted)?;
    let given = view.flat().node(node).and_then(|n| view.flat().nodes[n].outline.params.get(param));
    let now = given.cloned().unwrap_or_else(|| default_value(&declared.kind));
    let same = typed(&declared.kind, &now).is_some_and(|now| now == wanted);
    Ok((!same).then(|| (node.to_owned(), param.to_owned(), value.clone())))
}

fn find<'a>(view: &'a GraphView, address: &'a str) -> Result<(&'a str, &'a str, &'a Param), ChangeError> {
    let (node, param) = address.split_once('.').ok_or(ChangeError::Address)?;
    let flat = view.flat();
    let this = flat.node(node).map(|n| &flat.nodes[n]).ok_or(ChangeError::NoNode)?;
    let params = this.node_type.iter().flat_map(|t| &t.params);
    let declared = params.into_iter().find(|p| p.name == param && is_held(&p.kind));
    Ok((node, param, declared.ok_or(ChangeError::NoParam)?))
}

/// A value of a file as a value of a parameter; `None` for another type.
fn typed(kind: &ParamKind, value: &Value) -> Option<ParamValue> {
    let number = |value: &Value| value.as_float().or(value.as_integer().map(|whole| whole as f64));
    Some(match kind {
        ParamKind::Bool { .. } => ParamValue::Bool(value.as_bool()?),
        ParamKind::Int { .. } => ParamValue::Int(value.as_integer()?),
        ParamKind::Float { .. } => ParamValue::Float(number(value)?),
        ParamKind::Choice { choices, .. } => {
            let name = value.as_str()?.to_owned();
            // An index behind the end stands for a word that the list does not have.
            let index = choices.iter().position(|choice| *choice == name).unwrap_or(choices.len());
            ParamValue::Choice { index, name }
        }
        ParamKind::Floats { .. } => ParamValue::Floats(value.as_array()?.iter().map(number).collect::<Option<_>>()?),
        ParamKind::Text { .. } | ParamKind::Path { .. } => return None,
    })
}

/// Sets values as one undo step; consecutive steps with the same `merge` are one.
///
/// # Errors
/// A file cannot be edited like that; all texts are as before.
pub fn apply(doc: &mut Document, label: &str, merge: Option<&str>, changes: &Changes) -> Result<(), EditError> {
    let changes: Vec<_> =
        changes.changes.iter().map(|(node, param, value)| (node.as_str(), param.as_str(), Some(value))).collect();
    doc.edit_params(Origin::Hand, label, merge, &changes)
}

/// The values between two presets: those of `a` at `share` 0, those of `b` at 1. Only parameters that both hold.
///
/// Numbers and lists of one length move steadily. Switches, choices and parameters that reopen their node change once, in the middle.
pub fn between(view: &GraphView, a: &Preset, b: &Preset, share: f64) -> BTreeMap<String, Value> {
    let both = a.values.iter().filter_map(|(address, from)| Some((address, from, b.values.get(address)?)));
    both.map(|(address, from, to)| {
        let declared = find(view, address).ok().map(|(.., declared)| declared);
        (address.clone(), mixed(declared, from, to, share.clamp(0.0, 1.0)))
    })
    .collect()
}

fn mixed(declared: Option<&Param>, from: &Value, to: &Value, share: f64) -> Value {
    let nearer = || if share < 0.5 { from.clone() } else { to.clone() };
    let Some(declared) = declared.filter(|param| !param.reopen && share > 0.0 && share < 1.0) else { return nearer() };
    let linear = |a: f64, b: f64| a + (b - a) * share;
    match (typed(&declared.kind, from), typed(&declared.kind, to), &declared.kind) {
        (Some(ParamValue::Int(a)), Some(ParamValue::Int(b)), ParamKind::Int { min, step, .. }) => {
            let (base, step) = (min.unwrap_or(0) as f64, step.unwrap_or(1).max(1) as f64);
            let number = base + ((linear(a as f64, b as f64) - base) / step).round() * step;
            (number as i64).into()
        }
        (Some(ParamValue::Float(a)), Some(ParamValue::Float(b)), ParamKind::Float { min, max, .. }) => {
            let wide = min.zip(*max).is_some_and(|(min, max)| min > 0.0 && max / min >= WIDE) && a > 0.0 && b > 0.0;
            Value::from(if wide { linear(a.ln(), b.ln()).exp() } else { linear(a, b) })
        }
        (Some(ParamValue::Floats(a)), Some(ParamValue::Floats(b)), _) if a.len() == b.len() => {
            Value::from(a.iter().zip(&b).map(|(a, b)| linear(*a, *b)).collect::<Vec<f64>>())
        }
        _ => nearer(),
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use panoscope_graph::{NodeOutline, NodeType};

    use super::*;
    use crate::graph_view::NodeView;

    fn param(name: &str, kind: ParamKind, reopen: bool) -> Param {
        let (doc, unit) = (String::new(), String::new());
        Param {
            name: name.to_owned(),
            doc,
            unit,
            kind,
            reopen,
            pick: Default::default(),
            writes: false,
            shipped: false,
        }
    }

    fn view(params: toml::Table) -> GraphView {
        let int = ParamKind::Int { default: 4, min: Some(0), max: Some(100), step: Some(4) };
        let float = ParamKind::Float { default: 1.0, min: Some(0.001), max: Some(1000.0), step: None };
        let choice = ParamKind::Choice { default: "a".to_owned(), choices: vec!["a".to_owned(), "b".to_owned()] };
        let list = ParamKind::Floats { default: vec![], min_len: 0, max_len: None };
        let path = ParamKind::Path { default: String::new(), must_exist: false };
        let params_of = vec![
            param("int", int.clone(), false),
            param("wide", float, false),
            param("choice", choice, false),
            param("list", list, false),
            param("path", path, false),
            param("late", int, true),
        ];
        let node_type = NodeType { params: params_of, ..NodeType::default() };
        let outline = NodeOutline { id: "n".to_owned(), type_name: String::new(), inputs: Vec::new(), params, line: 1 };
        let node = NodeView {
            outline,
            node_type: Some(Arc::new(node_type)),
            position: None,
            mistakes: Vec::new(),
            is_part: false,
        };
        GraphView { nodes: vec![node], valid: true, ..GraphView::default() }
    }

    fn table(text: &str) -> toml::Table {
        text.parse().expect("a table")
    }

    #[test]
    fn presets_are_stored_applied_and_removed() {
        let folder = std::env::temp_dir().join(format!("panoscope_presets_{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder");
        let graph = folder.join("g.toml");
        let mut presets = Presets::load(&graph).expect("none yet");
        presets.store(" calm ", &view(table("int = 8\nchoice = \"b\"\npath = \"x\""))).expect("stored");
        assert!(matches!(presets.store(" ", &view(table(""))), Err(PresetError::NoName)));
        let mut presets = Presets::load(&graph).expect("read");
        let calm = presets.get("calm").expect("it is there").clone();
        assert!(!calm.values.contains_key("n.path"), "paths are not part of it");
        let changes = changes_to(&view(table("choice = \"b\"")), &calm.values);
        assert_eq!(changes.changes, [("n".to_owned(), "int".to_owned(), Value::from(8))], "only what differs");
        assert!(changes.skipped.is_empty());
        presets.remove("calm").expect("removed");
        assert!(matches!(presets.remove("calm"), Err(PresetError::Unknown { .. })));
        std::fs::write(file_of(&graph), "[[preset]]\nname = 3").expect("written");
        let error = Presets::load(&graph).expect_err("no name").to_string();
        assert!(error.contains("g.presets.toml") && error.contains("line 2"), "{error}");
        std::fs::remove_dir_all(&folder).expect("removed");
    }

    #[test]
    fn values_that_the_graph_cannot_take_are_named() {
        let values = table(
            "\"n.int\" = 7\n\"n.choice\" = \"c\"\n\"m.int\" = 4\n\"n.gone\" = 1\n\"n.list\" = \"x\"\n\"n.path\" = \"/etc\"",
        );
        let changes = changes_to(&view(table("")), &values.into_iter().collect());
        assert!(changes.changes.is_empty(), "{changes:?}");
        let reasons = changes.skipped.join("\n");
        for reason in
            ["not a multiple of 4", "`c` is not one of", "no such node", "n.gone: the node has no", "n.path: the node"]
        {
            assert!(reasons.contains(reason), "{reason}: {reasons}");
        }
    }

    #[test]
    fn morphing_moves_numbers_and_switches_the_rest_in_the_middle() {
        let preset = |text: &str| Preset { name: String::new(), values: table(text).into_iter().collect() };
        let a =
            preset("\"n.int\" = 0\n\"n.wide\" = 0.01\n\"n.choice\" = \"a\"\n\"n.list\" = [0.0, 10.0]\n\"n.late\" = 0");
        let b =
            preset("\"n.int\" = 20\n\"n.wide\" = 100.0\n\"n.choice\" = \"b\"\n\"n.list\" = [4, 20]\n\"n.late\" = 100");
        let view = view(table(""));
        let at = |share: f64| between(&view, &a, &b, share);
        assert_eq!((at(0.0), at(1.0)), (a.values.clone(), b.values.clone()));
        let middle = at(0.25);
        assert_eq!(middle["n.int"].as_integer(), Some(4), "on a step");
        assert!((middle["n.wide"].as_float().expect("a number") - 0.1).abs() < 1e-9, "by its logarithm");
        assert_eq!((middle["n.choice"].as_str(), middle["n.late"].as_integer()), (Some("a"), Some(0)));
        assert_eq!(middle["n.list"], Value::from(vec![1.0, 12.5]));
        let late = at(0.6);
        assert_eq!((late["n.choice"].as_str(), late["n.late"].as_integer()), (Some("b"), Some(100)));
        for share in [0.1, 0.33, 0.7] {
            assert!(changes_to(&view, &at(share)).skipped.is_empty(), "every value between is allowed");
        }
    }
}
