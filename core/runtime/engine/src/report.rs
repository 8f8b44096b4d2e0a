//! The report of a run, as written by `--report`. Its format is a contract: see the README.

use std::collections::{BTreeMap, HashMap};
use std::sync::atomic::Ordering;

use panoscope_graph::Graph;
use serde::{Deserialize, Serialize};

use crate::clock;
use crate::isolation::GroupReport;
use crate::join::Slot;
use crate::node::NodeRuntime;
use crate::plan::Plan;
use crate::schedule::Shared;
use crate::stats::quantile_between_ns;
use crate::sync::lock;

/// Counters and times of a run.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Name of the graph.
    pub graph: String,
    /// Ticks with a frame that the busiest source made.
    pub frames: u64,
    /// Wall time.
    pub seconds: f64,
    /// `frames / seconds`.
    pub fps: f64,
    /// Per node.
    pub nodes: BTreeMap<String, NodeReport>,
    /// Per sink: ages of its finished work.
    pub paths: BTreeMap<String, PathReport>,
    /// Per group of isolated nodes.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub groups: BTreeMap<String, GroupReport>,
    /// Nodes that lost data for good, with the reason: a full disk, a file that could not be completed. Such a run has
    /// failed.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub stopped: BTreeMap<String, String>,
    /// Heap allocations per frame in steady state, null when not counted.
    pub allocations_per_frame: Option<f64>,
    /// The machine of the run.
    pub machine: Machine,
}

/// Counters and times of a node.
#[derive(Clone, Debug, Serialize)]
pub struct NodeReport {
    /// Calls.
    pub count: u64,
    /// Median time of a call.
    pub p50_ms: f64,
    /// 99th percentile of the time of a call.
    pub p99_ms: f64,
    /// Maximum time of a call.
    pub max_ms: f64,
    /// Ticks and packets dropped where they would have entered here.
    pub dropped: u64,
    /// For a node that writes files: ticks of its source that are missing from the files, because they were dropped at
    /// the head of its region.
    #[serde(skip_serializing_if = "is_zero")]
    pub lacking: u64,
    /// Packets dropped per edge because its queue was full; edges without drops are not listed.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub dropped_on: Vec<WireDrops>,
    /// Ticks per edge at which the packet was older than `max_age_ms` and counted as absent; edges without any are not
    /// listed.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub too_old_on: Vec<WireTooOld>,
    /// Ticks not processed because a required input was empty.
    pub skipped: u64,
    /// Errors and panics.
    pub faults: u64,
    /// Restarts.
    pub restarts: u64,
    /// Calls over the node's budget.
    pub over_budget: u64,
    /// Maximum time from a fault to the end of the next successful call.
    pub recovery_max_ms: f64,
    /// Frames copied because the node wrote to a shared one, or between the memories of processor and GPU.
    pub copies: u64,
    /// Bytes of these frames, in MB (10^6 bytes).
    pub copied_mb: f64,
    /// Frames converted for its readers.
    pub conversions: u64,
    /// Heap allocations on the calling thread, all calls together; null when not counted.
    pub allocations: Option<u64>,
    /// For a source: ticks that it made.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub made: Option<u64>,
    /// Required inputs that never received a packet, as `node.port` of their producer.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub never_got: Vec<String>,
    /// Whether a replay skips the node because it acts on the world.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub muted: bool,
    /// Metrics of the node.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub metrics: BTreeMap<String, f64>,
}

/// Packets dropped on one edge.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct WireDrops {
    /// The input's name.
    pub input: String,
    /// Position in a list input; 0 for others.
    pub index: usize,
    /// Number of packets.
    pub dropped: u64,
}

/// Packets on one edge that were too old.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct WireTooOld {
    /// The input's name.
    pub input: String,
    /// Position in a list input; 0 for others.
    pub index: usize,
    /// Number of ticks.
    pub ticks: u64,
}

