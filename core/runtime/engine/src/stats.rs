//! Always-on counters: one writer per node, read by anyone at any time.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};

const SUB_BITS: u32 = 5;
/// Times from 2^40 ns on (18 minutes) share the last bucket.
const OCTAVES: u32 = 40;
const BUCKETS: usize = ((OCTAVES - SUB_BITS) as usize + 1) << SUB_BITS;

/// A histogram of times in ns with about 3 % resolution.
pub struct Histogram {
    max_ns: AtomicU64,
    counts: [AtomicU64; BUCKETS],
}

impl Default for Histogram {
    fn default() -> Self {
        Self { max_ns: AtomicU64::new(0), counts: [const { AtomicU64::new(0) }; BUCKETS] }
    }
}

fn bucket(ns: u64) -> usize {
    if ns < 1 << SUB_BITS {
        return ns as usize;
    }
    let ns = ns.min((1 << OCTAVES) - 1);
    let octave = 63 - ns.leading_zeros();
    let shift = octave - SUB_BITS;
    (((shift + 1) as usize) << SUB_BITS) + ((ns >> shift) as usize & ((1 << SUB_BITS) - 1))
}

fn bucket_middle(index: usize) -> u64 {
    let (octave, sub) = (index >> SUB_BITS, (index & ((1 << SUB_BITS) - 1)) as u64);
    if octave == 0 {
        return sub;
    }
    let shift = octave - 1;
    let low = (sub | 1 << SUB_BITS) << shift;
    low + (1u64 << shift) / 2
}

impl Histogram {
    /// Counts one time. Only one thread at a time may call this.
    #[inline]
    pub fn record(&self, ns: u64) {
        self.count_one(ns);
        self.raise(ns);
    }

    /// Counts a time that is known not to be the maximum.
    #[inline]
    pub(crate) fn count_one(&self, ns: u64) {
        let slot = &self.counts[bucket(ns)];
        slot.store(slot.load(Ordering::Relaxed) + 1, Ordering::Relaxed);
    }

    /// Updates the maximum.
    #[inline]
    pub(crate) fn raise(&self, ns: u64) {
        if ns > self.max_ns.load(Ordering::Relaxed) {
            self.max_ns.store(ns, Ordering::Relaxed);
        }
    }

    /// Number of counted times.
    pub fn count(&self) -> u64 {
        self.counts.iter().map(|count| count.load(Ordering::Relaxed)).sum()
    }

    /// The maximum in ns.
    pub fn max_ns(&self) -> u64 {
        self.max_ns.load(Ordering::Relaxed)
    }

    /// Counts per bucket, for [`quantile_between_ns`].
    pub fn counts(&self) -> Vec<u64> {
        self.counts.iter().map(|c| c.load(Ordering::Relaxed)).collect()
    }

    /// The `q` quantile (0..1) of the counted times, in ns; 0 when nothing was counted.
    pub fn quantile_ns(&self, q: f64) -> u64 {
        let counts = self.counts.each_ref().map(|count| count.load(Ordering::Relaxed));
        let total: u64 = counts.iter().sum();
        if total == 0 {
            return 0;
        }
        let want = ((total as f64 * q).ceil() as u64).clamp(1, total);
        let mut seen = 0;
        for (index, count) in counts.iter().enumerate() {
            seen += count;
            if seen >= want {
                return bucket_middle(index).min(self.max_ns());
            }
        }
        self.max_ns()
    }
}

/// A histogram that most nodes never use: allocated with the first time.
#[derive(Default)]
pub struct RareHistogram(OnceLock<Box<Histogram>>);

impl RareHistogram {
    /// As [`Histogram::record`].
    pub fn record(&self, ns: u64) {
        self.0.get_or_init(Box::default).record(ns);
    }

    /// As [`Histogram::max_ns`].
    pub fn max_ns(&self) -> u64 {
        self.0.get().map_or(0, |histogram| histogram.max_ns())
    }

    /// As [`Histogram::counts`]; empty before the first time.
    pub fn counts(&self) -> Vec<u64> {
        self.0.get().map_or_else(Vec::new, |histogram| histogram.counts())
    }

