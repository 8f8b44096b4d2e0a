//! The graph file being edited. Its text is the only state; everything that is drawn is derived from it.
//!
//! Every edit gives a new text, which is checked as a whole. A valid text is passed to the session to run. A text with mistakes is
//! shown with them while the last valid one keeps running. Undo and redo step through texts.

mod edits;

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use panoscope_graph::edit::{EditError, FileEdits, GraphEdit};
use panoscope_graph::{Arg, Catalog, Diagnostic, GraphOptions, GraphText, NodeType, ParamKind, Severity, check};
use panoscope_host::loader::Loader;

use crate::entries::{nodes_of, params_of, pins_of};
use crate::folding;
use crate::graph_view::{GraphView, NodeView, Wire, marks_of};
use crate::history::{Change, History, Origin};

/// The checker's code for a graph without nodes.
const EMPTY_GRAPH: &str = "empty-graph";

/// A value that runs and stands in no file: node, parameter, value.
pub type PlayedValue = (String, String, toml::Value);

/// Texts of part and overlay files, by absolute path.
type Texts = BTreeMap<PathBuf, Arc<str>>;

/// A file whose text is not on disk: path, text now, text as it was read or saved.
pub type ChangedFile<'d> = (&'d Path, &'d Arc<str>, Option<&'d Arc<str>>);

#[derive(Clone, Debug)]
struct UndoStep {
    text: Arc<str>,
    /// Those of the other files.
    others: Texts,
    /// Label of the edit that replaced this text.
    label: String,
}

/// The graph file's text with its undo history and the graph derived from it.
pub struct Document {
    path: PathBuf,
    text: Arc<str>,
    saved: Arc<str>,
    /// Part and overlay files, as they are now and as the disk holds them. A file that was created here is not on disk until it is saved.
    others: Texts,
    saved_others: Texts,
    /// Parts that are used several times and may be changed all the same.
    shared: BTreeSet<PathBuf>,
    /// Arguments that the graph declares, and the names of those that have no value.
    args: Vec<Arg>,
    missing_args: Vec<String>,
    /// Parameters that the preset pins: node, parameter, label.
    pins: Vec<(String, String, String)>,
    /// Overlays and values of arguments.
    given: GraphOptions,
    /// One text of all files; the text itself for a graph of one file.
    whole: Arc<str>,
    /// The same with [`Self::played`], for the session.
    runnable: Arc<str>,
    /// Values of parameters that run and stand in no file: node, parameter, value.
    played: Vec<PlayedValue>,
    undo: Vec<UndoStep>,
    redo: Vec<UndoStep>,
    merge: Option<String>,
    view: Arc<GraphView>,
    saved_params: HashMap<String, toml::Table>,
    loader: Arc<Loader>,
    catalog: Arc<Catalog>,
    plugins: Vec<String>,
    isolated_plugins: Vec<String>,
    types: HashMap<usize, Arc<NodeType>>,
    revision: u64,
    history: History,
}

