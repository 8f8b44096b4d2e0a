//! What can go wrong with a sweep.

use panoscope_graph::Diagnostics;

/// Why nothing can be swept.
#[derive(Debug, thiserror::Error)]
pub enum SweepError {
    /// The graph has mistakes.
    #[error("the graph has mistakes:\n{}", .0.render(false))]
    Check(Diagnostics),
    /// The parameter is not there, or cannot be swept.
    #[error("`{param}`: {reason}")]
    Param {
        /// As asked for.
        param: String,
        /// What is wrong, and how to correct it.
        reason: String,
    },
    /// The measure is not there, or tells no numbers.
    #[error("`{measure}`: {reason}")]
    Measure {
        /// As asked for.
        measure: String,
        /// What is wrong, and how to correct it.
        reason: String,
    },
    /// A node that acts on the world stands between the sources and the measure.
    #[error(
        "`{measure}` needs node `{node}`, which acts on the world (writes files or moves things): measure before it"
    )]
    Acts {
        /// As asked for.
        measure: String,
        /// The node.
        node: String,
    },
}

/// Why nothing was measured at one value.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{reason}")]
pub struct PointError {
    /// Why the run failed, or what it did not put out.
    pub reason: String,
}
