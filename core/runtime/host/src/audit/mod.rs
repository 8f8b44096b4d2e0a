//! The audit log of the theatre: what was opened, changed, recorded and overridden, and faults.
//!
//! A log is a folder with one file per day (UTC) of JSON lines. Every line has a number, the hash of the line before it
//! and its own hash, so that a changed, missing or added line is found by [`read`]. Lines are only appended, each
//! reaches the disk before the next, and a line that a crash cut off stays where it is: the next line names it. The
//! file `head.json` has the number and hash of the last line, so that a cut-off end is found as well.
//!
//! The log proves damage and careless changes. A user who may write the folder can also write a new log with valid
//! hashes; against that, keep the last hash elsewhere, which [`Report::last`] gives.
//!
//! It holds no patient data: [`Event`] has no field for what a user types.

mod auditor;
mod chain;
mod day;
mod event;
mod files;
mod log;
mod read;

pub use auditor::Auditor;
pub use day::{date, date_and_time};
pub use event::{ClipState, Event, LockFacts};
pub use log::{AuditError, Log};
pub use read::{Entry, Problem, Report, read};

use std::path::PathBuf;

/// The folder of a log if there is no user.
pub const SYSTEM_FOLDER: &str = "/var/lib/panoscope/audit";

/// The folder of the user's audit log: `panoscope/audit` in `$XDG_STATE_HOME` or `~/.local/state`. `None` if neither is
/// set.
pub fn folder() -> Option<PathBuf> {
    let absolute = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let state = absolute("XDG_STATE_HOME").or_else(|| Some(absolute("HOME")?.join(".local/state")));
    state.map(|state| state.join("panoscope/audit"))
}
