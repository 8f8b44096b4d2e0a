//! The thread of a node that has one.

use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Instant;

use crate::node::NodeRuntime;
use crate::pool;

/// A thread that belongs to a node. It may also run the nodes after it.
pub(crate) struct OwnThread {
    pub node: usize,
    pub runtime: Arc<NodeRuntime>,
    pub handle: JoinHandle<()>,
}

impl OwnThread {
    /// Waits until the thread ends or the deadline passes.
    pub fn join_until(self, until: Instant) {
        pool::join_until(self.handle, until);
    }
}
