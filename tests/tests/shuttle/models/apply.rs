// Model of live changes of the graph: the region rests, the node gets its inputs anew, the ticks that waited go on.

use panoscope_abi::Tick;
use shuttle::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use shuttle::sync::{Arc, Mutex};
use shuttle::thread;

use super::change_lock::ChangeLock;
use super::join::{Join, Rule, Slot, Take};
use super::light::{Lights, Sources};
use super::memory::FrameRef;
use super::region::{Freed, Region};

const TICKS: u64 = 4;

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

/// A source, one node in its region, and the lock of changes.
struct Model {
    change: ChangeLock,
    region: Region,
    join: Mutex<Join>,
    done_ticks: AtomicU64,
    is_changing: AtomicBool,
    runs: AtomicBool,
    ran: Mutex<Vec<u64>>,
    dropped: AtomicUsize,
}

fn join() -> Join {
    Join::new(vec![Slot::new(Rule::Exact, true, 1)], false)
}

impl Model {
    fn deliver(&self, outputs: Vec<FrameRef>) {
        for frame in outputs {
            self.join.lock().expect("no panic").push(0, frame);
        }
        self.try_fire();
    }

    /// Takes the next tick, as the scheduler does.
    fn decide(&self, join: &mut Join) -> Option<u64> {
        let take = join.try_take(None, &Lights { sources: &NoSource, by_capture: false, now_ns: 1 });
        join.set_running(matches!(take, Take::Fire { .. }));
        match take {
            Take::Fire { tick, .. } => Some(tick.seq),
            Take::Wait | Take::Finished => None,
        }
    }

    fn try_fire(&self) {
        let mut join = self.join.lock().expect("no panic");
        if !join.is_idle() {
            return;
        }
        let mut next = self.decide(&mut join);
        drop(join);
        while let Some(seq) = next {
            assert!(!self.runs.swap(true, Ordering::SeqCst), "two threads run the node");
            assert!(!self.is_changing.load(Ordering::SeqCst), "a tick runs during the change");
            thread::yield_now();
            assert!(!self.is_changing.load(Ordering::SeqCst), "the change did not wait for the tick");
            self.ran.lock().expect("no panic").push(seq);
            self.runs.store(false, Ordering::SeqCst);
            let nth = self.done_ticks.fetch_add(1, Ordering::SeqCst);
            let freed = self.region.leaf_done(nth);
            next = self.decide(&mut self.join.lock().expect("no panic"));
            if let Freed::Pending(outputs) = freed {
                self.hand_over(vec![outputs]);
                // The node may have become idle, or run on another thread.
                if next.is_none() {
                    return;
                }
            }
        }
    }

    /// Delivers ticks that waited, and those that arrive meanwhile.
    fn hand_over(&self, mut waited: Vec<Vec<FrameRef>>) {
        while !waited.is_empty() {
            waited.into_iter().for_each(|outputs| self.deliver(outputs));
            waited = self.region.handed_over().into_iter().collect();
        }
    }

    /// One change, as `Engine::apply` makes it. `wait` returns whether the region came to rest; otherwise the change is undone.
    fn apply(&self) {
        let _change = self.change.lock();
        self.region.pause();
        let is_busy = || self.region.in_flight() > 0 || self.join.lock().expect("no panic").is_running();
        while is_busy() {
            thread::yield_now();
        }
        assert!(!self.is_changing.swap(true, Ordering::SeqCst), "two changes at once");
        thread::yield_now();
        self.join.lock().expect("no panic").rewire(join(), &[Some(0)]);
        self.region.reset(1, 2);
        self.done_ticks.store(0, Ordering::SeqCst);
        self.is_changing.store(false, Ordering::SeqCst);
        let waited = self.region.resume();
        self.hand_over(waited);
    }
}

pub fn every_tick_runs_once_or_is_dropped_whatever_changes() {
    let model = Arc::new(Model {
        change: ChangeLock::default(),
        region: Region::new(0, 1, 2),
        join: Mutex::new(join()),
        done_ticks: AtomicU64::new(0),
        is_changing: AtomicBool::new(false),
        runs: AtomicBool::new(false),
        ran: Mutex::default(),
        dropped: AtomicUsize::new(0),
    });
    let source = {
        let model = Arc::clone(&model);
        thread::spawn(move || {
            for seq in 0..TICKS {
                let tick = Tick { source: 0, flags: 0, seq, capture_ns: seq as i64 };
                let (enter, dropped) = model.region.admit_or_keep(vec![FrameRef::empty(tick)]);
                model.dropped.fetch_add(usize::from(dropped.is_some()), Ordering::SeqCst);
                if let Some(outputs) = enter {
                    model.deliver(outputs);
                }
            }
        })
    };
    let changers: Vec<_> = (0..2)
        .map(|_| {
            let model = Arc::clone(&model);
            thread::spawn(move || model.apply())
        })
        .collect();
    source.join().expect("no panic");
    changers.into_iter().for_each(|changer| changer.join().expect("no panic"));
    assert_eq!(model.region.in_flight(), 0, "nothing is left inside");
    assert!(!model.region.has_pending(), "nothing waits for ever");
    let ran = model.ran.lock().expect("no panic").clone();
    assert!(ran.is_sorted_by(|a, b| a < b), "each once and in order: {ran:?}");
    assert_eq!(ran.len() + model.dropped.load(Ordering::SeqCst), TICKS as usize, "none lost uncounted");
}

/// A value that waits for a node is still there after the node was rewired.
pub fn a_rewired_node_keeps_what_waits() {
    let latest = || Join::new(vec![Slot::new(Rule::Exact, true, 1), Slot::new(Rule::Latest { trigger: false }, true, 1)], true);
    let join = Arc::new(Mutex::new(latest()));
    let change = Arc::new(ChangeLock::default());
    let tick = |seq: u64| FrameRef::empty(Tick { source: 0, flags: 0, seq, capture_ns: seq as i64 });
    let feeder = {
        let join = Arc::clone(&join);
        thread::spawn(move || (0..3).for_each(|seq| _ = join.lock().expect("no panic").push(1, tick(seq))))
    };
    let changers: Vec<_> = (0..2)
        .map(|_| {
            let (join, change) = (Arc::clone(&join), Arc::clone(&change));
            thread::spawn(move || {
                let _change = change.lock();
                join.lock().expect("no panic").rewire(latest(), &[Some(0), Some(1)]);
            })
        })
        .collect();
    feeder.join().expect("no panic");
    changers.into_iter().for_each(|changer| changer.join().expect("no panic"));
    assert_eq!(join.lock().expect("no panic").waiting(1), 3, "all that came is there");
}
