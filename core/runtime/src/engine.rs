//! Starting, steering and ending a graph.

use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use panoscope_abi as abi;
use panoscope_graph::{Catalog, Graph, Mode, NodeKind, Param, ParamValue};

use crate::cell::{Surroundings, lock};
use crate::clock;
use crate::host;
use crate::loader::Loader;
use crate::log::{Level, Log, LogFn};
use crate::params::Snapshot;
use crate::plan;
use crate::pool::{Pool, Task};
use crate::preview::Preview;
use crate::report::Report;
use crate::schedule::{AllocationMeter, Shared, ingest_ring};

/// How a graph is run.
pub struct Options {
    /// Threads of the pool; 0 takes as many as the machine has.
    pub threads: usize,
    /// Ticks each source makes; `None` until the sources end or the engine is stopped.
    pub frames: Option<u64>,
    /// In live mode, sources wait until the capture time of a tick has come. Without it they go as fast as the graph takes ticks.
    pub paced: bool,
    /// Folder that relative paths start from, shown to nodes.
    pub graph_dir: std::path::PathBuf,
    /// Takes log lines as they come.
    pub log: Option<Box<LogFn>>,
    /// Heap allocations of the process so far, where the program counts them.
    pub process_allocations: Option<fn() -> u64>,
    /// Heap allocations of the calling thread so far, where the program counts them.
    pub thread_allocations: Option<fn() -> u64>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            threads: 0,
            frames: None,
            paced: true,
            graph_dir: std::path::PathBuf::new(),
            log: None,
            process_allocations: None,
            thread_allocations: None,
        }
    }
}

/// Why a graph did not start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// A node did not open.
    #[error("node `{node}` ({node_type}) did not open: {reason}")]
    Open {
        /// The node's name.
        node: String,
        /// Its type.
        node_type: String,
        /// What it said.
        reason: String,
    },
    /// The graph does not fit the loaded plugins any more.
    #[error("{reason}; check the graph again")]
    Stale {
        /// What changed.
        reason: String,
    },
    /// The system gave no thread.
    #[error("no thread could be started: {cause}")]
    Thread {
        /// What the system says.
        cause: std::io::Error,
    },
}

/// Why a parameter was not changed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SetError {
    /// No such node.
    #[error("there is no node `{node}`")]
    NoNode {
        /// As asked for.
        node: String,
    },
    /// No such parameter.
    #[error("node `{node}` has no parameter `{param}`")]
    NoParam {
        /// The node.
        node: String,
        /// As asked for.
        param: String,
    },
    /// The value does not fit the declaration.
    #[error("`{node}.{param}`: {reason}")]
    BadValue {
        /// The node.
        node: String,
        /// The parameter.
        param: String,
        /// What is wrong with the value.
        reason: String,
    },
    /// The node did not open with the new value; the old one stays in force.
    #[error("node `{node}` did not open with the new value, the old one stays: {reason}")]
    Reopen {
        /// The node.
        node: String,
        /// What it said.
        reason: String,
    },
}

/// How a run ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Outcome {
    /// All sources ended, or the engine was asked to stop.
    Done,
    /// A node failed and the graph said to stop.
    Failed(String),
}

/// A running graph.
pub struct Engine {
    shared: Arc<Shared>,
    graph: Graph,
    params: Vec<Vec<Param>>,
    outputs: Vec<Vec<String>>,
    threads: Mutex<Vec<JoinHandle<()>>>,
    ticker: Mutex<Option<JoinHandle<()>>>,
    ticker_stop: Arc<AtomicBool>,
    closed: AtomicBool,
}

