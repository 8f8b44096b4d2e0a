//! The thread of a node that has one, and the time that its chain takes.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64};

use crate::leave::Leave;

/// The thread itself writes `thread`, `has_thread` and `walk_ns`; a thread that wakes it writes `wake`; a change of the graph writes the rest.
pub(crate) struct Runner {
    /// The node's own thread, if it has one.
    pub thread: Mutex<Option<std::thread::Thread>>,
    pub wake: AtomicBool,
    /// Taken out of the graph: its thread closes the instance when it leaves.
    pub retired: AtomicBool,
    /// Whether its thread is to leave, see [`Leave`].
    pub leave: Leave,
    pub has_thread: AtomicBool,
    /// What a tick of the inline chain that starts here took lately, the longest of about ten; `u64::MAX` before the first.
    pub walk_ns: AtomicU64,
}

impl Runner {
    /// No thread yet.
    pub fn new() -> Self {
        Self {
            thread: Mutex::new(None),
            wake: AtomicBool::new(false),
            retired: AtomicBool::new(false),
            leave: Leave::default(),
            has_thread: AtomicBool::new(false),
            walk_ns: AtomicU64::new(u64::MAX),
        }
    }
}
