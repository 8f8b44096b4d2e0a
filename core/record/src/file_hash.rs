//! Fingerprints of the files that a run depends on.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::digest::file_hash;

/// A plugin's or model's file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileHash {
    /// Plugin, or `node.param` of a model.
    pub name: String,
    /// Where it lay.
    pub file: String,
    /// Its length.
    pub bytes: u64,
    /// XXH3 with 128 bits, as hexadecimal digits.
    pub xxh3: String,
}

/// The fingerprint of a file; an unreadable file has an empty one.
pub(crate) fn hash(name: &str, file: &Path) -> FileHash {
    let (xxh3, bytes) = file_hash(file).unwrap_or_default();
    FileHash { name: name.to_owned(), file: file.display().to_string(), bytes, xxh3 }
}

/// Hashes of plugins' files, given by name.
pub(crate) fn hashes(files: &[(String, PathBuf)]) -> Vec<FileHash> {
    files.iter().map(|(name, file)| hash(name, file)).collect()
}
