//! A node of a running graph: its instance, its inputs, its counters.

mod call;
mod config;
mod decided;
mod failures;
mod finish;
mod open;
mod progress;
mod recovery;
mod runner;
mod ticks;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock};
use std::time::Duration;

use panoscope_abi::{self as abi, PortRange, Tick};
use panoscope_graph::{NodeKind, OnFault};

pub(crate) use self::config::LONGEST_BUDGET_NS;
use self::config::{Config, ConfigEpoch};
pub(crate) use self::failures::backoff_ms;
use self::progress::Progress;
pub(crate) use self::progress::SizeChange;
use self::recovery::Recovery;
use self::runner::Runner;
use self::ticks::SourceTicks;
use crate::busy::Busy;
use crate::claims::Claims;
use crate::clock;
use crate::decide::Decider;
use crate::ending::who::{Running, Who};
use crate::exec::{Exec, ExecPlace};
use crate::fault::{Action, Cause, Fault, FaultLog, unix_ms};
use crate::instance::Instance;
use crate::join::Join;
use crate::log::{Level, Log};
use crate::memory::FrameRef;
use crate::observe::Observer;
use crate::outputs::OutputRule;
use crate::params::Snapshot;
use crate::preview::{HearNumberFn, Subscribers};
use crate::scratch::CallOutputs;
use crate::stats::NodeStats;
use crate::sync::lock;

/// Frames that a node may keep beyond its calls.
pub(crate) const MAX_RETAINED_FRAMES: usize = 128;
/// Longest wait for whoever reads the log, and for the file of faults.
const LONGEST_FLUSH: Duration = Duration::from_secs(1);
/// Calls in a row without any output after which a node is called silent.
const SILENT_CALLS: u32 = 30;

/// What every call of an engine shares.
pub(crate) struct RunContext {
    pub host: abi::Host,
    pub log: Log,
    pub faults: FaultLog,
    pub start_ns: u64,
    pub graph_dir: String,
    pub batch: bool,
    /// Hears what happens.
    pub observer: Option<Arc<dyn Observer>>,
    /// Decides what otherwise depends on time.
    pub decider: Option<Arc<dyn Decider>>,
    /// Heap allocations of the calling thread so far.
    pub thread_allocations: Option<fn() -> u64>,
    /// Longest that a node may take to open, and to close or to save or take over a state.
    pub open_limit: Duration,
    pub close_limit: Duration,
    /// Files that nodes of this run write.
    pub claims: Arc<Claims>,
    /// Nodes that lost something for good, with the reason.
    pub stopped: Mutex<BTreeMap<String, String>>,
}

impl RunContext {
    /// The recording has a gap or ends: said at once, and the run goes on.
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

    /// A source that is recorded makes all its outputs, if that is wanted.
    pub fn make_all_recorded_outputs(&self, runtime: &NodeRuntime) {
        if runtime.source && self.observer.as_ref().is_some_and(|o| o.wants_all_source_outputs()) {
            runtime.outputs_read.store(u64::MAX, Ordering::Relaxed);
        }
    }

    /// Has log lines and faults passed on that were put in so far; a reader that stands still is not waited for.
    pub fn flush(&self) {
        self.log.flush(LONGEST_FLUSH);
        self.faults.flush(LONGEST_FLUSH);
    }

    /// Nobody watches the clock: a tick waits rather than being lost.
    pub fn ignores_wall_clock(&self) -> bool {
        self.batch || self.decider.is_some()
    }
}

/// How a call ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CallOutcome {
    Ok,
    /// A source has nothing left.
    End,
    /// Not called: an input was empty, or the node is down.
    Skipped,
    /// It failed; the graph goes on.
    Fault,
    /// It failed and the graph is to stop.
    Stop,
    /// The watchdog gave this call up; the thread is to leave without touching anything.
    Abandoned,
}

