//! The result of a change of the graph, and its errors.

use std::time::Duration;

use serde::{Deserialize, Serialize};

/// The effects of a change, by node name.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Applied {
    /// New nodes.
    pub added: Vec<String>,
    /// Removed nodes.
    pub removed: Vec<String>,
    /// Nodes of another type, or of a rebuilt plugin.
    pub replaced: Vec<String>,
    /// Nodes reopened for new values.
    pub reopened: Vec<String>,
    /// Nodes whose inputs changed.
    pub rewired: Vec<String>,
    /// Nodes whose new values took effect without reopening.
    pub tuned: Vec<String>,
    /// Time during which no tick entered the changed regions; zero if none was held.
    pub pause: Duration,
    /// For each source whose region was held: its name and the number of its first tick after the switch.
    pub switched_at: Vec<(String, u64)>,
}

impl Applied {
    /// Whether both graphs were the same.
    pub fn is_nothing(&self) -> bool {
        let lists = [&self.added, &self.removed, &self.replaced, &self.reopened, &self.rewired, &self.tuned];
        lists.iter().all(|list| list.is_empty())
    }
}

impl std::fmt::Display for Applied {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let lists = [
            ("added", &self.added),
            ("removed", &self.removed),
            ("replaced", &self.replaced),
            ("reopened", &self.reopened),
            ("rewired", &self.rewired),
            ("tuned", &self.tuned),
        ];
        for (done, nodes) in lists.into_iter().filter(|(_, nodes)| !nodes.is_empty()) {
            write!(f, "{done} {}; ", nodes.join(", "))?;
        }
        write!(f, "paused {:.1} ms", self.pause.as_secs_f64() * 1e3)
    }
}

/// A change that failed; the running graph is unchanged.
#[derive(Debug, thiserror::Error)]
pub enum ApplyError {
    /// A node did not open.
    #[error("node `{node}` ({node_type}) did not open, nothing was changed: {reason}")]
    Open {
        /// The node's name.
        node: String,
        /// Its type.
        node_type: String,
        /// The node's message.
        reason: String,
    },
    /// A node did not return from a call.
    #[error("node `{node}`, nothing was changed: {reason}")]
    NoReturn {
        /// The node's name.
        node: String,
        /// The call and how long the engine waited.
        reason: String,
    },
    /// The graph no longer fits the loaded plugins.
    #[error("{reason}; check the graph again")]
    Stale {
        /// The changed parts.
        reason: String,
    },
    /// `live` and `batch` do not mix.
    #[error("the mode cannot change while the graph runs")]
    Mode,
    /// The graph has ended.
    #[error("the graph has ended")]
    Ended,
    /// The tick to switch at has already entered the graph.
    #[error(
        "tick {seq} of `{source_node}` has passed, nothing was changed: the first tick that can still be kept out is {next}"
    )]
    Passed {
        /// The source.
        source_node: String,
        /// As given by the caller.
        seq: u64,
        /// The tick after which the graph should change has already entered the graph.
        next: u64,
    },
    /// A tick was given for a node that is not a source.
    #[error("`{node}` is not a source of the running graph, nothing was changed: name the source of the tick")]
    NoSource {
        /// As given by the caller.
        node: String,
    },
    /// Ticks in flight did not finish before the frames that wait filled the frame memory.
    #[error(
        "node `{node}` did not come to rest before the frames that wait took {waiting_mb} MB, most of the free frame memory; nothing was changed"
    )]
    Memory {
        /// A node that is still busy.
        node: String,
        /// Frames that waited.
        waiting_mb: i64,
    },
    /// Ticks in flight did not finish in time.
    #[error("node `{node}` did not come to rest within {seconds} s, nothing was changed")]
    Busy {
        /// A node that is still busy.
        node: String,
        /// Duration of the wait.
        seconds: u64,
    },
}