impl Engine {
    /// Opens all nodes of a checked graph and sets them going.
    pub fn start(graph: Graph, catalog: &Catalog, loader: &Loader, options: Options) -> Result<Self, StartError> {
        let threads = match options.threads {
            0 => std::thread::available_parallelism().map_or(1, usize::from),
            n => n,
        };
        let entry = |plugin: &str, node_type: &str| loader.entry(plugin, node_type);
        // Not the number of threads: how far ticks overlap must not depend on it where a delay closes a loop.
        let plan = plan::build(&graph, catalog, &entry, 4).map_err(|reason| StartError::Stale { reason })?;
        let around = Surroundings {
            host: host::table(threads),
            log: Log::new(options.log),
            graph_dir: absolute(&options.graph_dir),
            batch: graph.mode == Mode::Batch,
            thread_allocations: options.thread_allocations,
        };
        let pool = Pool::new(threads);
        pool.enter();
        for cell in &plan.cells {
            let instance = cell.open(&around, &cell.snapshot()).map_err(|reason| StartError::Open {
                node: cell.id.clone(),
                node_type: type_name(cell.node_type),
                reason,
            })?;
            lock(&cell.exec).instance = instance;
        }
        let count = plan.cells.len();
        let warm_up_ticks = options.frames.map_or(30, |n| (n / 4).min(30)).max(1);
        let shared = Arc::new(Shared {
            ingest_ns: plan.cells.iter().map(|c| ingest_ring(c.source)).collect(),
            made: (0..count).map(|_| AtomicU64::new(0)).collect(),
            plan,
            pool,
            around,
            paced: options.paced,
            frames: options.frames,
            stopping: AtomicBool::new(false),
            failed: Mutex::new(None),
            unfinished: AtomicUsize::new(count),
            finished: Condvar::new(),
            finished_lock: Mutex::new(()),
            start_ns: clock::now_ns(),
            end_ns: AtomicU64::new(0),
            allocations: AllocationMeter { count: options.process_allocations, warm_up_ticks, ..Default::default() },
            waiting_nearest: AtomicI64::new(0),
        });
        let engine = Self {
            params: graph.nodes.iter().map(|n| n.node_type(catalog).params.clone()).collect(),
            outputs: graph
                .nodes
                .iter()
                .map(|n| n.node_type(catalog).outputs.iter().map(|p| p.name.clone()).collect())
                .collect(),
            shared,
            graph,
            threads: Mutex::new(Vec::new()),
            ticker: Mutex::new(None),
            ticker_stop: Arc::new(AtomicBool::new(false)),
            closed: AtomicBool::new(false),
        };
        engine.start_threads().map_err(|cause| StartError::Thread { cause })?;
        Ok(engine)
    }

    fn start_threads(&self) -> std::io::Result<()> {
        let shared = &self.shared;
        // The pool's task must not keep the engine alive.
        let weak = Arc::downgrade(shared);
        let task: Task = Arc::new(move |node| {
            if let Some(shared) = weak.upgrade() {
                shared.run(node as usize);
            }
        });
        shared.pool.start(&task)?;
        let mut threads = lock(&self.threads);
        // Readers before sources: a thread must stand before it is woken.
        for sources in [false, true] {
            for (node, cell) in shared.plan.cells.iter().enumerate() {
                if !cell.owns_thread() || cell.source != sources {
                    continue;
                }
                let (shared, realtime, cpu) = (Arc::clone(shared), cell.kind == NodeKind::Realtime, cell.cpu);
                let builder = std::thread::Builder::new().name(cell.id.chars().take(15).collect());
                let (ready, wait) = std::sync::mpsc::sync_channel(1);
                let handle = builder.spawn(move || {
                    let cell = &shared.plan.cells[node];
                    let _ = cell.thread.set(std::thread::current());
                    let _ = ready.send(());
                    place_thread(cpu, realtime);
                    shared.pool.enter();
                    if cell.source { shared.source_thread(node) } else { shared.blocking_thread(node) }
                })?;
                let _ = wait.recv();
                threads.push(handle);
            }
        }
        drop(threads);
        let nearest = self.graph.edges.iter().any(|e| matches!(e.align, panoscope_graph::Align::Nearest { .. }));
        if nearest {
            let (shared, stop) = (Arc::clone(shared), Arc::clone(&self.ticker_stop));
            *lock(&self.ticker) = Some(std::thread::Builder::new().name("ticker".to_owned()).spawn(move || {
                while !stop.load(Ordering::Relaxed) {
                    std::thread::sleep(Duration::from_millis(1));
                    shared.poke_nearest();
                }
            })?);
        }
        Ok(())
    }

    /// The graph that runs.
    pub fn graph(&self) -> &Graph {
        &self.graph
    }

    /// Asks the sources to end; what is under way is finished.
    pub fn stop(&self) {
        self.shared.stop();
    }

    /// Whether all nodes are finished.
    pub fn is_finished(&self) -> bool {
        self.shared.unfinished.load(Ordering::Acquire) == 0
    }

    /// Waits until all nodes are finished, at most `most`; `false` when they are not by then.
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

