//! Live views: the newest pictures that arrived together.

use std::sync::Arc;
use std::time::{Duration, Instant};

use panoscope_media::input::Signal;

use crate::pairing::{Pairing, pair};
use crate::source::{Clock, Grab, Stream};
use crate::views::Grabbed;

/// Longest wait of one step: connections are looked after in between.
const STEP: Duration = Duration::from_millis(50);

/// Pairs the pictures of live streams.
pub struct Live {
    signal: Arc<Signal>,
    tolerance_ns: i64,
    /// Views without any pair for this long count as lost.
    limit: Duration,
    /// When the newest pair was complete.
    paired: Option<Instant>,
    /// Arrivals of the pictures that wait, for each view.
    waiting: Vec<Vec<i64>>,
    /// Pictures that had no partner.
    pub unpaired: u64,
    /// Pictures that were dropped because a newer pair was there.
    pub superseded: u64,
    /// Time between the first and the last picture of the newest pair, ms.
    pub skew_ms: f64,
    /// Arrival of the oldest picture of the newest pair, ns of `CLOCK_MONOTONIC`.
    pub arrived_ns: i64,
}

impl Live {
    /// Pictures further apart than `tolerance_s` do not belong together; every picture notifies `signal`.
    pub fn new(signal: Arc<Signal>, tolerance_s: f64, limit: Duration) -> Self {
        Self {
            signal,
            tolerance_ns: (tolerance_s * 1e9) as i64,
            limit,
            paired: None,
            waiting: Vec::new(),
            unpaired: 0,
            superseded: 0,
            skew_ms: 0.0,
            arrived_ns: 0,
        }
    }

    /// Takes one picture of each stream, waiting for pictures that belong together. While something `is_lost`, it waits one step only.
    pub fn grab(&mut self, streams: &mut [&mut Stream], clock: Clock<'_>, is_lost: bool) -> Grabbed {
        let since = *self.paired.get_or_insert_with(Instant::now);
        let begin = Instant::now();
        let mut waiting = std::mem::take(&mut self.waiting);
        waiting.resize(streams.len(), Vec::new());
        let result = loop {
            let seen = self.signal.changes();
            if let Some(result) = poll(streams, clock) {
                break result;
            }
            for (stream, times) in streams.iter().zip(&mut waiting) {
                stream.arrivals(times);
            }
            match pair(&waiting, self.tolerance_ns) {
                Pairing::Take { indices, skew_ns } => {
                    let times: Vec<i64> = waiting.iter().zip(indices).map(|(times, index)| times[index]).collect();
                    if self.take(streams, &times) {
                        self.skew_ms = skew_ns as f64 * 1e-6;
                        self.arrived_ns = times.into_iter().min().unwrap_or(0);
                        self.paired = Some(Instant::now());
                        break Grabbed::Ready;
                    }
                }
                Pairing::Skip { before_ns } => {
                    for (stream, before_ns) in streams.iter().zip(before_ns) {
                        self.unpaired += stream.discard_before(before_ns);
                    }
                }
                Pairing::Wait => {
                    if is_lost && begin.elapsed() >= STEP {
                        break Grabbed::Lost(String::new());
                    }
                    self.signal.wait(seen, STEP);
                }
            }
            if !is_lost && since.elapsed().min(begin.elapsed()) > self.limit {
                break Grabbed::Lost(format!(
                    "all views give pictures, but none of them arrived within {:.1} ms of each other (`tolerance_ms`)",
                    self.tolerance_ns as f64 * 1e-6
                ));
            }
        };
        self.waiting = waiting;
        result
    }

    /// Takes the pictures that arrived at `times`. A queue that was full may have dropped one of them meanwhile: then the others have no partner.
    fn take(&mut self, streams: &mut [&mut Stream], times: &[i64]) -> bool {
        let mut taken = 0;
        for (stream, time) in streams.iter_mut().zip(times) {
            self.superseded += stream.discard_before(*time);
            taken += u64::from(stream.take(*time));
        }
        let is_whole = taken as usize == streams.len();
        self.unpaired += if is_whole { 0 } else { taken };
        is_whole
    }
}

/// Looks after all connections; `None` while all of them stand.
fn poll(streams: &mut [&mut Stream], clock: Clock<'_>) -> Option<Grabbed> {
    let mut result = None;
    for stream in streams {
        let next = match stream.poll(clock) {
            Grab::Ready(_) => continue,
            Grab::End => Grabbed::End,
            Grab::Failed(words) => Grabbed::Failed(words),
            Grab::Lost(words) => Grabbed::Lost(words),
        };
        // All are polled, and a loss matters more than an end.
        if result.is_none() || result == Some(Grabbed::End) {
            result = Some(next);
        }
    }
    result
}
