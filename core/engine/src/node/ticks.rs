//! The ticks that a source has made. Its thread writes them; the watchdog does in its stead when it gives a call up.

use std::sync::atomic::{AtomicI64, AtomicU64};

use crate::ingest::ingest_ring;

/// See the module; of no meaning for a node that is no source.
pub(crate) struct SourceTicks {
    /// Newest capture time of a source, `i64::MIN` for none.
    pub last_capture_ns: AtomicI64,
    /// Ticks a source has made.
    pub made: AtomicU64,
    /// Ingest times of a source's newest ticks.
    pub ingest_ns: Box<[AtomicU64]>,
}

impl SourceTicks {
    /// None made yet.
    pub fn new(is_source: bool) -> Self {
        Self { last_capture_ns: AtomicI64::new(i64::MIN), made: AtomicU64::new(0), ingest_ns: ingest_ring(is_source) }
    }
}
