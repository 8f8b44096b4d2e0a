//! Which nodes are tried in a process of their own before they open in this one: reading a foreign file can crash the reader.

use std::time::Duration;

use panoscope_graph::ParamValue;

/// A node that is about to open: at the start of a run, in a change, with new values, or again after a fault.
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
    /// Most bytes of private memory of the process.
    pub memory_bytes: u64,
    /// Longest time for starting the process and opening the node there.
    pub time: Duration,
}

/// Decides which nodes are tried. See [`crate::Plugins::vet`].
pub trait Vet: Send + Sync {
    /// Returns when the node may open. `trial` opens the node with the same values in a process of its own, closes it there and ends the process.
    /// Called off the hot path, on the thread that opens the node and within the time limit of opening.
    ///
    /// # Errors
    /// Why the node must not open here, for the user.
    fn vet(
        &self,
        opening: &Opening<'_>,
        trial: &mut dyn FnMut(&TrialLimits) -> Result<(), String>,
    ) -> Result<(), String>;
}
