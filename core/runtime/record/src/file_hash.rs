//! Hashes of the files that a run depends on.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::digest::file_hash;

/// The hash of a plugin's or model's file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileHash {
    /// Name of the plugin, or `node.param` of a model.
    pub name: String,
    /// Path when the run was recorded.
    pub file: String,
    /// Length of the file.
    pub bytes: u64,
    /// XXH3 with 128 bits, as hexadecimal digits.
    pub xxh3: String,
}

/// The hash of a file; empty when the file cannot be read.
pub fn hash(name: &str, file: &Path) -> FileHash {
    let (xxh3, bytes) = file_hash(file).unwrap_or_default();
    FileHash { name: name.to_owned(), file: file.display().to_string(), bytes, xxh3 }
}

/// Hashes of plugins' files, given by name.
pub(crate) fn hashes(files: &[(String, PathBuf)]) -> Vec<FileHash> {
    files.iter().map(|(name, file)| hash(name, file)).collect()
}
