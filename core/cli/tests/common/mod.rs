//! What several tests of the command need.

use std::path::{Path, PathBuf};

/// Folder that holds these plugins, or words that they are not built.
pub fn plugins(names: &[&str]) -> Option<PathBuf> {
    let given = std::env::var_os("PANOSCOPE_PLUGIN_PATH").unwrap_or_default();
    let beside = Path::new(env!("CARGO_BIN_EXE_panoscope")).parent().map(Path::to_owned);
    let has = |folder: &PathBuf, name: &str| {
        [format!("lib{name}.so"), format!("libpanoscope_{name}.so")].iter().any(|file| folder.join(file).is_file())
    };
    let found = std::env::split_paths(&given).chain(beside).find(|folder| names.iter().all(|name| has(folder, name)));
    if found.is_none() {
        println!("skipped: the plugins {} are not built together; `cargo xtask test` builds them", names.join(", "));
    }
    found
}
