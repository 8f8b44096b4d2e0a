//! Finds plugins, reads their notes, loads those that are needed and fills the catalogue.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use panoscope_abi as abi;
use panoscope_graph::{Catalog, NodeType, Offer, PluginProblem};

use crate::elf::{self, ElfError, Note};
use crate::ending::who;
use crate::host;

/// Environment variable with further plugin folders, separated by colons.
pub const PLUGIN_PATH_VARIABLE: &str = "PANOSCOPE_PLUGIN_PATH";

/// Why a plugin could not be used.
#[derive(Debug, thiserror::Error)]
pub enum LoadError {
    /// The file cannot be read.
    #[error("{file} cannot be read: {cause}", file = file.display())]
    Unreadable {
        /// The plugin's file.
        file: PathBuf,
        /// What the system says.
        cause: std::io::Error,
    },
    /// The file is no whole plugin.
    #[error("{file} is not used: {cause}", file = file.display())]
    BadFile {
        /// The plugin's file.
        file: PathBuf,
        /// What is wrong with it.
        cause: ElfError,
    },
    /// Built for another host.
    #[error("{file} was built for plugin ABI {found}, this host speaks {expected}", file = file.display())]
    AbiMismatch {
        /// The plugin's file.
        file: PathBuf,
        /// Major number in the plugin's note.
        found: u32,
        /// Major number of this host.
        expected: u32,
    },
    /// The dynamic linker refused it.
    #[error("{file} does not load: {cause}", file = file.display())]
    Link {
        /// The plugin's file.
        file: PathBuf,
        /// What the dynamic linker says.
        cause: String,
    },
    /// It loaded, but what it says of itself makes no sense.
    #[error("{file} describes itself wrongly: {cause}", file = file.display())]
    BadDescriptor {
        /// The plugin's file.
        file: PathBuf,
        /// What is wrong.
        cause: String,
    },
}

impl LoadError {
    fn file(&self) -> &Path {
        match self {
            Self::Unreadable { file, .. }
            | Self::BadFile { file, .. }
            | Self::AbiMismatch { file, .. }
            | Self::Link { file, .. }
            | Self::BadDescriptor { file, .. } => file,
        }
    }

    fn help(&self) -> String {
        match self {
            Self::AbiMismatch { .. } => "rebuild the plugin against this version of panoscope".to_owned(),
            Self::BadFile { .. } | Self::BadDescriptor { .. } => "build or copy the plugin again".to_owned(),
            Self::Link { .. } => "install the library that is named, or rebuild the plugin".to_owned(),
            Self::Unreadable { .. } => "check the path and its permissions".to_owned(),
        }
    }

    /// For the graph checker.
    pub fn problem(&self, plugin: &str) -> PluginProblem {
        PluginProblem {
            plugin: plugin.to_owned(),
            file: self.file().display().to_string(),
            message: self.to_string(),
            help: self.help(),
        }
    }
}

/// A plugin's file and what its note says.
#[derive(Clone, Debug)]
pub struct Found {
    /// The shared library.
    pub file: PathBuf,
    /// What stands in its note.
    pub note: Note,
}

/// A loaded plugin; it stays mapped until the process ends.
#[derive(Clone)]
pub struct Loaded {
    /// Where it came from.
    pub found: Found,
    /// Its node types for the catalogue.
    pub node_types: Vec<NodeType>,
    /// Its node types for the engine, in the same order.
    pub entries: Vec<&'static abi::NodeType>,
}

/// Tells one state of a file from another: time, length and inode; all zero when there is none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stamp(u128, u64, u64);

impl Stamp {
    /// The file as it is now.
    pub fn of(file: &Path) -> Self {
        use std::os::unix::fs::MetadataExt;
        let Ok(meta) = std::fs::metadata(file) else { return Self::default() };
        let time = meta.modified().ok().and_then(|t| t.duration_since(std::time::UNIX_EPOCH).ok());
        Self(time.map_or(0, |t| t.as_nanos()), meta.len(), meta.ino())
    }
}

/// All plugins that can be seen from here.
#[derive(Default)]
pub struct Loader {
    folders: Vec<PathBuf>,
    stamps: BTreeMap<PathBuf, Stamp>,
    found: BTreeMap<String, Found>,
    problems: Vec<PluginProblem>,
    loaded: Mutex<BTreeMap<String, Result<Loaded, PluginProblem>>>,
}

