//! A node of a running graph: its instance, its inputs, its counters.

use std::ffi::c_void;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use panoscope_abi::{self as abi, Frame, PortRange, Str, Tick};
use panoscope_graph::{NodeKind, OnFault};

use crate::clock;
use crate::host::CallContext;
use crate::join::Join;
use crate::log::{Level, Log};
use crate::memory::FrameRef;
use crate::params::Snapshot;
use crate::preview::Taps;
use crate::stats::{NodeStats, bump};

/// What every call of an engine shares.
pub(crate) struct Surroundings {
    pub host: abi::Host,
    pub log: Log,
    pub graph_dir: String,
    pub batch: bool,
    /// Heap allocations of the calling thread so far.
    pub thread_allocations: Option<fn() -> u64>,
}

/// The instance and what a call needs; held by whoever runs the node.
pub(crate) struct Exec {
    pub instance: Instance,
    pub inputs: Vec<FrameRef>,
    pub ranges: Vec<PortRange>,
    pub outputs: Vec<Frame>,
    failure: String,
    snapshot: Arc<Snapshot>,
    bypassed: bool,
    /// Wall time in ns before which a failed node is not opened again.
    retry_ns: u64,
    failures_in_a_row: u32,
    last_fired_ns: Option<i64>,
}

/// An open instance of a node type, closed when dropped.
pub(crate) struct Instance {
    /// May be null: a C plugin without state needs none.
    raw: *mut c_void,
    node_type: &'static abi::NodeType,
    open: bool,
}

// SAFETY: the contract lets an instance move between threads; it is used by one at a time.
unsafe impl Send for Instance {}

impl Instance {
    fn none(node_type: &'static abi::NodeType) -> Self {
        Self { raw: std::ptr::null_mut(), node_type, open: false }
    }

    fn is_open(&self) -> bool {
        self.open
    }

    /// Closes now instead of at drop.
    pub fn close(&mut self) {
        let raw = std::mem::replace(&mut self.raw, std::ptr::null_mut());
        let was_open = std::mem::replace(&mut self.open, false);
        if let Some(close) = self.node_type.close.filter(|_| was_open) {
            // SAFETY: opened by `open` and closed once.
            unsafe { close(raw) }
        }
    }
}

impl Drop for Instance {
    fn drop(&mut self) {
        self.close();
    }
}

/// How a call ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Ran {
    Ok,
    /// A source has nothing left.
    End,
    /// Not called: an input was empty, or the node is down.
    Skipped,
    /// It failed; the graph goes on.
    Fault,
    /// It failed and the graph is to stop.
    Stop,
}

/// A node of a running graph.
pub(crate) struct Cell {
    pub id: String,
    id_hash: u64,
    pub node_type: &'static abi::NodeType,
    pub kind: NodeKind,
    pub source: bool,
    pub on_fault: OnFault,
    pub budget_ns: Option<u64>,
    pub period_ns: Option<i64>,
    pub cpu: Option<u32>,
    pub exec: Mutex<Exec>,
    pub join: Mutex<Join>,
    snapshot: Mutex<Arc<Snapshot>>,
    version: AtomicU64,
    /// Opened beside the running instance with values that need a reopening; taken over before the next tick.
    replacement: Mutex<Option<(Instance, Arc<Snapshot>)>>,
    replace: AtomicBool,
    pub stats: NodeStats,
    pub metrics: Mutex<Vec<(String, f64)>>,
    pub outputs_read: AtomicU64,
    pub taps: Taps,
    /// The node's own thread, if it has one.
    pub thread: OnceLock<std::thread::Thread>,
    pub wake: AtomicBool,
    /// Ticks this node is done with, for its region.
    pub done_ticks: AtomicU64,
    /// Start of the running call in ns of the host's clock; 0 when idle.
    pub busy_since_ns: AtomicU64,
}

/// Where a node's random numbers begin for a tick: the same in every run. The generator mixes what stands here, so a cheap
/// combination is enough.
fn seed(id_hash: u64, tick: &Tick) -> u64 {
    let source = u64::from(tick.source).wrapping_mul(0xD6E8_FEB8_6659_FD93);
    id_hash ^ tick.seq.wrapping_mul(0xA076_1D64_78BD_642F) ^ source
}

