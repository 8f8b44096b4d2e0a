//! Reports of a run, for example to a recorder.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use panoscope_abi::{Frame, Tick};
use panoscope_graph::{Graph, ParamValue};

use crate::applied::Applied;
use crate::decide::Ages;
use crate::fault::Fault;

/// An event of a run, in the order in which it happened to its node.
#[derive(Clone, Debug)]
pub enum Event {
    /// A live source's tick was dropped at the head of its region.
    Dropped {
        /// The source.
        node: String,
        /// Number of the tick.
        seq: u64,
    },
    /// The packets that a node took whose inputs do not all belong to one tick.
    Took {
        /// The node.
        node: String,
        /// The tick that fired it.
        tick: Tick,
        /// Source slot and number of each connection's packet, `None` where there was none.
        inputs: Vec<Option<(u32, u64)>>,
    },
    /// A node asked when the light of its inputs arrived.
    Ages {
        /// The node.
        node: String,
        /// The tick.
        tick: Tick,
        /// The answers.
        ages: Ages,
    },
    /// From this tick on a node had these values: all its parameters in declaration order.
    Values {
        /// The node.
        node: String,
        /// The tick.
        tick: Tick,
        /// The values.
        values: Vec<ParamValue>,
    },
    /// Before this tick a node reopened: after a fault, or for values that need it.
    Opened {
        /// The node.
        node: String,
        /// The tick.
        tick: Tick,
        /// All its parameters, in declaration order.
        values: Vec<ParamValue>,
    },
    /// A node skipped a tick although its inputs were complete: it was down, failed, or over its rate limit.
    Skipped {
        /// The node.
        node: String,
        /// The tick.
        tick: Tick,
        /// Whether its instance was closed.
        closed: bool,
    },
    /// A parameter was set; a later [`Event::Values`] or [`Event::Opened`] names the tick from which on.
    Set {
        /// The node.
        node: String,
        /// All its parameters, in declaration order.
        values: Vec<ParamValue>,
    },
    /// The graph was changed.
    Edit {
        /// The graph from then on.
        graph: Box<Graph>,
        /// Ticks that the regions it touched had admitted, by head.
        admitted: Vec<(String, u64)>,
        /// Its effects; `switched_at` names the first tick of each source under the new graph.
        applied: Box<Applied>,
        /// Names and files of the graph's plugins, where they changed.
        plugins: Vec<(String, PathBuf)>,
    },
    /// A fault.
    Fault(Fault),
}

/// Receives a report of a problem of the observer, such as a full disk.
pub type ReportFn = dyn Fn(&str) + Send + Sync;

/// Receives everything that a replay needs: input from outside, and decisions that depended on time.
///
/// The engine's threads call these between two nodes, so that none may wait for a disk.
pub trait Observer: Send + Sync {
    /// Whether sources make all their outputs, also those that no node reads.
    fn wants_all_source_outputs(&self) -> bool;

    /// Whether all other nodes make all their outputs, too.
    fn wants_all_outputs(&self) -> bool;

    /// Receives an event.
    fn event(&self, event: Event);

    /// The region of `head` admitted a tick.
    fn admitted(&self, head: &str);

    /// Ticks that the region of `head` has admitted.
    fn admitted_by(&self, head: &str) -> u64;

    /// A node that is not a source made these outputs. The frames are borrowed for the call.
    fn outputs(&self, node: &str, ports: &Arc<[String]>, outputs: &[Frame]);

    /// A source made a tick. The frames are borrowed for the call.
    fn source_tick(&self, node: &str, ports: &Arc<[String]>, tick: &Tick, outputs: &[Frame]);

    /// Sets where problems are reported.
    fn report_to(&self, report: Box<ReportFn>);

    /// The process is about to end after a crash: completes the files by `until`. Returns whether that was done.
    fn break_off(&self, until: Instant) -> bool;
}
