//! Locks a graph: writes SHA-256 fingerprints of all files that its run depends on, optionally signed, and compares
//! them.

use std::fmt;
use std::path::{Path, PathBuf};

use panoscope_base::files;
use panoscope_graph::{Catalog, Graph, GraphText};
use serde::{Deserialize, Serialize};

use crate::loader::depends;
use crate::loader::keys::{SecretKey, Trust};
use crate::loader::locked_file::{Kind, LockedFile};
use crate::loader::search::Loader;

/// Plugins that a lock covers in addition to those of the graph, because the theatre writes clips with them.
pub const ALWAYS_LOCKED: [&str; 1] = ["sinks"];

/// Version of the lock file's layout.
const VERSION: u32 = 2;

/// Prefix of the signed bytes, so that a signature of other data is not valid for a lock.
const SIGNED_AS: &[u8] = b"panoscope lock 2\n";

/// A text that is not a lock.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LockTextError {
    /// It is not TOML, or lacks a key.
    #[error("{message}")]
    Toml {
        /// The parser's message.
        message: String,
    },
    /// It has another layout.
    #[error("its layout has version {version}, but this program reads version {VERSION}")]
    Version {
        /// The version that it states.
        version: u32,
    },
}

/// A lock that was not written, read or accepted.
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
        /// Description of the problem.
        reason: String,
    },
    /// A required lock is missing.
    #[error("{graph} is not locked: {file} does not exist; write it with `panoscope lock`", graph = graph.display(), file = file.display())]
    Never {
        /// The graph file.
        graph: PathBuf,
        /// The lock file.
        file: PathBuf,
    },
    /// The installation trusts keys, and the lock has no signature.
    #[error("{file} is not signed, and this installation accepts only locks that a trusted key signed; sign it with `panoscope lock --key FILE`", file = file.display())]
    Unsigned {
        /// The lock file.
        file: PathBuf,
    },
    /// The key of the signature is not trusted.
    #[error("{file} is signed with the key {key}, which this installation does not trust; to trust it, put its public key into {folder} or name it with --trust FILE", file = file.display())]
    UnknownKey {
        /// The lock file.
        file: PathBuf,
        /// The first digits of the public key.
        key: String,
        /// A folder of trusted keys.
        folder: String,
    },
    /// The lock does not match its signature.
    #[error("{file} was altered after it was signed with the key {key}; restore it, or lock the graph again", file = file.display())]
    Altered {
        /// The lock file.
        file: PathBuf,
        /// The first digits of the public key.
        key: String,
    },
}

/// Signature of a lock.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Signature {
    /// The public key, as hexadecimal digits.
    key: String,
    /// The Ed25519 signature, as hexadecimal digits.
    ed25519: String,
}

/// Fingerprints of all files that a graph's run depends on.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Lock {
    /// Version of the file's layout.
    version: u32,
    /// Version of the program that wrote it.
    pub program: String,
    /// The files: the graph first, then code, then what nodes read in the order of the nodes.
    #[serde(rename = "file")]
    pub files: Vec<LockedFile>,
    #[serde(skip_serializing_if = "Option::is_none")]
    signature: Option<Signature>,
}

/// One difference between a lock and the files now.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Difference {
    /// Role of the file.
    pub kind: Kind,
    /// Name of the file, as in [`LockedFile::name`].
    pub name: String,
    /// Description of the change.
    pub change: Change,
}

/// Difference of a file from the lock.
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

impl Lock {
    /// The current fingerprints of a graph that was read as `text`. `extra_plugins` are included in addition to those
    /// that the graph lists.
    pub fn of(graph: &Graph, catalog: &Catalog, loader: &Loader, text: &GraphText, extra_plugins: &[&str]) -> Self {
        let folder = text.path().parent().unwrap_or(Path::new(""));
        let mut files = depends::code(text, loader.found(), extra_plugins);
        files.extend(depends::locked(&depends::data(graph, catalog, folder)));
        Self { version: VERSION, program: env!("CARGO_PKG_VERSION").to_owned(), files, signature: None }
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
        Self::parse(&text).map(Some).map_err(|error| LockError::Damaged { file, reason: error.to_string() })
    }

