//! What a change did, and why it was not made.

use std::time::Duration;

use serde::{Deserialize, Serialize};

/// What a change did, by node name.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Applied {
    /// New nodes.
    pub added: Vec<String>,
    /// Nodes that are gone.
    pub removed: Vec<String>,
    /// Nodes of another type, or of a rebuilt plugin.
    pub replaced: Vec<String>,
    /// Nodes opened anew with other values.
    pub reopened: Vec<String>,
    /// Nodes whose inputs changed.
    pub rewired: Vec<String>,
    /// Nodes with other values that need no reopening.
    pub tuned: Vec<String>,
    /// Time during which no tick entered the parts that were changed; zero when none was held up.
    pub pause: Duration,
    /// For each source whose region was switched: its name and the number of its first tick after the switch at the latest.
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

/// Why a change was not made; everything is as before.
#[derive(Debug, thiserror::Error)]
pub enum ApplyError {
    /// A node did not open.
    #[error("node `{node}` ({node_type}) did not open, nothing was changed: {reason}")]
    Open {
        /// The node's name.
        node: String,
        /// Its type.
        node_type: String,
        /// What it said.
        reason: String,
    },
    /// A node did not come to an answer.
    #[error("node `{node}`, nothing was changed: {reason}")]
    NoReturn {
        /// The node's name.
        node: String,
        /// What it did not return from, and after what time.
        reason: String,
    },
    /// The graph does not fit the loaded plugins any more.
    #[error("{reason}; check the graph again")]
    Stale {
        /// What changed.
        reason: String,
    },
    /// `live` and `batch` do not mix.
    #[error("the mode cannot change while the graph runs")]
    Mode,
    /// The graph has come to its end.
    #[error("the graph does not run any more")]
    Ended,
    /// The tick to switch at has entered the graph.
    #[error(
        "tick {seq} of `{source_node}` has passed, nothing was changed: tick {next} is the first that can be kept out"
    )]
    Passed {
        /// The source.
        source_node: String,
        /// As asked for.
        seq: u64,
        /// The first tick that has not entered.
        next: u64,
    },
    /// A tick was named of something that makes none.
    #[error("`{node}` is no source of the running graph, nothing was changed: ticks are named by their source")]
    NoSource {
        /// As asked for.
        node: String,
    },
    /// Ticks under way did not come to their end.
    #[error("node `{node}` did not come to rest within {seconds} s, nothing was changed")]
    Busy {
        /// A node that still works.
        node: String,
        /// How long was waited.
        seconds: u64,
    },
}
