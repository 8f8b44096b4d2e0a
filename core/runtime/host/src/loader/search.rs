//! Finds plugins by their notes, loads those that a graph needs and fills the catalogue.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use crate::isolate::Processes;
use panoscope_abi as abi;
use panoscope_engine::Plugins;
use panoscope_engine::isolation::Isolator;
use panoscope_engine::vet::Vet;
use panoscope_graph::{Catalog, Graph, GraphText, Offer, PluginProblem};

use crate::loader::depends;
use crate::loader::elf::ElfError;
use crate::loader::error::LoadError;
use crate::loader::file_name::{is_python, stem};
use crate::loader::foreign_models;
use crate::loader::locked_file::LockedFile;
use crate::loader::map::{describe_verified, inspect, load_verified};
use crate::loader::plugin_file::{Loaded, PluginFile};
use crate::loader::stamp::Stamp;

/// Time limit for a plugin to load and describe itself in another process.
const MAX_DESCRIBE: Duration = Duration::from_secs(20);
/// Environment variable with additional plugin folders, separated by colons.
pub const PLUGIN_PATH_VARIABLE: &str = "PANOSCOPE_PLUGIN_PATH";

/// A plugin, and whether it was described instead of loaded.
type LoadKey = (String, bool);

/// The plugins in a list of folders; loads each one on first use.
#[derive(Default)]
pub struct Loader {
    folders: Vec<PathBuf>,
    stamps: BTreeMap<PathBuf, Stamp>,
    found: BTreeMap<String, PluginFile>,
    problems: Vec<PluginProblem>,
    /// Files and folders that were skipped; see [`Catalog::passed_over`].
    passed_over: Vec<PluginProblem>,
    /// Libraries named like a plugin's file that are not plugins.
    strangers: Vec<PluginProblem>,
    /// SHA-256 of the plugins that may be loaded, by name; `None` if every plugin may.
    pins: Option<Arc<BTreeMap<String, String>>>,
    /// Folders whose plugins are found but not loaded.
    untrusted: Vec<PathBuf>,
    /// Plugins that are described by a separate process instead of loaded, see [`Self::catalog_of`].
    isolated: Mutex<BTreeSet<String>>,
    /// Plugins that this process never loads, whatever a graph says.
    never_loaded: BTreeSet<String>,
    /// Maximum time for a plugin to describe itself, if not [`MAX_DESCRIBE`].
    describe_limit: Option<Duration>,
    loaded: Mutex<BTreeMap<LoadKey, Result<Loaded, PluginProblem>>>,
}

fn is_library(file: &Path) -> bool {
    file.extension() == Some(OsStr::new("so"))
}

