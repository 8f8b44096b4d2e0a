//! A file of a lock: its role, name and fingerprint.

use std::fmt;

use serde::{Deserialize, Serialize};

/// The role of a file in a graph.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// The graph file itself.
    Graph,
    /// A part of the graph.
    Part,
    /// An overlay.
    Overlay,
    /// A plugin.
    Plugin,
    /// A shared library that a plugin needs, directly or not.
    Library,
    /// A program of the installation.
    Program,
    /// A neural network.
    Model,
    /// Weights of a neural network in a file next to it.
    Weights,
    /// ONNX Runtime, which runs neural networks.
    Runtime,
    /// A calibration file of a camera.
    Calibration,
    /// Another file that a node reads, such as the description of an arm or the names of classes.
    File,
    /// Recorded images that a source reads instead of a camera.
    Input,
}

impl Kind {
    pub(crate) const fn word(self) -> &'static str {
        match self {
            Self::Graph => "graph",
            Self::Part => "part",
            Self::Overlay => "overlay",
            Self::Plugin => "plugin",
            Self::Library => "library",
            Self::Program => "program",
            Self::Model => "model",
            Self::Weights => "weights",
            Self::Runtime => "runtime",
            Self::Calibration => "calibration",
            Self::File => "file",
            Self::Input => "input",
        }
    }

    /// Whether files of this role are known, and compared, before any code of a plugin runs.
    pub fn is_code(self) -> bool {
        matches!(self, Self::Graph | Self::Part | Self::Overlay | Self::Plugin | Self::Library | Self::Program)
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.word())
    }
}

/// A file's name and fingerprint.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LockedFile {
    /// Its role.
    pub kind: Kind,
    /// Name of the plugin, library, program or graph file; `node.param` for a file that a node reads.
    pub name: String,
    /// Length in bytes.
    pub bytes: u64,
    /// SHA-256 as hexadecimal digits; empty when the file cannot be read.
    pub sha256: String,
}
