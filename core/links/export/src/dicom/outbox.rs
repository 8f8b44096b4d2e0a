//! A folder of objects that wait to be sent. An object is removed only when a server has confirmed its storage.

use std::fs::{self, File};
use std::io;
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};

use crate::dicom::error::{DicomError, Result};
use crate::dicom::net::{self, Object, Peer};
use crate::dicom::part10::Head;

/// Result of sending the objects of an outbox.
#[derive(Debug, Default)]
pub struct Sent {
    /// Number of objects that the server stored.
    pub stored: usize,
    /// Objects that stay, each with the reason.
    pub kept: Vec<(PathBuf, DicomError)>,
}

/// Creates a folder that only its owner may access.
///
/// # Errors
/// It cannot be created.
pub fn create(folder: &Path) -> Result<()> {
    let made = fs::DirBuilder::new().recursive(true).mode(0o700).create(folder);
    made.map_err(|cause| DicomError::Write { file: folder.to_owned(), cause })
}

/// The objects in a folder, sorted by name.
///
/// # Errors
/// It cannot be read.
pub fn objects(folder: &Path) -> Result<Vec<PathBuf>> {
    let failed = |cause| DicomError::Read { file: folder.to_owned(), cause };
    let files = fs::read_dir(folder).map_err(failed)?.collect::<io::Result<Vec<_>>>().map_err(failed)?;
    let mut files: Vec<PathBuf> = files.into_iter().map(|file| file.path()).collect();
    files.retain(|file| file.extension().is_some_and(|ending| ending == "dcm") && !is_hidden(file) && file.is_file());
    files.sort();
    Ok(files)
}

fn is_hidden(file: &Path) -> bool {
    file.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(b"."))
}

/// Sends all objects of a folder; those that the server has stored are removed unless `keep` says otherwise.
///
/// # Errors
/// The server cannot be reached; all objects stay.
pub fn send(folder: &Path, peer: &Peer, keep: bool) -> Result<Sent> {
    let mut sent = Sent::default();
    let mut heads = Vec::new();
    let mut waiting = Vec::new();
    for file in objects(folder)? {
        match open(&file) {
            Ok(object) => {
                heads.push(object.head);
                waiting.push(file);
            }
            Err(error) => sent.kept.push((file, error)),
        }
    }
    if waiting.is_empty() {
        return Ok(sent);
    }
    let mut store = net::store(peer, &heads)?;
    let mut waiting = waiting.into_iter();
    for file in waiting.by_ref() {
        let object = match open(&file) {
            Ok(object) => object,
            // Another call may have sent it meanwhile.
            Err(DicomError::Read { cause, .. }) if cause.kind() == io::ErrorKind::NotFound => continue,
            Err(error) => {
                sent.kept.push((file, error));
                continue;
            }
        };
        match store.send(object) {
            Ok(()) => {
                sent.stored += 1;
                if !keep
                    && let Err(cause) = fs::remove_file(&file)
                    && cause.kind() != io::ErrorKind::NotFound
                {
                    // Stored all the same; the next call sends it again, which the server recognizes.
                    sent.kept.push((file.clone(), DicomError::Write { file, cause }));
                }
            }
            Err(error @ DicomError::Broken { .. }) => {
                sent.kept.push((file, error));
                let rest = waiting.map(|file| {
                    let problem = "not sent, because the association had broken".to_owned();
                    (file, DicomError::Broken { peer: peer.address.clone(), problem })
                });
                sent.kept.extend(rest);
                return Ok(sent);
            }
            Err(error) => sent.kept.push((file, error)),
        }
    }
    store.release();
    Ok(sent)
}

fn open(path: &Path) -> Result<Object> {
    let failed = |cause| DicomError::Read { file: path.to_owned(), cause };
    let mut file = File::open(path).map_err(failed)?;
    let head = Head::read(&mut file)
        .map_err(|error| DicomError::Malformed { what: path.display().to_string(), problem: error.to_string() })?;
    let bytes = file.metadata().map_err(failed)?.len().saturating_sub(head.length as u64);
    Ok(Object { head, file, bytes })
}
