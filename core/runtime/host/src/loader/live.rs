//! Edits a running graph by editing its text. Every edit is checked as a whole file and applied as one transaction.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use panoscope_engine::{Applied, ApplyError, Engine};
use panoscope_graph::edit::{EditError, GraphEdit};
use panoscope_graph::{Diagnostics, GraphText, check};

use crate::loader::seal::{NotLocked, Seal};
use crate::loader::search::{self, Loader};
use crate::loader::stamp::Stamp;

/// An edit that failed; text and graph are unchanged.
#[derive(Debug, thiserror::Error)]
pub enum LiveError {
    /// The edit does not fit the text.
    #[error(transparent)]
    Edit(#[from] EditError),
    /// The new text has mistakes.
    #[error("the new graph has mistakes, the old one keeps running:\n{}", .0.render(false))]
    Check(Diagnostics),
    /// The graph runs under its lock, and the new one reads another file.
    #[error("{0}; the old graph keeps running")]
    NotLocked(#[from] NotLocked),
    /// The engine could not apply the new graph.
    #[error(transparent)]
    Apply(#[from] ApplyError),
}

/// A running graph and its text, which `graph_file::Ready::start` makes.
pub struct Live {
    pub(super) engine: Arc<Engine>,
    pub(super) path: PathBuf,
    pub(super) text: String,
    /// `node.param=value`; they override the text, also a changed one.
    pub(super) settings: Vec<String>,
    pub(super) loader: Arc<Loader>,
    pub(super) seal: Option<Arc<Seal>>,
}

impl Live {
    /// Puts the graph under a lock: its nodes read the sealed copies of `seal`, and changes that need other files are
    /// refused. `None` ends that.
    pub fn set_seal(&mut self, seal: Option<Arc<Seal>>) {
        self.seal = seal;
    }

    /// The engine.
    pub fn engine(&self) -> &Arc<Engine> {
        &self.engine
    }

    /// The text of the running graph.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// The loader of its plugins.
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
        let catalog = used.catalog_of(parsed);
        let (mut graph, _) = check(parsed, &catalog).into_result().map_err(LiveError::Check)?;
        if let Some(seal) = &self.seal {
            seal.apply(&mut graph, &catalog)?;
        }
        let applied = self.engine.apply(graph, &catalog, used)?;
        self.text = parsed.flattened(&catalog).into_owned();
        if let Some(loader) = loader {
            self.loader = Arc::new(loader);
        }
        Ok(applied)
    }

    /// Changes the running graph to the one that `text` describes.
    ///
    /// # Errors
    /// The text has mistakes, or the change did not succeed; the old graph keeps running.
    pub fn apply_text(&mut self, text: &str) -> Result<Applied, LiveError> {
        self.apply(&self.parse(text))
    }

    /// Replaces the running graph by another one with its own parts, overlays and settings.
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

    /// Finds rebuilt plugins and swaps them in. When one cannot be loaded, its predecessor keeps running.
    pub fn reload_plugins(&mut self) -> Result<Applied, LiveError> {
        let (parsed, loader) = (self.parse(&self.text), self.loader.rescan());
        self.apply_with(&parsed, Some(loader))
    }

    /// Edits the text and applies the result as one transaction.
    pub fn edit(&mut self, edit: impl FnOnce(&mut GraphEdit) -> Result<(), EditError>) -> Result<Applied, LiveError> {
        let mut document = GraphEdit::parse(&self.text)?;
        edit(&mut document)?;
        self.apply_with(&self.parse(&document.text()), None)
    }

    /// Adds a node with its inputs, such as `("image", &["source.image"])`.
    pub fn add_node(&mut self, id: &str, node_type: &str, inputs: &[(&str, &[&str])]) -> Result<Applied, LiveError> {
        self.edit(|document| {
            document.add_node(id, node_type)?;
            inputs.iter().try_for_each(|(input, from)| document.set_input(id, input, from))
        })
    }

    /// Removes a node and all references to it.
    pub fn remove_node(&mut self, id: &str) -> Result<Applied, LiveError> {
        self.edit(|document| document.remove_node(id))
    }

    /// Connects an input to one output, or a list input to several.
    pub fn connect(&mut self, id: &str, input: &str, from: &[&str]) -> Result<Applied, LiveError> {
        self.edit(|document| document.set_input(id, input, from))
    }

    /// Disconnects an input.
    pub fn disconnect(&mut self, id: &str, input: &str) -> Result<Applied, LiveError> {
        self.edit(|document| document.remove_input(id, input))
    }

    /// Sets a parameter in the graph and in its text.
    pub fn set_param(&mut self, id: &str, param: &str, value: &toml::Value) -> Result<Applied, LiveError> {
        self.edit(|document| document.set_param(id, param, value))
    }
}

/// Which files changed on disk.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Changed {
    /// The graph file, a part or an overlay.
    pub graph: bool,
    /// At least one plugin file changed.
    pub plugins: bool,
}

/// Polls a graph file and the plugin folders for changes. A change is reported once the files are the same in two polls
/// in a row, so that no half-written file is used.
pub struct FileWatch {
    path: PathBuf,
    /// Parts and overlays.
    files: Vec<PathBuf>,
    folders: Vec<PathBuf>,
    /// Stamps that were reported last.
    reported: Stamps,
    /// Stamps of the last poll.
    polled: Stamps,
}

/// Stamps of the files of the graph and of the plugin files.
type Stamps = (Vec<Stamp>, BTreeMap<PathBuf, Stamp>);

fn stamps_of(path: &Path, files: &[PathBuf]) -> Vec<Stamp> {
    std::iter::once(path).chain(files.iter().map(PathBuf::as_path)).map(Stamp::of).collect()
}

fn stamps(path: &Path, graph_files: &[PathBuf], folders: &[PathBuf]) -> Stamps {
    let entries = folders.iter().filter_map(|folder| std::fs::read_dir(folder).ok()).flatten().flatten();
    let files = entries.map(|e| e.path()).filter(|file| search::may_be_plugin(file));
    (stamps_of(path, graph_files), files.map(|file| (file.clone(), Stamp::of(&file))).collect())
}

impl FileWatch {
    /// Starts from the plugin files that `loader` found and from the graph file as it is now.
    pub fn new(path: &Path, loader: &Loader) -> Self {
        let folders = loader.folders().to_vec();
        let reported = (stamps_of(path, &[]), loader.stamps().clone());
        Self { path: path.to_owned(), files: Vec::new(), polled: reported.clone(), folders, reported }
    }

