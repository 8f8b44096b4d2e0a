//! The error that a node's calls return.

use std::fmt;

/// Failure of a node, with a message for the user.
pub struct NodeError {
    message: String,
    status: crate::abi::Status,
}

/// Result of a node's calls.
pub type Result<T, E = NodeError> = std::result::Result<T, E>;

impl NodeError {
    /// An error with the message to show. The host may open the node again.
    pub fn new(message: impl Into<String>) -> Self {
        Self { message: message.into(), status: crate::abi::STATUS_ERROR }
    }

    /// An error that a restart of the node would not fix, such as a full disk: the host stops the node, reports it and
    /// continues without it.
    pub fn lasting(message: impl Into<String>) -> Self {
        Self::with_status(message, crate::abi::STATUS_STOPPED)
    }

    /// Whether the node must stay closed, see [`NodeError::lasting`].
    pub fn is_lasting(&self) -> bool {
        self.status == crate::abi::STATUS_STOPPED
    }

    /// Whether the host has no frame memory left for an output: the tick is dropped or made again, the node goes on.
    pub fn is_exhausted(&self) -> bool {
        self.status == crate::abi::STATUS_EXHAUSTED
    }

    /// For sources: the source has ended before its data was complete. The host counts a fault and does not open the
    /// source again.
    pub fn ended_early(message: impl Into<String>) -> Self {
        Self::with_status(message, crate::abi::STATUS_END)
    }

    /// An error with a status of the ABI.
    pub(crate) fn with_status(message: impl Into<String>, status: crate::abi::Status) -> Self {
        Self { message: message.into(), status }
    }

    /// The message, without the status.
    pub fn message(&self) -> &str {
        &self.message
    }

    /// The status that the call returns to the host.
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

/// Whether writes fail until the disk is freed or unlocked.
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
