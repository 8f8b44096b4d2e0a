//! Starts, controls and ends the run of a graph.

mod options;
mod values;

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use arc_swap::ArcSwap;
use panoscope_abi as abi;
use panoscope_graph::{Catalog, Graph, Mode, Node, Param, Validator};

pub use self::options::{Options, Outcome, SetError, StartError};
use crate::change_lock::ChangeLock;
use crate::claims::Claims;
use crate::clock;
use crate::ending;
use crate::fault::{Fault, FaultCursor, FaultLog};
use crate::guard::Limit;
use crate::host;
use crate::isolation::Groups;
use crate::light::Sources;
use crate::log::{Level, Log};
use crate::node::{MAX_BUDGET_NS, NodeRuntime};
use crate::plan::{self, Plan};
use crate::plugins::Plugins;
use crate::pool::{self, Pool, Task};
use crate::preview::{Listener, Preview};
use crate::report::{NodeWindow, Report, Window};
use crate::run_context::RunContext;
use crate::schedule::{AllocationMeter, Ready, Shared};
use crate::sync::lock;

/// The running graph and what the engine looks up in it.
pub(crate) struct Current {
    pub graph: Graph,
    /// Declared parameters of each node.
    pub params: Vec<Vec<Param>>,
    /// Each node's own check of its values.
    pub validators: Vec<Option<Validator>>,
    /// Names of each node's outputs.
    pub outputs: Vec<Vec<String>>,
    /// Slot of each node.
    pub slots: Vec<usize>,
}

impl Current {
    pub fn new(graph: Graph, catalog: &Catalog, slots: Vec<usize>) -> Self {
        let types = || graph.nodes.iter().map(|n| n.node_type(catalog));
        Self {
            params: types().map(|t| t.params.clone()).collect(),
            validators: types().map(|t| t.validator.clone()).collect(),
            outputs: types().map(|t| t.outputs.iter().map(|p| p.name.clone()).collect()).collect(),
            graph,
            slots,
        }
    }
}

/// Maximum wait; a longer one means no limit.
const MAX_PATIENCE: Duration = Duration::from_secs(100 * 24 * 3600);
/// Minimum wait when closing, whatever the caller passes: threads have to end and nodes to finish their files.
const MIN_PATIENCE: Duration = Duration::from_secs(1);
/// A running graph.
pub struct Engine {
    pub(crate) shared: Arc<Shared>,
    pub(crate) current: ArcSwap<Current>,
    /// Held while the graph changes.
    pub(crate) change: ChangeLock,
    watch: Mutex<Option<JoinHandle<()>>>,
    watch_stop: Arc<AtomicBool>,
    closed: AtomicBool,
    /// Keeps the listeners of [`Options::listen`].
    _listening: Vec<Preview>,
}