/// Age of a sink's finished work: the time from the arrival of its light to the end of the sink's work.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct PathReport {
    /// Median age of the oldest light, whatever edges it came by.
    pub age_p50_ms: f64,
    /// 99th percentile.
    pub age_p99_ms: f64,
    /// Maximum.
    pub age_max_ms: f64,
    /// Median age of the newest light.
    pub newest_age_p50_ms: f64,
    /// 99th percentile.
    pub newest_age_p99_ms: f64,
    /// Maximum.
    pub newest_age_max_ms: f64,
}

/// The machine of a run.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Machine {
    /// Processor.
    pub cpu: String,
    /// Processor cores that this process may use.
    pub cores: usize,
    /// Threads of the pool.
    pub threads: usize,
    /// Operating system.
    pub os: String,
}

fn is_zero(count: &u64) -> bool {
    *count == 0
}

fn ms(ns: u64) -> f64 {
    ns as f64 / 1e6
}

impl Machine {
    /// Describes this machine.
    pub fn here(threads: usize) -> Self {
        let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
        let cpu = info.lines().find_map(|l| l.strip_prefix("model name")?.split_once(':'));
        Self {
            cpu: cpu.map_or_else(|| std::env::consts::ARCH.to_owned(), |(_, name)| name.trim().to_owned()),
            cores: std::thread::available_parallelism().map_or(1, usize::from),
            threads,
            os: std::env::consts::OS.to_owned(),
        }
    }
}

impl Report {
    pub(crate) fn of(graph: &Graph, shared: &Shared) -> Self {
        let end_ns = match shared.end_ns.load(Ordering::Relaxed) {
            0 => clock::now_ns(),
            ns => ns,
        };
        let seconds = end_ns.saturating_sub(shared.start_ns) as f64 / 1e9;
        let plan = shared.plan.load();
        let frames = plan.live().map(|(_, c)| c.ticks.with_frame()).max().unwrap_or(0);
        let mut nodes = BTreeMap::new();
        let mut paths = BTreeMap::new();
        for (slot, runtime) in plan.live() {
            let wiring = &plan.wiring[slot];
            let stats = &runtime.stats;
            let load = |counter: &std::sync::atomic::AtomicU64| counter.load(Ordering::Relaxed);
            nodes.insert(
                runtime.id.clone(),
                NodeReport {
                    count: stats.time.count(),
                    p50_ms: ms(stats.time.quantile_ns(0.5)),
                    p99_ms: ms(stats.time.quantile_ns(0.99)),
                    max_ms: ms(stats.time.max_ns()),
                    dropped: load(&stats.dropped),
                    lacking: load(&stats.lacking),
                    dropped_on: wire_drops(runtime),
                    too_old_on: wires_too_old(runtime),
                    skipped: load(&stats.skipped),
                    faults: load(&stats.faults),
                    restarts: load(&stats.restarts),
                    over_budget: load(&stats.over_budget),
                    recovery_max_ms: ms(stats.recovery.max_ns()),
                    copies: load(&stats.copies),
                    copied_mb: load(&stats.copied_bytes) as f64 / 1e6,
                    conversions: load(&stats.conversions),
                    allocations: shared.context.thread_allocations.map(|_| load(&stats.allocations)),
                    made: runtime.source.then(|| runtime.ticks.made()),
                    never_got: Vec::new(),
                    muted: closes(shared, runtime),
                    metrics: runtime.progress.metrics().into_iter().collect(),
                },
            );
            if wiring.sink {
                paths.insert(
                    runtime.id.clone(),
                    PathReport {
                        age_p50_ms: ms(stats.age.quantile_ns(0.5)),
                        age_p99_ms: ms(stats.age.quantile_ns(0.99)),
                        age_max_ms: ms(stats.age.max_ns()),
                        newest_age_p50_ms: ms(stats.newest_age.quantile_ns(0.5)),
                        newest_age_p99_ms: ms(stats.newest_age.quantile_ns(0.99)),
                        newest_age_max_ms: ms(stats.newest_age.max_ns()),
                    },
                );
            }
        }
        for (reader, output) in starved(&plan) {
            if let Some(node) = nodes.get_mut(&reader) {
                node.never_got.push(output);
            }
        }
        let (from, to) = (*lock(&shared.allocations.from), *lock(&shared.allocations.to));
        let allocations_per_frame = match (from, to) {
            (Some((count, seq)), Some((last, end))) if end > seq => Some((last - count) as f64 / (end - seq) as f64),
            _ => None,
        };
        Self {
            graph: graph.name.clone(),
            frames,
            seconds,
            fps: if seconds > 0.0 { frames as f64 / seconds } else { 0.0 },
            nodes,
            paths,
            groups: shared.context.groups.report(),
            stopped: lock(&shared.context.stopped).clone(),
            allocations_per_frame,
            machine: Machine::here(shared.pool.threads()),
        }
    }
}

