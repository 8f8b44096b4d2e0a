// Model of a node with two inputs that several threads feed and fire.

use panoscope_abi::Tick;
use shuttle::sync::atomic::{AtomicBool, Ordering};
use shuttle::sync::{Arc, Mutex};
use shuttle::thread;

use super::join::{Join, Rule, Slot, Take};
use super::light::{Lights, Sources};
use super::memory::FrameRef;

/// A source of ticks of unknown light.
struct NoSource;

impl Sources for NoSource {
    fn arrived_ns(&self, _: &Tick) -> Option<i64> {
        None
    }

    fn is_constant(&self, _: &Tick) -> bool {
        false
    }

    fn is_forgotten(&self, _: &Tick) -> bool {
        false
    }
}

/// A node and its calls.
struct Node {
    join: Mutex<Join>,
    runs: AtomicBool,
    ran: Mutex<Vec<u64>>,
    finishes: Mutex<u32>,
    is_retired: AtomicBool,
}

impl Node {
    /// Takes the next tick, as the scheduler does. Returns whether one is staged.
    fn decide(&self, join: &mut Join) -> bool {
        let take = join.try_take(None, &Lights { sources: &NoSource, by_capture: false, now_ns: 1 });
        join.set_running(matches!(take, Take::Fire { .. }));
        let fires = matches!(take, Take::Fire { .. });
        assert!(!fires || !self.is_retired.load(Ordering::SeqCst), "it is fired after it was taken out");
        if take == Take::Finished && join.finish() {
            *self.finishes.lock().expect("no panic") += 1;
        }
        fires
    }

    /// Fires the node if no thread runs it, and runs it until an input is missing.
    fn try_fire(&self) {
        let mut join = self.join.lock().expect("no panic");
        if !join.is_idle() || !self.decide(&mut join) {
            return;
        }
        drop(join);
        loop {
            assert!(!self.runs.swap(true, Ordering::SeqCst), "two threads run the node");
            let (staged, take) = {
                let mut join = self.join.lock().expect("no panic");
                (std::mem::take(&mut join.staged), join.staged_take.take())
            };
            let (tick, complete) = take.expect("a tick is staged");
            assert_eq!(staged.iter().map(|frame| frame.tick().seq).collect::<Vec<_>>(), [tick.seq; 2], "one tick");
            assert!(!complete, "the frames of this model are empty");
            self.ran.lock().expect("no panic").push(tick.seq);
            thread::yield_now();
            self.runs.store(false, Ordering::SeqCst);
            if !self.decide(&mut self.join.lock().expect("no panic")) {
                return;
            }
        }
    }
}

fn node() -> Arc<Node> {
    let slots = (0..2).map(|_| Slot::new(Rule::Exact, false, 1)).collect();
    Arc::new(Node {
        join: Mutex::new(Join::new(slots, false)),
        runs: AtomicBool::new(false),
        ran: Mutex::default(),
        finishes: Mutex::default(),
        is_retired: AtomicBool::new(false),
    })
}

const TICKS: u64 = 3;

fn feed(node: &Arc<Node>, slot: usize) -> thread::JoinHandle<()> {
    let node = Arc::clone(node);
    thread::spawn(move || {
        for seq in 0..TICKS {
            let frame = FrameRef::empty(Tick { source: 0, flags: 0, seq, capture_ns: seq as i64 });
            node.join.lock().expect("no panic").push(slot, frame);
            node.try_fire();
        }
        node.join.lock().expect("no panic").end(slot);
        node.try_fire();
    })
}

pub fn a_node_runs_each_tick_once_and_on_one_thread() {
    let node = node();
    let feeders = [feed(&node, 0), feed(&node, 1)];
    feeders.into_iter().for_each(|feeder| feeder.join().expect("no panic"));
    assert_eq!(*node.ran.lock().expect("no panic"), (0..TICKS).collect::<Vec<_>>(), "each tick once and in order");
    assert_eq!(*node.finishes.lock().expect("no panic"), 1, "it finishes once");
    assert!(node.join.lock().expect("no panic").is_finished());
}

/// A change removes the node from the graph while it may be running.
pub fn a_node_that_was_taken_out_is_not_fired_again() {
    let node = node();
    let feeders = [feed(&node, 0), feed(&node, 1)];
    let mine = Arc::clone(&node);
    let retires = thread::spawn(move || {
        let mut join = mine.join.lock().expect("no panic");
        mine.is_retired.store(true, Ordering::SeqCst);
        join.finish()
    });
    feeders.into_iter().for_each(|feeder| feeder.join().expect("no panic"));
    let is_new = retires.join().expect("no panic");
    let finishes = *node.finishes.lock().expect("no panic");
    assert_eq!(finishes + u32::from(is_new), 1, "it finishes once");
    let join = node.join.lock().expect("no panic");
    assert!(join.is_finished() && !join.is_running() && !join.is_idle());
}
