//! The ticks of a source: how many it made, and when the newest entered the graph.

use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};

/// Ingest times that are kept per source: as many ticks may be in the graph at once.
const INGEST_RING: usize = 4096;

/// Counters of a source. The source's thread writes them; the watchdog does when it abandons a call of that thread.
pub(crate) struct SourceTicks {
    /// Newest capture time, `i64::MIN` before the first tick.
    last_capture_ns: AtomicI64,
    made: AtomicU64,
    /// Ingest times of the newest ticks; empty for a node that is no source.
    ingest_ns: Box<[AtomicU64]>,
}

impl SourceTicks {
    /// No tick yet.
    pub fn new(is_source: bool) -> Self {
        let len = if is_source { INGEST_RING } else { 0 };
        let ingest_ns = (0..len).map(|_| AtomicU64::new(0)).collect();
        Self { last_capture_ns: AtomicI64::new(i64::MIN), made: AtomicU64::new(0), ingest_ns }
    }

    /// Ticks made so far: the number of the next one.
    pub fn made(&self) -> u64 {
        self.made.load(Ordering::Acquire)
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

    /// Records when tick `seq` entered the graph, in ns of the host's clock, and counts it as made.
    pub fn enter(&self, seq: u64, now_ns: u64) {
        self.ingest_ns[seq as usize % INGEST_RING].store(now_ns.max(1), Ordering::Relaxed);
        self.set_made(seq + 1);
    }

    /// When tick `seq` entered the graph, in ns of the host's clock; `None` for a node that is no source.
    #[inline]
    pub fn ingest_ns(&self, seq: u64) -> Option<u64> {
        let slot = self.ingest_ns.get(seq as usize % self.ingest_ns.len().max(1))?;
        Some(slot.load(Ordering::Relaxed)).filter(|&ns| ns > 0)
    }
}
