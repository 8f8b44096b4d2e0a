//! The terminal as the session of evaluations and benches.

use panoscope_eval::{AllocationCounters, Session};

use panoscope_cli::terminal::{log, raw};
use panoscope_cli::{allocations, interrupt};

/// Progress goes to standard error, tables to standard output; a signal cancels.
pub struct Terminal;

impl Session for Terminal {
    fn note(&self, line: &str) {
        log!("{line}");
    }

    fn table(&self, text: &str) {
        raw(text);
    }

    fn is_cancelled(&self) -> bool {
        interrupt::asked()
    }

    fn allocation_counters(&self) -> AllocationCounters {
        AllocationCounters { process: allocations::process(), thread: allocations::thread() }
    }
}
