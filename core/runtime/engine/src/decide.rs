//! A decider repeats the decisions of an earlier run in place of the clock.

use std::collections::VecDeque;
use std::sync::Mutex;

use panoscope_abi::Tick;
use panoscope_graph::ParamValue;

use crate::memory::FrameRef;

/// A tick of a source in the earlier run.
#[derive(Clone, Copy, Debug)]
pub struct SourceTick {
    /// Its number.
    pub seq: u64,
    /// Media time.
    pub capture_ns: i64,
    /// Whether it entered the graph; otherwise it was dropped.
    pub admitted: bool,
    /// Whether its packets are missing from the recording.
    pub gap: bool,
}

/// The packets that a node takes next: the tick that fires it, and source slot and tick number of each connection's
/// packet.
#[derive(Clone, Debug)]
pub struct Wanted {
    /// The tick that fires the node.
    pub tick: Tick,
    /// Per connection; `None` where there was no packet.
    pub inputs: Vec<Option<(u32, u64)>>,
}

/// Input ages that a node received during one call.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Ages {
    /// The moment for which ages were given, ns.
    pub now_ns: i64,
    /// Per connection that it asked for: its index, and the arrival of its light, ns; `None` where it is unknown.
    pub arrived: Vec<(u32, Option<i64>)>,
}

/// An event of a node before a tick.
#[derive(Clone, Debug)]
pub enum Turn {
    /// These values take effect.
    Values(Vec<ParamValue>),
    /// The node reopens with these values.
    Opened(Vec<ParamValue>),
    /// The node skips the tick.
    Skipped {
        /// Whether it is this tick and not an earlier one that this run lacks.
        here: bool,
        /// Whether its instance is closed.
        closed: bool,
    },
}

/// A tick of a source that cannot be played.
#[derive(Debug, thiserror::Error)]
pub enum FramesError {
    /// The source has lost an output since.
    #[error(
        "tick {seq} of the recording has a packet of `{node}.{port}`, but the source here has no such output: record again"
    )]
    NoOutput {
        /// Number of the tick.
        seq: u64,
        /// The source.
        node: String,
        /// The output.
        port: String,
    },
    /// A packet cannot be read.
    #[error("{reason}")]
    Read {
        /// Reason.
        reason: String,
    },
}

/// Makes the decisions that otherwise depend on time. Edits are numbered from 0, in order.
pub trait Decider: Send + Sync {
    /// Whether a node never opens: its ticks are known, or it would act on the world.
    fn closes(&self, is_source: bool, has_side_effects: bool) -> bool;

    /// Whether the decider decides for all nodes, not only for sources.
    fn leads_nodes(&self) -> bool;

    /// Whether the ticks of this source are known.
    fn has_source(&self, node: &str) -> bool;

    /// The next tick of a source; the same one until [`Self::source_done`] is called.
    fn source_next(&self, node: &str) -> Option<SourceTick>;

    /// The next tick of a source is made.
    fn source_done(&self, node: &str);

    /// The packets of the source's next tick by the names of `ports`; `None` where there was none.
    ///
    /// # Errors
    /// The packets cannot be read, or are not those of this source.
    fn source_frames(&self, node: &str, ports: &[String]) -> Result<Vec<Option<FrameRef>>, FramesError>;

    /// The packets that a node takes next.
    fn took(&self, node: &str) -> Option<&Mutex<VecDeque<Wanted>>>;

    /// The next event of a node before `tick`; `None` when there is none left.
    fn next_turn(&self, node: &str, tick: &Tick) -> Option<Turn>;

    /// Input ages that a node received at `tick`; `None` where they are unknown.
    fn ages(&self, node: &str, tick: &Tick) -> Option<Ages>;

    /// Whether the head of a region may admit another tick before the next edit.
    fn may_enter(&self, head: &str) -> bool;

    /// The head of a region admitted a tick.
    fn entered(&self, head: &str);

    /// Whether ticks that come before this edit have not entered yet.
    fn waits_before(&self, edit: usize) -> bool;

    /// Nodes that an edit replaced.
    fn replaced(&self, edit: usize) -> &[String];

    /// An edit was made: the ticks after it may enter.
    fn edited(&self, edit: usize);

    /// The run can no longer repeat the earlier one.
    fn fail(&self, reason: String);

    /// Whether [`Self::fail`] was called.
    fn has_failed(&self) -> bool;
}
