//! Inputs that evaluations and benches share: data folders, models that ship, rendered pairs, graphs.

pub mod embedded;
mod folder;
pub mod level;
pub mod pairs;
pub mod references;
pub mod scene;
pub mod wiring;

use std::path::{Path, PathBuf};

pub use folder::Folder;

/// Where the models that ship stand, seen from the repository and from an installed folder.
const MODELS: &str = "plugins/tools/models";

/// The first of the folders that holds `name`, joined with it.
pub fn find(folders: &[PathBuf], name: &str) -> Option<PathBuf> {
    folders.iter().map(|folder| folder.join(name)).find(|path| path.exists())
}

/// A file that ships, by its path in the repository: in the current folder, else beside the program or up to three folders above it.
pub fn shipped_file(path: &Path) -> Option<PathBuf> {
    let program = std::env::current_exe().ok();
    let folders = program.iter().flat_map(|p| p.ancestors().skip(1).take(4)).map(Path::to_owned);
    let mut all = std::iter::once(PathBuf::new()).chain(folders);
    all.find_map(|folder| Some(folder.join(path)).filter(|file| file.is_file()))
}

/// A model that ships, by its file name.
pub fn shipped_model(name: &str) -> Option<PathBuf> {
    shipped_file(&Path::new(MODELS).join(name))
}

/// An absolute path in quotes, as graph text wants it.
pub fn quoted(path: &Path) -> String {
    let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    toml::Value::String(path.to_string_lossy().into_owned()).to_string()
}
