//! Snapshots of a graph's state: the texts of all its files, each with a picture, in a folder beside the graph.

use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

use panoscope_base::files;
use serde::{Deserialize, Serialize};

use crate::disk;
use crate::document::Document;
use crate::numbered::{FolderError, create_folder, number_of};

/// Maximum size of a snapshot's file, bytes.
const MAX_BYTES: u64 = 16 << 20;
/// Maximum number of snapshots that are listed, the newest ones.
const MAX_LISTED: usize = 200;

/// A stored state of a graph.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Snapshot {
    /// Its number, from 1.
    #[serde(skip)]
    pub number: u32,
    /// When it was taken, seconds since 1970.
    pub taken_s: u64,
    /// Text of the graph file.
    pub text: String,
    /// Texts of parts and overlays.
    #[serde(default)]
    pub files: Vec<OtherFile>,
}

/// The text of a part or overlay.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OtherFile {
    /// Its path, relative to the graph's folder where it is inside of it.
    pub path: PathBuf,
    /// Its text.
    pub text: String,
}

/// Why a snapshot was not taken or read.
#[derive(Debug, thiserror::Error)]
pub enum SnapshotError {
    /// The folder cannot be created.
    #[error(transparent)]
    Folder(#[from] FolderError),
    /// A file cannot be written.
    #[error("{} was not written: {cause}", .path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The operating system's error.
        cause: std::io::Error,
    },
}

/// The snapshots of a graph.
#[derive(Clone, Debug, Default)]
pub struct Snapshots {
    folder: PathBuf,
    list: Vec<Snapshot>,
    /// Files that are not snapshots, each with the reason.
    refused: Vec<String>,
}

impl Snapshots {
    /// Reads the snapshots of a graph: those in `depth.snapshots` beside `depth.toml`. Files that are not snapshots are named in [`Self::refused`].
    pub fn load(graph: &Path) -> Self {
        let folder = graph.with_extension("snapshots");
        let mut files: Vec<(u32, PathBuf)> = std::fs::read_dir(&folder)
            .into_iter()
            .flatten()
            .flatten()
            .map(|entry| entry.path())
            .filter(|path| path.extension().is_some_and(|e| e == "toml"))
            .filter_map(|path| Some((number_of(&path.file_name()?.to_string_lossy())?, path)))
            .collect();
        files.sort();
        let mut this = Self { folder, ..Self::default() };
        for (number, path) in files.split_off(files.len().saturating_sub(MAX_LISTED)) {
            match read(&path) {
                Ok(snapshot) => this.list.push(Snapshot { number, ..snapshot }),
                Err(reason) => this.refused.push(format!("{}: {reason}", path.display())),
            }
        }
        this
    }

    /// The snapshots, oldest first.
    pub fn list(&self) -> &[Snapshot] {
        &self.list
    }

    /// Files that are not snapshots, each with the reason.
    pub fn refused(&self) -> &[String] {
        &self.refused
    }

    /// The snapshot of this number.
    pub fn get(&self, number: u32) -> Option<&Snapshot> {
        self.list.iter().find(|snapshot| snapshot.number == number)
    }

    /// The file of a snapshot's picture.
    pub fn picture_file(&self, number: u32) -> PathBuf {
        self.folder.join(format!("snapshot_{number:04}.png"))
    }

    /// Stores the texts of a document as they are now; returns the number of the snapshot.
    ///
    /// # Errors
    /// The folder or the file cannot be written; nothing is stored.
    pub fn take(&mut self, document: &Document) -> Result<u32, SnapshotError> {
        create_folder(&self.folder)?;
        let number = crate::numbered::newest(&self.folder) + 1;
        let base = base_of(document.path());
        let others = document.texts_of_others().iter().map(|(path, text)| OtherFile {
            path: path.strip_prefix(&base).map_or_else(|_| path.clone(), Path::to_owned),
            text: text.to_string(),
        });
        let taken_s = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs());
        let snapshot = Snapshot { number, taken_s, text: document.text().to_string(), files: others.collect() };
        let path = self.folder.join(format!("snapshot_{number:04}.toml"));
        let fail = |cause| SnapshotError::Write { path: path.clone(), cause };
        let text = toml::to_string(&snapshot).map_err(|error| fail(std::io::Error::other(error)))?;
        files::replace(&path, text.as_bytes()).map_err(fail)?;
        self.list.push(snapshot);
        Ok(number)
    }

    /// Removes a snapshot with its picture.
    ///
    /// # Errors
    /// The file cannot be removed.
    pub fn remove(&mut self, number: u32) -> Result<(), SnapshotError> {
        let path = self.folder.join(format!("snapshot_{number:04}.toml"));
        std::fs::remove_file(&path).map_err(|cause| SnapshotError::Write { path, cause })?;
        // It may have none.
        let _ = std::fs::remove_file(self.picture_file(number));
        self.list.retain(|snapshot| snapshot.number != number);
        Ok(())
    }
}

