//! What is wrong with a calibration file, and where.

use std::path::{Path, PathBuf};

use thiserror::Error;

/// Why a calibration file cannot be used. Lines and columns count from 1; 0 means the file as a whole.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("{}: {what}", place(.file, *.line, *.column))]
pub struct FileError {
    /// File that the mistake is in.
    pub file: PathBuf,
    /// Line of the mistake.
    pub line: usize,
    /// Column of the mistake.
    pub column: usize,
    /// What is wrong there, and how to fix it where that is known.
    pub what: String,
}

fn place(file: &Path, line: usize, column: usize) -> String {
    if line == 0 { file.display().to_string() } else { format!("{}:{line}:{column}", file.display()) }
}

/// A mistake before the name of its file is known.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Mistake {
    pub line: usize,
    pub column: usize,
    pub what: String,
}

impl Mistake {
    pub fn whole(what: impl Into<String>) -> Self {
        Self { line: 0, column: 0, what: what.into() }
    }

    pub fn in_file(self, file: &Path) -> FileError {
        FileError { file: file.to_owned(), line: self.line, column: self.column, what: self.what }
    }
}
