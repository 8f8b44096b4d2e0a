//! The state of a conflict between the window's text of a file and the file.

use std::path::PathBuf;

/// Set while a file and the window's text of it have both changed since the file was read or saved.
pub(super) struct Conflict {
    /// The file.
    pub(super) path: PathBuf,
    /// The current text of the file.
    pub(super) theirs: String,
    /// Whether a save was refused because it would have lost the file's text.
    pub(super) refused_save: bool,
}
