//! Errors of this crate.

use std::io;
use std::path::PathBuf;

/// An object that was not made, kept or sent.
#[derive(Debug, thiserror::Error)]
pub enum DicomError {
    /// Input that is not DICOM, or not supported DICOM.
    #[error("{what}: {problem}")]
    Malformed {
        /// Expected content.
        what: String,
        /// Description of the problem.
        problem: String,
    },
    /// A worklist entry without the identification of a study.
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
        /// Number of matching entries.
        count: usize,
        /// What to do.
        help: &'static str,
    },
    /// A file that cannot become an object.
    #[error("{} cannot be exported: {problem}", file.display())]
    Input {
        /// The file.
        file: PathBuf,
        /// Reason.
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
    #[error("{} cannot be written: {cause}; nothing was exported and all originals are unchanged", file.display())]
    Write {
        /// The file.
        file: PathBuf,
        /// The operating system's error.
        cause: io::Error,
    },
    /// Nothing listens at the address.
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
    /// The server does not offer the service.
    #[error("{peer} does not offer {service}")]
    NoService {
        /// Address.
        peer: String,
        /// The service.
        service: String,
    },
    /// The connection broke, or a message is malformed.
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

/// Result of this crate.
pub type Result<T, E = DicomError> = std::result::Result<T, E>;

/// An error with its causes, in one line.
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
