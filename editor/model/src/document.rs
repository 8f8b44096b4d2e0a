//! The graph file under edit: its text is the truth, everything that is drawn is derived from it. No egui here.
//!
//! Every edit gives a new text, which is checked whole. A text without mistakes is what the session is asked to run; one with mistakes is
//! shown with them while the last good one runs on. Undo and redo step through texts.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use panoscope_graph::edit::{EditError, GraphEdit, NoHome};
use panoscope_graph::{
    Catalog, Diagnostic, GraphOptions, GraphText, NodeOutline, NodeType, PacketType, ParamKind, Port, Severity, check,
};
use panoscope_loader::Loader;

use crate::history::{By, Change, History};
use crate::mark::Mark;

/// Most texts that can be undone.
const MOST_STEPS: usize = 500;

/// A node as it is drawn.
#[derive(Clone, Debug)]
pub struct NodeView {
    /// What the file says of it.
    pub outline: NodeOutline,
    /// Its type, when it is known.
    pub node_type: Option<Arc<NodeType>>,
    /// Where `[editor]` puts it.
    pub position: Option<(f32, f32)>,
    /// What is wrong with it.
    pub mistakes: Vec<String>,
}

impl NodeView {
    /// Its name.
    pub fn id(&self) -> &str {
        &self.outline.id
    }

    /// Its family, or `unknown`.
    pub fn family(&self) -> &str {
        self.node_type.as_ref().map_or("unknown", |t| &t.family)
    }

    /// An input by name.
    pub fn input(&self, name: &str) -> Option<&Port> {
        self.node_type.as_ref()?.inputs.iter().find(|p| p.name == name)
    }

    /// An output by name.
    pub fn output(&self, name: &str) -> Option<&Port> {
        self.node_type.as_ref()?.outputs.iter().find(|p| p.name == name)
    }
}

/// A connection as it is drawn.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Wire {
    /// Producing node, a position in [`View::nodes`].
    pub from: usize,
    /// Its output.
    pub output: String,
    /// Consuming node.
    pub to: usize,
    /// Its input.
    pub input: String,
    /// Place in a list input.
    pub index: usize,
    /// Reads the value of the tick before.
    pub delayed: bool,
}

/// What is drawn of a text.
#[derive(Clone, Debug, Default)]
pub struct View {
    /// Nodes in file order.
    pub nodes: Vec<NodeView>,
    /// Connections between nodes that exist.
    pub wires: Vec<Wire>,
    /// Mistakes and warnings.
    pub diagnostics: Vec<Diagnostic>,
    /// Whether the text can run.
    pub right: bool,
    /// Name of the graph.
    pub name: String,
    /// The graph file, as diagnostics name it; others are of parts and overlays.
    pub file: String,
    /// Frames and notes.
    pub marks: Vec<Mark>,
}

/// What the checker says of a graph without nodes.
const EMPTY_GRAPH: &str = "empty-graph";

/// Keys of `[editor]` that no node can have.
pub(crate) const FRAMES: &str = ":frames";
pub(crate) const NOTES: &str = ":notes";

/// Frames and notes of an `[editor]` table; what is no such thing is left out.
fn marks_of(editor: &toml::Table) -> Vec<Mark> {
    let list = |key: &str| editor.get(key).and_then(toml::Value::as_array).cloned().unwrap_or_default();
    let mark = |value: &toml::Value, frame: bool| {
        let number = |key: &str| {
            let v = value.get(key)?;
            v.as_float().or(v.as_integer().map(|i| i as f64)).map(|v| v as f32)
        };
        let text = value.get("text")?.as_str()?.to_owned();
        let size = if frame { Some((number("width")?, number("height")?)) } else { None };
        Some(Mark { text, at: (number("x")?, number("y")?), size })
    };
    let frames = list(FRAMES).into_iter().filter_map(|v| mark(&v, true)).collect::<Vec<_>>();
    frames.into_iter().chain(list(NOTES).into_iter().filter_map(|v| mark(&v, false))).collect()
}

impl View {
    /// Position of the node called `id`.
    pub fn node(&self, id: &str) -> Option<usize> {
        self.nodes.iter().position(|n| n.id() == id)
    }

    /// The node of that name a diagnostic is about.
    pub fn node_of(&self, diagnostic: &Diagnostic, text: &str) -> Option<String> {
        if self.file != diagnostic.file {
            return None;
        }
        let lines: Vec<&str> = text.lines().take(diagnostic.line).collect();
        let header = lines.iter().rev().find(|line| line.starts_with('['))?;
        let inside = header.trim_start_matches('[').split(']').next()?;
        let id = inside.strip_prefix("nodes.")?.split('.').next()?.trim_matches('"');
        self.node(id).map(|_| id.to_owned())
    }

