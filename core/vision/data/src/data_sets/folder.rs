//! A folder whose names are listed once.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::calibration::pictures::{self, is_image};

use crate::data_sets::error::DataSetError;

/// Extensions of packed files.
const PACKED: [&str; 6] = [".zip", ".tar", ".tar.gz", ".tgz", ".7z", ".rar"];

/// A folder and the names in it.
#[derive(Debug)]
pub(crate) struct Folder {
    pub path: PathBuf,
    /// Path below the searched folder, `/` between its parts; empty for that folder itself.
    pub name: String,
    files: Vec<String>,
    folders: Vec<String>,
}

impl Folder {
    /// Lists the names; names that are not UTF-8 are left out.
    pub fn read(path: &Path, name: String) -> Result<Self, DataSetError> {
        let unreadable = |cause| DataSetError::Unreadable { path: path.to_owned(), cause };
        let (mut files, mut folders) = (Vec::new(), Vec::new());
        for entry in std::fs::read_dir(path).map_err(unreadable)? {
            let entry = entry.map_err(unreadable)?;
            let Ok(name) = entry.file_name().into_string() else { continue };
            // Data sets are often linked from another disk.
            if entry.path().is_dir() { folders.push(name) } else { files.push(name) }
        }
        files.sort();
        folders.sort();
        Ok(Self { path: path.to_owned(), name, files, folders })
    }

    /// A folder inside, listed.
    pub fn inner(&self, name: &str) -> Option<Self> {
        Self::read(&self.at(name), self.name_of(name)).ok()
    }

    /// The path of a file or folder inside.
    pub fn at(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// The name of a folder inside, below the folder that is searched.
    pub fn name_of(&self, inner: &str) -> String {
        if self.name.is_empty() { inner.to_owned() } else { format!("{}/{inner}", self.name) }
    }

    /// Name of the sequence for the folder itself.
    pub fn sequence_name(&self) -> String {
        if self.name.is_empty() { self.own_name() } else { self.name.clone() }
    }

    /// Last part of its path.
    pub fn own_name(&self) -> String {
        let path = std::path::absolute(&self.path).unwrap_or_else(|_| self.path.clone());
        path.file_name().map_or_else(|| "sequence".to_owned(), |name| name.to_string_lossy().into_owned())
    }

    pub fn has(&self, file: &str) -> bool {
        self.files.iter().any(|name| name == file)
    }

    /// The path of the first of these files that exists.
    pub fn first(&self, files: &[&str]) -> Option<PathBuf> {
        files.iter().find(|file| self.has(file)).map(|file| self.at(file))
    }

    pub fn has_folder(&self, folder: &str) -> bool {
        self.folders.iter().any(|name| name == folder)
    }

    pub fn files(&self) -> impl Iterator<Item = &str> {
        self.files.iter().map(String::as_str)
    }

    /// Folders inside that may hold data, without hidden ones and leftovers of other systems' archives.
    pub fn folders(&self) -> impl Iterator<Item = &str> {
        self.folders.iter().map(String::as_str).filter(|name| !name.starts_with(['.', '_']))
    }

    /// Names of packed files, below the folder that is searched.
    pub fn archives(&self) -> impl Iterator<Item = String> {
        let is_packed = |name: &&String| PACKED.iter().any(|ending| name.to_ascii_lowercase().ends_with(ending));
        self.files.iter().filter(is_packed).map(|name| self.name_of(name))
    }

    /// Images of a folder inside, in the order of their numbers.
    pub fn pictures(&self, inner: &str) -> Vec<PathBuf> {
        pictures_in(&self.at(inner))
    }
}

/// Images of a folder, in the order of their numbers; empty if it cannot be read.
pub(crate) fn pictures_in(folder: &Path) -> Vec<PathBuf> {
    pictures::image_files(&folder.join("*")).unwrap_or_default()
}

/// Files of a folder that `fits` accepts, in the order of their numbers.
pub(crate) fn files_in(folder: &Path, fits: impl Fn(&Path) -> bool) -> Vec<PathBuf> {
    pictures::numbered_files(&folder.join("*"), "file", fits).unwrap_or_default()
}

/// Name without its extension.
pub(crate) fn stem(path: &Path) -> String {
    path.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned())
}

/// Files by their names without extension.
pub(crate) fn by_stem(files: &[PathBuf]) -> BTreeMap<String, &PathBuf> {
    files.iter().map(|file| (stem(file), file)).collect()
}

/// For each image the file of its name.
pub(crate) fn matching(pictures: &[PathBuf], files: &[PathBuf]) -> Vec<Option<PathBuf>> {
    let by_stem = by_stem(files);
    pictures.iter().map(|picture| by_stem.get(&stem(picture)).map(|file| (*file).clone())).collect()
}

/// Pairs of equal names, and a remark about the others.
pub(crate) fn paired(left: &[PathBuf], right: &[PathBuf]) -> (Vec<PathBuf>, Vec<PathBuf>, Option<String>) {
    let partners = matching(left, right);
    let (mut lefts, mut rights) = (Vec::new(), Vec::new());
    for (picture, partner) in left.iter().zip(partners) {
        if let Some(partner) = partner {
            lefts.push(picture.clone());
            rights.push(partner);
        }
    }
    let lonely = left.len() + right.len() - 2 * lefts.len();
    let remark = (lonely > 0).then(|| format!("{lonely} pictures without a partner of the same name are skipped"));
    (lefts, rights, remark)
}

/// Whether a name is that of an image.
pub(crate) fn is_picture(name: &str) -> bool {
    is_image(Path::new(name))
}