/// The absolute folder of a graph.
fn base_of(graph: &Path) -> PathBuf {
    let folder = graph.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    std::fs::canonicalize(folder).unwrap_or_else(|_| folder.to_owned())
}

/// Why a snapshot cannot be read.
#[derive(Debug, thiserror::Error)]
enum ReadError {
    /// The operating system's error.
    #[error(transparent)]
    File(#[from] std::io::Error),
    /// It is larger than [`MAX_BYTES`].
    #[error("it has more than 16 MiB")]
    Large,
    /// Its text is not a snapshot.
    #[error("{}", .0.to_string().trim())]
    Contents(#[from] toml::de::Error),
}

fn read(path: &Path) -> Result<Snapshot, ReadError> {
    let text = disk::read_text(path, MAX_BYTES)?;
    Ok(parse(&text.ok_or(ReadError::Large)?)?)
}

/// Reads the text of a snapshot; its number is that of its file.
///
/// # Errors
/// What is wrong, with the line.
pub fn parse(text: &str) -> Result<Snapshot, toml::de::Error> {
    toml::from_str(text)
}

/// Gives a document the texts of a snapshot, as one step that can be undone. Returns whether anything differed.
///
/// A file outside of the graph's folder gets its text only if the document has it already, so that a foreign snapshot changes no other file.
pub fn restore(document: &mut Document, snapshot: &Snapshot) -> bool {
    let base = base_of(document.path());
    let is_inside = |path: &Path| path.components().all(|part| matches!(part, Component::Normal(_)));
    let known = document.texts_of_others();
    let others: BTreeMap<PathBuf, Arc<str>> = snapshot
        .files
        .iter()
        .filter(|file| is_inside(&file.path) || known.contains_key(&base.join(&file.path)))
        .map(|file| (base.join(&file.path), Arc::from(file.text.as_str())))
        .collect();
    document.replace_texts(&snapshot.text, others, &format!("go back to snapshot {}", snapshot.number))
}

#[cfg(test)]
mod tests {
    use panoscope_host::loader::Loader;

    use super::*;

    #[test]
    fn a_state_is_stored_with_its_parts_and_restored() {
        let folder = std::env::temp_dir().join(format!("panoscope_snapshots_{}", std::process::id()));
        std::fs::create_dir_all(folder.join("parts")).expect("a folder");
        let part = "[part]\n[nodes.m]\ntype = \"pass\"\n";
        std::fs::write(folder.join("parts/p.toml"), part).expect("written");
        let path = folder.join("g.toml");
        let text = "[nodes.p]\ngraph = \"parts/p.toml\"\n";
        let mut document = Document::new(&path, text, Arc::new(Loader::search(&[])));
        let mut snapshots = Snapshots::load(&path);
        assert_eq!(snapshots.take(&document).expect("taken"), 1);
        document.set_text("name = \"other\"\n", "edit", None);
        assert_eq!(snapshots.take(&document).expect("taken"), 2);
        let read = Snapshots::load(&path);
        assert_eq!((read.list(), read.refused().len()), (snapshots.list(), 0));
        let first = read.get(1).expect("it is there");
        assert_eq!((first.text.as_str(), first.files[0].text.as_str()), (text, part));
        assert_eq!(first.files[0].path, Path::new("parts/p.toml"), "relative to the graph");
        assert!(restore(&mut document, first));
        assert_eq!(**document.text(), *text);
        assert!(!restore(&mut document, first), "nothing differs any more");
        assert_eq!(document.undo().as_deref(), Some("go back to snapshot 1"));
        // A foreign snapshot does not reach files elsewhere.
        let foreign = OtherFile { path: "../../elsewhere.toml".into(), text: "x".to_owned() };
        assert!(restore(&mut document, &Snapshot { files: vec![foreign], ..first.clone() }));
        assert!(document.changed_files().is_empty(), "{:?}", document.changed_files());
        snapshots.remove(1).expect("removed");
        std::fs::write(folder.join("g.snapshots/snapshot_0007.toml"), "taken_s = \"x\"").expect("written");
        let read = Snapshots::load(&path);
        assert_eq!((read.list().len(), read.refused().len()), (1, 1), "{:?}", read.refused());
        std::fs::remove_dir_all(&folder).expect("removed");
    }
}