impl Engine {
    /// Opens all nodes of a checked graph and starts them.
    pub fn start(graph: Graph, catalog: &Catalog, plugins: &dyn Plugins, options: Options) -> Result<Self, StartError> {
        let threads = match options.threads {
            0 => std::thread::available_parallelism().map_or(1, usize::from),
            n => n,
        };
        let groups = Groups::new(plugins.isolator(), threads, options.group_memory_bytes, options.keep_group_stderr);
        let runtimes = runtimes(&graph, catalog, plugins, &groups)?;
        let slots: Vec<usize> = (0..runtimes.len()).collect();
        let plan = plan::lay_out(&graph, catalog, runtimes, slots.clone(), options.ticks_at_once, None);
        for numbers in &options.numbers {
            if let Some(node) = graph.node(&numbers.node) {
                let _ = plan.runtimes[node].hear_number.set(Arc::clone(&numbers.hear));
            }
        }
        let listening = listen(&graph, catalog, &plan.runtimes, &options.listen)?;
        let batch = graph.mode == Mode::Batch;
        let context = RunContext {
            host: host::table(threads),
            log: Log::new(options.log),
            faults: FaultLog::new(options.faults),
            start_ns: clock::now_ns(),
            graph_dir: absolute(&options.graph_dir),
            batch,
            observer: options.observer,
            tracer: options.tracer,
            decider: options.decider,
            thread_allocations: options.thread_allocations,
            open_limit: options.open_limit,
            close_limit: options.close_limit,
            claims: Arc::new(Claims::new(options.keep_outputs)),
            groups,
            vet: plugins.vet(),
            stopped: Mutex::default(),
        };
        let Options { paced, frames, hang, process_allocations, before_first_tick, .. } = options;
        let shared = new_shared(plan, context, threads, (paced, frames), hang, process_allocations);
        // Nodes run parallel loops while they open.
        let pool_started = start_pool(&shared).map_err(|cause| StartError::Thread { cause });
        if let Err(error) = pool_started.and_then(|()| open_all(&shared)) {
            shared.pool.stop(Instant::now() + shared.context.close_limit);
            shared.context.flush();
            return Err(error);
        }
        if let Some(observer) = &shared.context.observer {
            let shared = Arc::downgrade(&shared);
            observer.report_to(Box::new(move |words| {
                if let Some(shared) = shared.upgrade() {
                    shared.context.recording_trouble(words);
                }
            }));
        }
        let engine = Self {
            shared,
            current: ArcSwap::from_pointee(Current::new(graph, catalog, slots)),
            change: ChangeLock::default(),
            watch: Mutex::new(None),
            watch_stop: Arc::new(AtomicBool::new(false)),
            closed: AtomicBool::new(false),
            _listening: listening,
        };
        ending::register(&engine.shared);
        if let Some(call) = before_first_tick {
            call(&engine);
        }
        if let Err(cause) = engine.start_threads() {
            // Nodes without a thread never finish: close without waiting for them.
            engine.shared.fail_for_good(format!("no thread could be started: {cause}"));
            return Err(StartError::Thread { cause });
        }
        Ok(engine)
    }

    fn start_threads(&self) -> std::io::Result<()> {
        let shared = &self.shared;
        let (watching, stop) = (Arc::clone(shared), Arc::clone(&self.watch_stop));
        let (tell, told) = std::sync::mpsc::channel();
        let watch = shared.start_host_thread("watch", move || {
            pool::warm_up();
            let _ = tell.send(());
            watching.watch(&stop);
        })?;
        *lock(&self.watch) = Some(watch);
        // Runs before the first tick, like the workers.
        let _ = told.recv();
        let plan = shared.plan.load_full();
        for sources in [false, true] {
            for (node, runtime) in plan.live().filter(|(_, c)| c.owns_thread() && c.source == sources) {
                shared.start_thread(node, runtime)?;
            }
        }
        // A node without inputs that is no source never gets a tick: mark it finished, so that closing does not wait for it.
        let mut ready = Ready::default();
        for (node, runtime) in plan.live().filter(|(_, c)| !c.source) {
            if lock(&runtime.join).slots.is_empty() {
                shared.try_fire(&plan, node, &mut ready);
            }
        }
        ready.dispatch_ready(shared, &plan, 0);
        Ok(())
    }

    /// The running graph.
    pub fn graph(&self) -> Graph {
        self.current.load().graph.clone()
    }

    /// Ends the sources. Ticks in flight finish; a call that does not return within [`Options::hang`] is abandoned,
    /// whatever its budget.
    pub fn stop(&self) {
        self.shared.stop();
    }

    /// Whether all nodes are finished, or cannot finish because a thread of the engine panicked.
    pub fn is_finished(&self) -> bool {
        self.all_finished() || self.shared.broken.load(Ordering::Acquire)
    }

    fn all_finished(&self) -> bool {
        self.shared.unfinished.load(Ordering::Acquire) == 0
    }

