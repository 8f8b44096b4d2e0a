//! A node of a running graph: its instance, its inputs, its counters.

mod call;
mod config;
mod decided;
pub(crate) mod failures;
mod finish;
pub(crate) mod open;
mod progress;
mod recovery;
mod runner;
mod ticks;
mod trial;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock};
use std::time::Duration;

use panoscope_abi::{self as abi, PortRange, Tick};
use panoscope_graph::{NodeKind, OnFault};

pub(crate) use self::config::MAX_BUDGET_NS;
use self::config::{Config, ConfigEpoch};
use self::progress::Progress;
pub(crate) use self::progress::SizeChange;
use self::recovery::Recovery;
use self::runner::Runner;
use self::ticks::SourceTicks;
use crate::busy::Busy;
use crate::claims::Claims;
use crate::clock;
use crate::decide::Decider;
use crate::ending::current_node::{NodeNames, Running};
use crate::exec::{Exec, ExecPlace};
use crate::fault::{Action, Cause, Fault, FaultLog, unix_ms};
use crate::instance::Instance;
use crate::isolation::{Group, Groups};
use crate::join::Join;
use crate::light::Sources;
use crate::log::{Level, Log};
use crate::memory::FrameRef;
use crate::observe::Observer;
use crate::outputs::OutputRule;
use crate::params::Snapshot;
use crate::preview::{HearNumberFn, Subscribers};
use crate::scratch::CallOutputs;
use crate::stats::NodeStats;
use crate::sync::lock;
use crate::trace::Tracer;
use crate::vet::Vet;

/// Frames that a node may retain between calls.
pub(crate) const MAX_RETAINED_FRAMES: usize = 128;
/// Longest wait for the reader of the log, and for the fault log.
const MAX_FLUSH: Duration = Duration::from_secs(1);
/// Calls in a row without output after which a node counts as silent.
const SILENT_CALLS: u32 = 30;

/// What all calls of an engine share.
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
    /// Decides which nodes are tried in a process of their own before they open.
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
            runtime.outputs_read.store(u64::MAX, Ordering::Relaxed);
        }
    }

    /// Waits until log lines and faults are passed on, but no longer than [`MAX_FLUSH`] for a reader that does not read.
    pub fn flush(&self) {
        self.log.flush(MAX_FLUSH);
        self.faults.flush(MAX_FLUSH);
    }

    /// Whether results must not depend on the wall clock (batch, replay): a tick waits instead of being dropped.
    pub fn ignores_wall_clock(&self) -> bool {
        self.batch || self.decider.is_some()
    }
}

/// How a call ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CallOutcome {
    Ok,
    /// A source has ended.
    End,
    /// Not called: an input was empty, or the node is down.
    Skipped,
    /// It failed; the graph continues.
    Fault,
    /// It failed, and the graph has to stop.
    Stop,
    /// The watchdog abandoned this call; the thread must return without touching anything.
    Abandoned,
}

/// A node of a running graph. The fields that every call touches lie in the first cache line.
#[repr(C, align(64))]
pub(crate) struct NodeRuntime {
    pub exec: ExecPlace,
    /// The running call.
    pub busy: Busy,
    config_epoch: ConfigEpoch,
    outputs_read: AtomicU64,
    pub subscribers: Subscribers,
    pub id: String,
    /// Its functions: those of `declared`, or of its group.
    pub node_type: &'static abi::NodeType,
    /// As its plugin describes it.
    pub declared: &'static abi::NodeType,
    /// The group in whose process it runs, if it is isolated.
    pub group: Option<Arc<dyn Group>>,
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
    /// Failures and restarts.
    pub recovery: Recovery,
    /// The thread of a node that has one.
    pub runner: Runner,
    /// The ticks of a source.
    pub ticks: SourceTicks,
    pub stats: NodeStats,
    /// Receives each metric that the node reports.
    pub hear_number: OnceLock<Arc<HearNumberFn>>,
    /// Ticks this node is done with, for its region.
    done_ticks: AtomicU64,
    /// Which input slots belong to which port.
    ranges: Mutex<Vec<PortRange>>,
    pub progress: Progress,
    /// The node's names for a crash report.
    pub who: Arc<NodeNames>,
}

// The last field that every call touches is the count of readers at the start of `subscribers`.
const _: () = assert!(std::mem::offset_of!(NodeRuntime, subscribers) + size_of::<usize>() <= 64);

