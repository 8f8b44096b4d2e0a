//! Options of a run, errors at its start, and its outcome.

use std::sync::Arc;
use std::time::Duration;

use super::Engine;
use crate::decide::Decider;
use crate::fault::FaultFn;
use crate::log::LogFn;
use crate::observe::Observer;
use crate::preview::{Listener, NumberListener};
use crate::trace::Tracer;

/// Environment variable with the default of [`Options::hang`], a whole number of ms above 0: for machines so busy that
/// a healthy call takes longer than [`HANG_MS`]. Anything else counts as not set.
const HANG_VARIABLE: &str = "PANOSCOPE_HANG_MS";
const HANG_MS: u64 = 2000;

fn default_hang() -> Duration {
    let given = std::env::var(HANG_VARIABLE).ok().and_then(|text| hang_ms(&text));
    Duration::from_millis(given.unwrap_or(HANG_MS))
}

fn hang_ms(text: &str) -> Option<u64> {
    text.parse().ok().filter(|ms| *ms > 0)
}

/// See [`Options::before_first_tick`].
pub type BeforeFirstTickFn = dyn FnOnce(&Engine) + Send;

/// Options of a run.
pub struct Options {
    /// Threads of the pool; 0 takes as many as the machine has.
    pub threads: usize,
    /// Ticks each source makes; `None` until the sources end or the engine is stopped.
    pub frames: Option<u64>,
    /// In live mode, sources wait until the capture time of a tick. Otherwise they run as fast as the graph takes
    /// ticks.
    pub paced: bool,
    /// Ticks of a source that may be in flight at once; `None` leaves it to the mode and queues of the graph. 1 runs
    /// one tick at a time, so that node timings do not overlap.
    pub ticks_at_once: Option<u32>,
    /// Folder that nodes resolve relative paths against.
    pub graph_dir: std::path::PathBuf,
    /// Whether files of earlier runs stay: nodes that would replace one write to the next `NAME.partN` that does not
    /// exist.
    pub keep_outputs: bool,
    /// Receives log lines.
    pub log: Option<Box<LogFn>>,
    /// Receives faults; see [`crate::fault::json_lines`].
    pub faults: Option<Box<FaultFn>>,
    /// Receives everything that happens, for example to record it.
    pub observer: Option<Arc<dyn Observer>>,
    /// Receives the times of every call, for example to show the path of a tick.
    pub tracer: Option<Arc<dyn Tracer>>,
    /// Makes the decisions that otherwise depend on time, for example to replay a run.
    pub decider: Option<Arc<dyn Decider>>,
    /// Called when all nodes are open, before the first tick, for example to add previews that miss no packet.
    pub before_first_tick: Option<Box<BeforeFirstTickFn>>,
    /// Listeners that receive all packets of a port.
    pub listen: Vec<Listener>,
    /// Nodes whose metrics a listener receives, each when the node reports it; one listener for a node.
    pub numbers: Vec<NumberListener>,
    /// A call without a budget that takes longer counts as hung in live mode; in batch, 30 times as long. From
    /// [`Engine::stop`](crate::Engine::stop) on, any call that takes longer counts as hung in both. The default is 2 s,
    /// or what the environment variable `PANOSCOPE_HANG_MS` says.
    pub hang: Duration,
    /// Time limit for opening a node: at the start, in a change and after a fault.
    pub open_limit: Duration,
    /// Time limit for closing a node, and for saving or loading its state while the graph runs.
    pub close_limit: Duration,
    /// Maximum number of bytes of private memory that the process of a group of isolated nodes may have.
    pub group_memory_bytes: u64,
    /// Whether the standard error of a group's process goes into the message about its end instead of to this process's
    /// standard error.
    pub keep_group_stderr: bool,
    /// Heap allocations of the process so far, where the program counts them.
    pub process_allocations: Option<fn() -> u64>,
    /// Heap allocations of the calling thread so far, where the program counts them.
    pub thread_allocations: Option<fn() -> u64>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            threads: 0,
            frames: None,
            paced: true,
            ticks_at_once: None,
            graph_dir: std::path::PathBuf::new(),
            keep_outputs: false,
            log: None,
            faults: None,
            observer: None,
            tracer: None,
            decider: None,
            before_first_tick: None,
            listen: Vec::new(),
            numbers: Vec::new(),
            hang: default_hang(),
            open_limit: Duration::from_secs(30),
            close_limit: Duration::from_secs(10),
            group_memory_bytes: 8 << 30,
            keep_group_stderr: false,
            process_allocations: None,
            thread_allocations: None,
        }
    }
}

/// A graph that did not start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// A node did not open.
    #[error("node `{node}` ({node_type}) did not open: {reason}")]
    Open {
        /// The node's name.
        node: String,
        /// Its type.
        node_type: String,
        /// The node's message.
        reason: String,
    },
    /// The graph no longer fits the loaded plugins.
    #[error("{reason}; check the graph again")]
    Stale {
        /// The changed parts.
        reason: String,
    },
    /// The system gave no thread.
    #[error("no thread could be started: {cause}")]
    Thread {
        /// The system's error.
        cause: std::io::Error,
    },
}

/// A parameter that was not changed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SetError {
    /// No such node.
    #[error("there is no node `{node}`")]
    NoNode {
        /// As given by the caller.
        node: String,
    },
    /// No such parameter.
    #[error("node `{node}` has no parameter `{param}`")]
    NoParam {
        /// The node.
        node: String,
        /// As given by the caller.
        param: String,
    },
    /// The value does not fit the declaration.
    #[error("`{node}.{param}`: {reason}")]
    BadValue {
        /// The node.
        node: String,
        /// The parameter.
        param: String,
        /// Description of the problem.
        reason: String,
    },
    /// The node did not open with the new value; the old one stays in force.
    #[error("node `{node}` did not open with the new value, the old one stays: {reason}")]
    Reopen {
        /// The node.
        node: String,
        /// The node's message.
        reason: String,
    },
}

/// Result of a run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Outcome {
    /// All sources ended, or the engine was asked to stop.
    Done,
    /// A node failed and the graph said to stop.
    Failed(String),
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_of_a_hang_is_a_whole_number_of_ms_above_0() {
        assert_eq!(hang_ms("60000"), Some(60_000));
        for wrong in ["", "0", "-1", "2.5", "2 s"] {
            assert_eq!(hang_ms(wrong), None, "{wrong:?}");
        }
    }
}