/// What a node says of itself when it is made.
pub(crate) struct CellSpec {
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

pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Cell {
    /// A cell whose instance is not open yet.
    pub fn new(spec: CellSpec, join: Join, snapshot: Arc<Snapshot>) -> Self {
        let slots = join.slots.len();
        let exec = Exec {
            instance: Instance::none(spec.node_type),
            inputs: Vec::with_capacity(slots),
            ranges: spec.ranges,
            outputs: vec![Frame::EMPTY; spec.node_type.outputs_len],
            failure: String::new(),
            snapshot: Arc::clone(&snapshot),
            bypassed: false,
            retry_ns: 0,
            failures_in_a_row: 0,
            last_fired_ns: None,
        };
        Self {
            id_hash: abi::fnv1a(abi::FNV_START, spec.id.as_bytes()),
            id: spec.id,
            node_type: spec.node_type,
            kind: spec.kind,
            source: spec.source,
            on_fault: spec.on_fault,
            budget_ns: spec.budget_ms.map(|ms| (ms * 1e6) as u64),
            period_ns: spec.max_rate_hz.map(|hz| (1e9 / hz) as i64),
            cpu: spec.cpu,
            exec: Mutex::new(exec),
            join: Mutex::new(join),
            version: AtomicU64::new(snapshot.version()),
            snapshot: Mutex::new(snapshot),
            replacement: Mutex::new(None),
            replace: AtomicBool::new(false),
            stats: NodeStats::default(),
            metrics: Mutex::new(Vec::new()),
            outputs_read: AtomicU64::new(spec.outputs_read),
            taps: Taps::new(spec.node_type.outputs_len),
            thread: OnceLock::new(),
            wake: AtomicBool::new(false),
            done_ticks: AtomicU64::new(0),
            busy_since_ns: AtomicU64::new(0),
        }
    }

    /// Whether the node runs on a thread of its own.
    pub fn owns_thread(&self) -> bool {
        self.source || self.kind != NodeKind::Compute
    }

    /// The values in force.
    pub fn snapshot(&self) -> Arc<Snapshot> {
        Arc::clone(&lock(&self.snapshot))
    }

    /// Puts new values in force from the next tick on.
    pub fn set_snapshot(&self, snapshot: Arc<Snapshot>) {
        let version = snapshot.version();
        *lock(&self.snapshot) = snapshot;
        self.version.store(version, Ordering::Release);
    }

    /// Hands over an instance that was opened with new values.
    pub fn replace_instance(&self, instance: Instance, snapshot: Arc<Snapshot>) {
        let old = lock(&self.replacement).replace((instance, snapshot));
        self.replace.store(true, Ordering::Release);
        drop(old);
    }

    /// Opens an instance with the given values.
    pub fn open(&self, around: &Surroundings, snapshot: &Snapshot) -> Result<Instance, String> {
        let mut failure = String::new();
        let mut context = CallContext {
            outputs: std::ptr::null_mut(),
            outputs_len: 0,
            stats: &self.stats,
            log: &around.log,
            node_id: &self.id,
            failure: &mut failure,
            random: seed(self.id_hash, &Tick::default()),
            tick: Tick::default(),
            wait_for_memory: around.batch,
            metrics: &self.metrics,
        };
        let mut call = abi::OpenCall {
            struct_size: size_of::<abi::OpenCall>() as u32,
            flags: if around.batch { abi::CALL_BATCH } else { 0 },
            host: &raw const around.host,
            call: (&raw mut context).cast(),
            node_id: Str::borrow(&self.id),
            params: snapshot.values().as_ptr(),
            params_len: snapshot.values().len(),
            graph_dir: Str::borrow(&around.graph_dir),
            outputs_read: self.outputs_read.load(Ordering::Relaxed),
        };
        let mut instance = Instance::none(self.node_type);
        let status = match self.node_type.open {
            // SAFETY: the contract; everything the call points to outlives it.
            Some(open) => unsafe { open(&raw mut call, &raw mut instance.raw) },
            None => abi::STATUS_INVALID,
        };
        if status == abi::STATUS_OK {
            instance.open = true;
            return Ok(instance);
        }
        if failure.is_empty() {
            failure = format!("it did not open (status {status})");
        }
        Err(failure)
    }

    /// Calls the node for one tick with the inputs in `exec`; answers how it went and the time at its end. Inputs are given back.
    pub fn run(
        &self,
        exec: &mut Exec,
        around: &Surroundings,
        tick: &mut Tick,
        complete: bool,
        start_ns: u64,
    ) -> (Ran, u64) {
        let ran = self.run_inner(exec, around, tick, complete, start_ns);
        exec.inputs.clear();
        ran
    }

    fn run_inner(
        &self,
        exec: &mut Exec,
        around: &Surroundings,
        tick: &mut Tick,
        complete: bool,
        start_ns: u64,
    ) -> (Ran, u64) {
        // Looked at before it is taken: a swap would cost every tick.
        if self.replace.load(Ordering::Relaxed)
            && self.replace.swap(false, Ordering::Acquire)
            && let Some((instance, snapshot)) = lock(&self.replacement).take()
        {
            exec.instance = instance;
            exec.snapshot = Arc::clone(&snapshot);
            self.set_snapshot(snapshot);
            exec.bypassed = false;
        }
        let version = self.version.load(Ordering::Acquire);
        if exec.snapshot.version() != version {
            exec.snapshot = self.snapshot();
        }
        let too_soon = self.period_ns.zip(exec.last_fired_ns).is_some_and(|(p, last)| tick.capture_ns - last < p);
        if !complete || too_soon || exec.bypassed || !self.ready_to_run(exec, around, start_ns) {
            if !complete {
                bump(&self.stats.skipped);
            }
            return (Ran::Skipped, start_ns);
        }
        if !self.source {
            exec.last_fired_ns = Some(tick.capture_ns);
        }
        let allocations = around.thread_allocations.map(|count| count());
        self.busy_since_ns.store(start_ns.max(1), Ordering::Relaxed);
        let status = self.call(exec, around, tick);
        let end_ns = clock::now_ns();
        self.busy_since_ns.store(0, Ordering::Relaxed);
        if let Some((count, before)) = around.thread_allocations.zip(allocations) {
            let made = count().wrapping_sub(before);
            if made > 0 {
                self.stats.allocations.fetch_add(made, Ordering::Relaxed);
            }
        }
        let spent_ns = end_ns.saturating_sub(start_ns);
        self.stats.time.record(spent_ns);
        if self.budget_ns.is_some_and(|budget| spent_ns > budget) {
            bump(&self.stats.over_budget);
        }
        match status {
            abi::STATUS_OK => {
                exec.failures_in_a_row = 0;
                (Ran::Ok, end_ns)
            }
            abi::STATUS_END if self.source => {
                clear(&mut exec.outputs);
                (Ran::End, end_ns)
            }
            status => {
                clear(&mut exec.outputs);
                (self.fault(exec, around, status, end_ns), end_ns)
            }
        }
    }

    fn call(&self, exec: &mut Exec, around: &Surroundings, tick: &mut Tick) -> abi::Status {
        let Some(process) = self.node_type.process else { return abi::STATUS_INVALID };
        let mut context = CallContext {
            outputs: exec.outputs.as_mut_ptr(),
            outputs_len: exec.outputs.len(),
            stats: &self.stats,
            log: &around.log,
            node_id: &self.id,
            failure: &mut exec.failure,
            random: seed(self.id_hash, tick),
            tick: *tick,
            wait_for_memory: around.batch,
            metrics: &self.metrics,
        };
        let mut call = abi::Call {
            struct_size: size_of::<abi::Call>() as u32,
            flags: if around.batch { abi::CALL_BATCH } else { 0 },
            host: &raw const around.host,
            call: (&raw mut context).cast(),
            tick: *tick,
            inputs: exec.inputs.as_ptr().cast(),
            inputs_len: exec.inputs.len(),
            input_ranges: exec.ranges.as_ptr(),
            input_ranges_len: exec.ranges.len(),
            outputs: exec.outputs.as_mut_ptr(),
            outputs_len: exec.outputs.len(),
            params: exec.snapshot.values().as_ptr(),
            params_len: exec.snapshot.values().len(),
            params_version: exec.snapshot.version(),
            outputs_read: self.outputs_read.load(Ordering::Relaxed),
        };
        // SAFETY: the contract: an open instance that no other thread uses, and a call whose parts outlive it.
        let status = unsafe { process(exec.instance.raw, &raw mut call) };
        if self.source {
            tick.capture_ns = call.tick.capture_ns;
            for frame in exec.outputs.iter_mut().filter(|f| !f.is_empty()) {
                frame.tick = *tick;
            }
        }
        status
    }

    /// Opens a node again that failed, when its time has come.
    fn ready_to_run(&self, exec: &mut Exec, around: &Surroundings, now_ns: u64) -> bool {
        if exec.instance.is_open() {
            return true;
        }
        if self.on_fault != OnFault::Restart || now_ns < exec.retry_ns {
            return false;
        }
        bump(&self.stats.restarts);
        let snapshot = Arc::clone(&exec.snapshot);
        match self.open(around, &snapshot) {
            Ok(instance) => {
                around.log.say(Level::Info, &self.id, "opened again");
                exec.instance = instance;
                true
            }
            Err(words) => {
                exec.failures_in_a_row += 1;
                exec.retry_ns = clock::now_ns() + backoff_ns(exec.failures_in_a_row);
                around.log.say(Level::Error, &self.id, &format!("could not be opened again: {words}"));
                false
            }
        }
    }

    fn fault(&self, exec: &mut Exec, around: &Surroundings, status: abi::Status, now_ns: u64) -> Ran {
        if status == abi::STATUS_EXHAUSTED {
            bump(&self.stats.dropped);
            around.log.say(Level::Warn, &self.id, "the tick was dropped: frame memory is used up");
            return Ran::Fault;
        }
        bump(&self.stats.faults);
        let words = if exec.failure.is_empty() { "it failed without a word" } else { exec.failure.as_str() };
        around.log.say(Level::Error, &self.id, words);
        // What the instance holds after a fault is not to be trusted.
        exec.instance.close();
        exec.failures_in_a_row += 1;
        exec.retry_ns = now_ns + backoff_ns(exec.failures_in_a_row);
        match self.on_fault {
            OnFault::Restart => Ran::Fault,
            OnFault::Bypass => {
                exec.bypassed = true;
                Ran::Fault
            }
            OnFault::Stop => Ran::Stop,
        }
    }
}

/// 0, 10, 20, 40 ... 2,000 ms.
fn backoff_ns(failures: u32) -> u64 {
    if failures <= 1 { 0 } else { (10_000_000u64 << (failures - 2).min(8)).min(2_000_000_000) }
}

/// Gives back what stands in the outputs.
pub(crate) fn clear(outputs: &mut [Frame]) {
    for frame in outputs {
        drop(FrameRef::adopt(std::mem::replace(frame, Frame::EMPTY)));
    }
}
