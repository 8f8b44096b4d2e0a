//! Finds the gains of the controller on a simulated arm: by relay feedback and rules, and by a search that minimises a
//! stated cost.

pub mod course;
pub mod relay;
pub mod search;

use thiserror::Error;

/// Gains that could not be found.
#[derive(Debug, Error, PartialEq)]
pub enum TuneError {
    /// Invalid parameters of the relay.
    #[error("the relay's {what} is {value}; it must be above 0")]
    BadRelay {
        /// Which of its numbers.
        what: &'static str,
        /// Value of the number.
        value: f64,
    },
    /// The loop does not oscillate.
    #[error(
        "the loop oscillated {periods} times in {seconds:.1} s, but 12 periods are needed: give the relay a larger amplitude, or less hysteresis"
    )]
    NoSwing {
        /// Whole periods observed.
        periods: usize,
        /// Time observed, s.
        seconds: f64,
    },
    /// The oscillation does not become steady.
    #[error("after {seconds:.1} s periods of the loop still differ by {:.0} %: the limit of stability is unknown", share * 100.0)]
    Uneven {
        /// Largest difference, as a share of the mean period.
        share: f64,
        /// Time observed, s.
        seconds: f64,
    },
    /// The loop's output is not finite.
    #[error("the loop returned a value that is not finite after {at_s:.2} s")]
    NotFinite {
        /// Time, s.
        at_s: f64,
    },
    /// The arm does not follow.
    #[error("the simulated arm stopped after {at_s:.2} s: {cause}; it cannot be tuned with these parameters")]
    Stopped {
        /// Time, s.
        at_s: f64,
        /// Reason, as text of the interlock.
        cause: String,
    },
}
