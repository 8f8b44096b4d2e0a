//! Errors of a sweep.

use panoscope_graph::Diagnostics;

/// Maximum number of values of one sweep.
pub const MAX_STEPS: usize = 1000;

/// A sweep that cannot run.
#[derive(Debug, thiserror::Error)]
pub enum SweepError {
    /// The graph has mistakes.
    #[error("the graph has mistakes:\n{}", .0.render(false))]
    Check(Diagnostics),
    /// The parameter does not exist or cannot be swept.
    #[error("`{param}`: {reason}")]
    Param {
        /// Parameter as requested.
        param: String,
        /// The problem and its correction.
        reason: String,
    },
    /// The measure does not exist, or has no numbers.
    #[error("`{measure}`: {reason}")]
    Measure {
        /// Measure as requested.
        measure: String,
        /// The problem and its correction.
        reason: String,
    },
    /// A node with side effects is between the sources and the measure.
    #[error(
        "`{measure}` needs node `{node}`, which has side effects (writes files or moves devices): choose a measure upstream of it"
    )]
    Acts {
        /// Measure as requested.
        measure: String,
        /// Name of the node.
        node: String,
    },
}

/// A run without a measurement.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{reason}")]
pub struct PointError {
    /// Reason: the failure of the run, or the output without packets.
    pub reason: String,
}

/// A parameter that has no values to sweep.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub(super) enum ValuesError {
    #[error("it has no limits: give both ends of the range")]
    Unbounded,
    #[error("no allowed value lies between {from} and {to}: the step is {step}")]
    NoneAllowed { from: f64, to: f64, step: f64 },
    #[error("{kind} cannot be swept: choose a number, a switch or a choice")]
    Kind { kind: String },
    #[error("both ends must be finite numbers")]
    NotFinite,
    #[error("{steps} steps: the number of values must be 2 to {MAX_STEPS}")]
    Steps { steps: usize },
    #[error("both ends are {end}: give two different values")]
    Empty { end: f64 },
    #[error("{value}: {reason}")]
    Refused { value: String, reason: String },
}

/// An invalid row of a table.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`[{index}]` is not a row: write {column}[1] for the first one, {column}[*] for all")]
pub(super) struct RowError {
    pub column: String,
    pub index: String,
}

/// A graph's text that cannot be reduced to a part of it.
#[derive(Debug, thiserror::Error)]
pub(super) enum PartError {
    #[error("{}", .0.message())]
    Read(#[from] toml::de::Error),
    #[error(transparent)]
    Write(#[from] toml::ser::Error),
}
