//! Files and folders of the host on the other machine.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::SystemTime;

use panoscope_host::loader::sealed::Fingerprint;

use panoscope_host::isolate::relay::messages::FileHash;

/// Hashes of files, each computed once while the file is unchanged.
#[derive(Default)]
pub struct Hashes(Mutex<HashMap<PathBuf, (SystemTime, u64, String)>>);

impl Hashes {
    /// SHA-256 of a file; `None` if it is not a file or cannot be read.
    pub fn of(&self, file: &Path) -> Option<String> {
        let metadata = std::fs::metadata(file).ok().filter(std::fs::Metadata::is_file)?;
        let (changed, len) = (metadata.modified().ok()?, metadata.len());
        let mut known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((at, bytes, sha256)) = known.get(file)
            && (*at, *bytes) == (changed, len)
        {
            return Some(sha256.clone());
        }
        let sha256 = Fingerprint::of_file(file).ok()?.sha256;
        known.insert(file.to_owned(), (changed, len, sha256.clone()));
        Some(sha256)
    }
}

/// Folders of the host and their local equivalents: the graph's, and those of plugins.
#[derive(Clone, Debug, Default)]
pub struct Folders(Vec<(PathBuf, PathBuf)>);

impl Folders {
    /// Maps the host's folder `there` to the local folder `here`.
    pub fn add(&mut self, there: &Path, here: &Path) {
        self.0.retain(|(known, _)| known != there);
        self.0.push((there.to_owned(), here.to_owned()));
        // A folder inside another one goes before it.
        self.0.sort_by_key(|(there, _)| std::cmp::Reverse(there.components().count()));
    }

    /// The local path for a path of the host: the same, unless it is in a mapped folder.
    pub fn here(&self, path: &str) -> PathBuf {
        let path = Path::new(path);
        let moved = |(there, here): &(PathBuf, PathBuf)| Some(here.join(path.strip_prefix(there).ok()?));
        self.0.iter().find_map(moved).unwrap_or_else(|| path.to_owned())
    }
}

/// A file of the host that cannot be used here.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FileError {
    /// The file here has other bytes.
    #[error(
        "{path} differs: SHA-256 {sha256} on the host, {own} on `{machine}` ({}); copy the file there", here.display()
    )]
    Differs {
        /// The file on the host.
        path: String,
        /// Its hash there.
        sha256: String,
        /// Its hash here.
        own: String,
        /// Name of this machine.
        machine: String,
        /// The file here.
        here: PathBuf,
    },
    /// The file does not exist here.
    #[error("{path} (SHA-256 {sha256}) is missing on `{machine}`: copy it to {} there", here.display())]
    Missing {
        /// The file on the host.
        path: String,
        /// Its hash there.
        sha256: String,
        /// Name of this machine.
        machine: String,
        /// Its expected path on this machine.
        here: PathBuf,
    },
}

/// Compares files of the host with those here.
///
/// # Errors
/// The first that differs or is missing.
pub fn compare(files: &[FileHash], folders: &Folders, hashes: &Hashes, machine: &str) -> Result<(), FileError> {
    for FileHash { path, sha256 } in files {
        let here = folders.here(path);
        match hashes.of(&here) {
            Some(own) if own == *sha256 => {}
            own => {
                let (path, sha256, machine) = (path.clone(), sha256.clone(), machine.to_owned());
                return Err(match own {
                    Some(own) => FileError::Differs { path, sha256, own, machine, here },
                    None => FileError::Missing { path, sha256, machine, here },
                });
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_of_the_host_are_found_here() {
        let mut folders = Folders::default();
        folders.add("/host/graphs".as_ref(), "/rack/cases".as_ref());
        folders.add("/host/graphs/plugins/tools".as_ref(), "/usr/lib/plugins/tools".as_ref());
        assert_eq!(folders.here("/host/graphs/models/a.onnx"), Path::new("/rack/cases/models/a.onnx"));
        assert_eq!(folders.here("/host/graphs/plugins/tools/a.onnx"), Path::new("/usr/lib/plugins/tools/a.onnx"));
        assert_eq!(folders.here("/elsewhere/a.onnx"), Path::new("/elsewhere/a.onnx"));
        assert_eq!(folders.here("/host/graphs_2/a"), Path::new("/host/graphs_2/a"));
    }

    #[test]
    fn a_file_that_differs_is_named_with_both_hashes() {
        let folder = std::env::temp_dir().join(format!("panoscope-files-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder");
        let file = folder.join("model.onnx");
        std::fs::write(&file, b"one").expect("a file");
        let (hashes, folders) = (Hashes::default(), Folders::default());
        let path = file.display().to_string();
        let hash = |sha256: String| [FileHash { path: path.clone(), sha256 }];
        let right = hashes.of(&file).expect("a file");
        assert_eq!(compare(&hash(right.clone()), &folders, &hashes, "rack"), Ok(()));
        let wrong = compare(&hash("00ff".to_owned()), &folders, &hashes, "rack").expect_err("it differs").to_string();
        assert!(wrong.contains("00ff") && wrong.contains(&right) && wrong.contains("copy the file there"), "{wrong}");
        std::fs::write(&file, b"other").expect("a file");
        assert!(compare(&hash(right), &folders, &hashes, "rack").is_err(), "a file that changed is read again");
        std::fs::remove_file(&file).expect("a file");
        let missing =
            compare(&hash("00ff".to_owned()), &folders, &hashes, "rack").expect_err("it is missing").to_string();
        assert!(missing.contains("missing"), "{missing}");
        let _ = std::fs::remove_dir_all(&folder);
    }
}
