//! What can go wrong in a test that runs one node.

use std::fmt;

use crate::abi;

/// Why the harness could not do what it was asked.
#[derive(thiserror::Error)]
pub enum HarnessError {
    /// The node type's descriptor is malformed.
    #[error(transparent)]
    Descriptor(#[from] panoscope_graph::from_abi::FromAbiError),
    /// The parameters' text has mistakes; the message is the one that a graph file would get.
    #[error("{rendered}")]
    Params {
        /// All mistakes with line and underline.
        rendered: String,
    },
    /// A port that does not exist, or data that does not fit it.
    #[error("{problem}")]
    Port {
        /// What is wrong.
        problem: String,
    },
    /// The node answered with an error.
    #[error("{call} answered {}: {message}", status_name(*.status))]
    Node {
        /// `open`, `process`, `finish`, `save_state` or `load_state`.
        call: &'static str,
        /// The contract's status.
        status: abi::Status,
        /// The words it gave to the host.
        message: String,
    },
    /// The node used the host in a way that the contract forbids.
    #[error("the node broke the contract: {problem}")]
    Contract {
        /// What it did.
        problem: String,
    },
}

/// Tests end with `?` or `unwrap`: both shall show the words, not a struct.
impl fmt::Debug for HarnessError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl HarnessError {
    pub(super) fn port(problem: impl Into<String>) -> Self {
        Self::Port { problem: problem.into() }
    }

    /// The contract's status, when the node itself answered.
    pub fn status(&self) -> Option<abi::Status> {
        match self {
            Self::Node { status, .. } => Some(*status),
            _ => None,
        }
    }
}

fn status_name(status: abi::Status) -> String {
    match status {
        abi::STATUS_ERROR => "STATUS_ERROR".to_owned(),
        abi::STATUS_PANIC => "STATUS_PANIC".to_owned(),
        abi::STATUS_EXHAUSTED => "STATUS_EXHAUSTED".to_owned(),
        abi::STATUS_INVALID => "STATUS_INVALID".to_owned(),
        abi::STATUS_STOPPED => "STATUS_STOPPED".to_owned(),
        other => format!("status {other}"),
    }
}
