//! Pairs live views: delivers the newest frames that arrived together. While a view is lost or silent, the others are delivered without it.

use std::sync::Arc;
use std::time::{Duration, Instant};

use panoscope_media::input::Signal;

use crate::pairing::{Grabbed, Pairing, pair};
use crate::source::{Clock, Grab, Stream};

/// Maximum wait of one step; connections are polled in between.
const STEP: Duration = Duration::from_millis(50);

/// Pairs the frames of live streams by arrival.
pub struct Live {
    signal: Arc<Signal>,
    tolerance_ns: i64,
    /// Views without any pair for this long count as lost.
    limit: Duration,
    /// When the newest pair was complete.
    paired: Option<Instant>,
    /// Arrival times of the waiting frames, ns, for each view that delivers.
    waiting: Vec<Vec<i64>>,
    /// For each stream, whether the newest grab took a frame from it.
    pub is_taken: Vec<bool>,
    /// Frames dropped because they had no partner.
    pub unpaired: u64,
    /// Frames dropped because a newer pair was complete.
    pub superseded: u64,
    /// Time between the first and the last frame of the newest pair, ms.
    pub skew_ms: f64,
    /// Arrival of the oldest frame of the newest pair, ns of `CLOCK_MONOTONIC`.
    pub arrived_ns: i64,
}

impl Live {
    /// Frames further apart than `tolerance_s` do not belong together. Every new frame notifies `signal`.
    pub fn new(signal: Arc<Signal>, tolerance_s: f64, limit: Duration) -> Self {
        Self {
            signal,
            tolerance_ns: (tolerance_s * 1e9) as i64,
            limit,
            paired: None,
            waiting: Vec::new(),
            is_taken: Vec::new(),
            unpaired: 0,
            superseded: 0,
            skew_ms: 0.0,
            arrived_ns: 0,
        }
    }

    /// Takes one frame of each stream that delivers, and waits for frames that belong together; see [`Self::is_taken`]. While something `is_lost`, it
    /// waits for one step only.
    pub fn grab(&mut self, streams: &mut [&mut Stream], clock: Clock<'_>, is_lost: bool) -> Grabbed {
        let since = *self.paired.get_or_insert_with(Instant::now);
        let begin = Instant::now();
        self.is_taken.clear();
        self.is_taken.resize(streams.len(), false);
        let mut waiting = std::mem::take(&mut self.waiting);
        let result = loop {
            let seen = self.signal.changes();
            let loss = match poll(streams, clock) {
                Ok(loss) => loss,
                Err(result) => break result,
            };
            // The others are shown without a stream that is lost or silent.
            let mut delivering: Vec<(usize, &mut Stream)> =
                streams.iter_mut().map(|stream| &mut **stream).enumerate().filter(|(_, s)| s.delivers(clock)).collect();
            waiting.resize(delivering.len(), Vec::new());
            for ((_, stream), times) in delivering.iter().zip(&mut waiting) {
                stream.arrivals(times);
            }
            match pair(&waiting, self.tolerance_ns) {
                Pairing::Take { indices, skew_ns } => {
                    let times: Vec<i64> = waiting.iter().zip(indices).map(|(times, index)| times[index]).collect();
                    if self.take(&mut delivering, &times) {
                        delivering.iter().for_each(|(index, _)| self.is_taken[*index] = true);
                        self.skew_ms = skew_ns as f64 * 1e-6;
                        self.arrived_ns = times.into_iter().min().unwrap_or(0);
                        self.paired = Some(Instant::now());
                        break loss.map_or(Grabbed::Ready, Grabbed::Lost);
                    }
                }
                Pairing::Skip { before_ns } => {
                    for ((_, stream), before_ns) in delivering.iter().zip(before_ns) {
                        self.unpaired += stream.discard_before(before_ns);
                    }
                }
                Pairing::Wait => {
                    let is_over = if is_lost { begin.elapsed() >= STEP } else { loss.is_some() };
                    if is_over {
                        break Grabbed::Lost(loss.unwrap_or_default());
                    }
                    self.signal.wait(seen, STEP);
                }
            }
            // A view that has just fallen silent is lost a little later.
            let all_give = || streams.iter().all(|stream| stream.is_heard_within(self.limit / 2, clock));
            if !is_lost && since.elapsed().min(begin.elapsed()) > self.limit && all_give() {
                break Grabbed::Lost(format!(
                    "all views deliver frames, but no frames arrived within {:.1} ms of each other; increase `tolerance_ms`",
                    self.tolerance_ns as f64 * 1e-6
                ));
            }
        };
        self.waiting = waiting;
        result
    }

    /// Takes the frames that arrived at `times`. If a full queue has dropped one of them meanwhile, the others have no partner.
    fn take(&mut self, streams: &mut [(usize, &mut Stream)], times: &[i64]) -> bool {
        let mut taken = 0;
        for ((_, stream), time) in streams.iter_mut().zip(times) {
            self.superseded += stream.discard_before(*time);
            taken += u64::from(stream.take(*time));
        }
        let is_whole = taken as usize == streams.len();
        self.unpaired += if is_whole { 0 } else { taken };
        is_whole
    }
}

/// Polls all connections. Returns why streams are lost, if any are.
///
/// # Errors
/// A stream ended or failed; the result of the grab.
fn poll(streams: &mut [&mut Stream], clock: Clock<'_>) -> Result<Option<String>, Grabbed> {
    let (mut losses, mut end) = (Vec::new(), None);
    // All are polled, and a failure matters more than an end.
    for stream in streams {
        match stream.poll(clock) {
            Grab::Ready(_) => {}
            Grab::Lost(words) => losses.push(words),
            Grab::End => end = end.or(Some(Grabbed::End)),
            Grab::Failed(words) => end = Some(Grabbed::Failed(words)),
        }
    }
    match end {
        Some(end) if end != Grabbed::End || losses.is_empty() => Err(end),
        _ => Ok((!losses.is_empty()).then(|| losses.join("; "))),
    }
}