    /// Watches further files of the graph: parts and overlays.
    #[must_use]
    pub fn with_files(mut self, files: impl Iterator<Item = PathBuf>) -> Self {
        self.files = files.collect();
        self.reported.0 = stamps_of(&self.path, &self.files);
        self.polled.0.clone_from(&self.reported.0);
        self
    }

    /// Watches these parts and overlays for changes from their current state, instead of the former ones or, with
    /// `and_old`, in addition to them.
    pub fn set_files(&mut self, files: impl Iterator<Item = PathBuf>, and_old: bool) {
        let mut files: Vec<PathBuf> = files.collect();
        if and_old {
            files.extend(self.files.iter().filter(|old| !files.contains(old)).cloned().collect::<Vec<_>>());
        }
        let known = |stamps: &[Stamp], file: &PathBuf| {
            let at = self.files.iter().position(|old| old == file);
            at.and_then(|at| stamps.get(at + 1).cloned()).unwrap_or_else(|| Stamp::of(file))
        };
        for stamps in [&mut self.reported.0, &mut self.polled.0] {
            let new = files.iter().map(|file| known(stamps, file));
            *stamps = stamps.first().cloned().into_iter().chain(new).collect();
        }
        self.files = files;
    }

    /// The graph file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Reads the graph file.
    pub fn text(&self) -> std::io::Result<String> {
        std::fs::read_to_string(&self.path)
    }

    /// Changes since the last call that returned a change. Call it about every 200 ms.
    pub fn poll(&mut self) -> Changed {
        let now = stamps(&self.path, &self.files, &self.folders);
        let stable = now == self.polled;
        self.polled = now;
        if !stable || self.polled == self.reported {
            return Changed::default();
        }
        let changed = Changed { graph: self.polled.0 != self.reported.0, plugins: self.polled.1 != self.reported.1 };
        self.reported = self.polled.clone();
        changed
    }
}
