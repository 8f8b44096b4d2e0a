//! End of a process that runs graphs: on request, or because a plugin crashes it.
//!
//! - [`signals`]: SIGINT, SIGTERM and SIGHUP request an end; the code that runs a graph acknowledges it.
//! - [`install`]: a plugin that crashes, aborts or calls `exit` is named, the files of the other nodes are finished,
//!   and the process ends with the signal's own status (exit 1 for `exit`).
//!
//! Both programs, the command and the editor, call [`signals::install`] first, which calls [`install`], and define the
//! exit functions with [`guard_exits!`](crate::guard_exits).

mod crash;
mod exit;
mod line;
mod rescue;
pub mod signals;

pub use exit::{ExitCall, called, leave};
pub use line::write_json_lines;

/// Installs the reporting of plugin crashes. Call once, first thing in `main`.
pub fn install() {
    rescue::start();
    crash::install();
}

/// Finishes the files of all running graphs and returns a text that lists them, for an end that cannot wait for the
/// graphs.
pub(crate) fn finish_files() -> String {
    rescue::ask(rescue::LIMIT)
}

pub(crate) use rescue::register;
