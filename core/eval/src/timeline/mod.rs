//! What each thread did and when: the calls of a run, as a file for the viewer of Perfetto and as a budget of the time of a picture.

mod budget;
mod perfetto;

use std::cell::Cell;
use std::collections::{HashMap, VecDeque};
use std::sync::{Arc, Mutex};

use panoscope_engine::sync::lock;
use panoscope_engine::trace::{self, Tracer};

pub use budget::{Budget, Share, Waits, work_tables};
pub use perfetto::write;

/// Calls that are kept: the newest. One takes 72 bytes.
const CALLS: usize = 1 << 20;
/// Dropped ticks that are kept: the newest.
const DROPS: usize = 1 << 16;

thread_local! {
    /// Number of the thread in the timeline that it was last entered in, with the number of that timeline.
    static THREAD: Cell<(usize, u32)> = const { Cell::new((0, 0)) };
}

/// One call of a node, or a tick that it skipped.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Call {
    pub node: u32,
    pub thread: u32,
    pub source: u32,
    pub seq: u64,
    pub start_ns: u64,
    pub end_ns: u64,
    pub made: bool,
    pub read_bytes: u64,
    pub made_bytes: u64,
}

/// A tick that was dropped where it would have entered at `node`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Drop {
    pub node: u32,
    pub seq: u64,
    pub at_ns: u64,
}

#[derive(Clone, Debug, Default)]
pub(crate) struct Calls {
    pub nodes: Vec<Arc<str>>,
    pub threads: Vec<String>,
    pub calls: VecDeque<Call>,
    pub drops: VecDeque<Drop>,
    numbers: HashMap<Arc<str>, u32>,
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
        let this = std::ptr::from_ref(self).addr();
        let (timeline, number) = THREAD.get();
        if timeline == this {
            return number;
        }
        let number = self.threads.len() as u32;
        let name = std::thread::current().name().map_or_else(|| format!("thread {number}"), str::to_owned);
        self.threads.push(name);
        THREAD.set((this, number));
        number
    }
}

/// Keeps the newest calls and dropped ticks of a run: about a million calls, which is several minutes of a large graph.
#[derive(Debug, Default)]
pub struct Timeline(Mutex<Calls>);

impl Timeline {
    pub(crate) fn copy(&self) -> Calls {
        lock(&self.0).clone()
    }
}

impl Tracer for Timeline {
    fn call(&self, call: &trace::Call<'_>) {
        let mut calls = lock(&self.0);
        let (node, thread) = (calls.number(call.node), calls.thread());
        if calls.calls.len() == CALLS {
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
        let mut calls = lock(&self.0);
        let node = calls.number(node);
        if calls.drops.len() == DROPS {
            calls.drops.pop_front();
        }
        calls.drops.push_back(Drop { node, seq, at_ns });
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
        let calls = timeline.copy();
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
        // A thread that changes between two timelines is entered again, under another number; none is without a name.
        for timeline in [first, second] {
            let calls = timeline.copy();
            assert!(calls.calls.iter().all(|call| (call.thread as usize) < calls.threads.len()), "{calls:?}");
        }
    }
}
