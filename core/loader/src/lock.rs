//! Locks a graph: writes SHA-256 fingerprints of all files that its run depends on, and compares them before it starts.

use std::fmt;
use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

use panoscope_graph::{Catalog, FileKind, Graph, GraphFile, GraphText, ParamKind, ParamValue};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::search::Loader;

/// Plugins that a lock covers besides those of the graph: the theatre writes clips with them.
pub const ALWAYS_LOCKED: [&str; 1] = ["sinks"];

/// Version of the lock file's layout.
const VERSION: u32 = 1;

/// Why a lock was not written or read.
#[derive(Debug, thiserror::Error)]
pub enum LockError {
    /// A file could not be read or written.
    #[error("{file}: {cause}", file = file.display())]
    File {
        /// The file.
        file: PathBuf,
        /// The operating system's error.
        cause: std::io::Error,
    },
    /// The lock file is damaged.
    #[error("{file} is not a valid lock file ({reason}); write it again with `panoscope lock`", file = file.display())]
    Damaged {
        /// The lock file.
        file: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
}

/// The role of a file in a graph.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// The graph file itself.
    Graph,
    /// A part of the graph.
    Part,
    /// An overlay.
    Overlay,
    /// A plugin.
    Plugin,
    /// A file that a parameter names and that must exist, such as a neural network.
    Model,
    /// A calibration file of a camera.
    Calibration,
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Graph => "graph",
            Self::Part => "part",
            Self::Overlay => "overlay",
            Self::Plugin => "plugin",
            Self::Model => "model",
            Self::Calibration => "calibration",
        })
    }
}

/// A file's name and fingerprint.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LockedFile {
    /// Its role.
    pub kind: Kind,
    /// Name of the plugin or of the graph file; `node.param` for a model or calibration.
    pub name: String,
    /// Length in bytes.
    pub bytes: u64,
    /// SHA-256 as hexadecimal digits; empty when the file cannot be read.
    pub sha256: String,
}

/// Fingerprints of all files that a graph's run depends on.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Lock {
    /// Version of the file's layout.
    version: u32,
    /// Version of the program that wrote it.
    pub program: String,
    /// The files: the graph first, then plugins, then models and calibrations in the order of the nodes.
    #[serde(rename = "file")]
    pub files: Vec<LockedFile>,
}

/// One difference between a lock and the files now.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Difference {
    /// Role of the file.
    pub kind: Kind,
    /// Name of the file, as in [`LockedFile::name`].
    pub name: String,
    /// What changed.
    pub change: Change,
}

/// How a file differs from the lock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    /// Its contents differ.
    Changed,
    /// It was locked and is no longer used or no longer exists.
    Missing,
    /// It is used and was not locked.
    Added,
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let change = match self.change {
            Change::Changed => "has changed since the graph was locked",
            Change::Missing => "was locked and is missing now",
            Change::Added => "is used now and was not locked",
        };
        write!(f, "{} `{}` {change}", self.kind, self.name)
    }
}

/// The lock file of a graph file: its name with `.lock` appended.
pub fn lock_path(graph: &Path) -> PathBuf {
    let mut name = graph.as_os_str().to_owned();
    name.push(".lock");
    name.into()
}

fn hex(digest: &[u8]) -> String {
    digest.iter().map(|b| format!("{b:02x}")).collect()
}

fn fingerprint(file: &Path) -> std::io::Result<(u64, String)> {
    let (mut file, mut hash, mut buffer, mut bytes) = (File::open(file)?, Sha256::new(), vec![0; 1 << 16], 0);
    loop {
        match file.read(&mut buffer)? {
            0 => return Ok((bytes, hex(&hash.finalize()))),
            n => {
                hash.update(&buffer[..n]);
                bytes += n as u64;
            }
        }
    }
}

fn locked(kind: Kind, name: String, file: &Path) -> LockedFile {
    let (bytes, sha256) = fingerprint(file).unwrap_or_default();
    LockedFile { kind, name, bytes, sha256 }
}