    /// Stops, waits and closes all nodes, so that files are finished. `patience` bounds the wait for nodes that do not return; those are left
    /// behind and named in the log.
    pub fn close(&self, patience: Duration) -> Outcome {
        if !self.closed.swap(true, Ordering::AcqRel) {
            self.stop();
            let all = self.wait(Some(patience));
            self.ticker_stop.store(true, Ordering::Relaxed);
            if let Some(ticker) = lock(&self.ticker).take() {
                let _ = ticker.join();
            }
            if all {
                for thread in lock(&self.threads).drain(..) {
                    let _ = thread.join();
                }
                self.shared.pool.stop();
            }
            // Sources first, then along the graph: readers finish their files last.
            for &node in &self.graph.order {
                let cell = &self.shared.plan.cells[node];
                match cell.exec.try_lock() {
                    Ok(mut exec) => {
                        exec.inputs.clear();
                        exec.instance.close();
                    }
                    Err(_) => self.shared.around.log.say(
                        Level::Error,
                        &cell.id,
                        "it does not return and is left behind; its files may be incomplete",
                    ),
                }
            }
        }
        self.outcome()
    }

    /// How the run stands.
    pub fn outcome(&self) -> Outcome {
        match lock(&self.shared.failed).clone() {
            Some(reason) => Outcome::Failed(reason),
            None => Outcome::Done,
        }
    }

    /// Changes one parameter between two ticks. A `reopen` parameter opens a new instance beside the running one first.
    pub fn set_param(&self, node: &str, param: &str, value: ParamValue) -> Result<(), SetError> {
        let index = self.graph.node(node).ok_or_else(|| SetError::NoNode { node: node.to_owned() })?;
        let declared = &self.params[index];
        let position = declared
            .iter()
            .position(|p| p.name == param)
            .ok_or_else(|| SetError::NoParam { node: node.to_owned(), param: param.to_owned() })?;
        declared[position].kind.accepts(&value).map_err(|reason| SetError::BadValue {
            node: node.to_owned(),
            param: param.to_owned(),
            reason,
        })?;
        let cell = &self.shared.plan.cells[index];
        let mut values = cell.snapshot().owned().to_vec();
        values[position] = value;
        let snapshot = Snapshot::new(values);
        if !declared[position].reopen {
            cell.set_snapshot(snapshot);
            return Ok(());
        }
        let instance = cell
            .open(&self.shared.around, &snapshot)
            .map_err(|reason| SetError::Reopen { node: node.to_owned(), reason })?;
        cell.replace_instance(instance, snapshot);
        Ok(())
    }

    /// The values of a node's parameters now, in declaration order.
    pub fn param_values(&self, node: &str) -> Option<Vec<ParamValue>> {
        let index = self.graph.node(node)?;
        Some(self.shared.plan.cells[index].snapshot().owned().to_vec())
    }

    /// Looks at an output without slowing the graph.
    pub fn preview(&self, node: &str, output: &str) -> Option<Preview> {
        let index = self.graph.node(node)?;
        let port = self.outputs[index].iter().position(|name| name == output)?;
        let cell = &self.shared.plan.cells[index];
        let preview = cell.taps.subscribe(port)?;
        if port < 64 {
            cell.outputs_read.fetch_or(1 << port, Ordering::Relaxed);
        }
        Some(preview)
    }

    /// Newest log lines: level, node, words.
    pub fn recent_log(&self) -> Vec<(Level, String, String)> {
        self.shared.around.log.recent()
    }

    /// All counters and times so far.
    pub fn report(&self) -> Report {
        Report::of(&self.graph, &self.shared)
    }
}

impl Drop for Engine {
    fn drop(&mut self) {
        self.close(Duration::from_secs(5));
    }
}

fn absolute(path: &Path) -> String {
    std::path::absolute(path).unwrap_or_else(|_| path.to_owned()).to_string_lossy().into_owned()
}

fn type_name(node_type: &abi::NodeType) -> String {
    // SAFETY: a validated descriptor of a plugin that stays mapped.
    unsafe { node_type.name.text() }.unwrap_or("?").to_owned()
}

/// Pins the calling thread and asks for real-time priority; both are wishes that a system may refuse.
fn place_thread(cpu: Option<u32>, realtime: bool) {
    if let Some(cpu) = cpu.filter(|&c| (c as usize) < libc::CPU_SETSIZE as usize) {
        // SAFETY: plain system calls on a local set.
        unsafe {
            let mut set: libc::cpu_set_t = std::mem::zeroed();
            libc::CPU_SET(cpu as usize, &mut set);
            libc::sched_setaffinity(0, size_of::<libc::cpu_set_t>(), &raw const set);
        }
    }
    if realtime {
        let priority = libc::sched_param { sched_priority: 20 };
        // SAFETY: a plain system call.
        unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const priority) };
    }
}