/// A request of a node that the host refused.
pub(crate) type Refused = Box<(Cause, String)>;

/// Readers that run inline have one input.
const ONE_INPUT: &[PortRange] = &[PortRange { first: 0, count: 1 }];

/// Inputs and outputs of a call.
pub(crate) struct Ports<'w> {
    pub inputs: &'w mut [FrameRef],
    /// Whether the node has one input port with one connection.
    pub lone: bool,
    pub made: &'w mut CallOutputs,
    /// The sources of the graph.
    pub sources: &'w dyn Sources,
}

/// The fixed settings of a node.
pub(crate) struct NodeSpec {
    pub id: String,
    pub node_type: &'static abi::NodeType,
    pub group: Option<Arc<dyn Group>>,
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
        let declared = spec.node_type;
        let node_type = spec.group.as_ref().map_or(declared, |group| group.proxy(declared));
        let rules = OutputRule::of(declared);
        let stats = NodeStats::default();
        let time = Arc::clone(&stats.time);
        let exec = Exec::new(node_type, &rules, spec.ranges.clone(), Arc::clone(&snapshot), time);
        let this = Self {
            who: NodeNames::of(&spec.id, declared),
            id: spec.id,
            node_type,
            declared,
            group: spec.group,
            kind: spec.kind,
            source: spec.source,
            exclusive: declared.flags & abi::NODE_EXCLUSIVE != 0,
            side_effects: declared.flags & abi::NODE_SIDE_EFFECTS != 0,
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
            subscribers: Subscribers::new(declared.outputs_len),
            done_ticks: AtomicU64::new(0),
            ranges: Mutex::new(spec.ranges),
            progress: Progress::default(),
        };
        this.set_policy(spec.on_fault, spec.budget_ms, spec.max_rate_hz);
        this
    }

    /// Number of the domain in which it makes frames; `None` for that of all nodes in this process.
    pub fn domain(&self) -> Option<u32> {
        self.group.as_ref().map(|group| group.domain())
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

    /// Whether an output has a reader.
    pub fn is_read(&self) -> bool {
        self.outputs_read.load(Ordering::Relaxed) != 0
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

    /// An `Exec` without an instance, to replace that of an abandoned call.
    pub fn fresh_exec(&self) -> Box<Exec> {
        let ranges = lock(&self.ranges).clone();
        Exec::new(self.node_type, &self.rules, ranges, self.snapshot(), Arc::clone(&self.stats.time))
    }

    /// What to do after a fault.
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

    /// The values that a change of some of them begins with: those of an instance that waits, else those in force.
    pub fn newest_snapshot(&self) -> Arc<Snapshot> {
        self.config.newest_values()
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

    /// Hands over an instance that a restart opened, unless the restart is outdated or an instance with newer values waits. Returns the
    /// instance that the caller closes: the one given or one that waited.
    #[must_use]
    pub fn install_restarted(&self, instance: Instance, restart: u64) -> Option<Instance> {
        self.config.put_restarted(&self.config_epoch, instance, || self.recovery.is_outdated(restart))
    }

    /// Takes an instance that was handed over and waits, for the caller to close.
    #[must_use]
    pub fn take_replacement(&self) -> Option<Instance> {
        self.config.take_replacement().map(|(instance, _)| instance)
    }

    /// Takes all instances, for the caller to close. Returns `false` if a thread runs the node, whose instance stays.
    #[must_use]
    pub fn take_instances(&self) -> (Vec<Instance>, bool) {
        let mut all = self.recovery.take_broken();
        all.extend(self.take_replacement());
        let Some(mut exec) = self.exec.take() else { return (all, false) };
        all.push(std::mem::replace(&mut exec.instance, Instance::none(self.node_type)));
        self.exec.put(exec);
        (all, true)
    }

    /// Whether the node writes files: it has a parameter that names one.
    pub fn writes_files(&self) -> bool {
        if self.declared.params_len == 0 {
            return false;
        }
        // SAFETY: a validated descriptor of a plugin that stays mapped.
        let params = unsafe { std::slice::from_raw_parts(self.declared.params, self.declared.params_len) };
        self.side_effects && params.iter().any(|param| param.flags & abi::PARAM_WRITES != 0)
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
    fn who(&self) -> &NodeNames {
        &self.who
    }

    fn tick(&self) -> Tick {
        self.busy.tick()
    }
}
