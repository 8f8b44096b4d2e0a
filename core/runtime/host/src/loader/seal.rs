//! The files that the nodes of a graph under its lock may read.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use panoscope_base::onnx;
use panoscope_graph::{Catalog, Graph, ParamValue, tidy};

use crate::loader::depends::{self, DataFile, Named};
use crate::loader::lock::Lock;
use crate::loader::locked_file::{Kind, LockedFile};
use crate::loader::sealed::{self, Fingerprint, SealedWriter};

/// A graph would read a file that is not in its lock or differs from it.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{param}` of `{node}` names {file}, which {reason}", file = file.display())]
pub struct NotLocked {
    /// The node.
    pub node: String,
    /// The parameter.
    pub param: String,
    /// The file.
    pub file: PathBuf,
    /// Continuation of a sentence about the file: why it is not read and what to do.
    pub reason: &'static str,
}

/// The files that the nodes of a verified graph may read, each an immutable copy in memory.
#[derive(Debug, Default)]
pub struct Seal {
    files: Mutex<SealedFiles>,
    folder: PathBuf,
}

#[derive(Debug, Default)]
struct SealedFiles {
    /// Paths of the copies by the files they were made of, under each of [`names_of`].
    copies: BTreeMap<PathBuf, PathBuf>,
    /// Files that were compared and are read from disk: recorded images, which may be larger than the memory.
    inputs: BTreeSet<PathBuf>,
    /// Files that differed from the lock; they are compared again when a graph reads them.
    withheld: Vec<DataFile>,
    /// Files of the lock, if some are withheld.
    locked: Vec<LockedFile>,
}

impl Seal {
    /// Copies files into sealed memory. Returns the fingerprints of the copies in the same order, empty for an
    /// unreadable file; and the copy of ONNX Runtime, if it is among them.
    pub fn of(files: &[DataFile], folder: &Path) -> (Self, Vec<LockedFile>, Option<PathBuf>) {
        let mut seal = SealedFiles::default();
        let (mut locked, mut runtime) = (Vec::with_capacity(files.len()), None);
        let mut at = 0;
        while let Some(file) = files.get(at) {
            let weights = files[at + 1..].iter().take_while(|next| next.kind == Kind::Weights).count();
            let group = &files[at..=at + weights];
            at += group.len();
            if file.kind == Kind::Input {
                let fingerprint = Fingerprint::of_file(&file.path).unwrap_or_default();
                seal.inputs.extend(names_of(&file.path));
                locked.push((file, fingerprint));
                continue;
            }
            match copy(group) {
                Ok((path, fingerprints)) => {
                    if file.kind == Kind::Runtime {
                        runtime = Some(path);
                    } else {
                        seal.copies.extend(names_of(&file.path).map(|name| (name, path.clone())));
                    }
                    locked.extend(group.iter().zip(fingerprints));
                }
                Err(_) => locked.extend(group.iter().map(|file| (file, Fingerprint::default()))),
            }
        }
        let locked = locked.into_iter().map(|(file, Fingerprint { bytes, sha256 })| LockedFile {
            kind: file.kind,
            name: file.name.clone(),
            bytes,
            sha256,
        });
        (Self { files: Mutex::new(seal), folder: folder.to_owned() }, locked.collect(), runtime)
    }

    /// Withholds the files that differ from the lock; `now` has the fingerprints of `files`.
    pub(super) fn withhold(&mut self, files: &[DataFile], now: &[LockedFile], lock: &Lock) {
        let sealed = self.files.get_mut().unwrap_or_else(PoisonError::into_inner);
        let differs = |name: &str| {
            let of_file = now.iter().filter(|file| file.name == name || file.name.starts_with(&format!("{name}/")));
            of_file.into_iter().any(|file| file.sha256.is_empty() || !lock.files.contains(file))
        };
        for file in files.iter().filter(|file| file.kind != Kind::Weights && differs(&file.name)) {
            for name in names_of(&file.path) {
                sealed.copies.remove(&name);
                sealed.inputs.remove(&name);
            }
            sealed.withheld.push(file.clone());
        }
        sealed.locked.clone_from(&lock.files);
    }

    /// Makes the nodes of a graph read the sealed copies of their files.
    ///
    /// # Errors
    /// A parameter names a file that was not compared with the lock or differs from it; the graph must then not be
    /// used.
    pub fn apply(&self, graph: &mut Graph, catalog: &Catalog) -> Result<(), NotLocked> {
        let mut files = self.files.lock().unwrap_or_else(PoisonError::into_inner);
        files.compare_withheld(&self.folder);
        files.apply(graph, catalog, &self.folder)
    }
}

