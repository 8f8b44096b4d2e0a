//! Runs nodes of a graph in processes of their own.
//!
//! The nodes of one *group* share a child process. [`Processes`] attaches to the engine and makes the groups; [`child::serve`] is the
//! child's main loop. Pixels are never copied: the child maps the host's frame pools read-only and writes pools of its own, which the
//! host maps too. Each open instance has a *lane*, a page of shared memory on which host and child take turns:
//!
//! - The host posts a request (open, process, close, ...) and waits.
//! - The child calls the plugin. Host functions that the plugin calls are posted back on the same lane and run on the waiting host thread, so
//!   that reference counts, claims of files, random numbers, ages and logs are those of the host.
//! - The child posts the result.
//!
//! The host trusts nothing that the child writes: messages are copied before they are read, every length is checked, buffers are named by
//! (pool, offset), and a message that makes no sense ends the process.

pub mod child;
mod host;
mod lane;
mod socket;
mod wire;

pub use host::{PluginImage, Processes, remember};

/// First argument of the program that makes it the child process of a group: `panoscope isolated-nodes GROUP`. Its standard input is the socket;
/// the name is for lists of processes.
pub const COMMAND: &str = "isolated-nodes";

/// Incremented when the messages change: host and child must be of one build.
pub(crate) const PROTOCOL: u32 = 1;
