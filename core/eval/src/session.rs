//! Interface between a measurement and its caller.

use crate::error::{EvalError, Result};

/// Counters of heap allocations, for benches that report allocations per frame.
#[derive(Clone, Copy, Debug, Default)]
pub struct AllocationCounters {
    /// Allocations of the process so far.
    pub process: Option<fn() -> u64>,
    /// Allocations of the calling thread so far.
    pub thread: Option<fn() -> u64>,
}

/// Reports of a running measurement, and requests to its caller.
///
/// The library writes to no terminal and handles no signal: a command prints the reports, an editor shows them, a test
/// ignores them.
pub trait Session: Sync {
    /// One line of progress, or a warning. A skipped case starts with `skipped:`.
    fn note(&self, line: &str) {
        let _ = line;
    }

    /// An intermediate table as text, with its line breaks.
    fn table(&self, text: &str) {
        let _ = text;
    }

    /// Whether the caller wants the measurement to end. Called at least between two runs of a graph and ten times per
    /// second during one.
    fn is_cancelled(&self) -> bool {
        false
    }

    /// Counters of heap allocations, if the program counts them.
    fn allocation_counters(&self) -> AllocationCounters {
        AllocationCounters::default()
    }
}

/// A session that reports nothing and is never cancelled.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Session for Silent {}

/// Returns [`EvalError::Cancelled`] if the caller wants the measurement to end.
pub(crate) fn check_cancelled(session: &dyn Session) -> Result<()> {
    if session.is_cancelled() { Err(EvalError::Cancelled) } else { Ok(()) }
}

/// Reports a line of progress.
macro_rules! note {
    ($session:expr, $($argument:tt)*) => { $session.note(&format!($($argument)*)) };
}

pub(crate) use note;
