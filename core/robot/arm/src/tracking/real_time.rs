//! Real time from the capture times of a source, which may be wrong.
//!
//! Velocities need the real time between two images. Capture times provide it without the jitter of arrivals if the
//! device reports its true rate. A camera that claims 30 frames per second and delivers 10 does not: its capture times
//! advance by a third of the real time, and every velocity would be three times too large.

use std::collections::VecDeque;

/// Time over which the two clocks are compared, ns: much longer than the jitter of arrivals.
const WINDOW_NS: i64 = 1_000_000_000;
/// Shortest time that is enough to compare them, ns.
const MIN_NS: i64 = 200_000_000;
/// Maximum number of ticks that are compared.
const MAX_TICKS: usize = 64;
/// Capture times that advance more slowly than real time by this factor are corrected.
const SLOW: f64 = 1.25;

/// Real time of a source's ticks.
///
/// Capture times are corrected only where they advance too slowly. Where they advance faster than arrivals, the source
/// runs in simulated time, or its ticks were delayed, and the capture times are right.
#[derive(Clone, Debug)]
pub struct RealTime {
    /// Capture and arrival of the newest ticks, ns.
    ticks: VecDeque<(i64, i64)>,
    last_capture_ns: Option<i64>,
    real_ns: i64,
    rate: f64,
}

impl Default for RealTime {
    fn default() -> Self {
        Self { ticks: VecDeque::with_capacity(MAX_TICKS), last_capture_ns: None, real_ns: 0, rate: 1.0 }
    }
}

impl RealTime {
    /// Adds the next tick: its capture time and, if known, the arrival of its light by the host's clock. Returns its
    /// real time, ns, for computing differences; equal to `capture_ns` as long as capture times are right.
    pub fn step(&mut self, capture_ns: i64, arrived_ns: Option<i64>) -> i64 {
        let Some(last_ns) = self.last_capture_ns.replace(capture_ns) else {
            self.ticks.extend(arrived_ns.map(|arrived_ns| (capture_ns, arrived_ns)));
            self.real_ns = capture_ns;
            return self.real_ns;
        };
        if capture_ns < last_ns {
            // A recording that starts again.
            self.ticks.clear();
            self.rate = 1.0;
        }
        if let Some(arrived_ns) = arrived_ns {
            if self.ticks.len() == MAX_TICKS {
                self.ticks.pop_front();
            }
            self.ticks.push_back((capture_ns, arrived_ns));
            // One tick before the window stays, so that slow sources are compared, too.
            while self.ticks.get(1).is_some_and(|(_, then_ns)| arrived_ns.saturating_sub(*then_ns) > WINDOW_NS) {
                self.ticks.pop_front();
            }
            self.compare();
        }
        self.real_ns = self.real_ns.saturating_add(self.real(capture_ns.saturating_sub(last_ns)));
        self.real_ns
    }

    /// A difference of capture times as real time, ns.
    pub fn real(&self, capture_ns: i64) -> i64 {
        if self.rate > 1.0 { (capture_ns as f64 * self.rate) as i64 } else { capture_ns }
    }

    fn compare(&mut self) {
        let (Some(first), Some(last)) = (self.ticks.front(), self.ticks.back()) else { return };
        let (captured_ns, arrived_ns) = (last.0.saturating_sub(first.0), last.1.saturating_sub(first.1));
        if captured_ns <= 0 || arrived_ns < MIN_NS || self.ticks.len() < 3 {
            return;
        }
        let rate = arrived_ns as f64 / captured_ns as f64;
        self.rate = if rate > SLOW { rate } else { 1.0 };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    /// Real times of ticks that are captured every 33 ms according to the source and arrive at these times.
    fn steps(arrivals_ms: impl Iterator<Item = i64>) -> Vec<i64> {
        let mut time = RealTime::default();
        arrivals_ms.enumerate().map(|(n, ms)| time.step(n as i64 * 33 * MS, Some(ms * MS))).collect()
    }

    #[test]
    fn a_camera_that_gives_a_third_of_what_it_says_is_found_out() {
        let real = steps((0..60).map(|n| 7_000 + n * 99));
        let last = real.len() - 1;
        assert_eq!(real[last] - real[last - 1], 99 * MS);
        // And when it keeps its word again.
        let real = steps((0..60).map(|n| if n < 30 { n * 99 } else { 30 * 99 + (n - 30) * 33 }).chain(3960..3961));
        assert_eq!(real[59] - real[58], 33 * MS);
    }

    #[test]
    fn true_capture_times_are_kept_whatever_the_jitter() {
        // Two packets at once, every 66 ms; and a stream that arrives 2 s late.
        let real = steps((0..90).map(|n| 2_000 + n / 2 * 66));
        assert!(real.iter().enumerate().all(|(n, ns)| *ns == n as i64 * 33 * MS), "{real:?}");
        let mut time = RealTime::default();
        let batch = (0..90).map(|n| time.step(n * 33 * MS, Some(n * 33 * MS)) - n * 33 * MS);
        assert!(batch.into_iter().all(|off| off == 0));
        // Faster than real time: simulated.
        let real = steps((0..90).map(|n| n * 5));
        assert_eq!(real[89], 89 * 33 * MS);
    }

    #[test]
    fn time_that_starts_again_and_unknown_arrivals_are_survived() {
        let mut time = RealTime::default();
        assert_eq!(time.step(5 * MS, None), 5 * MS);
        assert_eq!(time.step(9 * MS, None), 9 * MS);
        assert_eq!(time.step(-90 * MS, Some(3)), -90 * MS);
        assert!(time.step(i64::MAX, Some(i64::MAX)) > 0);
        time.step(i64::MIN, Some(i64::MIN));
    }
}
