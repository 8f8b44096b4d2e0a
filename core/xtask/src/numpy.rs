//! NumPy for the tests of nodes in Python, beside the build and not in the user's Python.

use std::path::PathBuf;
use std::process::Command;

use crate::packages::Purpose;
use crate::process;
use crate::setup;
use crate::workspace::Workspace;

const REQUIREMENT: &str = "numpy>=1.24,<3";

/// The folder for `PYTHONPATH`; none where Python has NumPy by itself, or none can be had: then tests that need it are skipped.
pub fn folder(workspace: &Workspace) -> Option<PathBuf> {
    let has_numpy = |path: Option<&PathBuf>| {
        let mut python = Command::new("python3");
        python.args(["-c", "import numpy"]).envs(path.map(|path| ("PYTHONPATH", path)));
        process::capture(&mut python).is_ok()
    };
    if has_numpy(None) {
        return None;
    }
    let folder = workspace.target.join("python");
    if has_numpy(Some(&folder)) {
        return Some(folder);
    }
    println!("Fetching NumPy with pip");
    let install = || {
        let pip = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--target"];
        process::capture(Command::new("python3").args(pip).arg(&folder).arg(REQUIREMENT))
    };
    let installed =
        install().or_else(|error| setup::ensure(&[Purpose::Wheels]).map_err(|_| error).and_then(|_| install()));
    match installed {
        Ok(_) => Some(folder),
        Err(error) => {
            println!("NumPy was not fetched: {error:#}");
            None
        }
    }
}
