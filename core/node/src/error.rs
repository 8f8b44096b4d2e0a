//! What a node answers when it cannot do its work.

use std::fmt;

/// Why a node failed, in words for the person who runs the graph.
pub struct NodeError {
    message: String,
    status: crate::abi::Status,
}

/// Result of a node's calls.
pub type Result<T, E = NodeError> = std::result::Result<T, E>;

impl NodeError {
    /// An error with the words to show.
    pub fn new(message: impl Into<String>) -> Self {
        Self { message: message.into(), status: crate::abi::STATUS_ERROR }
    }

    /// For sources: nothing comes after this call, and something is missing. A fault is counted and the source is not opened again.
    pub fn ended_early(message: impl Into<String>) -> Self {
        Self::with_status(message, crate::abi::STATUS_END)
    }

    /// An error that stands for a status of the contract.
    pub(crate) fn with_status(message: impl Into<String>, status: crate::abi::Status) -> Self {
        Self { message: message.into(), status }
    }

    /// The words.
    pub fn message(&self) -> &str {
        &self.message
    }

    /// The contract's status.
    pub(crate) fn status(&self) -> crate::abi::Status {
        self.status
    }
}

impl fmt::Display for NodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl fmt::Debug for NodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl<E: std::error::Error> From<E> for NodeError {
    fn from(error: E) -> Self {
        let mut message = error.to_string();
        let mut source = error.source();
        while let Some(cause) = source {
            let text = cause.to_string();
            if !message.contains(&text) {
                message.push_str(": ");
                message.push_str(&text);
            }
            source = cause.source();
        }
        Self::new(message)
    }
}

/// Makes a [`NodeError`] like `format!`.
#[macro_export]
macro_rules! error {
    ($($argument:tt)*) => { $crate::NodeError::new(format!($($argument)*)) };
}
