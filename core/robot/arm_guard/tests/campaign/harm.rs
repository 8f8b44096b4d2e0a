//! What happens to the arm, its guard and its program.

use std::time::Duration;

use panoscope_firmware::Behaviour;

/// A harm.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Harm {
    /// The program's process is killed.
    HostKilled,
    /// The program's process is stopped for a while (SIGSTOP).
    HostStopped,
    /// The program hangs: its process runs, but requests nothing.
    HostHangs,
    /// The program's process crashes.
    HostCrashes,
    /// The program ends.
    Ends,
    /// The guard is killed.
    GuardKilled,
    /// The guard is stopped for a while.
    GuardStopped,
    /// Requests are made of light of 2 s ago.
    OldLight,
    /// A live edit holds the arm's region; the ticks kept meanwhile are played back at once.
    LiveEdit,
    /// Requests arrive late.
    LateTicks,
    /// Requests arrive in another order.
    Reordered,
    /// Stamps jump into the future or the past.
    ClockJumps,
    /// The clock of the stamps is too slow or too fast.
    SlowClock,
    /// Requests hold numbers that are none, or too many.
    HostileNumbers,
    /// Thousands of requests at once.
    Flood,
    /// Bytes of the line are flipped, lost, doubled and inserted.
    ByteDamage,
    /// The arm does not answer any more.
    Silent,
    /// The arm answers late.
    Late,
    /// The arm answers garbage.
    Garbage,
    /// The arm's answers have wrong numbers.
    WrongNumbers,
    /// The cable is unplugged.
    Unplugged,
    /// The motors do not move.
    Stuck,
    /// The motors run away.
    Runaway,
    /// The hardware stop.
    HardwareStop,
    /// The hardware has a fault.
    HardwareFault,
    /// A person's emergency stop.
    EmergencyStop,
    /// An emergency stop while the disk is full, then the guard is killed.
    DiskFull,
    /// Other programs want the arm: by the same path, by another one, and as another process.
    SecondMaster,
}

/// All harms; a case takes the one at its seed.
pub const HARMS: [Harm; 28] = [
    Harm::HostKilled,
    Harm::HostStopped,
    Harm::HostHangs,
    Harm::HostCrashes,
    Harm::Ends,
    Harm::GuardKilled,
    Harm::GuardStopped,
    Harm::OldLight,
    Harm::LiveEdit,
    Harm::LateTicks,
    Harm::Reordered,
    Harm::ClockJumps,
    Harm::SlowClock,
    Harm::HostileNumbers,
    Harm::Flood,
    Harm::ByteDamage,
    Harm::Silent,
    Harm::Late,
    Harm::Garbage,
    Harm::WrongNumbers,
    Harm::Unplugged,
    Harm::Stuck,
    Harm::Runaway,
    Harm::HardwareStop,
    Harm::HardwareFault,
    Harm::EmergencyStop,
    Harm::DiskFull,
    Harm::SecondMaster,
];

impl Harm {
    /// Whether a process of its own steers the arm. Other harms change single requests, which the test makes itself.
    pub fn has_host(self) -> bool {
        matches!(self, Self::HostKilled | Self::HostStopped | Self::HostHangs | Self::HostCrashes)
    }

    /// Whether a person has to release the arm afterwards.
    pub fn latches(self) -> bool {
        self.is_of_arm()
            || matches!(
                self,
                Self::HostKilled
                    | Self::HostCrashes
                    | Self::Ends
                    | Self::GuardKilled
                    | Self::GuardStopped
                    | Self::EmergencyStop
                    | Self::DiskFull
            )
    }

    /// Whether the arm or its line fails, so that the guard latches.
    pub fn is_of_arm(self) -> bool {
        matches!(
            self,
            Self::Silent
                | Self::Late
                | Self::Garbage
                | Self::WrongNumbers
                | Self::Unplugged
                | Self::Stuck
                | Self::Runaway
                | Self::HardwareStop
                | Self::HardwareFault
        )
    }

    /// Whether the time until the arm brakes is measured: it steers by nothing that arrives after the harm.
    pub fn is_timed(self) -> bool {
        self.has_host() || matches!(self, Self::Ends | Self::GuardKilled | Self::OldLight | Self::EmergencyStop)
    }

    /// Changes the simulated arm.
    pub fn of_firmware(self, behaviour: &mut Behaviour) {
        match self {
            Self::ByteDamage => behaviour.damaged_bytes = 0.004,
            Self::Silent => behaviour.is_silent = true,
            Self::Late => behaviour.delay = Duration::from_millis(450),
            Self::Garbage => behaviour.is_garbage = true,
            Self::WrongNumbers => behaviour.has_wrong_numbers = true,
            Self::Unplugged => behaviour.is_unplugged = true,
            Self::Stuck => behaviour.is_stuck = true,
            Self::Runaway => behaviour.runaway_rad_s = 0.9,
            Self::HardwareStop => behaviour.is_stopped = true,
            Self::HardwareFault => behaviour.has_fault = true,
            _ => {}
        }
    }
}
