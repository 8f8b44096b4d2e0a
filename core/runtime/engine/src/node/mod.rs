//! A node of a running graph: its instance, its inputs, its counters.

mod config;
mod progress;
mod recovery;
mod runner;
mod ticks;

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock};

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
use crate::current_node::{NodeNames, Running};
use crate::exec::{Exec, ExecPlace};
use crate::instance::Instance;
use crate::isolation::Group;
use crate::join::Join;
use crate::outputs::OutputRule;
use crate::params::Snapshot;
use crate::preview::{HearNumberFn, Subscribers};
use crate::stats::NodeStats;
use crate::sync::lock;

/// A node of a running graph. The fields that every call touches lie in the first cache line.
#[repr(C, align(64))]
pub(crate) struct NodeRuntime {
    pub exec: ExecPlace,
    /// The running call.
    pub busy: Busy,
    pub config_epoch: ConfigEpoch,
    outputs_read: AtomicU64,
    pub subscribers: Subscribers,
    pub id: String,
    /// Functions of the node type: those of `declared`, or of its group.
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
    /// See [`crate::rate::phase_ns`]; 0 without a rate.
    pub rate_phase_ns: i64,
    pub rules: Box<[OutputRule]>,
    /// Names of the outputs.
    pub output_names: Arc<[String]>,
    pub join: Mutex<Join>,
    pub config: Config,
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
    /// See [`crate::rate::phase_ns`]; 0 without a rate.
    pub rate_phase_ns: i64,
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
            rate_phase_ns: spec.rate_phase_ns,
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

    /// Time budget of a call in ns, 0 for none.
    pub fn budget_ns(&self) -> u64 {
        self.config.budget_ns()
    }

    /// Outputs that somebody reads, one bit each; all beyond the 64th are made.
    pub fn set_outputs_read(&self, bits: u64) {
        self.outputs_read.store(bits, Ordering::Relaxed);
    }

    /// Outputs with a reader, one bit each; all beyond the 64th are made.
    pub fn outputs_read(&self) -> u64 {
        self.outputs_read.load(Ordering::Relaxed)
    }

    /// Whether an output has a reader.
    pub fn is_read(&self) -> bool {
        self.outputs_read() != 0
    }

    /// Somebody reads an output from the next tick on.
    pub fn read_output(&self, output: usize) {
        self.outputs_read.fetch_or(1u64.checked_shl(output as u32).unwrap_or(0), Ordering::Relaxed);
    }

    /// Counts a tick that the node is done with; returns how many there were before.
    pub fn count_done_tick(&self) -> u64 {
        // Only the thread that runs the node writes, or the watchdog in its place.
        let before = self.done_ticks.load(Ordering::Relaxed);
        self.done_ticks.store(before + 1, Ordering::Relaxed);
        before
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

    /// Next step after a fault.
    pub fn on_fault(&self) -> OnFault {
        self.config.on_fault()
    }

    /// Whether the node runs on its own thread.
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

    /// Hands over an instance that was opened next to the running one, with the values it was opened with where they
    /// are new. Returns one that was handed over before and still waited; the caller closes it.
    #[must_use]
    pub fn replace_instance(&self, instance: Instance, snapshot: Option<Arc<Snapshot>>) -> Option<Instance> {
        self.config.put_replacement(&self.config_epoch, (instance, snapshot))
    }

    /// Hands over an instance that a restart opened, unless the restart is outdated or an instance with newer values
    /// waits. Returns the instance that the caller closes: the one given or one that waited.
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
        let running = self.take_instance();
        let is_at_rest = running.is_some();
        all.extend(running);
        (all, is_at_rest)
    }

    /// Takes the instance that ticks run on; `None` if a thread runs the node.
    pub fn take_instance(&self) -> Option<Instance> {
        self.exec.with(|exec| std::mem::replace(&mut exec.instance, Instance::none(self.node_type)))
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

    fn count_copy(&self, bytes: usize) {
        self.stats.count_copy(bytes);
    }
}
