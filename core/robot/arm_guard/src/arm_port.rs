//! Interface of the guard's loop to an arm, independent of the protocol.

use std::time::Duration;

use panoscope_arm_core::line::Serial;
use panoscope_arm_core::{Cause, JointVector};

use crate::port::PortError;

/// Identity that the arm reports.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Identity {
    /// Serial number.
    pub serial: Serial,
    /// Time limit of the arm's own watchdog, ms.
    pub watchdog_ms: u32,
}

/// The newest answer of the arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Answer {
    /// Encoder angles, rad.
    pub encoders: JointVector,
    /// Cause of the arm's own stop; `None` when it follows set-points.
    pub stop: Option<Cause>,
    /// Send time of the answered question, ns, so that a delayed answer counts as old as its question.
    pub answered_ns: i64,
    /// Time of the encoder angles, ns, on a clock that only these times share.
    pub measured_ns: i64,
    /// Damaged or unmatched answers since the last valid one.
    pub damaged: u32,
}

impl Default for Answer {
    fn default() -> Self {
        Self { encoders: JointVector::zeros(), stop: None, answered_ns: i64::MIN, measured_ns: i64::MIN, damaged: 0 }
    }
}

/// An open connection to an arm. Each call but `listen` sends one numbered question; the arm's answer states the last
/// question that it received.
pub trait ArmPort {
    /// Reads all answers that have arrived.
    ///
    /// # Errors
    /// The connection was lost, or the received data cannot be parsed.
    fn listen(&mut self) -> Result<(), PortError>;

    /// Asks for the state. Adds no movement.
    ///
    /// # Errors
    /// The connection was lost.
    fn query(&mut self) -> Result<(), PortError>;

    /// Sends a set-point: angles, rad, and speeds, rad/s.
    ///
    /// # Errors
    /// The connection was lost.
    fn set(&mut self, position: &JointVector, velocity: &JointVector) -> Result<(), PortError>;

    /// Asks the arm to clear its own stop, after a person's reset. [`Answer::stop`] shows whether it did.
    ///
    /// # Errors
    /// The connection was lost.
    fn clear(&mut self) -> Result<(), PortError>;

    /// The newest answer.
    fn answer(&self) -> &Answer;

    /// Resets the count of damaged answers.
    fn forgive(&mut self);

    /// The arm's identity as it was last reported.
    fn identity(&self) -> Option<Identity>;

    /// Time between two calls of `query` or `set`.
    fn period(&self) -> Duration;
}