    /// As [`Histogram::quantile_ns`].
    pub fn quantile_ns(&self, q: f64) -> u64 {
        self.0.get().map_or(0, |histogram| histogram.quantile_ns(q))
    }
}

/// [`Histogram::quantile_ns`] of the times counted between two calls of [`Histogram::counts`].
pub fn quantile_between_ns(before: &[u64], now: &[u64], q: f64) -> u64 {
    let added = |i: usize| now[i].saturating_sub(before.get(i).copied().unwrap_or(0));
    let total: u64 = (0..now.len()).map(added).sum();
    if total == 0 {
        return 0;
    }
    let want = ((total as f64 * q).ceil() as u64).clamp(1, total);
    let mut seen = 0;
    for index in 0..now.len() {
        seen += added(index);
        if seen >= want {
            return bucket_middle(index);
        }
    }
    0
}

/// Counters of a node.
#[derive(Default)]
pub struct NodeStats {
    /// Time inside the node's `process`.
    pub time: Arc<Histogram>,
    /// From the arrival of the oldest light to the end of this node's work on it; kept for sinks.
    pub age: RareHistogram,
    /// From the arrival of the newest light.
    pub newest_age: RareHistogram,
    /// From a failure to the end of the next successful call.
    pub recovery: RareHistogram,
    /// Ticks dropped at the node's inputs.
    pub dropped: AtomicU64,
    /// For a node that writes files: ticks of its source that were dropped before they entered.
    pub lacking: AtomicU64,
    /// Ticks for which a required input was empty.
    pub skipped: AtomicU64,
    /// Errors and panics.
    pub faults: AtomicU64,
    /// Restarts.
    pub restarts: AtomicU64,
    /// Frames copied because the node wrote to a shared one, or between the memories of processor and GPU.
    pub copies: AtomicU64,
    /// Bytes of these frames.
    pub copied_bytes: AtomicU64,
    /// Frames converted for readers that want another format.
    pub conversions: AtomicU64,
    /// Calls that took longer than the node's budget.
    pub over_budget: AtomicU64,
    /// Heap allocations seen on the calling thread.
    pub allocations: AtomicU64,
}

impl NodeStats {
    /// Counts a copy of a frame of `bytes`.
    pub(crate) fn count_copy(&self, bytes: usize) {
        bump(&self.copies);
        self.copied_bytes.fetch_add(bytes as u64, Ordering::Relaxed);
    }
}

/// Adds one. Only the thread that runs the node writes.
pub(crate) fn bump(counter: &AtomicU64) {
    counter.fetch_add(1, Ordering::Relaxed);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_within_a_few_percent() {
        let histogram = Histogram::default();
        for ns in 1..=10_000u64 {
            histogram.record(ns * 100);
        }
        let p50 = histogram.quantile_ns(0.5) as f64;
        let p99 = histogram.quantile_ns(0.99) as f64;
        assert!((p50 / 500_000.0 - 1.0).abs() < 0.04, "{p50}");
        assert!((p99 / 990_000.0 - 1.0).abs() < 0.04, "{p99}");
        assert_eq!(histogram.max_ns(), 1_000_000);
    }

    #[test]
    fn a_window_forgets_what_came_before() {
        let histogram = Histogram::default();
        (0..100).for_each(|_| histogram.record(1_000_000));
        let before = histogram.counts();
        assert_eq!(quantile_between_ns(&before, &histogram.counts(), 0.5), 0);
        (0..10).for_each(|_| histogram.record(5_000));
        let p99 = quantile_between_ns(&before, &histogram.counts(), 0.99) as f64;
        assert!((p99 / 5_000.0 - 1.0).abs() < 0.04, "{p99}");
    }

    #[test]
    fn every_time_has_a_bucket() {
        for shift in 0..64 {
            assert!(bucket(1u64 << shift) < BUCKETS);
        }
        assert!(bucket(u64::MAX) < BUCKETS);
        assert_eq!(Histogram::default().quantile_ns(0.5), 0);
    }
}
