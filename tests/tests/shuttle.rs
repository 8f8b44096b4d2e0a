//! The runtime's frame pool, parameter snapshot, admission queue and mark of a running call under a scheduler that tries thousands of orders (`shuttle`, after
//! Burckhardt et al., "A randomized scheduler with probabilistic guarantees of finding bugs", 2010). `build.rs` lays their sources out with
//! its locks and atomics; nothing else in them is changed.
#![allow(dead_code, missing_docs, unreachable_pub, unused_imports, clippy::undocumented_unsafe_blocks)]

use std::collections::BTreeSet;

use shuttle::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use shuttle::sync::{Arc, Mutex};
use shuttle::thread;

mod sync {
    include!(concat!(env!("OUT_DIR"), "/sync.rs"));
}
mod memory {
    include!(concat!(env!("OUT_DIR"), "/memory.rs"));

    mod pool {
        include!(concat!(env!("OUT_DIR"), "/pool.rs"));
    }
    /// The model has private memory only.
    mod domain {
        use super::Backing;

        pub struct Domain;
        pub struct DomainError;
        pub struct SharedFrames;
        pub(super) struct Shared;

        impl Shared {
            pub const fn new() -> Self {
                Self
            }

            pub fn with_backing<R>(&self, _: u32, work: impl FnOnce(Backing) -> R) -> Option<R> {
                Some(work(Backing::Private))
            }
        }
    }

    impl Memory {
        /// A memory of its own for every order that is tried.
        pub fn fresh(limit_bytes: i64) -> Self {
            Memory {
                pools: [const { OnceLock::new() }; MOST_POOLS],
                current: AtomicU32::new(PRIVATE),
                shared: Shared::new(),
                in_use_bytes: AtomicI64::new(0),
                limit_bytes: AtomicI64::new(limit_bytes),
                allocations: AtomicU64::new(0),
            }
        }
    }
}
mod params {
    include!(concat!(env!("OUT_DIR"), "/params.rs"));
}
mod region {
    include!(concat!(env!("OUT_DIR"), "/region.rs"));
}
mod busy {
    include!(concat!(env!("OUT_DIR"), "/busy.rs"));
}
mod thread_id {
    /// The model has one thread that runs nodes.
    pub(crate) fn current() -> u32 {
        7
    }
}

use busy::{Busy, CallKind};
use memory::{FrameRef, Memory};
use panoscope_abi::Tick;
use panoscope_graph::ParamValue;
use params::{InForce, Snapshot};
use region::{Freed, Region};

const ORDERS: usize = 2_000;
const BYTES: usize = 1 << 26;

#[test]
fn no_buffer_of_the_frame_pool_has_two_owners() {
    shuttle::check_pct(
        || {
            // Room for two: the third has to be refused.
            let memory = Arc::new(Memory::fresh(2 * BYTES as i64));
            let _ = memory.allocate(BYTES).map(|(id, _)| memory.release(id));
            let owned = Arc::new(Mutex::new(BTreeSet::new()));
            let threads: Vec<_> = (0..3)
                .map(|_| {
                    let (memory, owned) = (Arc::clone(&memory), Arc::clone(&owned));
                    thread::spawn(move || {
                        for _ in 0..2 {
                            let Ok((id, _)) = memory.allocate(BYTES) else { continue };
                            assert!(owned.lock().expect("no panic").insert(id.offset), "two owners of {id:?}");
                            // A reader elsewhere holds it for a while.
                            memory.retain(id);
                            let (elsewhere, held) = (Arc::clone(&memory), Arc::clone(&owned));
                            let reader = thread::spawn(move || {
                                assert!(held.lock().expect("no panic").contains(&id.offset), "gone under its reader");
                                elsewhere.release(id);
                            });
                            reader.join().expect("no panic");
                            assert_eq!(memory.references(id), 1);
                            owned.lock().expect("no panic").remove(&id.offset);
                            memory.release(id);
                        }
                    })
                })
                .collect();
            threads.into_iter().for_each(|t| t.join().expect("no panic"));
            assert_eq!(memory.in_use_bytes(), 0, "all is given back");
        },
        ORDERS / 10,
        3,
    );
}

#[test]
fn a_buffer_that_is_gone_cannot_be_kept() {
    shuttle::check_pct(
        || {
            let memory = Arc::new(Memory::fresh(4 * BYTES as i64));
            let Ok((id, _)) = memory.allocate(BYTES) else { panic!("there is room") };
            // A plugin knows the name of a buffer that is given back meanwhile, and maybe handed out anew.
            let theirs = Arc::clone(&memory);
            let plugin = thread::spawn(move || {
                for _ in 0..3 {
                    if theirs.retain_held(id) {
                        thread::yield_now();
                        assert!(theirs.references(id) > 0, "gone although it is kept");
                        theirs.release(id);
                    }
                }
            });
            memory.release(id);
            let mut mine = Vec::new();
            for _ in 0..3 {
                let Ok((new, _)) = memory.allocate(BYTES) else { continue };
                assert!(!mine.contains(&new), "handed out twice");
                mine.push(new);
            }
            plugin.join().expect("no panic");
            mine.into_iter().for_each(|id| memory.release(id));
            assert_eq!(memory.in_use_bytes(), 0, "all is given back");
        },
        ORDERS,
        3,
    );
}

