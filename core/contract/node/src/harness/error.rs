//! Errors of a test that runs one node.

use std::fmt;

use crate::abi;

/// Errors of the harness.
#[derive(thiserror::Error)]
pub enum HarnessError {
    /// The node type's descriptor is malformed.
    #[error(transparent)]
    Descriptor(#[from] panoscope_graph::from_abi::FromAbiError),
    /// The parameters' text has mistakes, rendered as for a graph file.
    #[error("{rendered}")]
    Params {
        /// All mistakes, each with its line and an underline.
        rendered: String,
    },
    /// A port that does not exist, or data that does not fit it.
    #[error("{problem}")]
    Port {
        /// Description of the problem.
        problem: String,
    },
    /// The node returned an error.
    #[error("{call} returned {}: {message}", status_name(*.status))]
    Node {
        /// `open`, `process`, `finish`, `save_state` or `load_state`.
        call: &'static str,
        /// The ABI status.
        status: abi::Status,
        /// The message that the node passed to the host.
        message: String,
    },
    /// The node used the host in a way that the ABI forbids.
    #[error("the node violated the ABI: {problem}")]
    Contract {
        /// Result of the node.
        problem: String,
    },
}

/// Shows the message, because tests end with `?` or `unwrap`, which print `Debug`.
impl fmt::Debug for HarnessError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl HarnessError {
    pub(super) fn port(problem: impl Into<String>) -> Self {
        Self::Port { problem: problem.into() }
    }

    /// The ABI status, when the node itself returned an error.
    pub fn status(&self) -> Option<abi::Status> {
        match self {
            Self::Node { status, .. } => Some(*status),
            _ => None,
        }
    }
}

fn status_name(status: abi::Status) -> String {
    match status {
        abi::STATUS_END => "STATUS_END".to_owned(),
        abi::STATUS_ERROR => "STATUS_ERROR".to_owned(),
        abi::STATUS_PANIC => "STATUS_PANIC".to_owned(),
        abi::STATUS_EXHAUSTED => "STATUS_EXHAUSTED".to_owned(),
        abi::STATUS_INVALID => "STATUS_INVALID".to_owned(),
        abi::STATUS_STOPPED => "STATUS_STOPPED".to_owned(),
        other => format!("status {other}"),
    }
}
