//! Errors of bags.

use std::io;
use std::path::PathBuf;

use crate::cdr::CdrError;

/// A bag that cannot be written or read.
#[derive(Debug, thiserror::Error)]
pub enum BagError {
    /// The output exists already.
    #[error("{} already exists: choose another folder", .path.display())]
    Exists {
        /// The folder.
        path: PathBuf,
    },
    /// A file cannot be written.
    #[error("{} cannot be written: {cause}", .path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The operating system's or the encoder's error.
        cause: io::Error,
    },
    /// A message that cannot be encoded.
    #[error(transparent)]
    Message(#[from] CdrError),
    /// A type without a definition.
    #[error("the definition of `{message}` is missing")]
    NoDefinition {
        /// The type.
        message: &'static str,
    },
    /// A file or folder cannot be read.
    #[error("{} cannot be read: {cause}", .path.display())]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// The operating system's error.
        cause: io::Error,
    },
    /// The folder has no MCAP file.
    #[error("{} has no MCAP file: {hint}", .path.display())]
    NoMcap {
        /// The folder.
        path: PathBuf,
        /// Actual content and a remedy.
        hint: &'static str,
    },
    /// Messages of ROS 1.
    #[error("{} has messages of ROS 1: convert it with `rosbags-convert`", .path.display())]
    Ros1 {
        /// The bag.
        path: PathBuf,
    },
    /// Messages that are compressed individually.
    #[error("messages of `{topic}` in {} are compressed individually, which is not supported: write the bag again with `ros2 bag convert`", .path.display())]
    PackedMessage {
        /// The file.
        path: PathBuf,
        /// The topic.
        topic: String,
    },
    /// A file that ends early: its recorder did not finish it.
    #[error("{} ends in the middle of a record after {messages} messages: its recorder did not finish it", .path.display())]
    CutOff {
        /// The file.
        path: PathBuf,
        /// Messages before that.
        messages: u64,
    },
    /// A damaged file.
    #[error("{} is damaged after {messages} messages: {words}", .path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Messages before that.
        messages: u64,
        /// Description of the problem.
        words: String,
    },
}