    /// Waits up to `most` until all nodes are finished; `false` if they are not.
    pub fn wait(&self, most: Option<Duration>) -> bool {
        let until = most.map(|m| Instant::now() + m);
        let mut guard = lock(&self.shared.finished_lock);
        while !self.is_finished() {
            let step = match until {
                Some(until) => match until.checked_duration_since(Instant::now()) {
                    Some(left) => left.min(Duration::from_millis(100)),
                    None => return false,
                },
                None => Duration::from_millis(100),
            };
            guard = self.shared.finished.wait_timeout(guard, step).unwrap_or_else(std::sync::PoisonError::into_inner).0;
        }
        true
    }

    /// Waits until the run ends, calling `each_step` every `step`. Returns the error that stopped it early, if there
    /// was one; the caller closes the engine in either case.
    pub fn watch<E>(&self, step: Duration, mut each_step: impl FnMut(&Self) -> Result<(), E>) -> Result<(), E> {
        while !self.wait(Some(step)) {
            each_step(self)?;
        }
        Ok(())
    }

    /// Stops the sources, waits, and closes all nodes, so that files are finished. `patience` limits the wait for nodes
    /// that do not return, and then for nodes that do not close (at least one second each); the log names those that it
    /// leaves behind. A change of the graph in progress fails.
    pub fn close(&self, patience: Duration) -> Outcome {
        if !self.closed.swap(true, Ordering::AcqRel) {
            self.stop();
            let log = &self.shared.context.log;
            let patience = patience.min(MAX_PATIENCE);
            let until = Instant::now() + patience.max(MIN_PATIENCE);
            let change = self.change.lock_until(until);
            if change.is_none() {
                log.write(Level::Error, "engine", "a change of the graph does not come to its end and is left behind");
            }
            self.wait(Some(until.saturating_duration_since(Instant::now()).min(patience)));
            self.watch_stop.store(true, Ordering::Relaxed);
            let leave = Instant::now() + MIN_PATIENCE;
            if let Some(watch) = lock(&self.watch).take() {
                watch.thread().unpark();
                pool::join_until(watch, leave);
            }
            let threads = std::mem::take(&mut *lock(&self.shared.own_threads));
            if !self.all_finished() {
                // Threads that wait for ticks leave now, those that hang when they return.
                threads.values().for_each(|thread| thread.runtime.runner.ask_to_leave());
            }
            threads.into_values().for_each(|thread| thread.join_until(leave));
            self.shared.pool.stop(leave);
            let (plan, current) = (self.shared.plan.load(), self.current.load());
            // In graph order, so that readers finish their files last.
            let runtimes = current.graph.order.iter().map(|&node| Arc::clone(&plan.runtimes[current.slots[node]]));
            self.shared.close_all(runtimes.collect(), Instant::now() + patience.max(MIN_PATIENCE));
            self.shared.context.claims.unlock();
            self.shared.context.flush();
        }
        self.outcome()
    }

    /// The state of the run.
    pub fn outcome(&self) -> Outcome {
        match lock(&self.shared.failed).clone() {
            Some(reason) => Outcome::Failed(reason),
            None => Outcome::Done,
        }
    }

    /// Subscribes to an output without slowing the graph.
    pub fn preview(&self, node: &str, output: &str) -> Option<Preview> {
        let current = self.current.load();
        let (index, runtime) = self.runtime(&current, node)?;
        let port = current.outputs[index].iter().position(|name| name == output)?;
        let preview = runtime.subscribers.subscribe(port)?;
        runtime.read_output(port);
        Some(preview)
    }

    /// Whether the graph runs in batch mode.
    pub fn is_batch(&self) -> bool {
        self.shared.context.batch
    }

    /// Outputs that other nodes read, as node and output.
    pub fn outputs_read(&self) -> Vec<(String, String)> {
        let current = self.current.load();
        let nodes = current.graph.nodes.iter().enumerate();
        let read = |(index, node): (usize, &Node)| {
            let bits = plan::outputs_read(&current.graph, index);
            let names = current.outputs[index].iter().enumerate();
            let read = names.filter(move |(port, _)| bits >> port & 1 == 1);
            read.map(|(_, name)| (node.id.clone(), name.clone())).collect::<Vec<_>>()
        };
        nodes.flat_map(read).collect()
    }