impl SealedFiles {
    /// Seals withheld files that match the lock by now.
    fn compare_withheld(&mut self, folder: &Path) {
        for file in std::mem::take(&mut self.withheld) {
            let group = file.clone().with_weights();
            let (seal, now, _) = Seal::of(&group, folder);
            if now.iter().all(|file| !file.sha256.is_empty() && self.locked.contains(file)) {
                let seal = seal.files.into_inner().unwrap_or_else(PoisonError::into_inner);
                self.copies.extend(seal.copies);
                self.inputs.extend(seal.inputs);
            } else {
                self.withheld.push(file);
            }
        }
    }

    /// Path that a node reads for a file: its copy, or the file itself if it was only compared or is already a copy.
    fn path_for(&self, file: &Path) -> Option<PathBuf> {
        if let Some(copy) = names_of(file).find_map(|name| self.copies.get(&name).cloned()) {
            return Some(copy);
        }
        let is_compared = names_of(file).any(|name| self.inputs.contains(&name));
        let is_copy = self.copies.values().any(|copy| copy == file);
        (is_compared || is_copy).then(|| file.to_owned())
    }

    fn apply(&self, graph: &mut Graph, catalog: &Catalog, folder: &Path) -> Result<(), NotLocked> {
        for node in &mut graph.nodes {
            let node_type = &catalog.node_types[node.type_index];
            for (param, value) in node_type.params.iter().zip(&mut node.params) {
                // First, because the file itself may be gone by now.
                if let ParamValue::Path(file) = value
                    && !param.writes
                    && let Some(copy) = self.path_for(file)
                {
                    *value = ParamValue::Path(copy);
                    continue;
                }
                let not_locked = |file: &PathBuf| NotLocked {
                    node: node.id.clone(),
                    param: param.name.clone(),
                    file: file.clone(),
                    reason: match self.withheld.iter().any(|withheld| names_of(&withheld.path).eq(names_of(file))) {
                        true => "is not as it was locked; restore it, or lock the graph again with it",
                        false => "the lock of the graph does not have; lock the graph again with it",
                    },
                };
                match depends::files_of(param, value, folder) {
                    None => {}
                    Some(Named::One(file)) => return Err(not_locked(&file)),
                    Some(Named::Listed(files)) => {
                        let copies = files.iter().map(|file| self.path_for(file).ok_or_else(|| not_locked(file)));
                        let copies = copies.collect::<Result<Vec<PathBuf>, NotLocked>>()?;
                        // A source keeps its text: it is more than a list of files.
                        if copies != files {
                            let texts: Vec<String> = copies.iter().map(|path| path.display().to_string()).collect();
                            *value = ParamValue::Text(texts.join(";"));
                        }
                    }
                }
            }
        }
        Ok(())
    }
}

/// The names under which a file is known: absolute without `.` and `..`, and with links followed. The first also finds
/// the copy of a file that was removed or replaced since.
fn names_of(file: &Path) -> impl Iterator<Item = PathBuf> {
    let plain = tidy(file);
    let real = file.canonicalize().ok().filter(|real| *real != plain);
    std::iter::once(plain).chain(real)
}

/// Copies a file, or a model with the files of its weights, into sealed memory; returns the copy's path and the
/// fingerprint of each file.
fn copy(group: &[DataFile]) -> std::io::Result<(PathBuf, Vec<Fingerprint>)> {
    let mut writer = SealedWriter::new(&group[0].path)?;
    let mut fingerprints = vec![writer.append_file(&group[0].path)?];
    for weights in &group[1..] {
        let mut file = std::fs::File::open(&weights.path)?;
        let len = file.metadata()?.len();
        writer.append(&onnx::bundle_header(weights.location.as_deref().unwrap_or_default(), len))?;
        let fingerprint = writer.append_from(&mut file)?;
        if fingerprint.bytes != len {
            return Err(std::io::Error::other(format!("{} changed while it was read", weights.path.display())));
        }
        fingerprints.push(fingerprint);
    }
    let names = group.iter().map(|file| file.location.as_deref().unwrap_or_default());
    let contents: Vec<String> = names.zip(&fingerprints).map(|(name, f)| format!("{name}\0{}", f.sha256)).collect();
    Ok((sealed::keep(contents.join("\0"), writer.seal()?, &group[0].path), fingerprints))
}
