//! Snapshots of a node's parameters: immutable, swapped whole between two ticks.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use panoscope_abi as abi;
use panoscope_graph::ParamValue;
use panoscope_graph::from_abi::ParamSnapshot;

/// Values of all parameters of a node at a point in time.
pub struct Snapshot {
    laid_out: ParamSnapshot,
    owned: Vec<ParamValue>,
    version: u64,
}

impl Snapshot {
    /// Lays values out for the contract; every snapshot has a version of its own.
    pub fn new(owned: Vec<ParamValue>) -> Arc<Self> {
        static VERSION: AtomicU64 = AtomicU64::new(1);
        let laid_out = ParamSnapshot::new(&owned);
        Arc::new(Self { laid_out, owned, version: VERSION.fetch_add(1, Ordering::Relaxed) })
    }

    /// In the contract's layout.
    pub fn values(&self) -> &[abi::ParamValue] {
        self.laid_out.values()
    }

    /// As the graph crate states them.
    pub fn owned(&self) -> &[ParamValue] {
        &self.owned
    }

    /// Differs from every other snapshot's.
    pub fn version(&self) -> u64 {
        self.version
    }
}
