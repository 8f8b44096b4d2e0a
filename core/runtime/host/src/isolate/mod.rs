//! Runs nodes of a graph in separate processes.
//!
//! The nodes of one *group* share a child process. [`Processes`] attaches to the engine and makes the groups;
//! [`child::serve`] is the child's main loop. Pixels are never copied: the child maps the host's frame pools read-only
//! and writes its own pools, which the host maps too. Each open instance has a *lane*, a page of shared memory on which
//! host and child take turns:
//!
//! - The host posts a request (open, process, close, ...) and waits. With the request of a tick it sends data that the
//!   node is likely to ask for: a buffer for each output, ages that were asked for before, the clock.
//! - The child calls the plugin. Of the host functions that the plugin calls, those without a result that it needs at
//!   once are written down; the others are posted back on the same lane and run on the waiting host thread.
//! - The child posts the result. Whatever was written down goes in front of each message, and the host runs it first,
//!   in order, so that reference counts, claims of files, ages and logs are those of the host. A tick of an ordinary
//!   filter costs one wake each way.
//!
//! The host trusts nothing that the child writes: messages are copied before they are read, every length is checked,
//! buffers are named by (pool, offset), and a malformed message ends the process.

pub mod child;
mod confine;
mod description;
mod host;
mod lane;
pub mod relay;
mod socket;
mod wire;

#[doc(hidden)]
pub use host::played;

pub use confine::{Kernel, kernel};
pub use host::{
    DescribeError, Describer, Description, Launch, PluginImage, Processes, describe, remember, remember_described,
};

/// First argument of the program that makes it the child process of a group: `panoscope isolated-nodes GROUP`. Its
/// standard input is the socket; the name is for lists of processes.
pub const COMMAND: &str = "isolated-nodes";

/// Name of the program that links machines. It is next to this program, which therefore needs no network library.
pub const MACHINE_PROGRAM: &str = "panoscope-machine";

/// First argument of [`MACHINE_PROGRAM`] that makes it the link of a group that runs on another machine:
/// `panoscope-machine link ... MACHINE`. Its standard input is the socket, as for [`COMMAND`].
pub const LINK_COMMAND: &str = "link";

/// Exit status of a link that lost its machine or was refused; its standard error has the reason.
pub const EXIT_LINK: i32 = 88;

/// Exit status of a process that could not be confined.
pub(crate) const EXIT_CONFINED: i32 = 87;

/// Incremented when the messages change: host and child must be of one build.
pub const PROTOCOL: u32 = 6;

/// The system's monotonic clock, the same in host and child.
pub fn system_ns() -> i64 {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: only writes the struct.
    unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &raw mut time) };
    time.tv_sec.saturating_mul(1_000_000_000).saturating_add(time.tv_nsec)
}
