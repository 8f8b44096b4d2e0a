//! The ends of a wire.

use serde::{Deserialize, Serialize};

/// An output: node and port.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Output {
    /// The node.
    pub node: String,
    /// Its output.
    pub port: String,
}

impl Output {
    /// Output `port` of node `node`.
    pub fn new(node: &str, port: &str) -> Self {
        Self { node: node.to_owned(), port: port.to_owned() }
    }
}

impl std::fmt::Display for Output {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}.{}", self.node, self.port)
    }
}

/// The consuming end of a wire.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct WireEnd {
    /// The node.
    pub node: String,
    /// Its input: index in the node type.
    pub port: usize,
    /// Index in a list input.
    pub index: usize,
}