/// A node of a running graph. What every call touches stands in the first cache line.
#[repr(C, align(64))]
pub(crate) struct NodeRuntime {
    pub exec: ExecPlace,
    /// The running call.
    pub busy: Busy,
    config_epoch: ConfigEpoch,
    outputs_read: AtomicU64,
    pub subscribers: Subscribers,
    pub id: String,
    pub node_type: &'static abi::NodeType,
    pub kind: NodeKind,
    pub source: bool,
    pub exclusive: bool,
    pub side_effects: bool,
    pub cpu: Option<u32>,
    pub rules: Box<[OutputRule]>,
    /// Names of the outputs.
    pub output_names: Arc<[String]>,
    pub join: Mutex<Join>,
    config: Config,
    /// Failures, and restarting after them.
    pub recovery: Recovery,
    /// The thread of a node that has one.
    pub runner: Runner,
    /// The ticks of a source.
    pub ticks: SourceTicks,
    pub stats: NodeStats,
    /// Hears each number that the node tells.
    pub hear_number: OnceLock<Arc<HearNumberFn>>,
    /// Ticks this node is done with, for its region.
    done_ticks: AtomicU64,
    /// Which input slots belong to which port.
    ranges: Mutex<Vec<PortRange>>,
    pub progress: Progress,
    /// The node as a crash report names it.
    pub who: Arc<Who>,
}

// The last of what every call touches is the count of readers, with which `subscribers` begins.
const _: () = assert!(std::mem::offset_of!(NodeRuntime, subscribers) + size_of::<usize>() <= 64);

/// What the host refused a node.
pub(crate) type Refused = Box<(Cause, String)>;

/// Readers that run inline have one input.
const ONE_INPUT: &[PortRange] = &[PortRange { first: 0, count: 1 }];

/// What a call takes and where its outputs go.
pub(crate) struct Ports<'w> {
    pub inputs: &'w mut [FrameRef],
    /// The node has one input port, with one connection.
    pub lone: bool,
    pub made: &'w mut CallOutputs,
}

/// What a node says of itself when it is made.
pub(crate) struct NodeSpec {
    pub id: String,
    pub node_type: &'static abi::NodeType,
    pub kind: NodeKind,
    pub source: bool,
    pub on_fault: OnFault,
    pub budget_ms: Option<f64>,
    pub max_rate_hz: Option<f64>,
    pub cpu: Option<u32>,
    pub ranges: Vec<PortRange>,
    pub outputs_read: u64,
}

impl NodeRuntime {
    /// A runtime whose instance is not open yet.
    pub fn new(spec: NodeSpec, join: Join, snapshot: Arc<Snapshot>) -> Self {
        let rules = OutputRule::of(spec.node_type);
        let stats = NodeStats::default();
        let time = Arc::clone(&stats.time);
        let exec = Exec::new(spec.node_type, &rules, spec.ranges.clone(), Arc::clone(&snapshot), time);
        let this = Self {
            who: Who::of(&spec.id, spec.node_type),
            id: spec.id,
            node_type: spec.node_type,
            kind: spec.kind,
            source: spec.source,
            exclusive: spec.node_type.flags & abi::NODE_EXCLUSIVE != 0,
            side_effects: spec.node_type.flags & abi::NODE_SIDE_EFFECTS != 0,
            cpu: spec.cpu,
            output_names: rules.iter().map(|rule| rule.name.clone()).collect(),
            rules,
            exec: ExecPlace::new(exec),
            busy: Busy::default(),
            join: Mutex::new(join),
            config_epoch: ConfigEpoch::new(),
            config: Config::new(snapshot),
            recovery: Recovery::default(),
            runner: Runner::new(),
            ticks: SourceTicks::new(spec.source),
            stats,
            hear_number: OnceLock::new(),
            outputs_read: AtomicU64::new(spec.outputs_read),
            subscribers: Subscribers::new(spec.node_type.outputs_len),
            done_ticks: AtomicU64::new(0),
            ranges: Mutex::new(spec.ranges),
            progress: Progress::default(),
        };
        this.set_policy(spec.on_fault, spec.budget_ms, spec.max_rate_hz);
        this
    }