/// Whether a file may be a plugin, by its name.
pub(crate) fn may_be_plugin(file: &Path) -> bool {
    is_library(file) || is_python(file)
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The folders to search, in order: `extra`, `PANOSCOPE_PLUGIN_PATH`, `plugins` next to the program, and the build's
/// folder for tests.
pub fn search_path(extra: &[PathBuf]) -> Vec<PathBuf> {
    let mut folders = extra.to_vec();
    if let Some(list) = std::env::var_os(PLUGIN_PATH_VARIABLE) {
        folders.extend(std::env::split_paths(&list).filter(|p| !p.as_os_str().is_empty()));
    }
    if let Some(folder) = panoscope_base::program::folder() {
        folders.push(folder.join("plugins"));
        if folder.file_name() == Some(OsStr::new("deps"))
            && let Some(up) = folder.parent()
        {
            folders.push(up.join("plugins"));
        }
    }
    let mut unique: Vec<PathBuf> = Vec::new();
    for folder in folders {
        if !unique.contains(&folder) {
            unique.push(folder);
        }
    }
    unique
}

/// The problem of a folder that the user named and that cannot be read.
fn unread_folder(folder: &Path, error: &std::io::Error) -> Option<PluginProblem> {
    let list = std::env::var_os(PLUGIN_PATH_VARIABLE)?;
    std::env::split_paths(&list).any(|named| named == folder).then(|| PluginProblem {
        plugin: String::new(),
        file: folder.display().to_string(),
        message: format!("{PLUGIN_PATH_VARIABLE} names the folder {}, which cannot be read: {error}", folder.display()),
        help: format!("correct {PLUGIN_PATH_VARIABLE}"),
    })
}

/// The folders that are not in the user's own search path.
fn foreign(own: &[PathBuf]) -> Vec<PathBuf> {
    let real = |folder: &PathBuf| folder.canonicalize().unwrap_or_else(|_| folder.clone());
    let trusted: Vec<PathBuf> = search_path(&[]).iter().map(real).collect();
    own.iter().filter(|folder| !trusted.contains(&real(folder))).cloned().collect()
}

impl Loader {
    /// Searches the given folders; of two plugins with the same name, the one in the earlier folder is used. Reads the
    /// notes but loads nothing.
    pub fn search(folders: &[PathBuf]) -> Self {
        let mut this = Self { folders: folders.to_vec(), ..Self::default() };
        for folder in folders {
            let entries = match std::fs::read_dir(folder) {
                Ok(entries) => entries,
                Err(error) => {
                    this.passed_over.extend(unread_folder(folder, &error));
                    continue;
                }
            };
            let mut files: Vec<PathBuf> = entries.flatten().map(|e| e.path()).collect();
            files.sort();
            for file in files.into_iter().filter(|file| may_be_plugin(file)) {
                // Taken before the file is read: if the file changes meanwhile, its stamp will differ.
                this.stamps.insert(file.clone(), Stamp::of(&file));
                match inspect(&file) {
                    Ok(found) => {
                        this.found.entry(found.note.name.clone()).or_insert(found);
                    }
                    Err(LoadError::NoNodes { .. }) => {}
                    Err(error) if this.found.contains_key(&stem(&file)) => drop(error),
                    // The folder may contain other libraries; they matter only where a graph asks for a plugin of their name.
                    Err(error @ LoadError::BadFile { cause: ElfError::NoNote, .. }) => {
                        this.strangers.push(error.problem(&stem(&file)));
                    }
                    Err(error) => this.problems.push(error.problem(&stem(&file))),
                }
            }
        }
        for problems in [&mut this.problems, &mut this.strangers] {
            let (mut replaced, other): (Vec<_>, Vec<_>) =
                std::mem::take(problems).into_iter().partition(|problem| this.found.contains_key(&problem.plugin));
            *problems = other;
            for problem in &mut replaced {
                problem.message += &format!("; {} is used instead", this.found[&problem.plugin].file.display());
            }
            this.passed_over.extend(replaced);
        }
        this
    }

    /// As [`Self::search`] in the folders of [`search_path`] for a graph that names the folders `own`. Plugins in them
    /// are found but not loaded, because the graph's author chose them, unless they are also in the user's own search
    /// path.
    pub fn search_without_loading(own: &[PathBuf]) -> Self {
        let mut this = Self::search(&search_path(own));
        this.untrusted = foreign(own);
        this
    }

    /// Plugins that were found in folders that only the graph names, not the user's own search path, so that the
    /// graph's author chose them.
    pub fn brought_by(&self, own: &[PathBuf]) -> Vec<String> {
        let foreign = foreign(own);
        let is_foreign =
            |found: &&PluginFile| found.file.parent().is_some_and(|folder| foreign.iter().any(|f| f == folder));
        self.found.values().filter(is_foreign).map(|found| found.note.name.clone()).collect()
    }

    /// Restricts loading to the plugins of a lock, and to the locked bytes, also after [`Self::rescan`].
    #[must_use]
    pub fn pinned(mut self, files: &[LockedFile]) -> Self {
        self.pins = Some(Arc::new(depends::plugins_of(files)));
        self
    }

    /// Sets the time limit for a plugin to describe itself in another process.
    #[must_use]
    pub fn describing_within(mut self, limit: Duration) -> Self {
        self.describe_limit = Some(limit);
        self
    }

    /// Makes plugins in folders that only the graph names be described by separate processes and never loaded into this
    /// one, also after [`Self::rescan`]. Their nodes run if the graph isolates them, see [`Graph::isolate_plugins`].
    #[must_use]
    pub fn isolating(mut self, own: &[PathBuf]) -> Self {
        self.never_loaded.extend(self.brought_by(own));
        lock(&self.isolated).extend(self.never_loaded.iter().cloned());
        self
    }

    fn set_isolated(&self, plugins: Vec<String>) {
        *lock(&self.isolated) = plugins.into_iter().chain(self.never_loaded.iter().cloned()).collect();
    }

    /// The SHA-256 that a plugin must have; `None` for any.
    fn pin_of(&self, found: &PluginFile) -> Result<Option<&str>, PluginProblem> {
        let problem = |message: String, help: &str| PluginProblem {
            plugin: found.note.name.clone(),
            file: found.file.display().to_string(),
            message,
            help: help.to_owned(),
        };
        if let Some(folder) = self.untrusted.iter().find(|folder| found.file.parent() == Some(folder.as_path())) {
            let message = format!("the graph brings it in its own folder {}, and it was not loaded", folder.display());
            let help = "loading it runs its code; if you trust whoever wrote it, add --trust-plugins";
            return Err(problem(message, help));
        }
        let Some(pins) = &self.pins else { return Ok(None) };
        match pins.get(&found.note.name) {
            Some(sha256) => Ok(Some(sha256.as_str())),
            None => {
                let message = "the lock of the graph does not have it".to_owned();
                Err(problem(message, "lock the graph again with `panoscope lock`"))
            }
        }
    }

    /// Searches the same folders again. Plugins whose files are unchanged stay loaded; the others are reloaded on
    /// demand, next to their predecessors.
    pub fn rescan(&self) -> Self {
        self.rescan_in(&self.folders)
    }

    /// Searches other folders, otherwise as [`Self::rescan`].
    pub fn rescan_in(&self, folders: &[PathBuf]) -> Self {
        let mut new = Self::search(folders);
        new.pins.clone_from(&self.pins);
        new.describe_limit = self.describe_limit;
        new.never_loaded.clone_from(&self.never_loaded);
        new.untrusted.clone_from(&self.untrusted);
        new.isolated = Mutex::new(lock(&self.isolated).clone());
        let loaded = lock(&self.loaded);
        // A plugin whose file is now damaged is not replaced by one of the same name from another folder: the loaded one keeps running.
        for (plugin, found) in self.found.iter().filter(|(plugin, _)| loaded.keys().any(|(name, _)| name == *plugin)) {
            if new.found.get(plugin).is_some_and(|n| n.file != found.file)
                && new.stamps.contains_key(&found.file)
                && let Err(error) = inspect(&found.file)
            {
                new.found.remove(plugin);
                new.problems.push(error.problem(plugin));
            }
        }
        let unchanged = |plugin: &str| {
            let file = &new.found.get(plugin)?.file;
            (self.found.get(plugin)?.file == *file && self.stamps.get(file) == new.stamps.get(file)).then_some(())
        };
        let retained = loaded.iter().filter(|((plugin, _), result)| result.is_ok() && unchanged(plugin).is_some());
        *lock(&new.loaded) = retained.map(|(key, result)| (key.clone(), result.clone())).collect();
        new
    }

    /// The stamps of all plugin files at the time of the search.
    pub fn stamps(&self) -> &BTreeMap<PathBuf, Stamp> {
        &self.stamps
    }

    /// The folders that were searched.
    pub fn folders(&self) -> &[PathBuf] {
        &self.folders
    }

    /// The plugins that were found, in the order of their names.
    pub fn found(&self) -> impl Iterator<Item = &PluginFile> {
        self.found.values()
    }

    /// Files that are plugins but cannot be used.
    pub fn problems(&self) -> &[PluginProblem] {
        &self.problems
    }

    /// The plugins that offer a node type, from their notes.
    pub fn offering(&self, node_type: &str) -> Vec<&PluginFile> {
        self.found.values().filter(|f| f.note.node_types.iter().any(|n| n == node_type)).collect()
    }

    /// Loads a plugin, or has it described if its nodes all run in separate processes; a second call returns the first
    /// result.
    pub fn load(&self, plugin: &str) -> Result<Loaded, PluginProblem> {
        let is_python = self.found.get(plugin).is_some_and(|found| found.python.is_some());
        let is_isolated = is_python || lock(&self.isolated).contains(plugin);
        let key = (plugin.to_owned(), is_isolated);
        let mut loaded = lock(&self.loaded);
        if let Some(done) = loaded.get(&key) {
            return done.clone();
        }
        let load = |found: &PluginFile, pin: Option<&str>| match is_isolated {
            true => describe_verified(found, pin, self.describe_limit.unwrap_or(MAX_DESCRIBE)),
            false => load_verified(found, pin),
        };
        let result = match self.found.get(plugin) {
            Some(found) => self.pin_of(found).and_then(|pin| load(found, pin).map_err(|e| e.problem(plugin))),
            None => match self.problems.iter().find(|p| p.plugin == plugin) {
                Some(problem) => Err(problem.clone()),
                None => return Err(missing(plugin)),
            },
        };
        loaded.insert(key, result.clone());
        result
    }

    /// Node types of all plugins found, from their notes.
    pub fn offers(&self) -> Vec<Offer> {
        let offer = |(plugin, found): (&String, &PluginFile)| Offer {
            plugin: plugin.clone(),
            node_types: found.note.node_types.clone(),
        };
        self.found.iter().map(offer).collect()
    }

    /// The plugins of a graph's text that [`Self::catalog_of`] does not load into this process.
    pub fn isolated_plugins(&self, text: &GraphText) -> Vec<String> {
        text.isolated_plugins(&self.offers())
    }

    /// The catalogue for a graph's text, as [`Self::catalog`] with its plugins. Plugins whose nodes all run in separate
    /// processes, see [`GraphText::isolated_plugins`], are then not loaded into this process: another process describes
    /// them.
    pub fn catalog_of(&self, text: &GraphText) -> Catalog {
        self.set_isolated(self.isolated_plugins(text));
        self.catalog(&text.plugins())
    }

    /// As [`Self::catalog_of`], for a graph that was checked elsewhere.
    pub fn catalog_of_graph(&self, graph: &Graph) -> Catalog {
        self.set_isolated(graph.isolated_plugins.clone());
        self.catalog(&graph.plugins)
    }

    /// The catalogue for a graph: the plugins that it lists are loaded, all others are entered by name only.
    pub fn catalog<S: AsRef<str>>(&self, plugins: &[S]) -> Catalog {
        let (mut problems, passed_over) = (self.problems.clone(), self.passed_over.clone());
        problems.extend(self.strangers.iter().filter(|s| plugins.iter().any(|p| p.as_ref() == s.plugin)).cloned());
        let mut catalog = Catalog { problems, passed_over, ..Catalog::default() };
        for (plugin, found) in &self.found {
            if !plugins.iter().any(|p| p.as_ref() == plugin) {
                catalog.plugins.push(plugin.clone());
                catalog.offers.push(Offer { plugin: plugin.clone(), node_types: found.note.node_types.clone() });
            }
        }
        for plugin in plugins {
            let plugin = plugin.as_ref();
            match self.load(plugin) {
                Ok(loaded) => {
                    if !catalog.plugins.iter().any(|p| p == plugin) {
                        catalog.plugins.push(plugin.to_owned());
                        catalog.node_types.extend(loaded.node_types);
                    }
                }
                Err(problem) if self.found.contains_key(plugin) => catalog.problems.push(problem),
                Err(_) => {}
            }
        }
        catalog.plugins.sort();
        catalog
    }
}

impl Plugins for Loader {
    fn entry(&self, plugin: &str, node_type: &str) -> Option<&'static abi::NodeType> {
        let loaded = self.load(plugin).ok()?;
        let index = loaded.node_types.iter().position(|t| t.name == node_type)?;
        loaded.entries.get(index).copied()
    }

    fn isolator(&self) -> Option<Arc<dyn Isolator>> {
        Some(Arc::new(Processes))
    }

    fn vet(&self) -> Option<Arc<dyn Vet>> {
        Some(foreign_models::vet())
    }

    fn files(&self, plugins: &[String]) -> Vec<(String, PathBuf)> {
        let used = self.found().filter(|found| plugins.contains(&found.note.name));
        used.map(|found| (found.note.name.clone(), found.file.clone())).collect()
    }
}

fn missing(plugin: &str) -> PluginProblem {
    PluginProblem {
        plugin: plugin.to_owned(),
        file: String::new(),
        message: format!("no plugin `{plugin}` was found"),
        help: format!(
            "it was searched for in the graph's plugin_paths, {PLUGIN_PATH_VARIABLE} and `plugins` beside the program"
        ),
    }
}
