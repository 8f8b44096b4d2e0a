//! The files that the run of a graph depends on.

use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};

use panoscope_base::onnx;
use panoscope_graph::{Catalog, FileKind, Graph, GraphText, Param, ParamKind, ParamValue, Pick};

use crate::loader::locked_file::{Kind, LockedFile};
use crate::loader::needed;
use crate::loader::plugin_file::PluginFile;
use crate::loader::sealed::Fingerprint;

/// Programs of an installation that take part in runs, next to the running one.
const PROGRAMS: [&str; 4] = ["panoscope", "panoscope-arm", "panoscope-machine", "panoscope-theatre"];

/// Name of ONNX Runtime in a lock.
const RUNTIME: &str = "onnxruntime";

/// A file that is code, or that says which code is used.
pub struct CodeFile {
    /// Its role and name in a lock.
    pub kind: Kind,
    /// Name in a lock; see [`LockedFile::name`].
    pub name: String,
    content: Content,
}

enum Content {
    Read(Fingerprint),
    OnDisk(Option<PathBuf>),
}

/// A file that a node reads.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DataFile {
    /// Its role.
    pub kind: Kind,
    /// Name in a lock; see [`LockedFile::name`].
    pub name: String,
    /// The file.
    pub path: PathBuf,
    /// For weights: the name by which the model refers to them.
    pub location: Option<String>,
}

impl DataFile {
    /// The file and, for a model, the files of its weights.
    pub(crate) fn with_weights(self) -> Vec<Self> {
        let names = if self.kind == Kind::Model { weights_of(&self.path) } else { Vec::new() };
        let weights: Vec<Self> = names
            .into_iter()
            .map(|location| Self {
                kind: Kind::Weights,
                name: format!("{}/{location}", self.name),
                path: self.path.parent().unwrap_or(Path::new("")).join(&location),
                location: Some(location),
            })
            .collect();
        std::iter::once(self).chain(weights).collect()
    }
}

/// Fingerprints of files on disk, computed on one thread per core; empty if a file cannot be read.
fn fingerprints(files: &[Option<&Path>]) -> Vec<Fingerprint> {
    let threads = std::thread::available_parallelism().map_or(1, usize::from).min(files.len().max(1));
    let mut all = vec![Fingerprint::default(); files.len()];
    let each = files.len().div_ceil(threads).max(1);
    std::thread::scope(|scope| {
        for (out, files) in all.chunks_mut(each).zip(files.chunks(each)) {
            scope.spawn(move || {
                for (out, file) in out.iter_mut().zip(files) {
                    *out = file.and_then(|file| Fingerprint::of_file(file).ok()).unwrap_or_default();
                }
            });
        }
    });
    all
}

/// The folder of the running program; for a cargo test, the folder of the build.
fn program_dir() -> Option<PathBuf> {
    let folder = panoscope_base::program::folder()?;
    if folder.ends_with("deps") { folder.parent().map(Path::to_owned) } else { Some(folder) }
}

/// The graph's files, those of the `found` plugins that it lists and of `extra_plugins`, the libraries that these need,
/// and the programs. Runs none of their code.
pub fn code<'a>(
    text: &GraphText,
    found: impl Iterator<Item = &'a PluginFile>,
    extra_plugins: &[&str],
) -> Vec<LockedFile> {
    let folder = text.path().parent().unwrap_or(Path::new(""));
    let mut files: Vec<CodeFile> = Vec::new();
    for file in text.files() {
        let kind = match file.kind {
            FileKind::Graph => Kind::Graph,
            FileKind::Part => Kind::Part,
            FileKind::Overlay => Kind::Overlay,
        };
        let path = Path::new(file.path);
        let name = path.strip_prefix(folder).unwrap_or(path).display().to_string();
        files.push(CodeFile { kind, name, content: Content::Read(Fingerprint::of(file.text.as_bytes())) });
    }
    let listed = text.plugins();
    let is_used = |name: &String| listed.contains(name) || extra_plugins.contains(&name.as_str());
    let plugins: Vec<_> = found.filter(|found| is_used(&found.note.name)).collect();
    for found in &plugins {
        let (name, content) = (found.note.name.clone(), Content::OnDisk(Some(found.file.clone())));
        files.push(CodeFile { kind: Kind::Plugin, name, content });
    }
    // A library that is not found here is one that only its user can find; the plugin does not load if nobody can.
    for (name, file) in needed::libraries(plugins.iter().map(|found| found.file.as_path())) {
        if file.is_some() {
            files.push(CodeFile { kind: Kind::Library, name, content: Content::OnDisk(file) });
        }
    }
    if let Some(folder) = program_dir() {
        for name in PROGRAMS {
            let file = folder.join(name);
            if file.is_file() {
                let content = Content::OnDisk(Some(file));
                files.push(CodeFile { kind: Kind::Program, name: name.to_owned(), content });
            }
        }
    }
    let on_disk: Vec<Option<&Path>> = files
        .iter()
        .map(|file| match &file.content {
            Content::Read(_) => None,
            Content::OnDisk(path) => path.as_deref(),
        })
        .collect();
    let fingerprints = fingerprints(&on_disk);
    let locked = |(file, on_disk): (CodeFile, Fingerprint)| {
        let Fingerprint { bytes, sha256 } = match file.content {
            Content::Read(fingerprint) => fingerprint,
            Content::OnDisk(_) => on_disk,
        };
        LockedFile { kind: file.kind, name: file.name, bytes, sha256 }
    };
    files.into_iter().zip(fingerprints).map(locked).collect()
}