/// The calibration files that a text names, separated by semicolons.
fn calibration_files<'t>(text: &'t str, folder: &'t Path) -> impl Iterator<Item = PathBuf> + 't {
    text.split(';').map(str::trim).filter(|part| !part.is_empty()).map(move |part| folder.join(part))
}

impl Lock {
    /// Fingerprints of a graph that was read as `text`, as all is now. `extra_plugins` are used besides those that the graph lists.
    pub fn of(graph: &Graph, catalog: &Catalog, loader: &Loader, text: &GraphText, extra_plugins: &[&str]) -> Self {
        let folder = text.path().parent().unwrap_or(Path::new(""));
        let graph_file = |file: GraphFile<'_>| {
            let kind = match file.kind {
                FileKind::Graph => Kind::Graph,
                FileKind::Part => Kind::Part,
                FileKind::Overlay => Kind::Overlay,
            };
            let path = Path::new(file.path);
            let name = path.strip_prefix(folder).unwrap_or(path).display().to_string();
            let sha256 = hex(&Sha256::digest(file.text.as_bytes()));
            LockedFile { kind, name, bytes: file.text.len() as u64, sha256 }
        };
        let mut files: Vec<LockedFile> = text.files().into_iter().map(graph_file).collect();
        let used = |name: &String| graph.plugins.contains(name) || extra_plugins.contains(&name.as_str());
        let plugins = loader.found().filter(|found| used(&found.note.name));
        files.extend(plugins.map(|found| locked(Kind::Plugin, found.note.name.clone(), &found.file)));
        for node in &graph.nodes {
            for (param, value) in node.node_type(catalog).params.iter().zip(&node.params) {
                let name = format!("{}.{}", node.id, param.name);
                let calibrates = param.name.contains("calibration");
                match (&param.kind, value) {
                    (ParamKind::Path { must_exist, .. }, ParamValue::Path(file))
                        if (*must_exist || calibrates) && !file.as_os_str().is_empty() =>
                    {
                        let kind = if calibrates { Kind::Calibration } else { Kind::Model };
                        files.push(locked(kind, name, file));
                    }
                    (_, ParamValue::Text(text)) if calibrates => {
                        let each = calibration_files(text, folder).enumerate();
                        files.extend(each.map(|(k, file)| {
                            let name = if k == 0 { name.clone() } else { format!("{name};{}", k + 1) };
                            locked(Kind::Calibration, name, &file)
                        }));
                    }
                    _ => {}
                }
            }
        }
        Self { version: VERSION, program: env!("CARGO_PKG_VERSION").to_owned(), files }
    }

    /// Reads the lock of the graph file `graph`; `None` when it was never locked.
    ///
    /// # Errors
    /// The lock cannot be read, or is damaged.
    pub fn read(graph: &Path) -> Result<Option<Self>, LockError> {
        let file = lock_path(graph);
        let text = match std::fs::read_to_string(&file) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(cause) => return Err(LockError::File { file, cause }),
        };
        let damaged = |reason: String| LockError::Damaged { file: file.clone(), reason };
        let lock: Self = toml::from_str(&text).map_err(|e| damaged(e.message().to_owned()))?;
        if lock.version != VERSION {
            return Err(damaged(format!("its layout is version {}, known is {VERSION}", lock.version)));
        }
        Ok(Some(lock))
    }

    /// Writes the lock beside the graph file, completely or not at all, and returns its path.
    ///
    /// # Errors
    /// The file cannot be written; an older one is unchanged.
    pub fn write(&self, graph: &Path) -> Result<PathBuf, LockError> {
        let file = lock_path(graph);
        let fail = |cause| LockError::File { file: file.clone(), cause };
        let text = toml::to_string(self).map_err(|e| fail(std::io::Error::other(e)))?;
        let name = graph.file_name().unwrap_or_default().to_string_lossy();
        let text = format!("# Written by `panoscope lock {name}`; the theatre compares it before it starts.\n{text}");
        let part = file.with_extension(format!("lock.{}.part", std::process::id()));
        let written = (|| {
            let mut out = File::create(&part)?;
            out.write_all(text.as_bytes())?;
            out.sync_all()?;
            std::fs::rename(&part, &file)
        })();
        if let Err(cause) = written {
            let _ = std::fs::remove_file(&part);
            return Err(fail(cause));
        }
        Ok(file)
    }

    /// The differences between this lock and `now`.
    pub fn differences(&self, now: &Self) -> Vec<Difference> {
        let find = |list: &'_ [LockedFile], file: &LockedFile| {
            list.iter().find(|f| (f.kind, &f.name) == (file.kind, &file.name)).cloned()
        };
        let mut found = Vec::new();
        for file in &self.files {
            let change = match find(&now.files, file) {
                None => Change::Missing,
                Some(other) if other == *file => continue,
                Some(other) if other.sha256.is_empty() => Change::Missing,
                Some(_) => Change::Changed,
            };
            found.push(Difference { kind: file.kind, name: file.name.clone(), change });
        }
        let new = now.files.iter().filter(|file| find(&self.files, file).is_none());
        found.extend(new.map(|file| Difference { kind: file.kind, name: file.name.clone(), change: Change::Added }));
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lock(files: &[(Kind, &str, &str)]) -> Lock {
        let file = |(kind, name, sha256): &(Kind, &str, &str)| LockedFile {
            kind: *kind,
            name: (*name).to_owned(),
            bytes: 3,
            sha256: (*sha256).to_owned(),
        };
        Lock { version: VERSION, program: "1".to_owned(), files: files.iter().map(file).collect() }
    }

    #[test]
    fn every_difference_is_named() {
        use Kind::*;
        let was = lock(&[(Graph, "g.toml", "a"), (Plugin, "stitch", "b"), (Model, "net.model", "c")]);
        let now =
            lock(&[(Graph, "g.toml", "x"), (Plugin, "stitch", "b"), (Model, "net.model", ""), (Plugin, "new", "d")]);
        let messages: Vec<String> = was.differences(&now).iter().map(ToString::to_string).collect();
        assert_eq!(
            messages,
            [
                "graph `g.toml` has changed since the graph was locked",
                "model `net.model` was locked and is missing now",
                "plugin `new` is used now and was not locked"
            ]
        );
        assert!(was.differences(&was).is_empty());
    }

    #[test]
    fn a_lock_is_read_back_and_a_damaged_one_is_an_error() {
        let folder = std::env::temp_dir().join(format!("panoscope_lock_{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let graph = folder.join("g.toml");
        assert_eq!(Lock::read(&graph).unwrap(), None);
        let written = lock(&[(Kind::Graph, "g.toml", "a"), (Kind::Calibration, "scope.calibration;2", "b")]);
        let file = written.write(&graph).unwrap();
        assert_eq!(Lock::read(&graph).unwrap(), Some(written));
        std::fs::write(&file, "version = 1\n[[file]]\nkind = ").unwrap();
        assert!(matches!(Lock::read(&graph), Err(LockError::Damaged { .. })));
        std::fs::write(&file, "version = 7\nprogram = \"1\"\nfile = []\n").unwrap();
        assert!(Lock::read(&graph).unwrap_err().to_string().contains("version 7"));
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_fingerprint_is_sha256() {
        let file = std::env::temp_dir().join(format!("panoscope_sha_{}", std::process::id()));
        std::fs::write(&file, "abc").unwrap();
        let (bytes, sha256) = fingerprint(&file).unwrap();
        assert_eq!(bytes, 3);
        assert_eq!(sha256, "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
        std::fs::remove_file(file).unwrap();
        assert_eq!(calibration_files("a.yml; b.yml;", Path::new("f")).count(), 2);
    }
}
