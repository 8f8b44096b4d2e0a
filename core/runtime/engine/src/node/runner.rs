//! The thread of a node that has one, and the time that its chain takes.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use crate::clock;
use crate::leave::Leave;
use crate::sync::lock;

/// Expected maximum time of giving way to the waking thread.
const SHORT_WAY_NS: u64 = 100_000;
/// Time without giving way after it took longer than expected; doubled each time, up to the second value.
const PAUSE_NS: [u64; 2] = [250_000_000, 32_000_000_000];

/// The pause of all threads of the process: they share the processors.
static PAUSE: Pause = Pause::new();

/// When threads do not give way, because it took too long.
struct Pause {
    until_ns: AtomicU64,
    next_ns: AtomicU64,
}

impl Pause {
    const fn new() -> Self {
        Self { until_ns: AtomicU64::new(0), next_ns: AtomicU64::new(PAUSE_NS[0]) }
    }

    fn is_over(&self, now_ns: u64) -> bool {
        now_ns >= self.until_ns.load(Ordering::Relaxed)
    }

    /// Records how long a thread gave way.
    fn gave_way(&self, start_ns: u64, end_ns: u64) {
        if end_ns.saturating_sub(start_ns) < SHORT_WAY_NS {
            self.next_ns.store(PAUSE_NS[0], Ordering::Relaxed);
        } else {
            let pause_ns = self.next_ns.load(Ordering::Relaxed);
            self.until_ns.store(end_ns + pause_ns, Ordering::Relaxed);
            self.next_ns.store((2 * pause_ns).min(PAUSE_NS[1]), Ordering::Relaxed);
        }
    }
}

/// Lets the thread that wakes another one return to its wait first.
///
/// A kernel may run the woken thread at once on the processor of its waker, which then has yet to finish its own tick.
/// A third thread that is woken meanwhile is moved to another processor, and waking a thread on a sleeping processor
/// takes several times as long. Where other programs want the processor, giving way lasts a time slice, so it is rarely
/// tried there.
#[derive(Default)]
struct Courtesy {
    /// Set while a thread is inside the call that wakes this one.
    is_waking: AtomicBool,
}

impl Courtesy {
    /// Wakes a thread. No other thread may be inside this call.
    fn wake(&self, thread: &std::thread::Thread) {
        self.is_waking.store(true, Ordering::Relaxed);
        thread.unpark();
        self.is_waking.store(false, Ordering::Relaxed);
    }

    /// Called by the woken thread.
    fn give_way(&self) {
        if !self.is_waking.load(Ordering::Relaxed) {
            return;
        }
        let start_ns = clock::now_ns();
        if PAUSE.is_over(start_ns) {
            std::thread::yield_now();
            PAUSE.gave_way(start_ns, clock::now_ns());
        }
    }
}

/// The node's own thread. The thread registers itself and parks here; any thread may wake it; a change of the graph
/// retires it.
pub(crate) struct Runner {
    thread: Mutex<Option<std::thread::Thread>>,
    courtesy: Courtesy,
    wake: AtomicBool,
    retired: AtomicBool,
    has_thread: AtomicBool,
    /// Recent maximum time of the inline chain that starts here; `u64::MAX` before the first.
    chain_ns: AtomicU64,
    /// The request to leave and its acknowledgement, see [`Leave`].
    pub leave: Leave,
}

impl Runner {
    /// A runner without a thread.
    pub fn new() -> Self {
        Self {
            thread: Mutex::new(None),
            courtesy: Courtesy::default(),
            wake: AtomicBool::new(false),
            retired: AtomicBool::new(false),
            has_thread: AtomicBool::new(false),
            chain_ns: AtomicU64::new(u64::MAX),
            leave: Leave::default(),
        }
    }

    /// Records that a thread for the node is about to start.
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
            self.courtesy.wake(thread);
        }
    }

    /// Parks the calling thread, the node's own, until it is woken.
    pub fn park(&self) {
        while !self.wake.swap(false, Ordering::Acquire) {
            std::thread::park();
        }
        self.courtesy.give_way();
    }

    /// Parks the calling thread until it is woken or the limit, if there is one, is over. May return early.
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

    /// Asks the node's thread to end once its call has returned.
    pub fn ask_to_leave(&self) {
        self.leave.request();
        self.wake();
    }

    /// Removes the node from the graph: its thread closes the instance and ends.
    pub fn retire(&self) {
        self.retired.store(true, Ordering::Release);
        self.ask_to_leave();
    }

    /// Whether the node was taken out of the graph.
    pub fn is_retired(&self) -> bool {
        self.retired.load(Ordering::Acquire)
    }

    /// Maximum time of recent ticks of the inline chain that starts here, in ns; `u64::MAX` before the first.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn threads_stop_giving_way_where_it_takes_long() {
        let pause = Pause::new();
        assert!(pause.is_over(0));
        pause.gave_way(1_000, 2_000);
        assert!(pause.is_over(2_000), "a short way costs nothing");
        // Each long one doubles the pause, up to the longest.
        let mut now_ns = 10_000;
        for pause_ms in [250, 500, 1_000, 2_000, 4_000, 8_000, 16_000, 32_000, 32_000] {
            let end_ns = now_ns + 3_000_000;
            pause.gave_way(now_ns, end_ns);
            now_ns = end_ns + pause_ms * 1_000_000;
            assert!(!pause.is_over(now_ns - 1) && pause.is_over(now_ns), "{pause_ms} ms");
        }
        // A short one makes the next pause short again.
        pause.gave_way(now_ns, now_ns + 1_000);
        pause.gave_way(now_ns, now_ns + 3_000_000);
        assert!(pause.is_over(now_ns + 253_000_000));
    }
}
