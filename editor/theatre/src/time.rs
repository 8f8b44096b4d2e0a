//! The clocks that the window shows and acts by. The campaign of simulated windows sets them.

use std::time::{Duration, Instant};

#[cfg(not(test))]
mod source {
    use std::time::{Instant, SystemTime};

    pub fn now() -> Instant {
        Instant::now()
    }

    pub fn clock_ns() -> u64 {
        panoscope_engine::clock::now_ns()
    }

    pub fn unix_now() -> SystemTime {
        SystemTime::now()
    }
}

pub use source::{clock_ns, now};

/// Time since `start`; zero for a later time.
pub fn since(start: Instant) -> Duration {
    now().saturating_duration_since(start)
}

/// The instant of a time of the engine's clock, which is not in the future; now where it is unknown.
pub fn instant_of(clock_ns_then: Option<i64>) -> Instant {
    let age_ns = clock_ns_then.map_or(0, |then| clock_ns().saturating_add_signed(then.saturating_neg()));
    now().checked_sub(Duration::from_nanos(age_ns)).unwrap_or_else(now)
}

/// Time since 1970, ms.
pub fn unix_ms() -> u64 {
    source::unix_now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default().as_millis() as u64
}

/// The clocks of a thread; they stand still once [`advance`](source::advance) was called.
#[cfg(test)]
pub mod source {
    use std::cell::Cell;
    use std::time::{Duration, Instant, SystemTime};

    thread_local! {
        static SIMULATED: Cell<Option<(Instant, u64, SystemTime)>> = const { Cell::new(None) };
    }

    fn real() -> (Instant, u64, SystemTime) {
        (Instant::now(), panoscope_engine::clock::now_ns(), SystemTime::now())
    }

    fn read() -> (Instant, u64, SystemTime) {
        SIMULATED.get().unwrap_or_else(real)
    }

    /// Sets the clocks of this thread forward.
    pub fn advance(by: Duration) {
        let (now, clock_ns, unix) = read();
        SIMULATED.set(Some((now + by, clock_ns + by.as_nanos() as u64, unix + by)));
    }

    pub fn now() -> Instant {
        read().0
    }

    pub fn clock_ns() -> u64 {
        read().1
    }

    pub fn unix_now() -> SystemTime {
        read().2
    }
}