#[test]
fn a_call_ends_or_is_left_behind_and_the_watchdog_knows_what_it_was_for() {
    const CALLS: [CallKind; 5] =
        [CallKind::Process, CallKind::Open, CallKind::Process, CallKind::SaveState, CallKind::Process];
    shuttle::check_pct(
        || {
            let busy = Arc::new(Busy::default());
            let ended = Arc::new(Mutex::new(Vec::new()));
            let (mine, list) = (Arc::clone(&busy), Arc::clone(&ended));
            let runner = thread::spawn(move || {
                for (n, kind) in CALLS.into_iter().enumerate() {
                    // As `Cell::run` and `Cell::aside` do.
                    let since_ns = n as u64 + 1;
                    mine.begin_kind(kind, &Tick { source: 3, flags: 0, seq: n as u64, capture_ns: 0 }, since_ns);
                    thread::yield_now();
                    if !mine.end(since_ns) {
                        // Left behind: it touches nothing any more.
                        return;
                    }
                    list.lock().expect("no panic").push(n);
                }
            });
            let mut left_behind = None;
            for _ in 0..6 {
                // As the watchdog does.
                let since_ns = busy.since_ns.load(Ordering::Acquire);
                let (kind, tick, thread) = (busy.kind(), busy.tick(), busy.thread.load(Ordering::Relaxed));
                if since_ns != 0 && busy.abandon(since_ns) {
                    let call = since_ns as usize - 1;
                    let seen = (kind, tick.source, tick.seq, thread);
                    assert_eq!(seen, (CALLS[call], 3, call as u64, 7), "it is another call's");
                    busy.clear();
                    left_behind = Some(call);
                    break;
                }
                thread::yield_now();
            }
            runner.join().expect("no panic");
            let ended = ended.lock().expect("no panic");
            let calls = left_behind.unwrap_or(CALLS.len());
            assert_eq!(*ended, (0..calls).collect::<Vec<_>>(), "each call ends once or is left behind");
        },
        ORDERS,
        3,
    );
}

#[test]
fn readers_end_with_the_snapshot_that_stays() {
    shuttle::check_pct(
        || {
            let snapshot = |n: i64| Snapshot::new(vec![ParamValue::Int(n), ParamValue::Int(-n)]);
            let values = Arc::new(InForce::new(snapshot(0)));
            let writers: Vec<_> = [1, 2]
                .map(|first| {
                    let values = Arc::clone(&values);
                    thread::spawn(move || (0..3).for_each(|n| values.set(snapshot(first * 10 + n))))
                })
                .into_iter()
                .collect();
            let reads = Arc::clone(&values);
            let reader = thread::spawn(move || {
                let mut known = reads.get();
                for _ in 0..6 {
                    if let Some(newer) = reads.newer(&known) {
                        known = newer;
                    }
                    let [ParamValue::Int(a), ParamValue::Int(b)] = known.owned() else { panic!("two numbers") };
                    assert_eq!(*a, -*b, "never a mixture");
                }
                known
            });
            writers.into_iter().for_each(|w| w.join().expect("no panic"));
            let known = reader.join().expect("no panic");
            let last = values.newer(&known).unwrap_or(known);
            assert_eq!(last.version(), values.get().version());
            assert!(values.newer(&last).is_none(), "the number is that of the snapshot that stays");
        },
        ORDERS,
        3,
    );
}

/// A source, a leaf and somebody who changes the graph.
struct Model {
    region: Region,
    /// Ticks delivered and not worked on.
    inbox: Mutex<Vec<u64>>,
    delivered: Mutex<Vec<u64>>,
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

    fn work(&self, nth: &mut u64) -> bool {
        let Some(_) = self.inbox.lock().expect("no panic").pop() else { return false };
        assert!(self.region.in_flight() <= 2, "no more inside than fit");
        if let Freed::Pending(outputs) = self.region.leaf_done(*nth) {
            self.deliver(&outputs);
            while let Some(outputs) = self.region.handed_over() {
                self.deliver(&outputs);
            }
        }
        *nth += 1;
        true
    }
}

#[test]
fn every_tick_is_delivered_once_or_dropped_whatever_the_pause() {
    const TICKS: u64 = 6;
    shuttle::check_pct(
        || {
            let model = Arc::new(Model {
                region: Region::new(0, 1, 2),
                inbox: Mutex::new(Vec::new()),
                delivered: Mutex::new(Vec::new()),
                dropped: AtomicUsize::new(0),
                over: AtomicBool::new(false),
            });
            let source = {
                let model = Arc::clone(&model);
                thread::spawn(move || {
                    for n in 0..TICKS {
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
                    let mut nth = 0;
                    while !model.over.load(Ordering::SeqCst) {
                        if !model.work(&mut nth) {
                            thread::yield_now();
                        }
                    }
                    while model.work(&mut nth) {}
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
        },
        ORDERS,
        3,
    );
}
