//! Arrival times of images at this machine.
//!
//! A probe at the output of every live source records, by the monotonic clock, when the data with each presentation
//! time entered the pipeline. Queues, jitter and decoding come later, so they are part of an image's age. A source's
//! own stamp (the driver's, or the one of RTP's jitter buffer) is more exact than the probe, and is used if it agrees
//! with the probe and arrival does not go back. The stamps of a camera that counts `1 / rate` steps at a wrong rate soon
//! disagree, and the probe's time is used.

use std::collections::VecDeque;
use std::sync::{Mutex, PoisonError};

/// Stamps that are kept: 30 s at 60 frames per second.
const KEPT: usize = 2048;
/// Maximum time by which a stamp may precede the probe's time: exposure, transfer and a busy machine.
const MAX_LAG_NS: i64 = 60_000_000;

/// Stamps of one pipeline's sources: presentation time and arrival, ns.
#[derive(Debug, Default)]
pub struct Arrivals(Mutex<VecDeque<(u64, i64)>>);

impl Arrivals {
    /// Records that data of presentation time `pts_ns` entered the pipeline at `now_ns`; `stamp_ns` is the source's own
    /// time for it. Of several buffers with one time, such as the packets of an image, the first is used.
    pub fn note(&self, pts_ns: u64, stamp_ns: Option<i64>, now_ns: i64) {
        let mut stamps = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if stamps.back().is_some_and(|(last, _)| *last == pts_ns) {
            return;
        }
        // After a time of the probe, on a machine that was busy, stamps may still be of the time before it.
        let latest_ns = stamps.back().map_or(i64::MIN, |(_, arrived_ns)| *arrived_ns);
        let agrees = |stamp: &i64| (0..=MAX_LAG_NS).contains(&(now_ns - stamp)) && *stamp > latest_ns;
        if stamps.len() == KEPT {
            stamps.pop_front();
        }
        stamps.push_back((pts_ns, stamp_ns.filter(agrees).unwrap_or(now_ns)));
    }

    /// Arrival of the image of presentation time `pts_ns`; `None` if no source had data with this time.
    pub fn of(&self, pts_ns: u64) -> Option<i64> {
        let stamps = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        stamps.iter().rev().find(|(pts, _)| *pts == pts_ns).map(|(_, arrived)| *arrived)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    #[test]
    fn a_stamp_counts_while_it_agrees_with_the_probe() {
        let arrivals = Arrivals::default();
        // A camera that promises 30 per second and gives 10: its stamps fall behind by 67 ms with every picture.
        for index in 0..50_i64 {
            arrivals.note((index * 33 * MS) as u64, Some(1000 * MS + index * 33 * MS), 1010 * MS + index * 100 * MS);
        }
        assert_eq!(arrivals.of(0), Some(1000 * MS));
        for index in 1..50_i64 {
            assert_eq!(arrivals.of((index * 33 * MS) as u64), Some(1010 * MS + index * 100 * MS), "{index}");
        }
        assert_eq!(arrivals.of(5), None);
        // A stamp of the future is none.
        arrivals.note(7, Some(9000 * MS), 8000 * MS);
        assert_eq!(arrivals.of(7), Some(8000 * MS));
    }

    #[test]
    fn arrival_does_not_go_back_after_a_busy_moment() {
        let arrivals = Arrivals::default();
        // The probe of the second one came 75 ms late, and the others after it at once.
        for (index, now_ms) in [(0, 1001), (1, 1108), (2, 1109), (3, 1110), (4, 1140)] {
            arrivals.note(index * 33, Some((1000 + index as i64 * 33) * MS), now_ms * MS);
        }
        let arrived = [0, 33, 66, 99, 132].map(|pts| arrivals.of(pts).map(|arrived_ns| arrived_ns / MS));
        assert_eq!(arrived, [1000, 1108, 1109, 1110, 1132].map(Some));
    }

    #[test]
    fn packets_of_one_picture_count_once_and_old_stamps_go() {
        let arrivals = Arrivals::default();
        for pts in 0..KEPT as u64 + 10 {
            arrivals.note(pts, None, pts as i64 * MS);
            arrivals.note(pts, None, pts as i64 * MS + 5);
        }
        assert_eq!((arrivals.of(9), arrivals.of(10)), (None, Some(10 * MS)));
    }
}
