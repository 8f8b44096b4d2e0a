//! The thread of a node that has one.

use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Instant;

use crate::node::NodeRuntime;
use crate::pool;

/// A thread that belongs to a node. It may run the nodes after it, too.
pub(crate) struct OwnThread {
    pub node: usize,
    pub runtime: Arc<NodeRuntime>,
    pub handle: JoinHandle<()>,
}

impl OwnThread {
    /// Waits until it has left, but no longer than until then.
    pub fn join_until(self, until: Instant) {
        pool::join_until(self.handle, until);
    }
}
