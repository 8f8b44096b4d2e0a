//! Timeline of the calls of a run by thread, as a file for the Perfetto viewer and as a time budget per frame.

mod budget;
mod perfetto;
mod simulate;

use std::collections::{HashMap, VecDeque};
use std::sync::{Arc, Mutex};
use std::thread::ThreadId;

use panoscope_engine::sync::lock;
use panoscope_engine::trace::{self, Tracer};

pub use budget::{Beside, Budget, Share, Waits, work_tables};
pub use perfetto::write;
pub use simulate::Recorded;

/// Default number of newest calls that are kept, 72 bytes each.
const CALLS: usize = 1 << 20;
/// Default number of newest dropped ticks that are kept.
const DROPS: usize = 1 << 16;

/// One call of a node, or a tick that it skipped. Times are ns of [`panoscope_engine::clock::now_ns`].
#[derive(Clone, Copy, Debug)]
pub struct Call {
    /// Position in [`Calls::nodes`].
    pub node: u32,
    /// Position in [`Calls::threads`].
    pub thread: u32,
    /// Slot of the tick's source.
    pub source: u32,
    /// Number of the tick.
    pub seq: u64,
    /// Begin of the call.
    pub start_ns: u64,
    /// End of the call.
    pub end_ns: u64,
    /// False if the node was skipped or failed.
    pub made: bool,
    /// Bytes of its inputs.
    pub read_bytes: u64,
    /// Bytes of its outputs.
    pub made_bytes: u64,
}

/// A tick that was dropped at the head of its region.
#[derive(Clone, Copy, Debug)]
pub struct Dropped {
    /// The node, a position in [`Calls::nodes`].
    pub node: u32,
    /// Number of the tick.
    pub seq: u64,
    /// When it was dropped, ns.
    pub at_ns: u64,
}

/// Content of a timeline.
#[derive(Clone, Debug, Default)]
pub struct Calls {
    /// Names of the nodes.
    pub nodes: Vec<Arc<str>>,
    /// Names of the threads.
    pub threads: Vec<String>,
    /// Calls in the order of their ends.
    pub calls: VecDeque<Call>,
    /// Dropped ticks.
    pub drops: VecDeque<Dropped>,
    numbers: HashMap<Arc<str>, u32>,
    thread_numbers: HashMap<ThreadId, u32>,
}

impl Calls {
    fn number(&mut self, node: &str) -> u32 {
        if let Some(number) = self.numbers.get(node) {
            return *number;
        }
        let (number, node) = (self.nodes.len() as u32, Arc::<str>::from(node));
        self.numbers.insert(Arc::clone(&node), number);
        self.nodes.push(node);
        number
    }

    fn thread(&mut self) -> u32 {
        let this = std::thread::current();
        *self.thread_numbers.entry(this.id()).or_insert_with(|| {
            let number = self.threads.len() as u32;
            self.threads.push(this.name().map_or_else(|| format!("thread {number}"), str::to_owned));
            number
        })
    }
}

/// Keeps the newest calls and dropped ticks of a run: by default about a million calls, which is several minutes of a
/// large graph.
#[derive(Debug)]
pub struct Timeline {
    calls: Mutex<Calls>,
    max_calls: usize,
    max_drops: usize,
}

impl Default for Timeline {
    fn default() -> Self {
        Self::with_room(CALLS, DROPS)
    }
}

impl Timeline {
    /// A timeline that keeps `max_calls` calls and `max_drops` dropped ticks.
    pub fn with_room(max_calls: usize, max_drops: usize) -> Self {
        // Reserved at once, because it is filled between two nodes.
        let (calls, drops) = (VecDeque::with_capacity(max_calls), VecDeque::with_capacity(max_drops));
        Self { calls: Mutex::new(Calls { calls, drops, ..Calls::default() }), max_calls, max_drops }
    }

    /// A copy of the current content.
    pub fn snapshot(&self) -> Calls {
        lock(&self.calls).clone()
    }
}

impl Tracer for Timeline {
    fn call(&self, call: &trace::Call<'_>) {
        let mut calls = lock(&self.calls);
        let (node, thread) = (calls.number(call.node), calls.thread());
        if calls.calls.len() == self.max_calls {
            calls.calls.pop_front();
        }
        calls.calls.push_back(Call {
            node,
            thread,
            source: call.tick.source,
            seq: call.tick.seq,
            start_ns: call.start_ns,
            end_ns: call.end_ns,
            made: call.made,
            read_bytes: call.read_bytes,
            made_bytes: call.made_bytes,
        });
    }

    fn dropped(&self, node: &str, seq: u64, at_ns: u64) {
        let mut calls = lock(&self.calls);
        let node = calls.number(node);
        if calls.drops.len() == self.max_drops {
            calls.drops.pop_front();
        }
        calls.drops.push_back(Dropped { node, seq, at_ns });
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use panoscope_abi::Tick;

    use super::*;

    /// Enters a call of `node` for tick `seq`, ms.
    pub(crate) fn enter(timeline: &Timeline, node: &str, seq: u64, start_ms: u64, end_ms: u64) {
        let tick = Tick { source: 0, flags: 0, seq, capture_ns: 0 };
        let (start_ns, end_ns) = (start_ms * 1_000_000, end_ms * 1_000_000);
        timeline.call(&trace::Call {
            node,
            tick: &tick,
            start_ns,
            end_ns,
            made: true,
            read_bytes: 0,
            made_bytes: 1000,
        });
    }

    #[test]
    fn calls_keep_their_threads() {
        let timeline = Timeline::default();
        enter(&timeline, "camera", 0, 0, 1);
        std::thread::scope(|scope| {
            let other = std::thread::Builder::new().name("second".to_owned());
            other.spawn_scoped(scope, || enter(&timeline, "sink", 0, 1, 2)).expect("a thread starts");
        });
        enter(&timeline, "camera", 1, 3, 4);
        let calls = timeline.snapshot();
        let entries: Vec<(&str, u32)> =
            calls.calls.iter().map(|c| (&*calls.nodes[c.node as usize], c.thread)).collect();
        assert_eq!(entries, [("camera", 0), ("sink", 1), ("camera", 0)]);
        assert_eq!(calls.threads[1], "second");
    }

    #[test]
    fn two_timelines_number_their_threads_alone() {
        let (first, second) = (Timeline::default(), Timeline::default());
        for seq in 0..2 {
            enter(&first, "a", seq, seq, seq + 1);
            enter(&second, "b", seq, seq, seq + 1);
        }
        for timeline in [first, second] {
            let calls = timeline.snapshot();
            assert_eq!(calls.threads.len(), 1, "{calls:?}");
            assert!(calls.calls.iter().all(|call| (call.thread as usize) < calls.threads.len()), "{calls:?}");
        }
    }
}
