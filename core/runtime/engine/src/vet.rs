//! Which nodes are opened on trial in a separate process before they open in this one, because a foreign file can crash
//! its reader.

use std::time::Duration;

use panoscope_graph::ParamValue;

use crate::isolation::GroupError;

/// A node that is about to open: at the start of a run, in a change, with new values, or after a fault.
#[derive(Clone, Debug)]
pub struct Opening<'a> {
    /// Name of the node.
    pub node: &'a str,
    /// File of its plugin; empty when it is not known.
    pub plugin_file: &'a str,
    /// Names and values of its parameters, in declaration order.
    pub params: Vec<(&'a str, &'a ParamValue)>,
}

/// Limits of a trial.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TrialLimits {
    /// Maximum number of bytes of private memory of the process.
    pub memory_bytes: u64,
    /// Maximum time for starting the process and opening the node there.
    pub time: Duration,
}

/// A node did not open on trial.
#[derive(Debug, thiserror::Error)]
pub enum TrialError {
    /// The trial has no process.
    #[error(transparent)]
    Group(#[from] GroupError),
    /// The system gave no thread.
    #[error("no thread could be started to watch its trial: {cause}")]
    Thread {
        /// The system's error.
        cause: std::io::Error,
    },
    /// The node refused, or its process ended.
    #[error("{message}")]
    Node {
        /// The node's message.
        message: String,
    },
}

/// The reason for which a node must not open in the process of the graph.
#[derive(Debug, thiserror::Error)]
pub enum VetError {
    /// Its trial failed with a message that names the mistake.
    #[error(transparent)]
    Trial(#[from] TrialError),
    /// Its trial failed because of these files.
    #[error("{} cannot be used: {cause}", files.join(", "))]
    Files {
        /// The files.
        files: Vec<String>,
        /// Failure of the trial.
        cause: TrialError,
    },
}

/// Opens the node of an [`Opening`] in a separate process within limits, closes it there and ends the process.
pub type TrialFn<'a> = dyn FnMut(&TrialLimits) -> Result<(), TrialError> + 'a;

/// Decides which nodes are opened on trial. See [`crate::Plugins::vet`].
pub trait Vet: Send + Sync {
    /// Returns `Ok` when the node may open. Called off the hot path, on the thread that opens the node and within the
    /// time limit of opening.
    ///
    /// # Errors
    /// The node must not open here.
    fn vet(&self, opening: &Opening<'_>, trial: &mut TrialFn<'_>) -> Result<(), VetError>;
}