    /// Sets what the host does about faults, slow calls and frequent ticks; in force from the next tick on.
    pub fn set_policy(&self, on_fault: OnFault, budget_ms: Option<f64>, max_rate_hz: Option<f64>) {
        self.config.set_policy(&self.config_epoch, on_fault, budget_ms, max_rate_hz);
    }

    /// Longest time of a call in ns, 0 for none.
    pub fn budget_ns(&self) -> u64 {
        self.config.budget_ns()
    }

    /// Outputs that somebody reads, one bit each; all beyond the 64th are made.
    pub fn set_outputs_read(&self, bits: u64) {
        self.outputs_read.store(bits, Ordering::Relaxed);
    }

    /// Somebody reads an output from the next tick on.
    pub fn read_output(&self, output: usize) {
        self.outputs_read.fetch_or(1u64.checked_shl(output as u32).unwrap_or(0), Ordering::Relaxed);
    }

    /// Counts a tick that the node is done with; returns how many there were before.
    pub fn count_done_tick(&self) -> u64 {
        self.done_ticks.fetch_add(1, Ordering::Relaxed)
    }

    /// Counts ticks from zero again, while the node's region is at rest.
    pub fn reset_done_ticks(&self) {
        self.done_ticks.store(0, Ordering::Relaxed);
    }

    /// Which input slots belong to which port.
    pub fn ranges(&self) -> Vec<PortRange> {
        lock(&self.ranges).clone()
    }

    /// Sets which input slots belong to which port.
    pub fn set_ranges(&self, ranges: Vec<PortRange>) {
        *lock(&self.ranges) = ranges;
    }

    /// The input port that a slot belongs to.
    pub fn port_of_slot(&self, slot: usize) -> Option<usize> {
        lock(&self.ranges).iter().position(|r| (r.first..r.first + r.count).contains(&(slot as u32)))
    }

    /// An exec without an instance, for after a call that was given up.
    pub fn fresh_exec(&self) -> Box<Exec> {
        let ranges = lock(&self.ranges).clone();
        Exec::new(self.node_type, &self.rules, ranges, self.snapshot(), Arc::clone(&self.stats.time))
    }

    /// What the graph wants done after a fault.
    pub fn on_fault(&self) -> OnFault {
        self.config.on_fault()
    }

    /// Whether the node runs on a thread of its own.
    pub fn owns_thread(&self) -> bool {
        self.source || self.kind != NodeKind::Compute
    }

    /// The values in force.
    pub fn snapshot(&self) -> Arc<Snapshot> {
        self.config.values()
    }

    /// Puts new values in force from the next tick on.
    pub fn set_snapshot(&self, snapshot: Arc<Snapshot>) {
        self.config.set_values(&self.config_epoch, snapshot);
    }

    /// Hands over an instance that was opened beside the running one, with the values it was opened with where they are new. Returns one
    /// that was handed over before and still waited; the caller closes it.
    #[must_use]
    pub fn replace_instance(&self, instance: Instance, snapshot: Option<Arc<Snapshot>>) -> Option<Instance> {
        self.config.put_replacement(&self.config_epoch, (instance, snapshot))
    }

    /// Takes all instances out, for the caller to close: files are finished then. `false` when somebody runs the node, whose instance stays.
    #[must_use]
    pub fn take_instances(&self) -> (Vec<Instance>, bool) {
        let mut all = self.recovery.take_broken();
        all.extend(self.config.take_replacement().map(|(instance, _)| instance));
        let Some(mut exec) = self.exec.take() else { return (all, false) };
        all.push(std::mem::replace(&mut exec.instance, Instance::none(self.node_type)));
        self.exec.put(exec);
        (all, true)
    }

    /// Name of an input.
    pub fn input_name(&self, port: usize) -> &str {
        if port >= self.node_type.inputs_len {
            return "?";
        }
        // SAFETY: a validated descriptor of a plugin that stays mapped.
        unsafe { (*self.node_type.inputs.add(port)).name.text() }.unwrap_or("?")
    }
}

impl Running for NodeRuntime {
    fn who(&self) -> &Who {
        &self.who
    }

    fn tick(&self) -> Tick {
        self.busy.tick()
    }
}
