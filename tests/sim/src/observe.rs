//! Records what the simulated nodes saw and did. One world runs at a time, so there is one list.

use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::world::disk::Disk;
use crate::world::note;

use crate::content::Content;
use crate::harm::Harm;

/// An observation of a node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Seen {
    /// A source made a tick.
    Made {
        /// The source.
        node: String,
        /// The tick.
        seq: u64,
    },
    /// A node was called with correct inputs.
    Called {
        /// The node.
        node: String,
        /// Number of the instance in the run.
        instance: u64,
        /// Number of the call's tick.
        seq: u64,
        /// Content of each input.
        inputs: Vec<Content>,
        /// Number of calls of this node, including those of predecessors whose state it loaded.
        count: u64,
    },
    /// An input is wrong.
    Wrong {
        /// The node.
        node: String,
        /// What is wrong.
        words: String,
    },
    /// A node misbehaved.
    Harmed {
        /// The node.
        node: String,
        /// The tick; `None` outside of a tick.
        seq: Option<u64>,
        /// Kind of misbehaviour.
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

/// State that the nodes of a run share.
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

/// Starts a run with an empty list.
pub fn begin(disk: Disk) {
    *run() = Some(Run { disk, ..Run::default() });
}

/// Adds an observation to the list and to the trace.
pub fn observe(seen: Seen) {
    note(|| format!("{seen:?}"));
    run().get_or_insert_default().seen.push(seen);
}

/// The list so far.
pub fn seen() -> Vec<Seen> {
    run().as_ref().map(|run| run.seen.clone()).unwrap_or_default()
}

/// Number of observations that fulfil a condition.
pub fn count(is: impl Fn(&Seen) -> bool) -> usize {
    run().as_ref().map_or(0, |run| run.seen.iter().filter(|seen| is(seen)).count())
}

/// Number of the next tick of a source. Cheaper than a report of the engine, which reads thousands of atomics and lets other threads run at each.
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

/// Lock held by a test that runs a world and reads the list afterwards.
pub fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}
