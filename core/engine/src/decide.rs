//! What a run follows instead of the clock: the decisions of an earlier run.

use std::collections::VecDeque;
use std::sync::Mutex;

use panoscope_abi::Tick;
use panoscope_graph::ParamValue;

use crate::memory::FrameRef;

/// A tick of a source as it was made once.
#[derive(Clone, Copy, Debug)]
pub struct SourceTick {
    /// Its number.
    pub seq: u64,
    /// Media time.
    pub capture_ns: i64,
    /// It went into the graph; else it was dropped.
    pub admitted: bool,
    /// Its packets are not known any more.
    pub gap: bool,
}

/// The packets that a node takes next: the tick that fires it, and source slot and number of each connection's packet.
#[derive(Clone, Debug)]
pub struct Wanted {
    /// The tick that fires the node.
    pub tick: Tick,
    /// Per connection; `None` where there was no packet.
    pub inputs: Vec<Option<(u32, u64)>>,
}

/// What is due at a node before a tick.
#[derive(Clone, Debug)]
pub enum Turn {
    /// These values come into force.
    Values(Vec<ParamValue>),
    /// The node is opened anew with these values.
    Opened(Vec<ParamValue>),
    /// The node makes nothing of the tick.
    Skipped {
        /// It is this very tick, not one that is missing here.
        here: bool,
        /// Its instance is given up.
        closed: bool,
    },
}

/// Decides what otherwise depends on time. Positions of edits count from 0 in the order in which they were made.
pub trait Decider: Send + Sync {
    /// Whether a node is never opened: its ticks are known, or it would act on the world.
    fn closes(&self, is_source: bool, has_side_effects: bool) -> bool;

    /// Whether nodes are decided for, not only sources.
    fn leads_nodes(&self) -> bool;

    /// Whether the ticks of this source are known.
    fn has_source(&self, node: &str) -> bool;

    /// The next tick of a source; the same again until [`Self::source_done`].
    fn source_next(&self, node: &str) -> Option<SourceTick>;

    /// The next tick of a source is made.
    fn source_done(&self, node: &str);

    /// The packets of the source's next tick by the names of `ports`; `None` where there was none.
    ///
    /// # Errors
    /// In words, when they cannot be had.
    fn source_frames(&self, node: &str, ports: &[String]) -> Result<Vec<Option<FrameRef>>, String>;

    /// The packets that a node takes next.
    fn took(&self, node: &str) -> Option<&Mutex<VecDeque<Wanted>>>;

    /// What is due at a node before `tick`, one after the other; `None` when nothing is left.
    fn next_turn(&self, node: &str, tick: &Tick) -> Option<Turn>;

    /// Whether the head of a region may let another tick in before the next edit.
    fn may_enter(&self, head: &str) -> bool;

    /// The head of a region let a tick in.
    fn entered(&self, head: &str);

    /// Whether a head that an edit waits for has not let all ticks in which come before it.
    fn waits_before(&self, edit: usize) -> bool;

    /// Nodes that an edit replaced.
    fn replaced(&self, edit: usize) -> &[String];

    /// An edit is made: what comes after it may enter.
    fn edited(&self, edit: usize);

    /// The run cannot go on like the earlier one.
    fn fail(&self, reason: String);

    /// Whether [`Self::fail`] was called.
    fn has_failed(&self) -> bool;
}