/// Nodes with required inputs whose packets were never made.
fn starved(plan: &Plan) -> Vec<(String, String)> {
    let mut found = Vec::new();
    for (slot, runtime) in plan.live() {
        let made = runtime.progress.ports_made();
        let never = |port: usize| made & 1u64.checked_shl(port as u32).unwrap_or(0) == 0;
        for (port, readers) in plan.wiring[slot].readers.iter().enumerate().filter(|(port, _)| never(*port)) {
            let name = runtime.rules.get(port).map_or("?", |rule| rule.name.as_str());
            for reader in readers {
                let reading = &plan.runtimes[reader.node];
                let required = lock(&reading.join).slots.get(reader.slot).is_some_and(|s| !s.optional);
                if required {
                    found.push((reading.id.clone(), format!("{}.{name}", runtime.id)));
                }
            }
        }
    }
    found
}

/// Activity of each node in a time window, for displays; [`Engine::window`](crate::Engine::window) advances it.
#[derive(Default)]
pub struct Window {
    at_ns: u64,
    seen: HashMap<String, Previous>,
}

/// Counters of a node at the previous call.
#[derive(Default)]
struct Previous {
    times: Vec<u64>,
    ages: Vec<u64>,
    count: u64,
}

/// One node in a [`Window`]: times and rate within it, counts since the node started.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct NodeWindow {
    /// Calls per second.
    pub fps: f64,
    /// Median time of a call.
    pub p50_ms: f64,
    /// 99th percentile of the time of a call.
    pub p99_ms: f64,
    /// For sinks: median time from the arrival of the oldest light to the end of the node's work.
    pub age_p50_ms: Option<f64>,
    /// For sinks: 99th percentile of that time.
    pub age_p99_ms: Option<f64>,
    /// All calls so far.
    pub count: u64,
    /// Ticks dropped at the node's inputs so far.
    pub dropped: u64,
    /// Errors and panics so far.
    pub faults: u64,
    /// Restarts.
    pub restarts: u64,
    /// Frames copied so far because the node wrote to a shared one, or between the memories of processor and GPU.
    #[serde(default)]
    pub copies: u64,
    /// Metrics of the node.
    pub metrics: Vec<(String, f64)>,
    /// The queues at its inputs, edge by edge.
    pub queues: Vec<QueueWindow>,
}

impl NodeWindow {
    /// Replaces numbers that are not finite, which JSON cannot represent; metrics of that kind are left out.
    pub fn finite(mut self) -> Self {
        for number in [&mut self.fps, &mut self.p50_ms, &mut self.p99_ms] {
            *number = if number.is_finite() { *number } else { 0.0 };
        }
        self.age_p50_ms = self.age_p50_ms.filter(|age| age.is_finite());
        self.age_p99_ms = self.age_p99_ms.filter(|age| age.is_finite());
        self.metrics.retain(|(_, value)| value.is_finite());
        self
    }
}

/// The queue of one edge. Nodes that run inline after their producer have no queue.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct QueueWindow {
    /// Input, a position in the node type's inputs.
    pub port: usize,
    /// Position in a list input; 0 for others.
    pub index: usize,
    /// Packets that wait now.
    pub waiting: usize,
    /// Maximum queue length since the previous call.
    pub most: usize,
    /// Packets dropped so far because the queue was full.
    pub dropped: u64,
}

