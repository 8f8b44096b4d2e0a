//! Inputs of evaluations and benches: data folders, shipped models, rendered pairs, graphs.

mod folder;
pub mod level;
pub mod pairs;
pub mod references;
pub mod scene;
pub mod wiring;

use std::path::{Path, PathBuf};

use crate::error::{FileAction, OnFile, Result};

pub use folder::Folder;

/// Folders of the shipped models, relative to the repository and to an installed folder.
const MODELS: &str = "plugins/tools/models";

/// Path of `name` in the first folder that has it.
pub fn find(folders: &[PathBuf], name: &str) -> Option<PathBuf> {
    folders.iter().map(|folder| folder.join(name)).find(|path| path.exists())
}

/// Whether `name` is among the wanted ones: all are if none is named.
pub fn wants(wanted: &[String], name: &str) -> bool {
    wanted.is_empty() || wanted.iter().any(|w| w == name)
}

/// Creates the folder of an option, if it is given.
///
/// # Errors
/// The folder cannot be created.
pub fn create(folder: Option<&Path>) -> Result<()> {
    folder.map_or(Ok(()), |folder| std::fs::create_dir_all(folder).on_file(FileAction::Create, folder))
}

/// A shipped file by its path in the repository: in the current folder, next to the program or up to three folders
/// above it.
pub fn shipped_file(path: &Path) -> Option<PathBuf> {
    let program = std::env::current_exe().ok();
    let folders = program.iter().flat_map(|p| p.ancestors().skip(1).take(4)).map(Path::to_owned);
    let mut all = std::iter::once(PathBuf::new()).chain(folders);
    all.find_map(|folder| Some(folder.join(path)).filter(|file| file.is_file()))
}

/// A shipped model by its file name.
pub fn shipped_model(name: &str) -> Option<PathBuf> {
    shipped_file(&Path::new(MODELS).join(name))
}

/// An absolute path in quotes, for graph text.
pub fn quoted(path: &Path) -> String {
    let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    toml::Value::String(path.to_string_lossy().into_owned()).to_string()
}