impl Document {
    /// A document of `text`, which was read from `path`.
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
            shared: BTreeSet::new(),
            args: Vec::new(),
            missing_args: Vec::new(),
            pins: Vec::new(),
            whole: text.into(),
            runnable: text.into(),
            played: Vec::new(),
            undo: Vec::new(),
            redo: Vec::new(),
            merge: None,
            view: Arc::default(),
            saved_params: params_of(&GraphText::parse_with(path, text, &given)),
            given,
            loader,
            catalog: Arc::default(),
            plugins: vec![String::new()],
            isolated_plugins: Vec::new(),
            types: HashMap::new(),
            revision: 0,
            history: History::default(),
        };
        document.derive();
        document
    }

    /// The current text.
    pub fn text(&self) -> &Arc<str> {
        &self.text
    }

    /// Path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The text in the file.
    pub fn saved(&self) -> &Arc<str> {
        &self.saved
    }

    /// Whether the text differs from the file.
    pub fn is_changed(&self) -> bool {
        self.text != self.saved || !self.changed_files().is_empty()
    }

    /// One text of the graph file with its parts, overlays and arguments, and with the values of [`Self::set_played`]: what the session runs.
    pub fn runnable(&self) -> &Arc<str> {
        &self.runnable
    }

    /// One text of the graph file with its parts, overlays and arguments.
    pub fn whole(&self) -> &Arc<str> {
        &self.whole
    }

    /// Values that run and stand in no file: how files are played.
    pub fn played(&self) -> &[PlayedValue] {
        &self.played
    }

    /// Sets the values that run and stand in no file. The texts, their history and undo do not change.
    pub fn set_played(&mut self, played: Vec<PlayedValue>) {
        if played != self.played {
            self.played = played;
            self.revision += 1;
            self.merge_played();
        }
    }

    /// Puts the values that stand in no file into the text that runs.
    fn merge_played(&mut self) {
        self.runnable = Arc::clone(&self.whole);
        let here = |(node, ..): &&PlayedValue| self.view.flat().node(node).is_some();
        let played: Vec<&PlayedValue> = self.played.iter().filter(here).collect();
        // A text with mistakes does not run.
        if played.is_empty() || !self.view.valid {
            return;
        }
        let edited = GraphEdit::parse(&self.whole).and_then(|mut edit| {
            played.iter().try_for_each(|(node, param, value)| edit.set_param(node, param, value))?;
            Ok(edit.text())
        });
        self.runnable = edited.map_or_else(|_| Arc::clone(&self.whole), Arc::from);
    }

    /// Part and overlay files whose texts differ from the disk's: path, text now, text as it was read or saved. A file that was created here has
    /// none of the latter.
    pub fn changed_files(&self) -> Vec<ChangedFile<'_>> {
        let all = self.others.iter().map(|(path, text)| (path.as_path(), text, self.saved_others.get(path)));
        all.filter(|(_, text, saved)| *saved != Some(*text)).collect()
    }

    /// Part and overlay files with the text that the disk held when it was last read or saved.
    pub fn saved_files(&self) -> impl Iterator<Item = (&Path, &Arc<str>)> {
        self.saved_others.iter().map(|(path, text)| (path.as_path(), text))
    }

    /// The current text of a part or overlay.
    pub fn file_text(&self, path: &Path) -> Option<&Arc<str>> {
        self.others.get(path)
    }

    /// Part and overlay files with their current texts.
    pub(crate) fn texts_of_others(&self) -> &BTreeMap<PathBuf, Arc<str>> {
        &self.others
    }

    /// The disk holds the text of a part or overlay now.
    pub fn file_now_saved(&mut self, path: &Path) {
        if let Some(text) = self.others.get(path) {
            self.saved_others.insert(path.to_owned(), Arc::clone(text));
        }
        self.saved_params = params_of(&self.parse_saved());
    }

    /// The disk holds another text of a part or overlay; with `take` it becomes the current one, as one undo step.
    pub fn file_changed_on_disk(&mut self, path: &Path, text: &str, take: bool) {
        self.saved_others.insert(path.to_owned(), text.into());
        self.saved_params = params_of(&self.parse_saved());
        if take {
            let mut others = self.others.clone();
            others.insert(path.to_owned(), text.into());
            let root = Arc::clone(&self.text);
            self.set_texts_by(Origin::File, &root, others, "change on disk", None);
        }
    }

    /// Allows changes of a part that is used several times in the graph.
    pub fn allow_shared(&mut self, path: &Path) {
        self.shared.insert(path.to_owned());
    }

    /// Arguments that the graph and its overlays declare.
    pub fn args(&self) -> &[Arg] {
        &self.args
    }

    /// Names of required arguments without a value.
    pub fn missing_args(&self) -> &[String] {
        &self.missing_args
    }

    /// Whether nothing is wrong but that arguments have no value.
    pub fn lacks_only_arguments(&self) -> bool {
        let mut errors = self.view.diagnostics.iter().filter(|d| d.severity == Severity::Error);
        !self.missing_args.is_empty() && errors.all(|d| d.code == "missing-arg")
    }

    /// Overlays and values of arguments.
    pub fn given(&self) -> &GraphOptions {
        &self.given
    }

    /// Sets overlays and values of arguments. The texts do not change.
    pub fn set_given(&mut self, given: GraphOptions) {
        if given != self.given {
            self.given = given;
            self.saved_params = params_of(&self.parse_saved());
            self.merge = None;
            self.derive();
        }
    }

    /// Parameters that the preset pins, with their labels. One of an opened part is that of the node inside.
    pub fn pins(&self) -> impl Iterator<Item = (&str, &str, &str)> {
        self.pins.iter().map(|(node, param, label)| (node.as_str(), param.as_str(), label.as_str()))
    }

    /// The parameter of a node that a parameter of a part stands for: `stereo.far_mm` is `stereo/points.far_mm`.
    pub fn resolve_param(&self, reference: &str) -> String {
        self.parse().resolve_param(reference)
    }

    /// Part and overlay files with their texts as they are now, by absolute path.
    pub(crate) fn files(&self) -> Vec<(PathBuf, String)> {
        self.parse().files().iter().skip(1).map(|file| (file.key(), file.text.to_owned())).collect()
    }

    /// The document was saved as `path`, and its other files under new absolute paths.
    pub(crate) fn move_to(&mut self, path: &Path, moved: &BTreeMap<PathBuf, PathBuf>) {
        let new = |old: &Path| moved.get(old).map_or_else(|| old.to_owned(), PathBuf::clone);
        let steps = self.undo.iter_mut().chain(&mut self.redo).map(|step| &mut step.others);
        for texts in steps.chain([&mut self.others, &mut self.saved_others]) {
            *texts = std::mem::take(texts).into_iter().map(|(old, text)| (new(&old), text)).collect();
        }
        self.given.with.iter_mut().for_each(|file| *file = new(&GraphOptions::key(file)));
        self.path = path.to_owned();
        self.saved_others = self.others.clone();
        let text = Arc::clone(&self.text);
        self.set_saved(&text);
        self.derive();
    }

    /// The graph derived from the text.
    pub fn view(&self) -> &Arc<GraphView> {
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

    /// Incremented with every new text.
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// Label of the edit that [`Self::undo`] would take back.
    pub fn undo_label(&self) -> Option<&str> {
        self.undo.last().map(|s| s.label.as_str())
    }

    /// Label of the edit that [`Self::redo`] would repeat.
    pub fn redo_label(&self) -> Option<&str> {
        self.redo.last().map(|s| s.label.as_str())
    }

    /// Number of undo steps.
    pub fn steps(&self) -> usize {
        self.undo.len()
    }

    /// Whether a node's parameter differs from its value in the file.
    pub fn differs_from_file(&self, node: &NodeView, param: &str) -> bool {
        let saved = self.saved_params.get(node.id()).and_then(|p| p.get(param));
        saved != node.outline.params.get(param)
    }

    /// Replaces the loader and derives the graph again if it is another one.
    pub fn set_loader(&mut self, loader: Arc<Loader>) {
        if !Arc::ptr_eq(&loader, &self.loader) {
            self.loader = loader;
            self.plugins = vec![String::new()];
            self.derive();
        }
    }

    /// The history of parameter changes.
    pub fn history(&self) -> &History {
        &self.history
    }

    /// Records `tick` as the first one with the current values.
    pub fn set_tick(&mut self, tick: u64) {
        self.history.set_tick(tick);
    }

    /// Sets the position in the history, see [`crate::ops::step_to`].
    pub(crate) fn set_position(&mut self, at: usize) {
        self.history.set_position(at);
    }

    /// Overlays and values of arguments, with the current texts of parts and overlays.
    pub fn options(&self) -> GraphOptions {
        let texts = self.others.iter().map(|(path, text)| (path.clone(), text.to_string())).collect();
        GraphOptions { texts, ..self.given.clone() }
    }

    /// The texts as read.
    fn parse(&self) -> GraphText {
        GraphText::parse_with(&self.path, &self.text, &self.options())
    }

    /// Looks at the files without changing them.
    ///
    /// # Errors
    /// Those of `read`.
    pub fn read_files<T>(&self, read: impl FnOnce(&mut FileEdits<'_>) -> Result<T, EditError>) -> Result<T, EditError> {
        read(&mut FileEdits::new(&self.parse()))
    }

    /// The texts as the disk holds them.
    fn parse_saved(&self) -> GraphText {
        let texts = self.saved_others.iter().map(|(path, text)| (path.clone(), text.to_string())).collect();
        GraphText::parse_with(&self.path, &self.saved, &GraphOptions { texts, ..self.given.clone() })
    }

    /// Keeps the texts of parts and overlays as they were first read, so that the disk cannot change the graph unnoticed.
    fn adopt(&mut self, parsed: &GraphText) {
        for file in parsed.files().iter().skip(1) {
            let key = file.key();
            if !self.others.contains_key(&key) {
                let text: Arc<str> = file.text.into();
                let steps = self.undo.iter_mut().chain(&mut self.redo).map(|step| &mut step.others);
                for texts in steps.chain([&mut self.saved_others, &mut self.others]) {
                    texts.entry(key.clone()).or_insert_with(|| Arc::clone(&text));
                }
            }
        }
    }

    /// Draws anew, and writes down which values are others than before.
    fn derive_by(&mut self, by: Origin, extends_last: bool) {
        let before = Arc::clone(&self.view);
        self.derive();
        if by == Origin::History {
            return;
        }
        let before = before.flat();
        for now in &self.view.flat().nodes {
            // Adding or removing a node is not a change of its values.
            let Some(then) = before.node(now.id()).map(|n| &before.nodes[n]) else { continue };
            let (then, now_params) = (&then.outline.params, &now.outline.params);
            let removed = then.keys().filter(|param| !now_params.contains_key(*param));
            for param in now_params.keys().chain(removed) {
                let (from, to) = (then.get(param).cloned(), now_params.get(param).cloned());
                if from != to {
                    let (node, param) = (now.id().to_owned(), param.clone());
                    self.history.record(Change { node, param, from, to, by, tick: None }, extends_last);
                }
            }
        }
    }

    /// The file holds `text` now.
    pub fn set_saved(&mut self, text: &str) {
        self.saved = text.into();
        self.saved_params = params_of(&self.parse_saved());
        self.merge = None;
    }

    fn derive(&mut self) {
        self.revision += 1;
        let parsed = self.parse();
        self.adopt(&parsed);
        self.args = parsed.args().to_vec();
        self.missing_args = parsed.missing_args().into_iter().map(str::to_owned).collect();
        let (plugins, isolated) = (parsed.plugins(), self.loader.isolated_plugins(&parsed));
        if plugins != self.plugins || isolated != self.isolated_plugins {
            self.catalog = Arc::new(self.loader.catalog_of(&parsed));
            (self.plugins, self.isolated_plugins) = (plugins, isolated);
            self.types.clear();
        }
        let (catalog, types) = (&self.catalog, &mut self.types);
        let editor = parsed.editor();
        let mut nodes: Vec<NodeView> = parsed
            .outline()
            .into_iter()
            .map(|outline| {
                let node_type = outline.type_index(catalog).map(|index| {
                    Arc::clone(types.entry(index).or_insert_with(|| Arc::new(catalog.node_types[index].clone())))
                });
                let position = folding::position(editor, &outline.id);
                NodeView { node_type, position, mistakes: Vec::new(), outline, is_part: false }
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
        // An empty graph is not reported as a mistake: it is a new graph.
        let diagnostics: Vec<Diagnostic> =
            checked.diagnostics.iter().filter(|d| d.code != EMPTY_GRAPH).cloned().collect();
        self.whole = match &checked.graph {
            Some(_) if !parsed.is_plain() => parsed.flattened(catalog).into_owned().into(),
            _ => Arc::clone(&self.text),
        };
        let view = GraphView {
            file: self.path.display().to_string(),
            valid: checked.graph.is_some(),
            name: parsed.name().to_owned(),
            marks: marks_of(editor),
            nodes: std::mem::take(&mut nodes),
            wires,
            diagnostics,
            ..GraphView::default()
        };
        let mut view = view;
        let errors = view.diagnostics.iter().filter(|d| d.severity == Severity::Error);
        let about: Vec<(Vec<String>, String)> =
            errors.map(|d| (nodes_of(&parsed, &view, d), d.message.clone())).collect();
        for (nodes, message) in about {
            for node in nodes.iter().filter_map(|id| view.node(id)).collect::<Vec<_>>() {
                view.nodes[node].mistakes.push(message.clone());
            }
        }
        let view = folding::drawn(view, &parsed);
        self.pins = pins_of(&self.text, &parsed, &view);
        self.view = Arc::new(view);
        self.merge_played();
    }
}

/// The default of a parameter as a TOML value.
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
