//! Detects changes of files.

use std::path::Path;

/// Identifies a version of a file by modification time, length and inode; all zero when the file does not exist.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stamp(u128, u64, u64);

impl Stamp {
    /// The stamp of the file as it is now.
    pub fn of(file: &Path) -> Self {
        use std::os::unix::fs::MetadataExt;
        let Ok(meta) = std::fs::metadata(file) else { return Self::default() };
        let time = meta.modified().ok().and_then(|t| t.duration_since(std::time::UNIX_EPOCH).ok());
        Self(time.map_or(0, |t| t.as_nanos()), meta.len(), meta.ino())
    }
}