    /// Call after previews of a node were dropped: stops making outputs without a reader. Does nothing while the graph
    /// is being changed, so that it never waits. Do not call it while another thread calls [`Self::preview`].
    pub fn end_previews(&self, node: &str) {
        let Some(_change) = self.change.lock_until(Instant::now()) else { return };
        let current = self.current.load();
        if let Some((index, runtime)) = self.runtime(&current, node) {
            let read = plan::outputs_read(&current.graph, index) | runtime.subscribers.bits();
            runtime.set_outputs_read(read);
        }
    }

    /// When the light of a packet arrived, in ns of [`clock::now_ns`]; negative for light from before the clock began.
    /// For a tick older than the newest few thousand the result is too late. `None` where it is unknown.
    pub fn arrived_ns(&self, tick: &abi::Tick) -> Option<i64> {
        self.shared.light_ns(tick)
    }

    /// Newest log lines: level, node, text.
    pub fn recent_log(&self) -> Vec<(Level, String, String)> {
        self.shared.context.log.recent()
    }

    /// Newest faults, oldest first.
    pub fn recent_faults(&self) -> Vec<Fault> {
        self.shared.context.faults.recent()
    }

    /// Moves `cursor` past the newest fault; a cursor of another run starts at the first fault. Returns whether its
    /// faults changed. Cheap where there are no new ones, for displays.
    pub fn faults_since(&self, cursor: &mut FaultCursor) -> bool {
        self.shared.context.faults.advance(cursor)
    }

    /// Ticks that the busiest source has made.
    pub fn ticks(&self) -> u64 {
        let plan = self.shared.plan.load();
        plan.live().map(|(_, runtime)| runtime.ticks.made()).max().unwrap_or(0)
    }

    /// All counters and times so far.
    pub fn report(&self) -> Report {
        Report::of(&self.current.load().graph, &self.shared)
    }

    /// Activity of each node since the last call with this `window`. Cheaper than a report, for displays.
    pub fn window(&self, window: &mut Window) -> BTreeMap<String, NodeWindow> {
        window.step(&self.shared)
    }
}

impl Drop for Engine {
    fn drop(&mut self) {
        self.close(Duration::from_secs(5));
    }
}

/// A runtime without an instance for each node of a graph.
fn runtimes(
    graph: &Graph,
    catalog: &Catalog,
    plugins: &dyn Plugins,
    groups: &Groups,
) -> Result<Vec<Arc<NodeRuntime>>, StartError> {
    let entry = |plugin: &str, node_type: &str| plugins.entry(plugin, node_type);
    let stale = |error: &dyn std::fmt::Display| StartError::Stale { reason: error.to_string() };
    let one = |node: usize| {
        let node_type = plan::entry_of(graph, node, &entry).map_err(|error| stale(&error))?;
        let group = groups.of(&graph.nodes[node]).map_err(|error| stale(&error))?;
        Ok(plan::runtime(graph, catalog, node, node_type, group))
    };
    (0..graph.nodes.len()).map(one).collect()
}

