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

    /// An error that opening the node again would not mend, such as a full disk: the host stops the node, says so and goes on without it.
    pub fn lasting(message: impl Into<String>) -> Self {
        Self::with_status(message, crate::abi::STATUS_STOPPED)
    }

    /// Whether the node is to stay closed, see [`NodeError::lasting`].
    pub fn is_lasting(&self) -> bool {
        self.status == crate::abi::STATUS_STOPPED
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

/// Whether a device takes nothing more until somebody does something about it.
fn is_full(error: &(dyn std::error::Error + 'static)) -> bool {
    use std::io::ErrorKind::{FileTooLarge, QuotaExceeded, ReadOnlyFilesystem, StorageFull};
    let kind = error.downcast_ref::<std::io::Error>().map(std::io::Error::kind);
    matches!(kind, Some(StorageFull | QuotaExceeded | ReadOnlyFilesystem | FileTooLarge))
}

/// The message with those of its causes. A full disk, as a cause, makes the error a [lasting](NodeError::lasting) one.
impl<E: std::error::Error + 'static> From<E> for NodeError {
    fn from(error: E) -> Self {
        let mut message = error.to_string();
        let mut full = is_full(&error);
        let mut source = error.source();
        while let Some(cause) = source {
            full |= is_full(cause);
            let text = cause.to_string();
            if !message.contains(&text) {
                message.push_str(": ");
                message.push_str(&text);
            }
            source = cause.source();
        }
        if full { Self::lasting(message) } else { Self::new(message) }
    }
}

/// Makes a [`NodeError`] like `format!`.
#[macro_export]
macro_rules! error {
    ($($argument:tt)*) => { $crate::NodeError::new(format!($($argument)*)) };
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug)]
    struct Outer(std::io::Error);

    impl fmt::Display for Outer {
        fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("cannot write x")
        }
    }

    impl std::error::Error for Outer {
        fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
            Some(&self.0)
        }
    }

    #[test]
    fn a_full_disk_is_a_lasting_error_wherever_it_stands_in_the_chain() {
        let io = |kind: std::io::ErrorKind| std::io::Error::from(kind);
        assert!(NodeError::from(io(std::io::ErrorKind::StorageFull)).is_lasting());
        let wrapped = NodeError::from(Outer(io(std::io::ErrorKind::QuotaExceeded)));
        assert!(wrapped.is_lasting() && wrapped.message().starts_with("cannot write x: "), "{wrapped}");
        assert!(!NodeError::from(Outer(io(std::io::ErrorKind::TimedOut))).is_lasting());
        assert!(!NodeError::new("no space left, says a node").is_lasting());
    }
}
