//! Causes of a stop.

use std::fmt;

/// Cause of a stop of the arm.
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
    /// The newest demand is too old: the control loop has stalled.
    LoopStalled,
    /// The demand is not finite, or has another number of joints.
    BadDemand,
    /// Further movement would leave the limits of joints or workspace.
    Limit,
    /// The arm has started and has not been released by an operator; latches.
    AwaitsOperator,
    /// The process that guards the arm ended while the arm was released; latches.
    Interrupted,
    /// The record of latched stops is damaged; latches.
    RecordLost,
    /// The record of latched stops cannot be written; latches.
    CannotRecord,
    /// The arm's hardware stop is pressed; latches.
    HardwareStop,
    /// The arm's hardware reports a fault; latches.
    HardwareFault,
    /// The program that steers the arm has ended; latches.
    HostGone,
    /// The process that guards the arm has ended or does not report; latches.
    GuardGone,
    /// The arm moves faster than the limits allow, by its encoders; latches.
    MeasuredSpeed,
    /// The arm is outside its joint limits or its workspace, by its encoders; latches.
    MeasuredWorkspace,
    /// The robot's safety system made a protective stop; latches.
    ProtectiveStop,
    /// The robot's safety system stopped it for another reason than an emergency stop: safeguard, recovery; latches.
    SafeguardStop,
    /// The robot is switched off, or its brakes are on; latches.
    RobotOff,
    /// The program that follows set-points does not run on the robot's controller; latches.
    ProgramNotRunning,
    /// The clock of the arm's controller is wrong: its own watchdog would be late; latches.
    DeviceClock,
}

impl Cause {
    /// All causes; a cause's index is its number in tables.
    pub const ALL: [Self; 30] = [
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
        Self::AwaitsOperator,
        Self::Interrupted,
        Self::RecordLost,
        Self::CannotRecord,
        Self::HardwareStop,
        Self::HardwareFault,
        Self::HostGone,
        Self::GuardGone,
        Self::MeasuredSpeed,
        Self::MeasuredWorkspace,
        Self::ProtectiveStop,
        Self::SafeguardStop,
        Self::RobotOff,
        Self::ProgramNotRunning,
        Self::DeviceClock,
    ];

    /// Its number in tables, from 1; 0 stands for no stop.
    pub fn number(self) -> usize {
        Self::ALL.iter().position(|cause| *cause == self).map_or(0, |index| index + 1)
    }

    /// The cause with this number.
    pub fn from_number(number: usize) -> Option<Self> {
        Self::ALL.get(number.checked_sub(1)?).copied()
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
                | Self::AwaitsOperator
                | Self::Interrupted
                | Self::RecordLost
                | Self::CannotRecord
                | Self::HardwareStop
                | Self::HardwareFault
                | Self::HostGone
                | Self::GuardGone
                | Self::MeasuredSpeed
                | Self::MeasuredWorkspace
                | Self::ProtectiveStop
                | Self::SafeguardStop
                | Self::RobotOff
                | Self::ProgramNotRunning
                | Self::DeviceClock
        )
    }

    /// Description for messages.
    pub fn words(self) -> &'static str {
        match self {
            Self::EmergencyStop => "emergency stop",
            Self::NotFollowing => "the arm is not where it was sent",
            Self::Unplugged => "the arm's line broke off",
            Self::Garbage => "the arm's answers are malformed",
            Self::Stalled => "the arm does not answer",
            Self::DeviceStopped => "the arm stopped by itself",
            Self::Clock => "the clock jumped",
            Self::NoTip => "no tip is seen",
            Self::OldTip => "the tip is too old",
            Self::DoubtfulTip => "the tip is doubtful or only predicted",
            Self::FlatTip => "the tip's distance is not known",
            Self::NoDemand => "nobody asks for a movement",
            Self::LoopStalled => "the control loop does not run",
            Self::BadDemand => "the demand is malformed",
            Self::Limit => "at the limit of joints or workspace",
            Self::AwaitsOperator => "the arm has just come up and waits for `reset`",
            Self::Interrupted => "the guard of the arm ended while the arm was released",
            Self::RecordLost => "the record of latched stops is damaged",
            Self::CannotRecord => "the record of latched stops cannot be written",
            Self::HardwareStop => "the hardware stop is pressed",
            Self::HardwareFault => "the arm's hardware reports a fault",
            Self::HostGone => "the program that steers the arm has ended",
            Self::GuardGone => "the process that guards the arm has ended or does not report",
            Self::MeasuredSpeed => "the arm moves faster than its limits, by its encoders",
            Self::MeasuredWorkspace => "the arm is outside its workspace, by its encoders",
            Self::ProtectiveStop => "the robot made a protective stop",
            Self::SafeguardStop => "the robot's safety system stopped it",
            Self::RobotOff => "the robot is switched off or its brakes are on",
            Self::ProgramNotRunning => "the arm's program does not run on the robot",
            Self::DeviceClock => "the clock of the arm's controller is wrong",
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