/// The state of a run whose nodes are not open yet.
fn new_shared(
    plan: Plan,
    context: RunContext,
    threads: usize,
    (paced, frames): (bool, Option<u64>),
    hang: Duration,
    process_allocations: Option<fn() -> u64>,
) -> Arc<Shared> {
    let hurried = !context.ignores_wall_clock();
    let warm_up_ticks = frames.map_or(30, |n| (n / 4).min(30)).max(1);
    let patience = u64::try_from(hang.as_nanos()).map_or(MAX_BUDGET_NS, |ns| ns.min(MAX_BUDGET_NS));
    Arc::new_cyclic(|me| Shared {
        me: me.clone(),
        pool: Pool::new(threads),
        paced,
        frames,
        stopping: AtomicBool::new(false),
        failed: Mutex::new(None),
        broken: AtomicBool::new(false),
        unfinished: AtomicUsize::new(plan.runtimes.len()),
        plan: ArcSwap::from_pointee(plan),
        finished: Condvar::new(),
        finished_lock: Mutex::new(()),
        finishing: Mutex::new(()),
        start_ns: context.start_ns,
        context,
        end_ns: AtomicU64::new(0),
        allocations: AllocationMeter { count: process_allocations, warm_up_ticks, ..Default::default() },
        waiting_nearest: AtomicI64::new(0),
        own_threads: Mutex::default(),
        hang_ns: if hurried { patience } else { patience.saturating_mul(30) },
        stop_ns: AtomicU64::new(0),
        stop_limit_ns: patience,
        frame_ns: AtomicU64::new(33_333_333),
    })
}

/// Adds listeners to ports of nodes that are not open yet. At this time slots equal positions in the graph.
fn listen(
    graph: &Graph,
    catalog: &Catalog,
    runtimes: &[Arc<NodeRuntime>],
    wanted: &[Listener],
) -> Result<Vec<Preview>, StartError> {
    let one = |listener: &Listener| {
        let node = graph.node(&listener.node)?;
        let port = graph.nodes[node].node_type(catalog).output(&listener.output)?;
        let preview = runtimes[node].subscribers.listen(port, Arc::clone(&listener.hear))?;
        runtimes[node].read_output(port);
        Some(preview)
    };
    let missing = |l: &Listener| StartError::Stale { reason: format!("there is no output `{}.{}`", l.node, l.output) };
    wanted.iter().map(|listener| one(listener).ok_or_else(|| missing(listener))).collect()
}

/// Starts the pool's workers; they have no task until the nodes are open.
fn start_pool(shared: &Arc<Shared>) -> std::io::Result<()> {
    // The pool's task must not keep the engine alive.
    let weak = Arc::downgrade(shared);
    let task: Task = Arc::new(move |node, scratch| {
        if let Some(shared) = weak.upgrade() {
            shared.run(node as usize, scratch, u64::MAX);
        }
    });
    let weak = Arc::downgrade(shared);
    shared.pool.on_panic(Box::new(move |name, words| {
        if let Some(shared) = weak.upgrade() {
            shared.thread_panicked(name, words);
        }
    }));
    shared.pool.start(&task)
}

/// Opens all nodes of an engine that does not run yet. If one fails, closes the others.
fn open_all(shared: &Arc<Shared>) -> Result<(), StartError> {
    let plan = shared.plan.load_full();
    let calls = plan.runtimes.iter().map(|runtime| {
        shared.context.make_all_recorded_outputs(runtime);
        shared.opening(runtime, &runtime.snapshot())
    });
    let mut failed = None;
    shared.guarded(Limit::until_stop(shared.context.open_limit), Result::is_ok, calls, |runtime, answer| {
        match answer.map_err(|error| error.to_string()).and_then(|opened| opened.map_err(|refusal| refusal.message)) {
            Ok(instance) => _ = runtime.exec.with(|exec| exec.instance = instance.begun()),
            Err(reason) => failed = Some((runtime.id.clone(), type_name(runtime.node_type), reason)),
        }
        if failed.is_some() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    });
    let Some((node, node_type, reason)) = failed else { return Ok(()) };
    shared.close_all(plan.runtimes.clone(), Instant::now() + shared.context.close_limit);
    Err(StartError::Open { node, node_type, reason })
}

fn absolute(path: &Path) -> String {
    std::path::absolute(path).unwrap_or_else(|_| path.to_owned()).to_string_lossy().into_owned()
}

pub(crate) fn type_name(node_type: &abi::NodeType) -> String {
    // SAFETY: a validated descriptor of a plugin that stays mapped.
    unsafe { node_type.name.text() }.unwrap_or("?").to_owned()
}
