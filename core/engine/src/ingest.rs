//! When the ticks of a source came into the graph.

use std::sync::atomic::AtomicU64;

/// Ticks whose ingest time is remembered per source.
pub(crate) const INGEST_RING: usize = 4096;

/// Memory for the ingest times of one source.
pub(crate) fn ingest_ring(source: bool) -> Box<[AtomicU64]> {
    (0..if source { INGEST_RING } else { 0 }).map(|_| AtomicU64::new(0)).collect()
}
