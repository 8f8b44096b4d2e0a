//! As `std::time`, with the clock of the calling thread's world.

use std::ops::{Add, AddAssign, Sub};

pub use std::time::Duration;

use crate::world::scheduler;

/// Time of the world's clock, ns.
pub fn now_ns() -> u64 {
    scheduler::now_ns()
}

/// As `std::time::Instant`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Instant(Duration);

impl Instant {
    /// The world's time.
    pub fn now() -> Self {
        Self(Duration::from_nanos(now_ns()))
    }

    /// Time since then.
    pub fn elapsed(&self) -> Duration {
        Self::now().saturating_duration_since(*self)
    }

    /// Time from `earlier` to this; 0 if it is later.
    pub fn duration_since(&self, earlier: Self) -> Duration {
        self.saturating_duration_since(earlier)
    }

    /// Time from `earlier` to this; 0 if it is later.
    pub fn saturating_duration_since(&self, earlier: Self) -> Duration {
        self.0.saturating_sub(earlier.0)
    }

    /// Time from `earlier` to this; `None` if it is later.
    pub fn checked_duration_since(&self, earlier: Self) -> Option<Duration> {
        self.0.checked_sub(earlier.0)
    }

    /// A later time; `None` beyond what the type holds.
    pub fn checked_add(&self, time: Duration) -> Option<Self> {
        self.0.checked_add(time).map(Self)
    }
}

impl Add<Duration> for Instant {
    type Output = Self;

    fn add(self, time: Duration) -> Self {
        Self(self.0 + time)
    }
}

impl AddAssign<Duration> for Instant {
    fn add_assign(&mut self, time: Duration) {
        self.0 += time;
    }
}

impl Sub<Duration> for Instant {
    type Output = Self;

    fn sub(self, time: Duration) -> Self {
        Self(self.0 - time)
    }
}

impl Sub for Instant {
    type Output = Duration;

    fn sub(self, earlier: Self) -> Duration {
        self.saturating_duration_since(earlier)
    }
}

/// Wall clock at the start of a world: 2025-01-01.
const BEGIN: Duration = Duration::from_secs(1_735_689_600);

/// As `std::time::SystemTime`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct SystemTime(Duration);

/// As `std::time::UNIX_EPOCH`.
pub const UNIX_EPOCH: SystemTime = SystemTime(Duration::ZERO);

/// The other time is later than this one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SystemTimeError;

impl SystemTime {
    /// The world's wall clock.
    pub fn now() -> Self {
        Self(BEGIN + Duration::from_nanos(now_ns()))
    }

    /// Time from `earlier` to this.
    ///
    /// # Errors
    /// `earlier` is later.
    pub fn duration_since(&self, earlier: Self) -> Result<Duration, SystemTimeError> {
        self.0.checked_sub(earlier.0).ok_or(SystemTimeError)
    }
}