    /// Wires into an input, in list order.
    pub fn wires_into<'a>(&'a self, node: usize, input: &'a str) -> impl Iterator<Item = &'a Wire> {
        self.wires.iter().filter(move |w| w.to == node && w.input == input)
    }

    /// A wire in words, by where it ends.
    pub fn wire_name(&self, end: &crate::observe::WireEnd) -> String {
        let Some(node) = self.node(&end.node) else { return end.node.clone() };
        let port = self.nodes[node].node_type.as_ref().and_then(|t| t.inputs.get(end.port));
        let Some(port) = port else { return end.node.clone() };
        let wire = self.wires_into(node, &port.name).find(|w| w.index == end.index);
        let from = wire.map(|w| format!("{}.{}", self.nodes[w.from].id(), w.output)).unwrap_or_default();
        format!("{from} to {}.{}", end.node, port.name)
    }

    /// Packet type of an output, when it is known.
    pub fn packet(&self, node: usize, output: &str) -> Option<&PacketType> {
        Some(&self.nodes[node].output(output)?.packet)
    }

    /// Whether wiring an output to an input would close a loop that has no delay.
    pub fn closes_loop(&self, from: usize, to: usize) -> bool {
        let (mut open, mut seen) = (vec![to], vec![false; self.nodes.len()]);
        while let Some(node) = open.pop() {
            if node == from {
                return true;
            }
            if !std::mem::replace(&mut seen[node], true) {
                open.extend(self.wires.iter().filter(|w| w.from == node && !w.delayed).map(|w| w.to));
            }
        }
        false
    }

    /// Whether an output may be wired to an input; if not, why.
    ///
    /// # Errors
    /// A sentence for people.
    pub fn may_wire(&self, from: usize, output: &str, to: usize, input: &str) -> Result<(), String> {
        let (source, target) = (&self.nodes[from], &self.nodes[to]);
        let missing = |node: &NodeView, what: &str| format!("`{}` has no {what}", node.id());
        let output = source.output(output).ok_or_else(|| missing(source, "such output"))?;
        let input = target.input(input).ok_or_else(|| missing(target, "such input"))?;
        output.packet.fits(&input.packet).map_err(|e| e.to_string())?;
        if self.closes_loop(from, to) {
            return Err("that would close a loop; a loop needs `delay = 1` in the file".to_owned());
        }
        Ok(())
    }
}

/// Texts of part and overlay files, by absolute path.
type Texts = BTreeMap<PathBuf, Arc<str>>;

#[derive(Clone, Debug)]
struct Step {
    text: Arc<str>,
    /// Of those other files that were ever changed.
    others: Texts,
    /// What led away from this text.
    label: String,
}

/// The file, its history and what is drawn of it.
pub struct Document {
    path: PathBuf,
    text: Arc<str>,
    saved: Arc<str>,
    /// Part and overlay files that were changed here, as they are now and as the disk holds them.
    others: Texts,
    saved_others: Texts,
    /// Overlays and values of arguments.
    given: GraphOptions,
    /// One text of all files, for the session; the text itself for a graph of one file.
    runnable: Arc<str>,
    undo: Vec<Step>,
    redo: Vec<Step>,
    merge: Option<String>,
    view: Arc<View>,
    saved_params: HashMap<String, toml::Table>,
    loader: Arc<Loader>,
    catalog: Arc<Catalog>,
    plugins: Vec<String>,
    types: HashMap<usize, Arc<NodeType>>,
    revision: u64,
    history: History,
}

impl Document {
    /// A document of the text read at `path`.
    pub fn new(path: &Path, text: &str, loader: Arc<Loader>) -> Self {
        Self::with_options(path, text, loader, GraphOptions::default())
    }

    /// As [`Self::new`], with overlays and values of arguments.
    pub fn with_options(path: &Path, text: &str, loader: Arc<Loader>, given: GraphOptions) -> Self {
        let mut document = Self {
            path: path.to_owned(),
            text: text.into(),
            saved: text.into(),
            others: Texts::new(),
            saved_others: Texts::new(),
            runnable: text.into(),
            undo: Vec::new(),
            redo: Vec::new(),
            merge: None,
            view: Arc::default(),
            saved_params: params_of(&GraphText::parse_with(path, text, &given)),
            given,
            loader,
            catalog: Arc::default(),
            plugins: vec![String::new()],
            types: HashMap::new(),
            revision: 0,
            history: History::default(),
        };
        document.derive();
        document
    }

