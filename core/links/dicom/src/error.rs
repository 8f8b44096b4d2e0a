//! Errors.

use std::io;
use std::path::PathBuf;

/// Why an object was not made, kept or sent.
#[derive(Debug, thiserror::Error)]
pub enum DicomError {
    /// Bytes from outside that are no DICOM, or no DICOM that is read here.
    #[error("{what}: {problem}")]
    Malformed {
        /// What they were to be.
        what: String,
        /// What is wrong.
        problem: String,
    },
    /// A worklist entry without what identifies a study.
    #[error("the worklist entry cannot be used: {problem}")]
    Entry {
        /// What is missing.
        problem: String,
    },
    /// No entry, or several, have the key.
    #[error("{count} worklist entries have the accession number, step or study `{key}`; {help}")]
    Choice {
        /// The key.
        key: String,
        /// How many.
        count: usize,
        /// What to do.
        help: &'static str,
    },
    /// A file that cannot become an object.
    #[error("{} cannot be exported: {problem}", file.display())]
    Input {
        /// The file.
        file: PathBuf,
        /// Why.
        problem: String,
    },
    /// A file that cannot be read.
    #[error("{} cannot be read: {cause}", file.display())]
    Read {
        /// The file.
        file: PathBuf,
        /// The operating system's error.
        cause: io::Error,
    },
    /// An object that cannot be kept in the outbox.
    #[error("{} cannot be written: {cause}; nothing was exported, all originals are as they were", file.display())]
    Write {
        /// The file.
        file: PathBuf,
        /// The operating system's error.
        cause: io::Error,
    },
    /// Nobody listens there.
    #[error("{peer} cannot be reached: {cause}; is the address right, and does the server run?")]
    Unreachable {
        /// Address.
        peer: String,
        /// The operating system's error.
        cause: String,
    },
    /// The server does not accept this caller.
    #[error(
        "{peer} refused the association of {calling} with {called}: {reason}; the server must know both application entity titles (--calling, --called)"
    )]
    Refused {
        /// Address.
        peer: String,
        /// Own title.
        calling: String,
        /// The server's title.
        called: String,
        /// Its reason.
        reason: String,
    },
    /// The server offers no such service.
    #[error("{peer} does not offer {service}")]
    NoService {
        /// Address.
        peer: String,
        /// The service.
        service: String,
    },
    /// The connection broke, or what came is malformed.
    #[error("{peer}: {problem}")]
    Broken {
        /// Address.
        peer: String,
        /// What happened.
        problem: String,
    },
    /// The server answered with an error.
    #[error("{peer} answered {service} with status {status:#06x}: {meaning}")]
    Status {
        /// Address.
        peer: String,
        /// The service.
        service: &'static str,
        /// The status.
        status: u16,
        /// Its meaning, with the server's comment.
        meaning: String,
    },
}

/// A shorthand.
pub type Result<T, E = DicomError> = std::result::Result<T, E>;

/// An error with what caused it, in one line.
pub(crate) fn chain(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut next = error.source();
    while let Some(source) = next {
        let words = source.to_string();
        if !text.contains(&words) {
            text = format!("{text}: {words}");
        }
        next = source.source();
    }
    text
}