/// Whether a parameter names a camera calibration.
fn calibrates(param: &Param) -> bool {
    param.name.contains("calibration")
}

fn is_model(file: &Path) -> bool {
    file.extension().is_some_and(|e| e.eq_ignore_ascii_case("onnx"))
}

/// Files that the value of a parameter names: one file, or the files of a list.
pub(crate) enum Named {
    /// The value is one path.
    One(PathBuf),
    /// The value is a text that lists paths, separated by semicolons.
    Listed(Vec<PathBuf>),
}

/// The files that a parameter reads. Locks, and runs under a lock, find a node's files only this way. A parameter is
/// declared as a file by its type (a path that the node does not write) or by the hint that it may name a file.
/// `folder` is that of the graph.
pub(crate) fn files_of(param: &Param, value: &ParamValue, folder: &Path) -> Option<Named> {
    match (&param.kind, value) {
        (ParamKind::Path { must_exist, .. }, ParamValue::Path(file)) if !param.writes => {
            let is_read = *must_exist || calibrates(param) || file.is_file();
            (is_read && !file.as_os_str().is_empty()).then(|| Named::One(file.clone()))
        }
        (_, ParamValue::Text(text)) if calibrates(param) => {
            let parts = text.split(';').map(str::trim).filter(|part| !part.is_empty());
            let files: Vec<PathBuf> = parts.map(|part| folder.join(part)).collect();
            (!files.is_empty()).then_some(Named::Listed(files))
        }
        // A source: what is not a regular file is a camera, an address, a folder or a pattern.
        (_, ParamValue::Text(text)) if param.pick == Pick::File => {
            let parts = text.split([';', '\n']).map(str::trim).filter(|part| !part.is_empty());
            let files: Vec<PathBuf> = parts.map(|part| folder.join(part)).filter(|file| file.is_file()).collect();
            (!files.is_empty()).then_some(Named::Listed(files))
        }
        _ => None,
    }
}

/// The role of a file that a parameter names.
pub(crate) fn kind_of(param: &Param, file: &Path) -> Kind {
    match &param.kind {
        _ if calibrates(param) => Kind::Calibration,
        ParamKind::Path { .. } if is_model(file) => Kind::Model,
        ParamKind::Path { .. } => Kind::File,
        _ => Kind::Input,
    }
}

/// The files that the nodes of a checked graph read, in the order of the nodes: models with the files of their weights,
/// calibrations, URDF, labels, recorded images; and ONNX Runtime if there is a model.
pub fn data(graph: &Graph, catalog: &Catalog, folder: &Path) -> Vec<DataFile> {
    let mut files = Vec::new();
    for node in &graph.nodes {
        for (param, value) in node.node_type(catalog).params.iter().zip(&node.params) {
            let named = match files_of(param, value, folder) {
                None => continue,
                Some(Named::One(file)) => vec![file],
                Some(Named::Listed(files)) => files,
            };
            for (k, path) in named.into_iter().enumerate() {
                let name = format!("{}.{}", node.id, param.name);
                let name = if k == 0 { name } else { format!("{name};{}", k + 1) };
                let kind = kind_of(param, &path);
                files.extend(DataFile { kind, name, path, location: None }.with_weights());
            }
        }
    }
    if files.iter().any(|file| file.kind == Kind::Model)
        && let Some(path) = runtime()
    {
        files.push(DataFile { kind: Kind::Runtime, name: RUNTIME.to_owned(), path, location: None });
    }
    files
}

/// Names of the files of a model's weights that are next to it. An unreadable model has none; its node reports why.
pub(crate) fn weights_of(model: &Path) -> Vec<String> {
    // A device or a pipe need not end.
    if !model.is_file() {
        return Vec::new();
    }
    let Ok(bytes) = std::fs::read(model) else { return Vec::new() };
    let mut names = onnx::weight_files(&bytes).unwrap_or_default();
    // Names that lead elsewhere are refused by the node that opens the model.
    names.retain(|name| Path::new(name).components().all(|part| matches!(part, Component::Normal(_))));
    names
}

/// ONNX Runtime's library as found by the nodes that use it.
fn runtime() -> Option<PathBuf> {
    let found = onnx::runtime_candidates().into_iter().find_map(|file| match file.components().count() {
        1 => needed::library(&file.display().to_string()),
        _ => file.is_file().then_some(file),
    })?;
    found.canonicalize().ok()
}

/// Fingerprints of files that nodes read, on disk.
pub fn locked(files: &[DataFile]) -> Vec<LockedFile> {
    let paths: Vec<Option<&Path>> = files.iter().map(|file| Some(file.path.as_path())).collect();
    let locked = |(file, Fingerprint { bytes, sha256 }): (&DataFile, Fingerprint)| LockedFile {
        kind: file.kind,
        name: file.name.clone(),
        bytes,
        sha256,
    };
    files.iter().zip(fingerprints(&paths)).map(locked).collect()
}

/// Fingerprints of the plugins in a lock, by plugin.
pub(crate) fn plugins_of(files: &[LockedFile]) -> BTreeMap<String, String> {
    let plugins = files.iter().filter(|file| file.kind == Kind::Plugin);
    plugins.map(|file| (file.name.clone(), file.sha256.clone())).collect()
}