    /// A lock from the text of its file.
    ///
    /// # Errors
    /// The text is not a lock of this version.
    pub fn parse(text: &str) -> Result<Self, LockTextError> {
        #[derive(Deserialize)]
        struct Head {
            version: u32,
        }
        // Another layout may lack what this one has, so its number is read first.
        let head: Head =
            toml::from_str(text).map_err(|error| LockTextError::Toml { message: error.message().to_owned() })?;
        if head.version != VERSION {
            return Err(LockTextError::Version { version: head.version });
        }
        toml::from_str(text).map_err(|error| LockTextError::Toml { message: error.message().to_owned() })
    }

    /// Bytes that a signature covers: everything but itself, with the lengths of all texts, so that different locks
    /// have different bytes.
    fn message(&self) -> Vec<u8> {
        let mut out = SIGNED_AS.to_vec();
        let mut push = |text: &str| {
            out.extend_from_slice(&(text.len() as u64).to_le_bytes());
            out.extend_from_slice(text.as_bytes());
        };
        push(&self.program);
        for file in &self.files {
            push(file.kind.word());
            push(&file.name);
            push(&file.bytes.to_string());
            push(&file.sha256);
        }
        out
    }

    /// Signs the lock and replaces an older signature.
    pub fn sign(&mut self, key: &SecretKey) {
        let ed25519 = key.sign(&self.message());
        self.signature = Some(Signature { key: key.public().hex(), ed25519 });
    }

    /// Whether the lock of the graph file `graph` is acceptable: signed by a trusted key, or unsigned while no key is
    /// trusted here. Returns the name of the key.
    ///
    /// # Errors
    /// [`LockError::Unsigned`], [`LockError::UnknownKey`] or [`LockError::Altered`].
    pub fn check_signature(&self, graph: &Path, trust: &Trust) -> Result<Option<String>, LockError> {
        let file = lock_path(graph);
        let Some(signature) = &self.signature else {
            return if trust.is_empty() { Ok(None) } else { Err(LockError::Unsigned { file }) };
        };
        let short = signature.key.chars().take(16).collect::<String>();
        let Some(key) = trust.find(&signature.key) else {
            return Err(LockError::UnknownKey { file, key: short, folder: Trust::folder_to_use() });
        };
        match key.verifies(&self.message(), &signature.ed25519) {
            true => Ok(Some(key.name().to_owned())),
            false => Err(LockError::Altered { file, key: short }),
        }
    }

    /// Writes the lock next to the graph file, completely or not at all, and returns its path.
    ///
    /// # Errors
    /// The file cannot be written; an older one is unchanged.
    pub fn write(&self, graph: &Path) -> Result<PathBuf, LockError> {
        let file = lock_path(graph);
        let fail = |cause| LockError::File { file: file.clone(), cause };
        let text = toml::to_string(self).map_err(|e| fail(std::io::Error::other(e)))?;
        let name = graph.file_name().unwrap_or_default().to_string_lossy();
        let text = format!("# Written by `panoscope lock {name}`; the theatre compares it before it starts.\n{text}");
        files::replace(&file, text.as_bytes()).map_err(fail)?;
        Ok(file)
    }

    /// SHA-256 of the lock's content, as hexadecimal digits, for logs.
    pub fn digest(&self) -> String {
        crate::loader::sealed::Fingerprint::of(&self.message()).sha256
    }

    /// The differences between this lock and `now`.
    pub fn differences(&self, now: &Self) -> Vec<Difference> {
        self.differences_among(&now.files, |_| true)
    }