    /// The text now.
    pub fn text(&self) -> &Arc<str> {
        &self.text
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The text as the file holds it.
    pub fn saved(&self) -> &Arc<str> {
        &self.saved
    }

    /// Whether the text differs from the file.
    pub fn is_changed(&self) -> bool {
        self.text != self.saved || self.others != self.saved_others
    }

    /// One text of the graph file with its parts, overlays and arguments: what the session runs.
    pub fn runnable(&self) -> &Arc<str> {
        &self.runnable
    }

    /// Part and overlay files whose texts differ from the disk's: path, text now, text as it was read or saved.
    pub fn changed_files(&self) -> Vec<(&Path, &Arc<str>, &Arc<str>)> {
        let pairs =
            self.others.iter().filter_map(|(path, text)| Some((path.as_path(), text, self.saved_others.get(path)?)));
        pairs.filter(|(_, text, saved)| text != saved).collect()
    }

    /// The disk holds the text of a part or overlay now.
    pub fn file_now_saved(&mut self, path: &Path) {
        if let Some(text) = self.others.get(path) {
            self.saved_others.insert(path.to_owned(), Arc::clone(text));
        }
    }

    /// What is drawn.
    pub fn view(&self) -> &Arc<View> {
        &self.view
    }

    /// Node types of the plugins that the graph lists.
    pub fn catalog(&self) -> &Arc<Catalog> {
        &self.catalog
    }

    /// Plugins that the graph lists.
    pub fn plugins(&self) -> &[String] {
        &self.plugins
    }

    /// Counts texts.
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// What undo would take back.
    pub fn undo_label(&self) -> Option<&str> {
        self.undo.last().map(|s| s.label.as_str())
    }

    /// What redo would do again.
    pub fn redo_label(&self) -> Option<&str> {
        self.redo.last().map(|s| s.label.as_str())
    }

    /// Steps that can be undone.
    pub fn steps(&self) -> usize {
        self.undo.len()
    }

    /// Whether a node's parameter differs from the file's.
    pub fn differs_from_file(&self, node: &NodeView, param: &str) -> bool {
        let saved = self.saved_params.get(node.id()).and_then(|p| p.get(param));
        saved != node.outline.params.get(param)
    }

    /// Looks names up with another loader from now on.
    pub fn set_loader(&mut self, loader: Arc<Loader>) {
        if !Arc::ptr_eq(&loader, &self.loader) {
            self.loader = loader;
            self.plugins = vec![String::new()];
            self.derive();
        }
    }

    /// What became of the parameters.
    pub fn history(&self) -> &History {
        &self.history
    }

    /// What is known to be in force is in force since this tick.
    pub fn in_force(&mut self, tick: u64) {
        self.history.in_force(tick);
    }

    /// The history stands there now, see [`crate::ops::step_to`].
    pub(crate) fn stepped_to(&mut self, at: usize) {
        self.history.stepped_to(at);
    }

    /// Makes `text` the text, as one step of history. Steps with the same `merge` that follow one another count as one.
    pub fn set_text(&mut self, text: &str, label: &str, merge: Option<&str>) {
        self.set_text_by(By::Hand, text, label, merge);
    }

    /// As [`Self::set_text`], by somebody.
    pub fn set_text_by(&mut self, by: By, text: &str, label: &str, merge: Option<&str>) {
        let others = self.others.clone();
        self.set_texts_by(by, text, others, label, merge);
    }

    fn set_texts_by(&mut self, by: By, text: &str, others: Texts, label: &str, merge: Option<&str>) {
        if *text == *self.text && others == self.others {
            return;
        }
        let goes_on = merge.is_some() && merge == self.merge.as_deref() && !self.undo.is_empty();
        if !goes_on {
            let (text, others) = (Arc::clone(&self.text), self.others.clone());
            self.undo.push(Step { text, others, label: label.to_owned() });
            if self.undo.len() > MOST_STEPS {
                self.undo.remove(0);
            }
        }
        self.merge = merge.map(str::to_owned);
        self.redo.clear();
        self.text = text.into();
        self.others = others;
        self.derive_by(by, goes_on);
    }

    /// Sets parameters, or with `None` takes them out, as one step. Each change goes into the file that the value came from: the graph, a part, an
    /// overlay, or the default of an argument.
    ///
    /// # Errors
    /// A text cannot be edited like that, or a value comes from the command line; all texts are as before.
    pub fn edit_params(
        &mut self,
        by: By,
        label: &str,
        merge: Option<&str>,
        changes: &[(&str, &str, Option<&toml::Value>)],
    ) -> Result<(), EditError> {
        let mut root = GraphEdit::parse(&self.text)?;
        let parsed = self.parse();
        let mut edits: BTreeMap<PathBuf, (Arc<str>, GraphEdit)> = BTreeMap::new();
        for (node, param, value) in changes {
            let home = match parsed.param_home(node, param) {
                Ok(home) => home,
                // The edit of the text says what is wrong.
                Err(NoHome::NoNode(_)) => {
                    match value {
                        Some(value) => root.set_param(node, param, value)?,
                        None => root.unset_param(node, param)?,
                    }
                    continue;
                }
                Err(error) => return Err(error.into()),
            };
            let files = parsed.files();
            match files.iter().skip(1).find(|f| Path::new(f.path) == home.file) {
                Some(file) => {
                    let key = file.key();
                    if !edits.contains_key(&key) {
                        edits.insert(key.clone(), (file.text.into(), GraphEdit::parse(file.text)?));
                    }
                    let Some((_, edit)) = edits.get_mut(&key) else { continue };
                    home.entry.set(edit, *value)?;
                }
                None => home.entry.set(&mut root, *value)?,
            }
        }
        let mut others = self.others.clone();
        for (key, (before, edit)) in edits {
            // Steps before the first change of a file hold it as it was.
            let steps = self.undo.iter_mut().chain(&mut self.redo).map(|step| &mut step.others);
            for texts in steps.chain([&mut self.saved_others, &mut self.others]) {
                texts.entry(key.clone()).or_insert_with(|| Arc::clone(&before));
            }
            others.insert(key, edit.text().into());
        }
        self.set_texts_by(by, &root.text(), others, label, merge);
        Ok(())
    }

    /// The texts as read.
    fn parse(&self) -> GraphText {
        let texts = self.others.iter().map(|(path, text)| (path.clone(), text.to_string())).collect();
        GraphText::parse_with(&self.path, &self.text, &GraphOptions { texts, ..self.given.clone() })
    }

    /// Draws anew, and writes down which values are others than before.
    fn derive_by(&mut self, by: By, goes_on: bool) {
        let before = Arc::clone(&self.view);
        self.derive();
        if by == By::History {
            return;
        }
        for now in &self.view.nodes {
            // A node that comes or goes changes no value.
            let Some(then) = before.node(now.id()).map(|n| &before.nodes[n]) else { continue };
            let (then, now_params) = (&then.outline.params, &now.outline.params);
            let gone = then.keys().filter(|param| !now_params.contains_key(*param));
            for param in now_params.keys().chain(gone) {
                let (from, to) = (then.get(param).cloned(), now_params.get(param).cloned());
                if from != to {
                    let (node, param) = (now.id().to_owned(), param.clone());
                    self.history.take(Change { node, param, from, to, by, tick: None }, goes_on);
                }
            }
        }
    }

    /// Ends a merged step, so that the next one counts anew.
    pub fn end_merge(&mut self) {
        self.merge = None;
    }

    /// Edits the text as one step.
    ///
    /// # Errors
    /// The text cannot be edited like that; it is as before.
    pub fn edit(
        &mut self,
        label: &str,
        merge: Option<&str>,
        edit: impl FnOnce(&mut GraphEdit) -> Result<(), EditError>,
    ) -> Result<(), EditError> {
        self.edit_by(By::Hand, label, merge, edit)
    }

    /// As [`Self::edit`], by somebody.
    ///
    /// # Errors
    /// As there.
    pub fn edit_by(
        &mut self,
        by: By,
        label: &str,
        merge: Option<&str>,
        edit: impl FnOnce(&mut GraphEdit) -> Result<(), EditError>,
    ) -> Result<(), EditError> {
        let mut document = GraphEdit::parse(&self.text)?;
        edit(&mut document)?;
        self.set_text_by(by, &document.text(), label, merge);
        Ok(())
    }

    /// Edits the text as a part of the step before: one undo takes both back.
    ///
    /// # Errors
    /// The text cannot be edited like that; it is as before.
    pub fn amend(&mut self, edit: impl FnOnce(&mut GraphEdit) -> Result<(), EditError>) -> Result<(), EditError> {
        let mut document = GraphEdit::parse(&self.text)?;
        edit(&mut document)?;
        let text = document.text();
        if *text != *self.text {
            self.text = text.into();
            self.derive_by(By::Hand, true);
        }
        Ok(())
    }

    /// Takes the last step back; answers what it was.
    pub fn undo(&mut self) -> Option<String> {
        let step = self.undo.pop()?;
        let now = self.swap(&step);
        self.redo.push(now);
        self.merge = None;
        self.derive_by(By::Undo, false);
        Some(step.label)
    }

    /// Does what was undone again; answers what it was.
    pub fn redo(&mut self) -> Option<String> {
        let step = self.redo.pop()?;
        let now = self.swap(&step);
        self.undo.push(now);
        self.merge = None;
        self.derive_by(By::Redo, false);
        Some(step.label)
    }

    /// Takes the texts of a step; returns those of now under its label.
    fn swap(&mut self, step: &Step) -> Step {
        let text = std::mem::replace(&mut self.text, Arc::clone(&step.text));
        let others = std::mem::replace(&mut self.others, step.others.clone());
        Step { text, others, label: step.label.clone() }
    }

    /// The file holds `text` now.
    pub fn now_saved(&mut self, text: &str) {
        self.saved = text.into();
        self.saved_params = params_of(&GraphText::parse_with(&self.path, text, &self.given));
        self.merge = None;
    }

    fn derive(&mut self) {
        self.revision += 1;
        let parsed = self.parse();
        let plugins = parsed.plugins();
        if plugins != self.plugins {
            self.catalog = Arc::new(self.loader.catalog(&plugins));
            self.plugins = plugins;
            self.types.clear();
        }
        let (catalog, types) = (&self.catalog, &mut self.types);
        let editor = parsed.editor();
        let number = |v: &toml::Value| v.as_float().or(v.as_integer().map(|i| i as f64)).map(|v| v as f32);
        let mut nodes: Vec<NodeView> = parsed
            .outline()
            .into_iter()
            .map(|outline| {
                let node_type = outline.type_index(catalog).map(|index| {
                    Arc::clone(types.entry(index).or_insert_with(|| Arc::new(catalog.node_types[index].clone())))
                });
                let place = editor.get(&outline.id);
                let at = |axis: &str| place.and_then(|p| p.get(axis)).and_then(number);
                NodeView { node_type, position: at("x").zip(at("y")), mistakes: Vec::new(), outline }
            })
            .collect();
        let by_id: HashMap<&str, usize> = nodes.iter().enumerate().map(|(i, n)| (n.id(), i)).collect();
        let mut wires = Vec::new();
        for (to, node) in nodes.iter().enumerate() {
            for input in &node.outline.inputs {
                for (index, r) in input.from.iter().enumerate() {
                    let Some(&from) = by_id.get(r.node.as_str()) else { continue };
                    let (output, input) = (r.port.clone(), input.port.clone());
                    wires.push(Wire { from, output, to, input, index, delayed: r.delay > 0 });
                }
            }
        }
        let checked = check(&parsed, catalog);
        // A graph without nodes is not begun yet; nothing in it is wrong.
        let diagnostics: Vec<Diagnostic> =
            checked.diagnostics.iter().filter(|d| d.code != EMPTY_GRAPH).cloned().collect();
        self.runnable = match &checked.graph {
            Some(_) if !parsed.is_plain() => parsed.flattened(catalog).into_owned().into(),
            _ => Arc::clone(&self.text),
        };
        let view = View {
            file: self.path.display().to_string(),
            right: checked.graph.is_some(),
            name: parsed.name().to_owned(),
            marks: marks_of(editor),
            nodes: std::mem::take(&mut nodes),
            wires,
            diagnostics,
        };
        let about: Vec<(Option<String>, String)> = view
            .diagnostics
            .iter()
            .filter(|d| d.severity == Severity::Error)
            .map(|d| (view.node_of(d, &self.text), d.message.clone()))
            .collect();
        let mut view = view;
        for (node, message) in about {
            if let Some(node) = node.and_then(|id| view.node(&id)) {
                view.nodes[node].mistakes.push(message);
            }
        }
        self.view = Arc::new(view);
    }
}

fn params_of(text: &GraphText) -> HashMap<String, toml::Table> {
    text.outline().into_iter().map(|n| (n.id, n.params)).collect()
}

/// The default of a parameter as a file would write it.
pub fn default_value(kind: &ParamKind) -> toml::Value {
    match kind {
        ParamKind::Bool { default } => (*default).into(),
        ParamKind::Int { default, .. } => (*default).into(),
        ParamKind::Float { default, .. } => (*default).into(),
        ParamKind::Choice { default, .. } | ParamKind::Text { default } | ParamKind::Path { default, .. } => {
            default.as_str().into()
        }
        ParamKind::Floats { default, .. } => default.clone().into(),
    }
}
