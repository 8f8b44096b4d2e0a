// Model of a region that admits ticks.

use panoscope_abi::Tick;
use shuttle::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use shuttle::sync::{Arc, Mutex};
use shuttle::thread;

use super::memory::FrameRef;
use super::region::{Freed, Region};

/// A source, a leaf, and a thread that changes the graph.
struct Model {
    region: Region,
    /// Ticks delivered but not processed.
    inbox: Mutex<Vec<u64>>,
    delivered: Mutex<Vec<u64>>,
    /// Whether a thread runs the leaf, and how often it ran.
    running: AtomicBool,
    done: AtomicU64,
    dropped: AtomicUsize,
    over: AtomicBool,
}

fn seq(outputs: &[FrameRef]) -> u64 {
    outputs[0].tick().seq
}

impl Model {
    fn deliver(&self, outputs: &[FrameRef]) {
        thread::yield_now();
        self.delivered.lock().expect("no panic").push(seq(outputs));
        self.inbox.lock().expect("no panic").push(seq(outputs));
    }

    /// Runs the leaf for the oldest tick in the inbox, if there is one.
    fn work(&self) -> bool {
        let Some(_) = self.inbox.lock().expect("no panic").pop() else { return false };
        self.run_leaf();
        true
    }

    fn run_leaf(&self) {
        assert!(!self.running.swap(true, Ordering::SeqCst), "one thread at a time runs the leaf");
        thread::yield_now();
        assert!(self.region.in_flight() <= 2, "no more inside than fit");
        self.running.store(false, Ordering::SeqCst);
        if let Freed::Pending(outputs) = self.region.leaf_done(self.done.fetch_add(1, Ordering::SeqCst)) {
            self.deliver(&outputs);
            while let Some(outputs) = self.region.handed_over() {
                self.deliver(&outputs);
            }
        }
    }
}

pub fn every_tick_is_delivered_once_or_dropped_whatever_the_pause() {
    run(false);
}

pub fn a_tick_admitted_alone_has_the_region_to_itself() {
    run(true);
}

/// With `alone`, the source runs the leaf itself for ticks that find the region empty.
fn run(alone: bool) {
    const TICKS: u64 = 6;
    let model = Arc::new(Model {
        region: Region::new(0, 1, 2),
        inbox: Mutex::new(Vec::new()),
        delivered: Mutex::new(Vec::new()),
        running: AtomicBool::new(false),
        done: AtomicU64::new(0),
        dropped: AtomicUsize::new(0),
        over: AtomicBool::new(false),
    });
    let source = {
        let model = Arc::clone(&model);
        thread::spawn(move || {
            for n in 0..TICKS {
                if alone && model.region.admit_alone(n) {
                    model.delivered.lock().expect("no panic").push(n);
                    model.run_leaf();
                    continue;
                }
                let tick = Tick { source: 0, flags: 0, seq: n, capture_ns: n as i64 };
                let (enter, dropped) = model.region.admit_or_keep(vec![FrameRef::empty(tick)]);
                model.dropped.fetch_add(usize::from(dropped.is_some()), Ordering::SeqCst);
                if let Some(outputs) = enter {
                    model.deliver(&outputs);
                }
            }
        })
    };
    let changer = {
        let model = Arc::clone(&model);
        thread::spawn(move || {
            model.region.pause();
            thread::yield_now();
            let mut waited = model.region.resume();
            while !waited.is_empty() {
                waited.iter().for_each(|outputs| model.deliver(outputs));
                waited = model.region.handed_over().into_iter().collect();
            }
        })
    };
    let leaf = {
        let model = Arc::clone(&model);
        thread::spawn(move || {
            while !model.over.load(Ordering::SeqCst) {
                if !model.work() {
                    thread::yield_now();
                }
            }
            while model.work() {}
        })
    };
    source.join().expect("no panic");
    changer.join().expect("no panic");
    model.over.store(true, Ordering::SeqCst);
    leaf.join().expect("no panic");
    assert_eq!(model.region.in_flight(), 0, "nothing is left inside");
    assert!(!model.region.has_pending(), "nothing waits for ever");
    let mut delivered = model.delivered.lock().expect("no panic").clone();
    let count = delivered.len();
    assert!(delivered.is_sorted(), "one overtook another: {delivered:?}");
    delivered.dedup();
    assert_eq!(delivered.len(), count, "none twice");
    assert_eq!(count + model.dropped.load(Ordering::SeqCst), TICKS as usize, "none lost uncounted");
}