    /// The differences between the files of this lock whose role `is_among` accepts, and `now`, which has all files of
    /// these roles.
    pub(crate) fn differences_among(&self, now: &[LockedFile], is_among: impl Fn(Kind) -> bool) -> Vec<Difference> {
        let find = |list: &'_ [LockedFile], file: &LockedFile| {
            list.iter().find(|f| (f.kind, &f.name) == (file.kind, &file.name)).cloned()
        };
        let mut found = Vec::new();
        for file in self.files.iter().filter(|file| is_among(file.kind)) {
            let change = match find(now, file) {
                None => Change::Missing,
                Some(other) if other == *file && !other.sha256.is_empty() => continue,
                Some(other) if other.sha256.is_empty() => Change::Missing,
                Some(_) => Change::Changed,
            };
            found.push(Difference { kind: file.kind, name: file.name.clone(), change });
        }
        let new = now.iter().filter(|file| find(&self.files, file).is_none());
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
        let files = files.iter().map(file).collect();
        Lock { version: VERSION, program: "1".to_owned(), files, signature: None }
    }

    fn folder(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("panoscope_lock_{name}_{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir_all(&folder).unwrap();
        folder
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
        let folder = folder("read");
        let graph = folder.join("g.toml");
        assert_eq!(Lock::read(&graph).unwrap(), None);
        let written = lock(&[(Kind::Graph, "g.toml", "a"), (Kind::Calibration, "scope.calibration;2", "b")]);
        let file = written.write(&graph).unwrap();
        assert_eq!(Lock::read(&graph).unwrap(), Some(written));
        std::fs::write(&file, "version = 2\n[[file]]\nkind = ").unwrap();
        assert!(matches!(Lock::read(&graph), Err(LockError::Damaged { .. })));
        std::fs::write(&file, "version = 7\nprogram = \"1\"\nfile = []\n").unwrap();
        assert!(Lock::read(&graph).unwrap_err().to_string().contains("version 7"));
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_signature_names_its_key_and_every_alteration_is_found() {
        let folder = folder("sign");
        let graph = folder.join("g.toml");
        let public = SecretKey::create(&folder.join("ward")).unwrap();
        let secret = SecretKey::read(&folder.join("ward")).unwrap();
        let mut signed = lock(&[(Kind::Graph, "g.toml", "a"), (Kind::Plugin, "stitch", "b")]);
        let (nobody, mut trust) = (Trust::default(), Trust::default());
        trust.add(public);
        // Without a signature.
        assert_eq!(signed.check_signature(&graph, &nobody).unwrap(), None);
        assert!(matches!(signed.check_signature(&graph, &trust), Err(LockError::Unsigned { .. })));
        // With one, read back from its file.
        signed.sign(&secret);
        signed.write(&graph).unwrap();
        let read = Lock::read(&graph).unwrap().unwrap();
        assert_eq!(read.check_signature(&graph, &trust).unwrap().as_deref(), Some("ward"));
        let unknown = read.check_signature(&graph, &nobody).unwrap_err();
        assert!(
            matches!(unknown, LockError::UnknownKey { .. }) && unknown.to_string().contains("--trust"),
            "{unknown}"
        );
        // Any change of the content.
        let alterations: [fn(&mut Lock); 6] = [
            |lock| lock.files[0].sha256 = "x".to_owned(),
            |lock| lock.files[1].name = "other".to_owned(),
            |lock| lock.files[1].kind = Kind::Model,
            |lock| lock.files[0].bytes = 4,
            |lock| lock.program = "2".to_owned(),
            |lock| _ = lock.files.pop(),
        ];
        for alter in alterations {
            let mut altered = read.clone();
            alter(&mut altered);
            assert!(matches!(altered.check_signature(&graph, &trust), Err(LockError::Altered { .. })), "{altered:?}");
        }
        // The signature itself.
        let mut altered = read;
        altered.signature.as_mut().unwrap().ed25519 = "00".repeat(64);
        assert!(matches!(altered.check_signature(&graph, &trust), Err(LockError::Altered { .. })));
        altered.signature.as_mut().unwrap().ed25519 = "no digits".to_owned();
        assert!(matches!(altered.check_signature(&graph, &trust), Err(LockError::Altered { .. })));
        std::fs::remove_dir_all(folder).unwrap();
    }
}
