//! What the guard's loop needs of a connection to an arm, whatever its protocol.

use std::ffi::OsString;
use std::time::Duration;

use panoscope_arm_core::line::Serial;
use panoscope_arm_core::{Cause, JointVector};

use crate::link::{ArmLink, Connection};
use crate::port::PortError;
use crate::ur::{UrConnection, UrLink};

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

/// How to reach an arm.
#[derive(Clone, Debug)]
pub enum Target {
    /// An arm on a serial line.
    Serial(Connection),
    /// A Universal Robots arm.
    Ur(UrConnection),
}

impl Target {
    /// Opens the connection. Moves nothing and clears no stop of the arm.
    ///
    /// # Errors
    /// The arm cannot be reached, is in use, does not answer, or speaks another protocol.
    pub fn open(&self) -> Result<(Box<dyn ArmPort>, Identity), PortError> {
        Ok(match self {
            Self::Serial(connection) => {
                let (link, identity) = ArmLink::open(connection)?;
                (Box::new(link), identity)
            }
            Self::Ur(connection) => {
                let (link, identity) = UrLink::open(connection)?;
                (Box::new(link), identity)
            }
        })
    }

    /// Time without an answer after which the arm is stopped.
    pub fn answer_within(&self) -> Duration {
        match self {
            Self::Serial(connection) => connection.answer_within,
            Self::Ur(connection) => connection.answer_within,
        }
    }

    /// The arguments of `panoscope-arm` that name this arm.
    pub fn arguments(&self) -> Vec<OsString> {
        let option = |name: &str, value: OsString| [name.into(), value];
        let number = |name: &str, value: u128| option(name, value.to_string().into());
        let mut out = match self {
            Self::Serial(connection) => {
                [option("--port", connection.path.clone().into()), number("--baud", connection.baud.into())].concat()
            }
            Self::Ur(connection) => [
                option("--ur", connection.host.clone().into()),
                number("--rtde-port", connection.rtde_port.into()),
                number("--dashboard-port", connection.dashboard_port.into()),
                option("--home", connection.home_text().into()),
            ]
            .concat(),
        };
        out.extend(number("--answer-ms", self.answer_within().as_millis()));
        out
    }
}

impl From<&Connection> for Target {
    fn from(connection: &Connection) -> Self {
        Self::Serial(connection.clone())
    }
}

impl From<&UrConnection> for Target {
    fn from(connection: &UrConnection) -> Self {
        Self::Ur(connection.clone())
    }
}

impl From<&Target> for Target {
    fn from(target: &Target) -> Self {
        target.clone()
    }
}
