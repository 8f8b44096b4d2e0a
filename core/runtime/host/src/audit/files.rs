//! The files of a log, and the head file with the end of its chain.

use std::fs;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::audit::chain::End;

/// File with the end of the chain.
pub const HEAD: &str = "head.json";
/// Whether a file name, without a folder, is that of a file of a log.
pub fn is_log(name: &str) -> bool {
    name.starts_with("audit-") && name.ends_with(".jsonl") && !name.contains('/')
}

/// The files of a log in order.
pub fn files(folder: &Path) -> std::io::Result<Vec<PathBuf>> {
    let entries = match fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(error),
    };
    let mut files: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    files.retain(|file| {
        let name = file.file_name().unwrap_or_default().to_string_lossy();
        is_log(&name) && file.is_file()
    });
    files.sort();
    Ok(files)
}

/// The end of the chain in the head file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Head {
    /// Number of the last line.
    pub number: u64,
    /// Its hash.
    pub hash: String,
    /// Name of its file.
    pub file: String,
    /// Length of that file up to the end of the line, bytes.
    pub bytes: u64,
}

impl Head {
    pub fn end(&self) -> End {
        End { number: self.number, hash: self.hash.clone() }
    }

    /// The head of the log in `folder`; `None` if it is missing or damaged.
    pub fn read(folder: &Path) -> Option<Self> {
        let head: Self = serde_json::from_slice(&fs::read(folder.join(HEAD)).ok()?).ok()?;
        // A name that leads elsewhere would make the log go on in a file of somebody else.
        is_log(&head.file).then_some(head)
    }
}
