//! A folder for what a bench plays or writes.

use std::path::PathBuf;

use anyhow::{Context, Result};

/// A folder among the temporary ones that is removed at the end.
pub struct Folder(pub PathBuf);

impl Folder {
    /// Makes `NAME-PROCESS`.
    pub fn new(name: &str) -> Result<Self> {
        let path = std::env::temp_dir().join(format!("{name}-{}", std::process::id()));
        std::fs::create_dir_all(&path).with_context(|| format!("cannot make {}", path.display()))?;
        Ok(Self(path))
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        // What stays behind is in the system's folder for temporary files.
        let _ = std::fs::remove_dir_all(&self.0);
    }
}
