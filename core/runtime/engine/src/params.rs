//! Snapshots of a node's parameters: immutable, swapped whole between two ticks.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

use panoscope_abi as abi;
use panoscope_graph::ParamValue;
use panoscope_graph::from_abi::ParamSnapshot;

use crate::sync::lock;

/// Values of all parameters of a node at a point in time.
pub struct Snapshot {
    laid_out: ParamSnapshot,
    owned: Vec<ParamValue>,
    version: u64,
}

impl Snapshot {
    /// Converts values to the contract's layout. Every snapshot has its own version.
    pub fn new(owned: Vec<ParamValue>) -> Arc<Self> {
        static VERSION: AtomicU64 = AtomicU64::new(1);
        let laid_out = ParamSnapshot::new(&owned);
        Arc::new(Self { laid_out, owned, version: VERSION.fetch_add(1, Ordering::Relaxed) })
    }

    /// The values in the contract's layout.
    pub fn values(&self) -> &[abi::ParamValue] {
        self.laid_out.values()
    }

    /// The values as types of the graph crate.
    pub fn owned(&self) -> &[ParamValue] {
        &self.owned
    }

    /// Differs from the version of every other snapshot.
    pub fn version(&self) -> u64 {
        self.version
    }
}

/// The snapshot in force. A reader compares one number per tick and takes the snapshot only when it has changed.
pub(crate) struct InForce {
    snapshot: Mutex<Arc<Snapshot>>,
    version: AtomicU64,
}

impl InForce {
    pub fn new(snapshot: Arc<Snapshot>) -> Self {
        Self { version: AtomicU64::new(snapshot.version()), snapshot: Mutex::new(snapshot) }
    }

    pub fn get(&self) -> Arc<Snapshot> {
        Arc::clone(&lock(&self.snapshot))
    }

    /// In force from the next tick on.
    pub fn set(&self, snapshot: Arc<Snapshot>) {
        let mut place = lock(&self.snapshot);
        // Under the lock, so that the version belongs to the snapshot that stays when two threads write.
        self.version.store(snapshot.version(), Ordering::Release);
        *place = snapshot;
    }

    /// The new snapshot, if `known` is not the one in force.
    #[inline]
    pub fn newer(&self, known: &Snapshot) -> Option<Arc<Snapshot>> {
        (known.version() != self.version.load(Ordering::Acquire)).then(|| self.get())
    }
}
