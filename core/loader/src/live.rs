//! Editing a running graph by its text: every edit is checked as a whole file and applied as one transaction.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::ops::Deref;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use panoscope_engine::{Applied, ApplyError, Engine};
use panoscope_graph::edit::{EditError, GraphEdit};
use panoscope_graph::{Diagnostics, GraphText, check};

use crate::search::{self, Loader, Stamp};

/// Why an edit was not made; text and graph are as before.
#[derive(Debug, thiserror::Error)]
pub enum LiveError {
    /// The text cannot be edited like that.
    #[error(transparent)]
    Edit(#[from] EditError),
    /// The new text has mistakes.
    #[error("the new graph has mistakes, the old one runs on:\n{}", .0.render(false))]
    Check(Diagnostics),
    /// The change did not succeed.
    #[error(transparent)]
    Apply(#[from] ApplyError),
}

/// A running graph and its text. `E` is whatever holds the engine: a reference, an `Arc`.
pub struct Live<E> {
    engine: E,
    path: PathBuf,
    text: String,
    settings: Vec<String>,
    loader: Arc<Loader>,
}

impl<E: Deref<Target = Engine>> Live<E> {
    /// Takes over a graph that was started from `text`, read at `path`, with `settings` (`node.param=value`) that win over it.
    pub fn new(engine: E, path: &Path, text: String, settings: Vec<String>, loader: impl Into<Arc<Loader>>) -> Self {
        Self { engine, path: path.to_owned(), text, settings, loader: loader.into() }
    }

    /// The engine.
    pub fn engine(&self) -> &Engine {
        &self.engine
    }

    /// The text of the graph that runs.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Where its plugins came from.
    pub fn loader(&self) -> &Arc<Loader> {
        &self.loader
    }

    fn parse(&self, text: &str) -> GraphText {
        let mut parsed = GraphText::parse(&self.path, text);
        self.settings.iter().for_each(|setting| parsed.set(setting));
        parsed
    }

    fn apply_with(&mut self, parsed: &GraphText, loader: Option<Loader>) -> Result<Applied, LiveError> {
        let used: &Loader = loader.as_ref().unwrap_or(&self.loader);
        let catalog = used.catalog(&parsed.plugins());
        let (graph, _) = check(parsed, &catalog).into_result().map_err(LiveError::Check)?;
        let applied = self.engine.apply(graph, &catalog, used)?;
        self.text = parsed.flattened(&catalog).into_owned();
        if let Some(loader) = loader {
            self.loader = Arc::new(loader);
        }
        Ok(applied)
    }

    /// Makes the running graph the one that `text` describes.
    ///
    /// # Errors
    /// The text has mistakes, or the change did not succeed; the old graph runs on.
    pub fn apply_text(&mut self, text: &str) -> Result<Applied, LiveError> {
        self.apply(&self.parse(text))
    }

    /// Makes the running graph another one, read with its own parts, overlays and settings.
    ///
    /// # Errors
    /// As [`Self::apply_text`].
    pub fn apply(&mut self, parsed: &GraphText) -> Result<Applied, LiveError> {
        let folders = search::search_path(&parsed.plugin_paths());
        let elsewhere = folders != self.loader.folders() && folders.iter().any(|f| !self.loader.folders().contains(f));
        let loader = elsewhere.then(|| {
            let mut all = folders;
            all.extend(self.loader.folders().iter().filter(|f| !all.contains(f)).cloned().collect::<Vec<_>>());
            self.loader.rescan_in(&all)
        });
        self.apply_with(parsed, loader)
    }

    /// Looks for rebuilt plugins and swaps them in. One that is broken leaves its predecessor running.
    pub fn reload_plugins(&mut self) -> Result<Applied, LiveError> {
        let (parsed, loader) = (self.parse(&self.text), self.loader.rescan());
        self.apply_with(&parsed, Some(loader))
    }

    /// Edits the text and applies the result, all edits of `edit` as one transaction.
    pub fn edit(&mut self, edit: impl FnOnce(&mut GraphEdit) -> Result<(), EditError>) -> Result<Applied, LiveError> {
        let mut document = GraphEdit::parse(&self.text)?;
        edit(&mut document)?;
        self.apply_with(&self.parse(&document.text()), None)
    }

    /// Adds a node with its inputs: `("image", &["source.image"])`.
    pub fn add_node(&mut self, id: &str, node_type: &str, inputs: &[(&str, &[&str])]) -> Result<Applied, LiveError> {
        self.edit(|document| {
            document.add_node(id, node_type)?;
            inputs.iter().try_for_each(|(input, from)| document.set_input(id, input, from))
        })
    }

    /// Removes a node and what refers to it.
    pub fn remove_node(&mut self, id: &str) -> Result<Applied, LiveError> {
        self.edit(|document| document.remove_node(id))
    }

    /// Connects an input to one output or, for a list, several.
    pub fn connect(&mut self, id: &str, input: &str, from: &[&str]) -> Result<Applied, LiveError> {
        self.edit(|document| document.set_input(id, input, from))
    }

    /// Disconnects an input.
    pub fn disconnect(&mut self, id: &str, input: &str) -> Result<Applied, LiveError> {
        self.edit(|document| document.remove_input(id, input))
    }

    /// Sets a parameter, in the graph and in its text.
    pub fn set_param(&mut self, id: &str, param: &str, value: &toml::Value) -> Result<Applied, LiveError> {
        self.edit(|document| document.set_param(id, param, value))
    }
}

/// What changed on disk.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Changed {
    /// The graph file, a part or an overlay.
    pub graph: bool,
    /// A plugin's file.
    pub plugins: bool,
}

/// Watches a graph file and the plugins' folders. A change counts once the files hold still from one look to the next, so that no half-written
/// file is taken.
pub struct FileWatch {
    path: PathBuf,
    /// Parts and overlays.
    files: Vec<PathBuf>,
    folders: Vec<PathBuf>,
    known: State,
    seen: State,
}

type State = (Vec<Stamp>, BTreeMap<PathBuf, Stamp>);

fn stamps(path: &Path, files: &[PathBuf]) -> Vec<Stamp> {
    std::iter::once(path).chain(files.iter().map(PathBuf::as_path)).map(Stamp::of).collect()
}

fn state(path: &Path, graph_files: &[PathBuf], folders: &[PathBuf]) -> State {
    let entries = folders.iter().filter_map(|folder| std::fs::read_dir(folder).ok()).flatten().flatten();
    let files = entries.map(|e| e.path()).filter(|f| f.extension() == Some(OsStr::new("so")));
    (stamps(path, graph_files), files.map(|file| (file.clone(), Stamp::of(&file))).collect())
}

impl FileWatch {
    /// Starts from what `loader` saw and from the graph file as it is now.
    pub fn new(path: &Path, loader: &Loader) -> Self {
        let folders = loader.folders().to_vec();
        let known = (stamps(path, &[]), loader.stamps().clone());
        Self { path: path.to_owned(), files: Vec::new(), seen: known.clone(), folders, known }
    }

    /// Watches further files of the graph: parts and overlays.
    #[must_use]
    pub fn with_files(mut self, files: impl Iterator<Item = PathBuf>) -> Self {
        self.files = files.collect();
        self.known.0 = stamps(&self.path, &self.files);
        self.seen.0.clone_from(&self.known.0);
        self
    }

    /// The graph file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The graph file's text now.
    pub fn text(&self) -> std::io::Result<String> {
        std::fs::read_to_string(&self.path)
    }

    /// What changed since the last call that answered a change. To be called every 200 ms or so.
    pub fn look(&mut self) -> Changed {
        let now = state(&self.path, &self.files, &self.folders);
        let still = now == self.seen;
        self.seen = now;
        if !still || self.seen == self.known {
            return Changed::default();
        }
        let changed = Changed { graph: self.seen.0 != self.known.0, plugins: self.seen.1 != self.known.1 };
        self.known = self.seen.clone();
        changed
    }
}