/// Folders that are searched: those given, `PANOSCOPE_PLUGIN_PATH`, `plugins` beside the program, the build's folder.
pub fn search_path(extra: &[PathBuf]) -> Vec<PathBuf> {
    let mut folders = extra.to_vec();
    if let Some(list) = std::env::var_os(PLUGIN_PATH_VARIABLE) {
        folders.extend(std::env::split_paths(&list).filter(|p| !p.as_os_str().is_empty()));
    }
    if let Ok(program) = std::env::current_exe()
        && let Some(folder) = program.parent()
    {
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

/// Reads a plugin's note without loading it.
pub fn inspect(file: &Path) -> Result<Found, LoadError> {
    let parts = elf::OnDisk::open(file).map_err(|cause| LoadError::Unreadable { file: file.to_owned(), cause })?;
    let note = elf::read_note(&parts).map_err(|cause| LoadError::BadFile { file: file.to_owned(), cause })?;
    if note.abi_major != abi::ABI_MAJOR {
        let (found, expected) = (note.abi_major, abi::ABI_MAJOR);
        return Err(LoadError::AbiMismatch { file: file.to_owned(), found, expected });
    }
    Ok(Found { file: file.to_owned(), note })
}

/// Loads a plugin from a private copy of its file, so that a rebuild never changes what is mapped.
pub fn load(found: &Found) -> Result<Loaded, LoadError> {
    let file = &found.file;
    let link = |cause: String| LoadError::Link { file: file.clone(), cause };
    let mut whole = File::open(file).map_err(|cause| LoadError::Unreadable { file: file.clone(), cause })?;
    let copy = private_copy(file, &mut whole).map_err(|e| link(format!("no private copy could be made: {e}")))?;
    // Checked again on the very bytes that are loaded: the file may have changed since it was found.
    elf::read_note(&copy.parts).map_err(|cause| LoadError::BadFile { file: file.clone(), cause })?;
    // SAFETY: constructors of the library run here. The note says that it is a plugin of this ABI; a plugin is trusted like
    // any program its user installs.
    let library = who::loading(file, || unsafe {
        libloading::os::unix::Library::open(Some(&copy.path), libc::RTLD_NOW | libc::RTLD_LOCAL)
            .map_err(|e| link(clean(&e, &copy.path, file)))
    });
    let library = library?;
    let bad = |cause: String| LoadError::BadDescriptor { file: file.clone(), cause };
    // SAFETY: the symbol's type is part of the contract.
    let plugin = unsafe {
        let entry = library
            .get::<abi::Entry>(abi::ENTRY_SYMBOL.as_bytes())
            .map_err(|_| bad(format!("it exports no symbol `{}`", abi::ENTRY_SYMBOL)))?;
        who::loading(file, || entry())
    };
    // The library stays mapped: its threads, thread-locals and exit handlers cannot be undone safely. The descriptor of its copy stays open
    // like the mapping: debuggers and profilers read symbols through it.
    std::mem::forget(library);
    std::mem::forget(copy);
    // SAFETY: a descriptor of a plugin that stays mapped; every field is checked before use.
    let mut node_types = unsafe { panoscope_graph::from_abi::node_types(plugin) }.map_err(|e| bad(e.to_string()))?;
    // Files that come with a plugin lie in a folder of its name beside its library.
    let shipped_dir = file.parent().unwrap_or(Path::new("")).join(&found.note.name);
    for node_type in &mut node_types {
        node_type.shipped_dir.clone_from(&shipped_dir);
        node_type.validator = node_type.validator.take().map(|v| who::checking(&node_type.name, file, v));
    }
    // SAFETY: validated by `node_types`.
    let descriptor = unsafe { &*plugin };
    // SAFETY: as above.
    let name = unsafe { descriptor.name.text() }.unwrap_or("");
    if name != found.note.name {
        return Err(bad(format!("its note says `{}`, its code says `{name}`", found.note.name)));
    }
    // SAFETY: validated by `node_types`.
    let entries: Vec<&'static abi::NodeType> = (0..descriptor.node_types_len)
        .map(|index| unsafe { panoscope_graph::from_abi::whole(*descriptor.node_types.add(index)) })
        .collect();
    who::loaded(&entries, file);
    if let Some(attach) = descriptor.attach {
        // SAFETY: the plugin's table outlives it.
        let status = who::loading(file, || unsafe { attach(host::plugin_table(plugin)) });
        if status != abi::STATUS_OK {
            return Err(bad(format!("it refused the host ({status})")));
        }
    }
    Ok(Loaded { found: found.clone(), node_types, entries })
}

struct PrivateCopy {
    path: PathBuf,
    /// The same bytes.
    parts: elf::OnDisk,
}

/// A copy in memory.
fn private_copy(file: &Path, whole: &mut File) -> std::io::Result<PrivateCopy> {
    use std::os::fd::{AsRawFd, FromRawFd};
    let name = file.file_name().unwrap_or(OsStr::new("plugin")).to_string_lossy();
    let c_name = std::ffi::CString::new(name.as_bytes()).map_err(std::io::Error::other)?;
    // SAFETY: a plain system call with a terminated name.
    let fd = unsafe { libc::memfd_create(c_name.as_ptr(), libc::MFD_CLOEXEC) };
    if fd < 0 {
        return Err(std::io::Error::last_os_error());
    }
    // SAFETY: a fresh descriptor that nobody else owns.
    let mut copy = unsafe { File::from_raw_fd(fd) };
    std::io::copy(whole, &mut copy)?;
    let path = PathBuf::from(format!("/proc/self/fd/{}", copy.as_raw_fd()));
    Ok(PrivateCopy { path, parts: elf::OnDisk::over(copy)? })
}

fn clean(error: &libloading::Error, copy: &Path, file: &Path) -> String {
    let mut text = error.to_string();
    if let Some(source) = std::error::Error::source(error) {
        text = source.to_string();
    }
    text.replace(&copy.display().to_string(), &file.display().to_string())
}

impl Loader {
    /// Looks into the given folders, earlier ones first; reads notes, loads nothing.
    pub fn search(folders: &[PathBuf]) -> Self {
        let mut this = Self { folders: folders.to_vec(), ..Self::default() };
        for folder in folders {
            let Ok(entries) = std::fs::read_dir(folder) else { continue };
            let mut files: Vec<PathBuf> = entries.flatten().map(|e| e.path()).collect();
            files.sort();
            for file in files.into_iter().filter(|f| f.extension() == Some(OsStr::new("so"))) {
                // Read first: a file that changes now will differ from it.
                this.stamps.insert(file.clone(), Stamp::of(&file));
                match inspect(&file) {
                    Ok(found) => {
                        this.found.entry(found.note.name.clone()).or_insert(found);
                    }
                    // Any library may stand in such a folder; only what claims to be a plugin is worth a word.
                    Err(LoadError::BadFile { cause: ElfError::NoNote, .. }) => {}
                    Err(error) => this.problems.push(error.problem(&stem(&file))),
                }
            }
        }
        let found = &this.found;
        this.problems.retain(|p| !found.contains_key(&p.plugin));
        this
    }

    /// Looks into the same folders again. Plugins whose files are as they were go on as loaded; the others load anew when they are needed,
    /// beside their predecessors.
    pub fn rescan(&self) -> Self {
        self.rescan_in(&self.folders)
    }

    /// Looks into other folders, otherwise like [`Self::rescan`].
    pub fn rescan_in(&self, folders: &[PathBuf]) -> Self {
        let mut new = Self::search(folders);
        let loaded = self.loaded.lock().unwrap_or_else(PoisonError::into_inner);
        // A plugin whose file broke is not replaced by one of the same name from another folder: its predecessor runs on.
        for (plugin, found) in self.found.iter().filter(|(plugin, _)| loaded.contains_key(*plugin)) {
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
        let kept = loaded.iter().filter(|(plugin, result)| result.is_ok() && unchanged(plugin).is_some());
        let kept: BTreeMap<_, _> = kept.map(|(plugin, result)| (plugin.clone(), result.clone())).collect();
        *new.loaded.lock().unwrap_or_else(PoisonError::into_inner) = kept;
        new
    }

    /// The plugin files seen, as they were.
    pub fn stamps(&self) -> &BTreeMap<PathBuf, Stamp> {
        &self.stamps
    }

    /// Folders that were searched.
    pub fn folders(&self) -> &[PathBuf] {
        &self.folders
    }

    /// Plugins by name.
    pub fn found(&self) -> impl Iterator<Item = &Found> {
        self.found.values()
    }

    /// Files that look like plugins and cannot be used.
    pub fn problems(&self) -> &[PluginProblem] {
        &self.problems
    }

    /// The plugins that offer a node type, from their notes.
    pub fn offering(&self, node_type: &str) -> Vec<&Found> {
        self.found.values().filter(|f| f.note.node_types.iter().any(|n| n == node_type)).collect()
    }

    /// Loads a plugin, once.
    pub fn load(&self, plugin: &str) -> Result<Loaded, PluginProblem> {
        let mut loaded = self.loaded.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(done) = loaded.get(plugin) {
            return done.clone();
        }
        let result = match self.found.get(plugin) {
            Some(found) => load(found).map_err(|e| e.problem(plugin)),
            None => match self.problems.iter().find(|p| p.plugin == plugin) {
                Some(problem) => Err(problem.clone()),
                None => return Err(missing(plugin)),
            },
        };
        loaded.insert(plugin.to_owned(), result.clone());
        result
    }

    /// The catalogue for a graph: its listed plugins loaded, all others by name only.
    pub fn catalog<S: AsRef<str>>(&self, plugins: &[S]) -> Catalog {
        let mut catalog = Catalog { problems: self.problems.clone(), ..Catalog::default() };
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

    /// The engine's entry of a node type.
    pub fn entry(&self, plugin: &str, node_type: &str) -> Option<&'static abi::NodeType> {
        let loaded = self.load(plugin).ok()?;
        let index = loaded.node_types.iter().position(|t| t.name == node_type)?;
        loaded.entries.get(index).copied()
    }
}

fn stem(file: &Path) -> String {
    let stem = file.file_stem().unwrap_or_default().to_string_lossy();
    let stem = stem.strip_prefix("lib").unwrap_or(&stem);
    stem.strip_prefix("panoscope_").unwrap_or(stem).to_owned()
}

fn missing(plugin: &str) -> PluginProblem {
    PluginProblem {
        plugin: plugin.to_owned(),
        file: String::new(),
        message: format!("no plugin `{plugin}` was found"),
        help: format!(
            "folders searched: the graph's plugin_paths, {PLUGIN_PATH_VARIABLE}, `plugins` beside the program"
        ),
    }
}
