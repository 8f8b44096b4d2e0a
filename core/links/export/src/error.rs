//! Errors of exports.

use std::path::PathBuf;

use panoscope_base::packet::PacketError;
use panoscope_record::RecordingError;

/// Bytes that are not a valid packet of their type.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ValueError {
    /// A packet of the contract that is damaged.
    #[error(transparent)]
    Packet(#[from] PacketError),
    /// An image whose rows do not fit its bytes.
    #[error("an image of {width}x{height} {format} with {stride_bytes} bytes per row does not match {len} bytes")]
    Picture {
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
        /// Name of the format.
        format: &'static str,
        /// Bytes from one row to the next.
        stride_bytes: u32,
        /// Actual number of bytes.
        len: usize,
    },
    /// A text that is not UTF-8.
    #[error("a text is not UTF-8")]
    Text,
}

/// A recording that was not exported, or not completely.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// A port that is not in the recording.
    #[error("{} has no packets of `{port}`; it has {known}", .file.display())]
    NoPort {
        /// The recording.
        file: PathBuf,
        /// Requested port.
        port: String,
        /// The ports that it has.
        known: String,
    },
    /// No packet is selected.
    #[error("{} has no packets of the chosen ports and ticks; it has ticks {first} to {last}", .file.display())]
    NoTicks {
        /// The recording.
        file: PathBuf,
        /// First tick that it has.
        first: u64,
        /// Last tick that it has.
        last: u64,
    },
    /// A recording without packets.
    #[error("{} has no packets: record again, with --all-ports for the outputs of all nodes", .file.display())]
    Empty {
        /// The recording.
        file: PathBuf,
    },
    /// The output exists already.
    #[error("{} already exists: choose another one, or replace it with --force", .path.display())]
    Exists {
        /// The file or folder.
        path: PathBuf,
    },
    /// The output is the recording itself.
    #[error("{} is the recording itself: choose another file", .path.display())]
    IsRecording {
        /// The file.
        path: PathBuf,
    },
    /// A file cannot be written.
    #[error("{} cannot be written: {cause}", .path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The operating system's or the encoder's error.
        cause: std::io::Error,
    },
    /// The recording is damaged.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// A packet that does not match its type.
    #[error("packet {tick} of `{port}`: {cause}; record again with the plugins of this installation")]
    Value {
        /// The port.
        port: String,
        /// The tick.
        tick: u64,
        /// Description of the problem.
        cause: ValueError,
    },
}
