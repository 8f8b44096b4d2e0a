//! What the guard's loop needs of a connection to an arm, whatever its protocol.

use std::time::Duration;

use panoscope_arm_core::line::Serial;
use panoscope_arm_core::{Cause, JointVector};

use crate::port::PortError;

/// What the arm reports about itself.
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
    /// Why the arm stopped by itself, or must not move; `None` when it follows set-points.
    pub stop: Option<Cause>,
    /// When the question was sent that the answer belongs to, ns: an answer that was held up on its way counts as old as its question.
    pub answered_ns: i64,
    /// Time of the encoder angles, ns, on a clock that only these times share.
    pub measured_ns: i64,
    /// Damaged answers, and answers to no question, since the last valid one.
    pub damaged: u32,
}

impl Default for Answer {
    fn default() -> Self {
        Self { encoders: JointVector::zeros(), stop: None, answered_ns: i64::MIN, measured_ns: i64::MIN, damaged: 0 }
    }
}

/// An open connection to an arm. Each call but `listen` sends one numbered question; the arm's answer says which one it has seen last.
pub trait ArmPort {
    /// Reads all answers that have arrived.
    ///
    /// # Errors
    /// The connection was lost, or what arrives cannot be read.
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

    /// Asks the arm to clear its own stop, after a person's reset. [`Answer::stop`] says whether it did.
    ///
    /// # Errors
    /// The connection was lost.
    fn clear(&mut self) -> Result<(), PortError>;

    /// The newest answer.
    fn answer(&self) -> &Answer;

    /// Starts counting damaged answers again.
    fn forgive(&mut self);

    /// The arm's identity as it was last reported.
    fn identity(&self) -> Option<Identity>;

    /// Time between two calls of `query` or `set`.
    fn period(&self) -> Duration;
}
