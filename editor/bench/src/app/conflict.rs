//! The state of a conflict between the window's graph and the file.

/// Set while the file and the window's graph have both changed since the file was read or saved.
pub(super) struct Conflict {
    /// The current text of the file.
    pub(super) theirs: String,
    /// Whether a save was refused because it would have lost the file's text.
    pub(super) refused_save: bool,
}
