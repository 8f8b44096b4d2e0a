//! Where the programs of this installation are: plugins, ONNX Runtime and other programs are found next to them.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

/// Environment variable with the file of the program `panoscope`, for a process that runs graphs but is not one of the
/// installation's programs, such as a Python interpreter. Child processes and plugins read it too.
pub const PROGRAM_VARIABLE: &str = "PANOSCOPE_PROGRAM";

/// Name of the program, and beginning of the names of the others.
const PROGRAM: &str = "panoscope";

/// The running program if it belongs to an installation, else the one that [`PROGRAM_VARIABLE`] names, else the running
/// one. `None` where the system does not say which file runs.
pub fn file() -> Option<PathBuf> {
    choose(std::env::current_exe().ok(), std::env::var_os(PROGRAM_VARIABLE).as_deref())
}

fn choose(running: Option<PathBuf>, named: Option<&OsStr>) -> Option<PathBuf> {
    let is_ours = |file: &PathBuf| file.file_name().is_some_and(|name| name.to_string_lossy().starts_with(PROGRAM));
    match named.filter(|named| !named.is_empty()) {
        Some(named) if !running.as_ref().is_some_and(is_ours) => Some(PathBuf::from(named)),
        _ => running,
    }
}

/// The folder of [`file()`].
pub fn folder() -> Option<PathBuf> {
    file().as_deref().and_then(Path::parent).map(Path::to_owned)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_program_of_an_installation_belongs_to_its_own_installation() {
        let path = |text: &str| Some(PathBuf::from(text));
        let named = Some(OsStr::new("/opt/lib/panoscope/panoscope"));
        assert_eq!(choose(path("/usr/bin/python3.11"), named), path("/opt/lib/panoscope/panoscope"));
        assert_eq!(choose(None, named), path("/opt/lib/panoscope/panoscope"));
        for own in ["/usr/lib/panoscope/panoscope", "/usr/lib/panoscope/panoscope-editor"] {
            assert_eq!(choose(path(own), named), path(own));
        }
        assert_eq!(choose(path("/usr/bin/python3.11"), None), path("/usr/bin/python3.11"));
        assert_eq!(choose(path("/usr/bin/python3.11"), Some(OsStr::new(""))), path("/usr/bin/python3.11"));
    }
}
