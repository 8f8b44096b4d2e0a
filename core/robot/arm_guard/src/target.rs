//! Connection to an arm, for every protocol.

use std::ffi::OsString;
use std::time::Duration;

use crate::arm_port::{ArmPort, Identity};
use crate::link::{ArmLink, Connection};
use crate::port::PortError;
use crate::ur::{UrConnection, UrLink};

/// Connection to an arm.
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
