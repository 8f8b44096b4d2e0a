//! How a graph is run, why it does not start, and how it ended.

use std::sync::Arc;
use std::time::Duration;

use crate::decide::Decider;
use crate::fault::FaultFn;
use crate::log::LogFn;
use crate::observe::Observer;
use crate::preview::{Listener, NumberListener};

/// How a graph is run.
pub struct Options {
    /// Threads of the pool; 0 takes as many as the machine has.
    pub threads: usize,
    /// Ticks each source makes; `None` until the sources end or the engine is stopped.
    pub frames: Option<u64>,
    /// In live mode, sources wait until the capture time of a tick has come. Without it they go as fast as the graph takes ticks.
    pub paced: bool,
    /// Ticks of a source that may be under way at once; `None` lets as many in as the mode and the queues of the graph say. With 1
    /// each tick has the machine for itself, as whoever times nodes wants it.
    pub ticks_at_once: Option<u32>,
    /// Folder that relative paths start from, shown to nodes.
    pub graph_dir: std::path::PathBuf,
    /// Takes log lines as they come.
    pub log: Option<Box<LogFn>>,
    /// Takes faults as they happen; see [`crate::fault::json_lines`].
    pub faults: Option<Box<FaultFn>>,
    /// Hears what happens, for instance to write it down.
    pub observer: Option<Arc<dyn Observer>>,
    /// Decides what otherwise depends on time, for instance as an earlier run had it.
    pub decider: Option<Arc<dyn Decider>>,
    /// Ports whose every packet is heard.
    pub listen: Vec<Listener>,
    /// A node whose told numbers are heard, each as it is told.
    pub numbers: Option<NumberListener>,
    /// A call of a node without a budget that takes longer does not return, in live mode; in batch, 30 times that.
    pub hang: Duration,
    /// Longest that a node may take to open: at the start, in a change and after a fault.
    pub open_limit: Duration,
    /// Longest that a node may take to close, to save a state or to take one over while the graph runs.
    pub close_limit: Duration,
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
            log: None,
            faults: None,
            observer: None,
            decider: None,
            listen: Vec::new(),
            numbers: None,
            hang: Duration::from_secs(2),
            open_limit: Duration::from_secs(30),
            close_limit: Duration::from_secs(10),
            process_allocations: None,
            thread_allocations: None,
        }
    }
}

/// Why a graph did not start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// A node did not open.
    #[error("node `{node}` ({node_type}) did not open: {reason}")]
    Open {
        /// The node's name.
        node: String,
        /// Its type.
        node_type: String,
        /// What it said.
        reason: String,
    },
    /// The graph does not fit the loaded plugins any more.
    #[error("{reason}; check the graph again")]
    Stale {
        /// What changed.
        reason: String,
    },
    /// The system gave no thread.
    #[error("no thread could be started: {cause}")]
    Thread {
        /// What the system says.
        cause: std::io::Error,
    },
}

/// Why a parameter was not changed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SetError {
    /// No such node.
    #[error("there is no node `{node}`")]
    NoNode {
        /// As asked for.
        node: String,
    },
    /// No such parameter.
    #[error("node `{node}` has no parameter `{param}`")]
    NoParam {
        /// The node.
        node: String,
        /// As asked for.
        param: String,
    },
    /// The value does not fit the declaration.
    #[error("`{node}.{param}`: {reason}")]
    BadValue {
        /// The node.
        node: String,
        /// The parameter.
        param: String,
        /// What is wrong with the value.
        reason: String,
    },
    /// The node did not open with the new value; the old one stays in force.
    #[error("node `{node}` did not open with the new value, the old one stays: {reason}")]
    Reopen {
        /// The node.
        node: String,
        /// What it said.
        reason: String,
    },
}

/// How a run ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Outcome {
    /// All sources ended, or the engine was asked to stop.
    Done,
    /// A node failed and the graph said to stop.
    Failed(String),
}
