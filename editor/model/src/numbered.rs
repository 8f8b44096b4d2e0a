//! Files that are named by a number that goes on.

use std::path::{Path, PathBuf};

/// The number of a file that was written here before.
pub fn number_of(name: &str) -> Option<u32> {
    let stem = name.split('.').next()?;
    stem.rsplit('_').next()?.parse().ok()
}

/// The next file of a kind in a folder, such as `plot_0003.csv`; the folder is there.
///
/// # Errors
/// In words, when the folder cannot be made.
pub fn next_file(folder: &Path, kind: &str, ending: &str) -> Result<PathBuf, String> {
    std::fs::create_dir_all(folder).map_err(|e| format!("{} cannot be made: {e}", folder.display()))?;
    Ok(folder.join(format!("{kind}_{:04}.{ending}", newest(folder) + 1)))
}

/// The highest number of a file in a folder.
pub fn newest(folder: &Path) -> u32 {
    let files = std::fs::read_dir(folder).into_iter().flatten().flatten();
    files.filter_map(|f| number_of(&f.file_name().to_string_lossy())).max().unwrap_or(0)
}
