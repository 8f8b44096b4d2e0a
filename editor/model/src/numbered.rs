//! Files named with consecutive numbers.

use std::fs::DirBuilder;
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};

/// The number in a file name such as `plot_0003.csv`.
pub fn number_of(name: &str) -> Option<u32> {
    let stem = name.split('.').next()?;
    stem.rsplit('_').next()?.parse().ok()
}

/// Why a folder for files could not be created.
#[derive(Debug, thiserror::Error)]
#[error("{} cannot be created: {cause}", .folder.display())]
pub struct FolderError {
    /// The folder.
    pub folder: PathBuf,
    /// The operating system's error.
    pub cause: std::io::Error,
}

/// Creates a folder for files, with its parents: mode 0700, because they may show patients.
///
/// # Errors
/// The folder cannot be created.
pub fn create_folder(folder: &Path) -> Result<(), FolderError> {
    let created = DirBuilder::new().recursive(true).mode(0o700).create(folder);
    created.map_err(|cause| FolderError { folder: folder.to_owned(), cause })
}

/// The path of the next file of a kind in a folder, such as `plot_0003.csv`. Creates the folder.
///
/// # Errors
/// The folder cannot be created.
pub fn next_file(folder: &Path, kind: &str, ending: &str) -> Result<PathBuf, FolderError> {
    create_folder(folder)?;
    Ok(folder.join(format!("{kind}_{:04}.{ending}", newest(folder) + 1)))
}

/// The highest number of a file in a folder; 0 when there is none.
pub fn newest(folder: &Path) -> u32 {
    let files = std::fs::read_dir(folder).into_iter().flatten().flatten();
    files.filter_map(|f| number_of(&f.file_name().to_string_lossy())).max().unwrap_or(0)
}
