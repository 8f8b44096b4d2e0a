//! How a process that runs graphs ends when it is told to, or when a plugin takes it down.
//!
//! - [`signals`]: SIGINT, SIGTERM and SIGHUP ask for an end; whoever runs a graph answers.
//! - [`install`]: a plugin that crashes, aborts or calls `exit` is named, the files of the other nodes are finished, and the process
//!   ends with the signal's own status (exit 1 for `exit`).
//!
//! Both programs, the command and the editor, call [`signals::install`] first, which calls [`install`], and define the exit functions with
//! [`guard_exits!`](crate::guard_exits).

mod crash;
mod exit;
mod rescue;
pub mod signals;
pub(crate) mod who;
mod words;

pub use exit::{ExitCall, called, leave};

/// Reports crashes of plugins from now on. Call once, first thing in `main`.
pub fn install() {
    rescue::start();
    crash::install();
}

/// Finishes the files of all graphs that run and says in words which, for an end that cannot wait for the graphs.
pub(crate) fn finish_files() -> String {
    rescue::ask(rescue::LIMIT)
}

pub(crate) use rescue::register;
