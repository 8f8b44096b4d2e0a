//! What the simulated nodes saw and did. One world runs at a time, so there is one list.

use std::sync::{Mutex, MutexGuard, PoisonError};

use panoscope_sim_world::disk::Disk;
use panoscope_sim_world::note;

use crate::content::Content;
use crate::harm::Harm;

/// Something that a node saw or did.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Seen {
    /// A source made a tick.
    Made {
        /// The source.
        node: String,
        /// The tick.
        seq: u64,
    },
    /// A node was called and its inputs are right.
    Called {
        /// The node.
        node: String,
        /// Number of the instance in the run.
        instance: u64,
        /// Number of the call's tick.
        seq: u64,
        /// What each input said.
        inputs: Vec<Content>,
        /// Calls of this node, its predecessors' included whose state it took over.
        count: u64,
    },
    /// An input is wrong.
    Wrong {
        /// The node.
        node: String,
        /// What is wrong.
        words: String,
    },
    /// A node did harm.
    Harmed {
        /// The node.
        node: String,
        /// The tick; `None` for harm outside of a tick.
        seq: Option<u64>,
        /// What it did.
        harm: Harm,
    },
    /// A sink wrote a tick.
    Wrote {
        /// The sink.
        node: String,
        /// Its file.
        file: String,
        /// The tick.
        seq: u64,
    },
    /// A sink completed its file.
    Finished {
        /// The sink.
        node: String,
        /// The file.
        file: String,
    },
}

/// What nodes of a run share.
#[derive(Default)]
struct Run {
    seen: Vec<Seen>,
    disk: Disk,
    instances: u64,
}

static RUN: Mutex<Option<Run>> = Mutex::new(None);

fn run() -> MutexGuard<'static, Option<Run>> {
    RUN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Begins a run with an empty list.
pub fn begin(disk: Disk) {
    *run() = Some(Run { disk, ..Run::default() });
}

/// Adds to the list and to the trace.
pub fn observe(seen: Seen) {
    note(|| format!("{seen:?}"));
    run().get_or_insert_default().seen.push(seen);
}

/// The list so far.
pub fn seen() -> Vec<Seen> {
    run().as_ref().map(|run| run.seen.clone()).unwrap_or_default()
}

/// Counts what is on the list and fulfils a condition.
pub fn count(is: impl Fn(&Seen) -> bool) -> usize {
    run().as_ref().map_or(0, |run| run.seen.iter().filter(|seen| is(seen)).count())
}

/// The number of the tick that a source makes next. Cheaper than a report of the engine, which reads thousands of atomics and lets
/// other threads run at each.
pub fn next_tick(source: &str) -> u64 {
    let of = |seen: &Seen| match seen {
        Seen::Made { node, seq } if node == source => Some(seq + 1),
        _ => None,
    };
    run().as_ref().and_then(|run| run.seen.iter().rev().find_map(of)).unwrap_or(0)
}

/// The disk of the run.
pub fn disk() -> Disk {
    run().get_or_insert_default().disk.clone()
}

/// The number of the next instance.
pub fn next_instance() -> u64 {
    let mut run = run();
    let run = run.get_or_insert_default();
    run.instances += 1;
    run.instances
}

/// Held by who runs a world and reads the list afterwards.
pub fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}
