//! A node of a running graph: its instance, its inputs, its counters.

mod call;
mod lead;
mod open;
mod recovery;
mod runner;
mod ticks;

use std::collections::{BTreeMap, VecDeque};
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU8, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock};
use std::time::Duration;

use panoscope_abi::{self as abi, PortRange, Tick};
use panoscope_graph::{NodeKind, OnFault};

use self::recovery::Recovery;
use self::runner::Runner;
use self::ticks::SourceTicks;
use crate::busy::Busy;
use crate::claims::Claims;
use crate::clock;
use crate::decide::Decider;
use crate::ending::who::{Running, Who};
use crate::exec::{Exec, ExecPlace};
use crate::fault::{Action, CAUSES, Cause, Fault, FaultLog, unix_ms};
use crate::instance::Instance;
use crate::join::Join;
use crate::log::{Level, Log};
use crate::memory::FrameRef;
use crate::observe::Observer;
use crate::outputs::OutputRule;
use crate::params::{InForce, Snapshot};
use crate::preview::{HearNumberFn, Subscribers};
use crate::scratch::CallOutputs;
use crate::stats::NodeStats;
use crate::sync::lock;

/// Frames that a node may keep beyond its calls.
pub(crate) const MOST_KEPT_FRAMES: usize = 128;
/// Longest wait for whoever reads the log, and for the file of faults.
const LONGEST_FLUSH: Duration = Duration::from_secs(1);
/// Budgets are no longer: 100 days.
pub(crate) const LONGEST_BUDGET_NS: u64 = 100 * 24 * 3600 * 1_000_000_000;
/// Calls in a row without any output after which a node is called silent.
const SILENT_CALLS: u32 = 30;
/// Changes of size that are remembered: a reader may lag a few ticks behind.
const REMEMBERED_SIZES: usize = 8;

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
    pub fn widen(&self, cell: &NodeRuntime) {
        if cell.source && self.observer.as_ref().is_some_and(|o| o.wants_all_source_outputs()) {
            cell.outputs_read.store(u64::MAX, Ordering::Relaxed);
        }
    }

    /// Has log lines and faults passed on that were put in so far; a reader that stands still is not waited for.
    pub fn flush(&self) {
        self.log.flush(LONGEST_FLUSH);
        self.faults.flush(LONGEST_FLUSH);
    }

    /// Nobody watches the clock: a tick waits rather than being lost.
    pub fn unhurried(&self) -> bool {
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
    /// Changes whenever parameters, instance or policy do: a call that finds it as before need look at none of them.
    config_epoch: AtomicU64,
    pub outputs_read: AtomicU64,
    pub subscribers: Subscribers,
    pub id: String,
    pub node_type: &'static abi::NodeType,
    pub kind: NodeKind,
    pub source: bool,
    pub exclusive: bool,
    pub side_effects: bool,
    on_fault: AtomicU8,
    /// 0 for none.
    pub budget_ns: AtomicU64,
    /// 0 for none.
    pub period_ns: AtomicI64,
    pub cpu: Option<u32>,
    pub rules: Box<[OutputRule]>,
    /// Names of the outputs.
    pub output_names: Arc<[String]>,
    pub join: Mutex<Join>,
    values: InForce,
    /// Opened beside the running instance; taken over before the next tick.
    replacement: Mutex<Option<(Instance, Option<Arc<Snapshot>>)>>,
    replace: AtomicBool,
    /// Failures, and restarting after them.
    pub recovery: Recovery,
    /// The thread of a node that has one.
    pub runner: Runner,
    /// The ticks of a source.
    pub ticks: SourceTicks,
    pub stats: NodeStats,
    pub metrics: Mutex<Vec<(String, f64)>>,
    /// Hears each number that the node tells.
    pub hear_number: OnceLock<Arc<HearNumberFn>>,
    /// Ticks this node is done with, for its region.
    pub done_ticks: AtomicU64,
    /// Which input slots belong to which port.
    pub ranges: Mutex<Vec<PortRange>>,
    /// The newest changes of outputs' sizes.
    pub resized: Mutex<VecDeque<Resized>>,
    pub fault_counts: [AtomicU64; CAUSES],
    /// The node as a crash report names it.
    pub who: Arc<Who>,
    /// Outputs that made a packet so far, one bit each.
    pub ports_made: AtomicU64,
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

/// An output changed its size.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Resized {
    pub output: usize,
    pub tick: Tick,
    pub from: (u32, u32),
    pub to: (u32, u32),
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
    /// A cell whose instance is not open yet.
    pub fn new(spec: NodeSpec, join: Join, snapshot: Arc<Snapshot>) -> Self {
        let rules = OutputRule::of(spec.node_type);
        let stats = NodeStats::default();
        let time = Arc::clone(&stats.time);
        let exec = Exec::new(spec.node_type, &rules, spec.ranges.clone(), Arc::clone(&snapshot), time);
        let this = Self {
            who: Who::of(&spec.id, spec.node_type),
            ports_made: AtomicU64::new(0),
            id: spec.id,
            node_type: spec.node_type,
            kind: spec.kind,
            source: spec.source,
            exclusive: spec.node_type.flags & abi::NODE_EXCLUSIVE != 0,
            side_effects: spec.node_type.flags & abi::NODE_SIDE_EFFECTS != 0,
            on_fault: AtomicU8::new(0),
            budget_ns: AtomicU64::new(0),
            period_ns: AtomicI64::new(0),
            cpu: spec.cpu,
            output_names: rules.iter().map(|rule| rule.name.clone()).collect(),
            rules,
            exec: ExecPlace::new(exec),
            busy: Busy::default(),
            join: Mutex::new(join),
            // That of a new exec is 0.
            config_epoch: AtomicU64::new(1),
            values: InForce::new(snapshot),
            replacement: Mutex::new(None),
            replace: AtomicBool::new(false),
            recovery: Recovery::default(),
            runner: Runner::new(),
            ticks: SourceTicks::new(spec.source),
            stats,
            metrics: Mutex::new(Vec::new()),
            hear_number: OnceLock::new(),
            outputs_read: AtomicU64::new(spec.outputs_read),
            subscribers: Subscribers::new(spec.node_type.outputs_len),
            done_ticks: AtomicU64::new(0),
            ranges: Mutex::new(spec.ranges),
            resized: Mutex::default(),
            fault_counts: [const { AtomicU64::new(0) }; CAUSES],
        };
        this.set_policy(spec.on_fault, spec.budget_ms, spec.max_rate_hz);
        this
    }

    /// Sets what the host does with the node; in force from the next tick on.
    pub fn set_policy(&self, on_fault: OnFault, budget_ms: Option<f64>, max_rate_hz: Option<f64>) {
        self.on_fault.store(on_fault as u8, Ordering::Relaxed);
        // Within what a clock may be asked to add up.
        let budget_ns = budget_ms.map_or(0, |ms| ((ms * 1e6).max(1.0) as u64).min(LONGEST_BUDGET_NS));
        self.budget_ns.store(budget_ns, Ordering::Relaxed);
        self.period_ns.store(max_rate_hz.map_or(0, |hz| (1e9 / hz) as i64), Ordering::Relaxed);
        self.config_epoch.fetch_add(1, Ordering::Release);
    }

    /// An exec without an instance, for after a call that was given up.
    pub fn fresh_exec(&self) -> Box<Exec> {
        let ranges = lock(&self.ranges).clone();
        Exec::new(self.node_type, &self.rules, ranges, self.snapshot(), Arc::clone(&self.stats.time))
    }

    pub fn on_fault(&self) -> OnFault {
        let number = self.on_fault.load(Ordering::Relaxed);
        [OnFault::Restart, OnFault::Bypass, OnFault::Stop].into_iter().find(|o| *o as u8 == number).unwrap_or_default()
    }

    /// Whether the node runs on a thread of its own.
    pub fn owns_thread(&self) -> bool {
        self.source || self.kind != NodeKind::Compute
    }

    /// Takes down what a tick of the chain that starts here took.
    pub fn note_walk(&self, ns: u64) {
        let before = self.runner.walk_ns.load(Ordering::Relaxed);
        let faded = if before == u64::MAX { 0 } else { before - before / 8 };
        self.runner.walk_ns.store(ns.max(faded), Ordering::Relaxed);
    }

    /// Notes which outputs were made, where no call did.
    pub fn note_made(&self, outputs: &[abi::Frame]) {
        let made = outputs.iter().enumerate().filter(|(_, frame)| !frame.is_empty());
        let bits = made.fold(0u64, |bits, (port, _)| bits | 1u64.checked_shl(port as u32).unwrap_or(0));
        self.ports_made.fetch_or(bits, Ordering::Relaxed);
    }

    /// The values in force.
    pub fn snapshot(&self) -> Arc<Snapshot> {
        self.values.get()
    }

    /// Puts new values in force from the next tick on.
    pub fn set_snapshot(&self, snapshot: Arc<Snapshot>) {
        self.values.set(snapshot);
        self.config_epoch.fetch_add(1, Ordering::Release);
    }

    /// Hands over an instance that was opened beside the running one, with the values it was opened with where they are new. Answers one
    /// that was handed over before and is not wanted any more; the caller closes it.
    #[must_use]
    pub fn replace_instance(&self, instance: Instance, snapshot: Option<Arc<Snapshot>>) -> Option<Instance> {
        let old = lock(&self.replacement).replace((instance, snapshot));
        self.replace.store(true, Ordering::Relaxed);
        self.config_epoch.fetch_add(1, Ordering::Release);
        old.map(|(instance, _)| instance)
    }

    /// Takes all instances out, for the caller to close: files are finished then. `false` when somebody runs the node, whose instance stays.
    #[must_use]
    pub fn take_instances(&self) -> (Vec<Instance>, bool) {
        let mut all = std::mem::take(&mut *lock(&self.recovery.broken));
        all.extend(lock(&self.replacement).take().map(|(instance, _)| instance));
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
