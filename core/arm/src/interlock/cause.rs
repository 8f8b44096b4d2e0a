//! Why the arm stands still.

use std::fmt;

/// Why the arm is stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// A person stopped it; latches.
    EmergencyStop,
    /// The arm does not follow its set-points; latches.
    NotFollowing,
    /// The connection to the device was lost; latches.
    Unplugged,
    /// The device's answers are invalid; latches.
    Garbage,
    /// The device does not answer in time; latches.
    Stalled,
    /// The device stopped by itself; latches.
    DeviceStopped,
    /// The clock went backwards or jumped.
    Clock,
    /// No tip has arrived.
    NoTip,
    /// The newest tip is too old.
    OldTip,
    /// The tip's score is too low: uncertain, or only predicted.
    DoubtfulTip,
    /// The tip's position in space is not known.
    FlatTip,
    /// No movement is requested.
    NoDemand,
    /// The newest demand is too old: the loop does not run.
    LoopStalled,
    /// The demand is not finite, or has another number of joints.
    BadDemand,
    /// Further movement would leave the limits of joints or workspace.
    Limit,
    /// The driver's thread ended by itself; latches.
    DriverFailed,
}

impl Cause {
    /// All causes; a cause's index is its number in tables.
    pub const ALL: [Self; 16] = [
        Self::EmergencyStop,
        Self::NotFollowing,
        Self::Unplugged,
        Self::Garbage,
        Self::Stalled,
        Self::DeviceStopped,
        Self::Clock,
        Self::NoTip,
        Self::OldTip,
        Self::DoubtfulTip,
        Self::FlatTip,
        Self::NoDemand,
        Self::LoopStalled,
        Self::BadDemand,
        Self::Limit,
        Self::DriverFailed,
    ];

    /// Its number in tables, from 1; 0 stands for no stop.
    pub fn number(self) -> usize {
        Self::ALL.iter().position(|cause| *cause == self).map_or(0, |index| index + 1)
    }

    /// Whether the arm stays stopped until a person releases it.
    pub fn latches(self) -> bool {
        matches!(
            self,
            Self::EmergencyStop
                | Self::NotFollowing
                | Self::Unplugged
                | Self::Garbage
                | Self::Stalled
                | Self::DeviceStopped
                | Self::DriverFailed
        )
    }

    /// In words.
    pub fn words(self) -> &'static str {
        match self {
            Self::EmergencyStop => "emergency stop",
            Self::NotFollowing => "the arm is not where it was sent",
            Self::Unplugged => "the arm's line broke off",
            Self::Garbage => "the arm's answers make no sense",
            Self::Stalled => "the arm does not answer",
            Self::DeviceStopped => "the arm stopped by itself",
            Self::Clock => "the clock jumped",
            Self::NoTip => "no tip is seen",
            Self::OldTip => "the tip is too old",
            Self::DoubtfulTip => "the tip is doubtful or only predicted",
            Self::FlatTip => "the tip's distance is not known",
            Self::NoDemand => "nobody asks for a movement",
            Self::LoopStalled => "the control loop does not run",
            Self::BadDemand => "the demand makes no sense",
            Self::Limit => "at the limit of joints or workspace",
            Self::DriverFailed => "the arm's driver failed",
        }
    }
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.words())
    }
}

/// A stop, or its end, for the log.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Event {
    /// Time of the clock that the interlock is called with, ns.
    pub at_ns: i64,
    /// The cause of a stop; none when the arm moves again.
    pub stop: Option<Cause>,
    /// Highest joint speed at that moment, rad/s.
    pub speed_rad_s: f64,
}

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ms = self.at_ns as f64 / 1e6;
        match self.stop {
            Some(cause) => {
                let let_go =
                    if cause.latches() { "; it stays stopped until `reset` is given another number" } else { "" };
                write!(f, "at {ms:.0} ms the arm stops from {:.3} rad/s: {cause}{let_go}", self.speed_rad_s)
            }
            None => write!(f, "at {ms:.0} ms the arm moves again"),
        }
    }
}
