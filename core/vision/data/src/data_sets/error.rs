//! Errors of the search for sequences.

use std::path::PathBuf;

/// Maximum number of names in a message.
const LISTED: usize = 12;

/// A sequence that was not found.
#[derive(Debug, thiserror::Error)]
pub enum DataSetError {
    /// The folder does not exist.
    #[error("there is no folder {path}", path = path.display())]
    NoFolder {
        /// As given.
        path: PathBuf,
    },
    /// The folder cannot be read.
    #[error("the folder {path} cannot be read: {cause}", path = path.display())]
    Unreadable {
        /// The folder.
        path: PathBuf,
        /// The system's error.
        cause: std::io::Error,
    },
    /// No known layout.
    #[error(
        "{folder} has no data set of a known layout ({known}){remarks}; `panoscope import {folder}` lists the searched files",
        folder = folder.display(),
        remarks = in_words(remarks)
    )]
    Nothing {
        /// The folder.
        folder: PathBuf,
        /// Names of the known layouts.
        known: String,
        /// Obstacles found in the folder.
        remarks: Vec<String>,
    },
    /// No sequence of that name.
    #[error("{folder} has no sequence `{name}`: it has {names}", folder = folder.display(), names = listed(names))]
    NoSequence {
        /// The folder.
        folder: PathBuf,
        /// The requested name.
        name: String,
        /// The existing names.
        names: Vec<String>,
    },
}

fn in_words(remarks: &[String]) -> String {
    if remarks.is_empty() { String::new() } else { format!("; {}", remarks.join("; ")) }
}

fn listed(names: &[String]) -> String {
    let mut text = names.iter().take(LISTED).map(String::as_str).collect::<Vec<_>>().join(", ");
    if names.len() > LISTED {
        text.push_str(&format!(" and {} more", names.len() - LISTED));
    }
    text
}
