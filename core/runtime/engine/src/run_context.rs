//! State shared by all calls of an engine: the host's functions, logs, observers and deciders.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use panoscope_abi as abi;

use crate::claims::Claims;
use crate::clock;
use crate::decide::Decider;
use crate::fault::{Action, Cause, Fault, FaultLog, unix_ms};
use crate::isolation::Groups;
use crate::log::{Level, Log};
use crate::node::NodeRuntime;
use crate::observe::Observer;
use crate::trace::Tracer;
use crate::vet::Vet;

/// Maximum wait for the reader of the log, and for the fault log.
const MAX_FLUSH: Duration = Duration::from_secs(1);

/// State shared by all calls of an engine.
pub(crate) struct RunContext {
    pub host: abi::Host,
    pub log: Log,
    pub faults: FaultLog,
    pub start_ns: u64,
    pub graph_dir: String,
    pub batch: bool,
    /// Receives everything that happens.
    pub observer: Option<Arc<dyn Observer>>,
    /// Receives the times of every call.
    pub tracer: Option<Arc<dyn Tracer>>,
    /// Makes the decisions that otherwise depend on time.
    pub decider: Option<Arc<dyn Decider>>,
    /// Heap allocations of the calling thread so far.
    pub thread_allocations: Option<fn() -> u64>,
    /// Time limits for opening a node, and for closing it, saving or loading its state.
    pub open_limit: Duration,
    pub close_limit: Duration,
    /// Files that nodes of this run write.
    pub claims: Arc<Claims>,
    /// Groups of isolated nodes.
    pub groups: Groups,
    /// Decides which nodes are opened on trial in a separate process first.
    pub vet: Option<Arc<dyn Vet>>,
    /// Nodes that lost data for good, with the reason.
    pub stopped: Mutex<BTreeMap<String, String>>,
}

impl RunContext {
    /// Reports that the recording has a gap or ends; the run continues.
    pub fn recording_trouble(&self, words: &str) {
        self.log.write(Level::Warn, "record", words);
        self.faults.put(Fault {
            unix_ms: unix_ms(),
            run_ms: clock::now_ns().saturating_sub(self.start_ns) as f64 / 1e6,
            node: "record".to_owned(),
            cause: Cause::Recording,
            words: words.to_owned(),
            done: Action::Note,
            seq: None,
            late_ms: None,
            count: 1,
        });
    }

    /// Makes a recorded node produce all its outputs, if the observer wants them.
    pub fn make_all_recorded_outputs(&self, runtime: &NodeRuntime) {
        let wants = |o: &Arc<dyn Observer>| o.wants_all_outputs() || runtime.source && o.wants_all_source_outputs();
        if self.observer.as_ref().is_some_and(wants) {
            runtime.set_outputs_read(u64::MAX);
        }
    }

    /// Waits until log lines and faults are passed on, at most [`MAX_FLUSH`] for a reader that is stuck.
    pub fn flush(&self) {
        self.log.flush(MAX_FLUSH);
        self.faults.flush(MAX_FLUSH);
    }

    /// Whether results must not depend on the wall clock (batch, replay): a tick waits instead of being dropped.
    pub fn ignores_wall_clock(&self) -> bool {
        self.batch || self.decider.is_some()
    }
}