impl Window {
    pub(crate) fn step(&mut self, shared: &Shared) -> BTreeMap<String, NodeWindow> {
        let now_ns = clock::now_ns();
        let since = if self.at_ns == 0 { shared.start_ns } else { self.at_ns };
        let seconds = (now_ns.saturating_sub(since) as f64 / 1e9).max(1e-3);
        self.at_ns = now_ns;
        let plan = shared.plan.load();
        let mut seen = HashMap::new();
        let mut nodes = BTreeMap::new();
        for (slot, runtime) in plan.live() {
            let stats = &runtime.stats;
            let (count, times) = (stats.time.count(), stats.time.counts());
            // A replaced node counts from zero again.
            let before = self.seen.remove(&runtime.id).filter(|s| s.count <= count).unwrap_or_default();
            let ages = if plan.wiring[slot].sink { stats.age.counts() } else { Vec::new() };
            let age = |q| (!ages.is_empty()).then(|| ms(quantile_between_ns(&before.ages, &ages, q)));
            let window = NodeWindow {
                fps: (count - before.count) as f64 / seconds,
                p50_ms: ms(quantile_between_ns(&before.times, &times, 0.5)),
                p99_ms: ms(quantile_between_ns(&before.times, &times, 0.99)),
                age_p50_ms: age(0.5),
                age_p99_ms: age(0.99),
                count,
                dropped: stats.dropped.load(Ordering::Relaxed),
                faults: stats.faults.load(Ordering::Relaxed),
                restarts: stats.restarts.load(Ordering::Relaxed),
                copies: stats.copies.load(Ordering::Relaxed),
                metrics: runtime.progress.metrics(),
                queues: queues(runtime),
            };
            nodes.insert(runtime.id.clone(), window);
            seen.insert(runtime.id.clone(), Previous { times, ages, count });
        }
        self.seen = seen;
        nodes
    }
}

/// Whether the decider keeps a node closed in this run.
fn closes(shared: &Shared, runtime: &NodeRuntime) -> bool {
    let decider = shared.context.decider.as_ref();
    !runtime.source && decider.is_some_and(|decider| decider.closes(runtime.source, runtime.side_effects))
}

/// The values that `of` returns for the edges of a node, in the order of ports and list positions.
fn per_wire<T>(runtime: &NodeRuntime, of: impl Fn(String, usize, &Slot) -> Option<T>) -> Vec<T> {
    let ranges = runtime.ranges();
    let join = lock(&runtime.join);
    let wires = ranges.iter().enumerate().flat_map(|(port, r)| (0..r.count as usize).map(move |index| (port, index)));
    let found = wires.zip(&join.slots);
    found.filter_map(|((port, index), slot)| of(runtime.input_name(port).to_owned(), index, slot)).collect()
}

fn wire_drops(runtime: &NodeRuntime) -> Vec<WireDrops> {
    per_wire(runtime, |input, index, slot| {
        (slot.dropped() > 0).then(|| WireDrops { input, index, dropped: slot.dropped() })
    })
}

fn wires_too_old(runtime: &NodeRuntime) -> Vec<WireTooOld> {
    per_wire(runtime, |input, index, slot| {
        (slot.too_old > 0).then_some(WireTooOld { input, index, ticks: slot.too_old })
    })
}

/// The queues of a node, in the order of ports and list positions.
fn queues(runtime: &NodeRuntime) -> Vec<QueueWindow> {
    let ranges = runtime.ranges();
    let mut join = lock(&runtime.join);
    let places = ranges.iter().enumerate().flat_map(|(port, r)| (0..r.count as usize).map(move |index| (port, index)));
    let of = |((port, index), slot): ((usize, usize), &mut Slot)| {
        let (waiting, most) = slot.fill();
        QueueWindow { port, index, waiting, most, dropped: slot.dropped() }
    };
    places.zip(join.slots.iter_mut()).map(of).collect()
}
