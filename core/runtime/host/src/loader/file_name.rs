//! Reads the name of a plugin's file.

use std::ffi::OsStr;
use std::path::Path;

/// Whether a file may be a plugin in Python.
pub(crate) fn is_python(file: &Path) -> bool {
    file.extension() == Some(OsStr::new("py"))
}

/// Name of a plugin's file without prefixes and extension: `phantom` for `libpanoscope_phantom.so`.
pub(crate) fn stem(file: &Path) -> String {
    let stem = file.file_stem().unwrap_or_default().to_string_lossy();
    let stem = stem.strip_prefix("lib").unwrap_or(&stem);
    stem.strip_prefix("panoscope_").unwrap_or(stem).to_owned()
}
