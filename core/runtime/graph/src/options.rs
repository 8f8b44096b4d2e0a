//! Options for opening a graph file.

use crate::source::tidy;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Options of a graph file: overlays, values of its arguments, settings.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct GraphOptions {
    /// Overlay files, applied in this order: each replaces nodes of the same name and defaults of arguments.
    #[serde(default)]
    pub with: Vec<PathBuf>,
    /// Values of arguments by name, as the command line gives them; the last one of a name wins. Relative paths start
    /// from the working folder. An empty value of a flag means true.
    #[serde(default)]
    pub args: Vec<(String, String)>,
    /// `node.param=value`; these override the files.
    #[serde(default)]
    pub set: Vec<String>,
    /// Texts that are read in place of part and overlay files, by absolute path: an editor's unsaved changes.
    #[serde(default)]
    pub texts: BTreeMap<PathBuf, String>,
    /// A required argument without a value is not an error. What depends on it is not checked, and the graph cannot
    /// run.
    #[serde(default)]
    pub allow_missing_args: bool,
}

impl GraphOptions {
    /// The absolute path by which [`Self::texts`] names a file: without `.` and `..`, links not followed.
    pub fn key(file: &Path) -> PathBuf {
        tidy(file)
    }
}
