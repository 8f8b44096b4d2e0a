//! The ticks of a source: how many it made, and when the light of the newest arrived.

use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};

/// Arrival times that are kept per source: as many ticks may be in the graph at once.
const ARRIVALS: usize = 4096;
/// Oldest times that are not read, because the source may overwrite them meanwhile.
const MARGIN: u64 = 64;
/// Counters of a source. The source's thread writes them; the watchdog does when it abandons a call of that thread.
pub(crate) struct SourceTicks {
    /// Newest capture time, `i64::MIN` before the first tick.
    last_capture_ns: AtomicI64,
    made: AtomicU64,
    /// Number of them without a frame although a node reads one.
    empty: AtomicU64,
    /// Arrival times of the newest ticks, `i64::MIN` for none; empty for a node that is not a source.
    arrived_ns: Box<[AtomicI64]>,
    /// The first tick of this source, after those of its predecessors.
    first: AtomicU64,
    /// Ticks made when the source had ended with one tick, 0 for a source that makes more.
    made_one: AtomicU64,
}

impl SourceTicks {
    /// Counters of a source before its first tick.
    pub fn new(is_source: bool) -> Self {
        let len = if is_source { ARRIVALS } else { 0 };
        let arrived_ns = (0..len).map(|_| AtomicI64::new(i64::MIN)).collect();
        Self {
            last_capture_ns: AtomicI64::new(i64::MIN),
            made: AtomicU64::new(0),
            empty: AtomicU64::new(0),
            arrived_ns,
            first: AtomicU64::new(0),
            made_one: AtomicU64::new(0),
        }
    }

    /// Ticks made so far: the number of the next one.
    pub fn made(&self) -> u64 {
        self.made.load(Ordering::Acquire)
    }

    /// Ticks with a frame so far. A source that has lost its camera makes ticks without one.
    pub fn with_frame(&self) -> u64 {
        self.made().saturating_sub(self.empty.load(Ordering::Relaxed))
    }

    /// Counts the tick that is being made as one without a frame although a node reads one.
    pub fn count_empty(&self) {
        self.empty.fetch_add(1, Ordering::Relaxed);
    }

    /// Sets how many ticks were made.
    pub fn set_made(&self, made: u64) {
        self.made.store(made, Ordering::Release);
    }

    /// Capture time of the newest tick, if there is one.
    pub fn last_capture_ns(&self) -> Option<i64> {
        Some(self.last_capture_ns.load(Ordering::Relaxed)).filter(|&ns| ns != i64::MIN)
    }

    /// Sets the capture time of the newest tick.
    pub fn set_last_capture_ns(&self, capture_ns: i64) {
        self.last_capture_ns.store(capture_ns, Ordering::Relaxed);
    }

    /// Continues to count where the source's predecessor ended; packets of its ticks keep their age.
    pub fn continue_from(&self, old: &Self) {
        for (to, from) in self.arrived_ns.iter().zip(&old.arrived_ns) {
            to.store(from.load(Ordering::Relaxed), Ordering::Relaxed);
        }
        self.set_made(old.made());
        self.first.store(old.made(), Ordering::Relaxed);
        self.empty.store(old.empty.load(Ordering::Relaxed), Ordering::Relaxed);
    }

    /// Records when the light of tick `seq`, which is being made, arrived, in ns of the host's clock.
    pub fn arrive(&self, seq: u64, arrived_ns: i64) {
        self.arrived_ns[seq as usize % ARRIVALS].store(arrived_ns.max(i64::MIN + 1), Ordering::Relaxed);
    }

    /// Counts tick `seq`, whose arrival is recorded, as made.
    pub fn enter(&self, seq: u64) {
        self.set_made(seq + 1);
    }

    /// The source says that no tick will follow.
    pub fn end(&self) {
        let made = self.made();
        if made == self.first.load(Ordering::Relaxed) + 1 {
            self.made_one.store(made, Ordering::Release);
        }
    }

    /// Whether tick `seq` is the only one that the source made before it ended.
    pub fn is_only_one(&self, seq: u64) -> bool {
        self.made_one.load(Ordering::Acquire) == seq.saturating_add(1)
    }

    /// The oldest tick whose arrival time is kept.
    fn oldest_kept(&self) -> u64 {
        (self.made() + MARGIN).saturating_sub(ARRIVALS as u64)
    }

    /// Whether the arrival time of tick `seq` was discarded: its age is unknown, and higher than [`Self::arrived_ns`]
    /// says.
    pub fn is_forgotten(&self, seq: u64) -> bool {
        !self.arrived_ns.is_empty() && seq < self.oldest_kept()
    }

    /// When the light of tick `seq` arrived, in ns of the host's clock. For a tick older than all kept times, the
    /// oldest kept time: its age is then too low, but never that of a new tick. `None` for a node that is not a source
    /// and for a tick that was not made.
    pub fn arrived_ns(&self, seq: u64) -> Option<i64> {
        let made = self.made();
        if self.arrived_ns.is_empty() || seq > made {
            return None;
        }
        let kept = seq.max(self.oldest_kept());
        Some(self.arrived_ns[kept as usize % ARRIVALS].load(Ordering::Relaxed)).filter(|&ns| ns != i64::MIN)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrivals_of_old_ticks_never_look_new() {
        let ticks = SourceTicks::new(true);
        assert_eq!(ticks.arrived_ns(0), None, "no tick was made");
        for seq in 0..3 * ARRIVALS as u64 {
            ticks.arrive(seq, seq as i64 - 100);
            assert_eq!(ticks.arrived_ns(seq), Some(seq as i64 - 100), "known while it is made");
            ticks.enter(seq);
        }
        let made = ticks.made();
        assert_eq!(ticks.arrived_ns(made - 1), Some(made as i64 - 101));
        assert_eq!(ticks.arrived_ns(made + 1), None, "not made yet");
        let oldest = made as i64 - 100 - (ARRIVALS as i64 - MARGIN as i64);
        assert_eq!(ticks.arrived_ns(0), Some(oldest), "overwritten: as old as the oldest that is kept");
        let first_kept = (oldest + 100) as u64;
        assert!(ticks.is_forgotten(0) && ticks.is_forgotten(first_kept - 1) && !ticks.is_forgotten(first_kept));
        let next = SourceTicks::new(true);
        next.continue_from(&ticks);
        assert_eq!((next.made(), next.arrived_ns(made - 7)), (made, ticks.arrived_ns(made - 7)));
        assert_eq!(SourceTicks::new(false).arrived_ns(0), None);
        assert!(!SourceTicks::new(true).is_forgotten(0) && !SourceTicks::new(false).is_forgotten(0));
    }

    #[test]
    fn only_a_source_that_ended_after_one_tick_gave_a_constant() {
        let ticks = SourceTicks::new(true);
        ticks.enter(0);
        assert!(!ticks.is_only_one(0), "another tick may come");
        ticks.end();
        assert!(ticks.is_only_one(0) && !ticks.is_only_one(1));
        let next = SourceTicks::new(true);
        next.continue_from(&ticks);
        next.enter(1);
        next.end();
        assert!(next.is_only_one(1) && !next.is_only_one(0));
        let stream = SourceTicks::new(true);
        (0..2).for_each(|seq| stream.enter(seq));
        stream.end();
        assert!(!stream.is_only_one(0) && !stream.is_only_one(1));
    }
}
