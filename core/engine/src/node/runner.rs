//! The thread of a node that has one, and the time that its chain takes.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use crate::leave::Leave;
use crate::sync::lock;

/// The node's own thread. The thread registers itself and parks here; any thread may wake it; a change of the graph retires it.
pub(crate) struct Runner {
    thread: Mutex<Option<std::thread::Thread>>,
    wake: AtomicBool,
    retired: AtomicBool,
    has_thread: AtomicBool,
    /// Recent longest time of the inline chain that starts here; `u64::MAX` before the first.
    chain_ns: AtomicU64,
    /// The request to leave and its acknowledgement, see [`Leave`].
    pub leave: Leave,
}

impl Runner {
    /// Without a thread.
    pub fn new() -> Self {
        Self {
            thread: Mutex::new(None),
            wake: AtomicBool::new(false),
            retired: AtomicBool::new(false),
            has_thread: AtomicBool::new(false),
            chain_ns: AtomicU64::new(u64::MAX),
            leave: Leave::default(),
        }
    }

    /// A thread for the node is about to start.
    pub fn thread_starts(&self) {
        self.has_thread.store(true, Ordering::Release);
    }

    /// The calling thread is the node's own from now on.
    pub fn register_thread(&self) {
        *lock(&self.thread) = Some(std::thread::current());
    }

    /// The node's thread is about to end; it no longer touches the node.
    pub fn thread_ended(&self) {
        self.has_thread.store(false, Ordering::Release);
    }

    /// Whether the node's thread runs.
    pub fn has_thread(&self) -> bool {
        self.has_thread.load(Ordering::Acquire)
    }

    /// Wakes the node's thread.
    pub fn wake(&self) {
        self.wake.store(true, Ordering::Release);
        if let Some(thread) = &*lock(&self.thread) {
            thread.unpark();
        }
    }

    /// Parks the calling thread, the node's own, until somebody wakes it.
    pub fn park(&self) {
        while !self.wake.swap(false, Ordering::Acquire) {
            std::thread::park();
        }
    }

    /// Parks the calling thread until somebody wakes it or, where there is a limit, this time is over. May return early.
    pub fn park_at_most(&self, limit: Option<Duration>) {
        if self.wake.swap(false, Ordering::Acquire) {
            return;
        }
        match limit {
            Some(limit) => std::thread::park_timeout(limit),
            None => std::thread::park(),
        }
        self.wake.store(false, Ordering::Release);
    }

    /// Asks the node's thread to end; it does when its call has returned.
    pub fn ask_to_leave(&self) {
        self.leave.request();
        self.wake();
    }

    /// Takes the node out of the graph: its thread closes the instance and ends.
    pub fn retire(&self) {
        self.retired.store(true, Ordering::Release);
        self.ask_to_leave();
    }

    /// Whether the node was taken out of the graph.
    pub fn is_retired(&self) -> bool {
        self.retired.load(Ordering::Acquire)
    }

    /// Longest time of recent ticks of the inline chain that starts here, in ns; `u64::MAX` before the first.
    #[inline]
    pub fn chain_ns(&self) -> u64 {
        self.chain_ns.load(Ordering::Relaxed)
    }

    /// Records the time of a tick of that chain. Older maxima fade by an eighth per tick.
    #[inline]
    pub fn record_chain_time(&self, ns: u64) {
        let before = self.chain_ns.load(Ordering::Relaxed);
        let faded = if before == u64::MAX { 0 } else { before - before / 8 };
        self.chain_ns.store(ns.max(faded), Ordering::Relaxed);
    }
}
