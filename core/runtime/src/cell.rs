//! A node of a running graph: its instance, its inputs, its counters.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU8, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use panoscope_abi::{self as abi, PortRange, Str, Tick};
use panoscope_graph::{NodeKind, OnFault};

use crate::clock;
use crate::exec::{Busy, Exec, ExecPlace, Instance, Made, clear};
use crate::fault::{Action, Cause, Fault, FaultLog, unix_ms};
use crate::host::CallContext;
use crate::join::Join;
use crate::keep::kept_more;
use crate::log::{Level, Log};
use crate::memory::FrameRef;
use crate::outputs::{OutputRule, is_same};
use crate::params::{InForce, Snapshot};
use crate::preview::Taps;
use crate::record::format::Event;
use crate::record::{Recorder, Script};
use crate::stats::{NodeStats, bump};
use crate::threads::{Leave, ingest_ring};

/// Frames that a node may keep beyond its calls.
pub(crate) const MOST_KEPT_FRAMES: usize = 128;
/// Calls in a row without any output after which a node is called silent.
const SILENT_CALLS: u32 = 30;
/// Changes of size that are remembered: a reader may lag a few ticks behind.
const REMEMBERED_SIZES: usize = 8;
const CAUSES: usize = Cause::Leak as usize + 1;

/// What every call of an engine shares.
pub(crate) struct Surroundings {
    pub host: abi::Host,
    pub log: Log,
    pub faults: FaultLog,
    pub start_ns: u64,
    pub graph_dir: String,
    pub batch: bool,
    /// Writes down what happens.
    pub recorder: Option<Arc<Recorder>>,
    /// What happened once and is to happen again.
    pub script: Option<Arc<Script>>,
    /// Heap allocations of the calling thread so far.
    pub thread_allocations: Option<fn() -> u64>,
}

impl Surroundings {
    /// The recording has a gap or ends: said at once, and the run goes on.
    pub fn recording_trouble(&self, words: &str) {
        self.log.say(Level::Warn, "record", words);
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
    pub fn widen(&self, cell: &Cell) {
        if cell.source && self.recorder.as_ref().is_some_and(|r| r.all_source_ports()) {
            cell.outputs_read.store(u64::MAX, Ordering::Relaxed);
        }
    }

    /// Nobody watches the clock: a tick waits rather than being lost.
    pub fn unhurried(&self) -> bool {
        self.batch || self.script.is_some()
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
    /// The watchdog gave this call up; the thread is to leave without touching anything.
    Abandoned,
}

/// A node of a running graph. What every call touches stands in the first cache line.
#[repr(C, align(64))]
pub(crate) struct Cell {
    pub exec: ExecPlace,
    /// The running call.
    pub busy: Busy,
    /// Changes whenever parameters, instance or manners do: a call that finds it as before need look at none of them.
    news: AtomicU64,
    pub outputs_read: AtomicU64,
    pub taps: Taps,
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
    pub join: Mutex<Join>,
    values: InForce,
    /// Opened beside the running instance; taken over before the next tick.
    replacement: Mutex<Option<(Instance, Option<Arc<Snapshot>>)>>,
    replace: AtomicBool,
    /// Failed instances, to be closed off the hot path.
    pub broken: Mutex<Vec<Instance>>,
    /// A failed node is to be opened again.
    pub wants_mending: AtomicBool,
    /// Increases whenever somebody sets out to mend; only the newest may hand over.
    pub mending: AtomicU64,
    /// Since when somebody waits for `open`; 0 when nobody does.
    pub opening_since_ns: AtomicU64,
    pub failures: AtomicU32,
    /// Calls and openings that did not return so far.
    pub stuck: Arc<AtomicU32>,
    pub stats: NodeStats,
    pub metrics: Mutex<Vec<(String, f64)>>,
    /// The node's own thread, if it has one.
    pub thread: Mutex<Option<std::thread::Thread>>,
    pub wake: AtomicBool,
    /// Taken out of the graph: its thread closes the instance when it leaves.
    pub retired: AtomicBool,
    /// Whether its thread is to leave, see [`Leave`].
    pub leave: Leave,
    pub has_thread: AtomicBool,
    /// What a tick of the inline chain that starts here took lately, the longest of about ten; `u64::MAX` before the first.
    pub walk_ns: AtomicU64,
    /// Newest capture time of a source, `i64::MIN` for none.
    pub last_capture_ns: AtomicI64,
    /// Ticks this node is done with, for its region.
    pub done_ticks: AtomicU64,
    /// Ticks a source has made.
    pub made: AtomicU64,
    /// Ingest times of a source's newest ticks.
    pub ingest_ns: Box<[AtomicU64]>,
    /// Which input slots belong to which port.
    pub ranges: Mutex<Vec<PortRange>>,
    /// The newest changes of outputs' sizes.
    pub resized: Mutex<VecDeque<Resized>>,
    pub fault_counts: [AtomicU64; CAUSES],
}

/// What the host refused a node.
pub(crate) type Refused = Box<(Cause, String)>;

/// Readers that run inline have one input.
const ONE_INPUT: &[PortRange] = &[PortRange { first: 0, count: 1 }];

/// What a call takes and where its outputs go.
pub(crate) struct Ports<'w> {
    pub inputs: &'w mut [FrameRef],
    /// The node has one input port, with one connection.
    pub lone: bool,
    pub made: &'w mut Made,
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
        let rules = OutputRule::of(spec.node_type);
        let stats = NodeStats::default();
        let time = Arc::clone(&stats.time);
        let exec = Exec::new(spec.node_type, &rules, spec.ranges.clone(), Arc::clone(&snapshot), time);
        let this = Self {
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
            rules,
            exec: ExecPlace::new(exec),
            busy: Busy::default(),
            join: Mutex::new(join),
            // That of a new exec is 0.
            news: AtomicU64::new(1),
            values: InForce::new(snapshot),
            replacement: Mutex::new(None),
            replace: AtomicBool::new(false),
            broken: Mutex::new(Vec::new()),
            wants_mending: AtomicBool::new(false),
            mending: AtomicU64::new(0),
            opening_since_ns: AtomicU64::new(0),
            failures: AtomicU32::new(0),
            stuck: Arc::default(),
            stats,
            metrics: Mutex::new(Vec::new()),
            outputs_read: AtomicU64::new(spec.outputs_read),
            taps: Taps::new(spec.node_type.outputs_len),
            thread: Mutex::new(None),
            wake: AtomicBool::new(false),
            retired: AtomicBool::new(false),
            leave: Leave::default(),
            has_thread: AtomicBool::new(false),
            walk_ns: AtomicU64::new(u64::MAX),
            last_capture_ns: AtomicI64::new(i64::MIN),
            done_ticks: AtomicU64::new(0),
            made: AtomicU64::new(0),
            ingest_ns: ingest_ring(spec.source),
            ranges: Mutex::new(spec.ranges),
            resized: Mutex::default(),
            fault_counts: [const { AtomicU64::new(0) }; CAUSES],
        };
        this.set_manners(spec.on_fault, spec.budget_ms, spec.max_rate_hz);
        this
    }

    /// Sets what the host does with the node; in force from the next tick on.
    pub fn set_manners(&self, on_fault: OnFault, budget_ms: Option<f64>, max_rate_hz: Option<f64>) {
        self.on_fault.store(on_fault as u8, Ordering::Relaxed);
        self.budget_ns.store(budget_ms.map_or(0, |ms| (ms * 1e6).max(1.0) as u64), Ordering::Relaxed);
        self.period_ns.store(max_rate_hz.map_or(0, |hz| (1e9 / hz) as i64), Ordering::Relaxed);
        self.news.fetch_add(1, Ordering::Release);
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
        let before = self.walk_ns.load(Ordering::Relaxed);
        let faded = if before == u64::MAX { 0 } else { before - before / 8 };
        self.walk_ns.store(ns.max(faded), Ordering::Relaxed);
    }

    /// The values in force.
    pub fn snapshot(&self) -> Arc<Snapshot> {
        self.values.get()
    }

    /// Puts new values in force from the next tick on.
    pub fn set_snapshot(&self, snapshot: Arc<Snapshot>) {
        self.values.set(snapshot);
        self.news.fetch_add(1, Ordering::Release);
    }

    /// Hands over an instance that was opened beside the running one, with the values it was opened with where they are new.
    pub fn replace_instance(&self, instance: Instance, snapshot: Option<Arc<Snapshot>>) {
        let old = lock(&self.replacement).replace((instance, snapshot));
        self.replace.store(true, Ordering::Relaxed);
        self.news.fetch_add(1, Ordering::Release);
        drop(old);
    }

    /// Ends the instance, if nobody runs the node; files are finished then. Answers whether it could be had.
    pub fn close_instance(&self) -> bool {
        drop(lock(&self.replacement).take());
        lock(&self.broken).clear();
        match self.exec.take() {
            Some(mut exec) => {
                exec.instance.close();
                self.exec.put(exec);
                true
            }
            None => false,
        }
    }

    /// Opens an instance with the given values.
    pub fn open(&self, around: &Surroundings, snapshot: &Snapshot) -> Result<Instance, String> {
        if around.script.as_ref().is_some_and(|s| s.closes(self)) {
            return Ok(Instance::none(self.node_type));
        }
        let mut failure = String::new();
        let mut context = CallContext {
            outputs: std::ptr::null_mut(),
            shown: std::ptr::null_mut(),
            outputs_len: 0,
            inputs: std::ptr::null(),
            inputs_len: 0,
            lent: None,
            first_formats: 0,
            cell: self,
            log: &around.log,
            failure: &mut failure,
            refused: None,
            random: None,
            tick: Tick::default(),
            wait_for_memory: around.unhurried(),
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
        let keeper = instance.kept.enter();
        let status = match self.node_type.open {
            // SAFETY: the contract; everything the call points to outlives it.
            Some(open) => unsafe { open(&raw mut call, &raw mut instance.raw) },
            None => abi::STATUS_INVALID,
        };
        drop(keeper);
        if status == abi::STATUS_OK {
            instance.open = true;
            return Ok(instance);
        }
        if failure.is_empty() {
            failure = format!("it did not open (status {status})");
        }
        Err(failure)
    }

    /// Calls the node for one tick; answers how it went and the time at its end. The inputs are the caller's to give back.
    pub fn run(
        &self,
        exec: &mut Exec,
        around: &Surroundings,
        tick: &mut Tick,
        complete: bool,
        start_ns: u64,
        ports: &mut Ports<'_>,
    ) -> (Ran, u64) {
        let led = around.script.as_ref().and_then(|s| s.lead(self, exec, around, tick));
        if self.news.load(Ordering::Acquire) != exec.news {
            self.catch_up(exec, around, tick, led.is_some());
        }
        ports.made.set_len(exec.outputs_len as usize);
        if !complete {
            bump(&self.stats.skipped);
            return (Ran::Skipped, start_ns);
        }
        if !led.unwrap_or_else(|| self.may_run(exec, around, tick)) {
            self.left_out(around, tick, false);
            return (Ran::Skipped, start_ns);
        }
        let allocations = around.thread_allocations.map(|count| count());
        self.busy.begin(tick, start_ns);
        let (status, refused) = self.call(exec, around, tick, ports);
        if !self.busy.end(start_ns) {
            return (Ran::Abandoned, start_ns);
        }
        let end_ns = clock::now_ns();
        if let Some((count, before)) = around.thread_allocations.zip(allocations) {
            let more = count().wrapping_sub(before);
            if more != 0 {
                self.stats.allocations.fetch_add(more, Ordering::Relaxed);
            }
        }
        let spent_ns = end_ns.saturating_sub(start_ns);
        exec.time.count_one(spent_ns);
        if spent_ns > exec.longest_ns {
            exec.longest_ns = spent_ns;
            exec.time.raise(spent_ns);
        }
        if exec.limited && exec.budget_ns != 0 && spent_ns > exec.budget_ns {
            self.over_budget(around, tick, spent_ns, exec.budget_ns);
        }
        let ran = if status == abi::STATUS_OK {
            self.accept(exec, around, tick, refused, end_ns, ports.made)
        } else {
            ports.made.clear();
            if status == abi::STATUS_END && exec.source {
                Ran::End
            } else {
                self.failed(exec, around, status, refused, tick, end_ns)
            }
        };
        if ran != Ran::Ok && ran != Ran::End {
            self.left_out(around, tick, !exec.instance.is_open());
        }
        (ran, end_ns)
    }

    /// Writes an event of this node into the recording, if there is one.
    #[inline]
    pub fn write_down(&self, around: &Surroundings, event: impl FnOnce(String) -> Event) {
        if let Some(recorder) = &around.recorder {
            recorder.say(event(self.id.clone()));
        }
    }

    #[cold]
    fn over_budget(&self, around: &Surroundings, tick: &Tick, spent_ns: u64, budget_ns: u64) {
        bump(&self.stats.over_budget);
        let words = || format!("took {:.1} ms of {:.1} ms", spent_ns as f64 / 1e6, budget_ns as f64 / 1e6);
        self.note(around, Cause::Slow, Action::Note, Some(tick.seq), words);
    }

    /// Takes over what others changed since the last call. Where a recording leads, it says when a replacement takes its turn.
    #[cold]
    fn catch_up(&self, exec: &mut Exec, around: &Surroundings, tick: &Tick, led: bool) {
        exec.news = self.news.load(Ordering::Acquire);
        if !led && self.replace.load(Ordering::Relaxed) {
            self.take_replacement(exec, around, tick);
        }
        if let Some(snapshot) = self.values.newer(exec.snapshot()) {
            let values = || snapshot.owned().to_vec();
            self.write_down(around, |node| Event::Values {
                node,
                source: tick.source,
                seq: tick.seq,
                values: values(),
            });
            exec.set_snapshot(snapshot);
        }
        exec.period_ns = self.period_ns.load(Ordering::Relaxed);
        exec.budget_ns = self.budget_ns.load(Ordering::Relaxed);
        exec.limited = exec.period_ns > 0 || exec.budget_ns != 0;
    }

    /// The node made nothing of a tick although its inputs were there.
    pub fn left_out(&self, around: &Surroundings, tick: &Tick, closed: bool) {
        self.write_down(around, |node| Event::LeftOut { node, source: tick.source, seq: tick.seq, closed });
    }

    /// The node goes on with an instance that was opened with these values.
    pub fn opened(&self, snapshot: &Snapshot, around: &Surroundings, tick: &Tick) {
        let values = || snapshot.owned().to_vec();
        self.write_down(around, |node| Event::Opened { node, source: tick.source, seq: tick.seq, values: values() });
    }

    #[cold]
    fn take_replacement(&self, exec: &mut Exec, around: &Surroundings, tick: &Tick) {
        self.replace.store(false, Ordering::Relaxed);
        let Some((mut instance, snapshot)) = lock(&self.replacement).take() else { return };
        self.hand_over(exec, &mut instance, around);
        drop(std::mem::replace(&mut exec.instance, instance));
        if let Some(snapshot) = snapshot {
            self.set_snapshot(Arc::clone(&snapshot));
            exec.set_snapshot(snapshot);
        }
        exec.bypassed = false;
        exec.bad_in_a_row = 0;
        if around.recorder.is_some() {
            self.opened(&self.snapshot(), around, tick);
        }
    }

    /// Gives the state of the running instance to its successor, where both know how.
    pub fn hand_over(&self, exec: &mut Exec, successor: &mut Instance, around: &Surroundings) {
        if let Some(state) = exec.instance.save_state(&around.host)
            && !successor.load_state(&state)
        {
            around.log.say(Level::Warn, &self.id, "the state of its predecessor was not understood: it starts anew");
        }
    }

    #[inline]
    fn may_run(&self, exec: &mut Exec, around: &Surroundings, tick: &Tick) -> bool {
        let last = exec.last_fired_ns;
        if exec.limited && exec.period_ns > 0 && last != i64::MIN && tick.capture_ns - last < exec.period_ns {
            return false;
        }
        if exec.bypassed || !(exec.instance.is_open() || (around.batch && self.open_in_batch(exec, around, tick))) {
            return false;
        }
        if !exec.source {
            exec.last_fired_ns = tick.capture_ns;
        }
        true
    }

    fn call(
        &self,
        exec: &mut Exec,
        around: &Surroundings,
        tick: &mut Tick,
        ports: &mut Ports<'_>,
    ) -> (abi::Status, Option<Refused>) {
        let Some(process) = exec.process else { return (abi::STATUS_INVALID, None) };
        let made = &mut *ports.made;
        match &mut made.shown[..] {
            [one] => *one = abi::Frame::EMPTY,
            all => all.fill(abi::Frame::EMPTY),
        }
        let (inputs, inputs_len) = (ports.inputs.as_ptr().cast::<abi::Frame>(), ports.inputs.len());
        let (params, params_len) = exec.params();
        let ranges: &[PortRange] = if ports.lone { ONE_INPUT } else { &exec.ranges };
        let mut context = CallContext {
            outputs: made.outputs.as_mut_ptr(),
            shown: made.shown.as_mut_ptr(),
            outputs_len: made.outputs.len(),
            inputs,
            inputs_len,
            lent: None,
            first_formats: exec.first_formats(),
            cell: self,
            log: &around.log,
            failure: &mut exec.failure,
            refused: None,
            random: None,
            tick: *tick,
            wait_for_memory: around.unhurried(),
        };
        let mut call = abi::Call {
            struct_size: size_of::<abi::Call>() as u32,
            flags: if around.batch { abi::CALL_BATCH } else { 0 },
            host: &raw const around.host,
            call: (&raw mut context).cast(),
            tick: *tick,
            inputs,
            inputs_len,
            input_ranges: ranges.as_ptr(),
            input_ranges_len: ranges.len(),
            outputs: made.shown.as_mut_ptr(),
            outputs_len: made.shown.len(),
            params,
            params_len,
            params_version: exec.params_version,
            outputs_read: self.outputs_read.load(Ordering::Relaxed),
        };
        let keeper = exec.instance.kept.enter();
        // SAFETY: the contract: an open instance that no other thread uses, and a call whose parts outlive it.
        let status = unsafe { process(exec.instance.raw, &raw mut call) };
        drop(keeper);
        let refused = context.refused.take();
        if let Some(lent) = context.lent {
            // The output holds the input's reference from here on.
            ports.inputs[lent.input as usize].forget();
        }
        if exec.source {
            tick.capture_ns = call.tick.capture_ns;
            for frame in made.outputs.iter_mut().filter(|f| !f.is_empty()) {
                frame.tick = *tick;
            }
        }
        (status, refused)
    }

    /// Looks at what a call made that says it went well.
    #[inline]
    fn accept(
        &self,
        exec: &mut Exec,
        around: &Surroundings,
        tick: &Tick,
        mut refused: Option<Refused>,
        end_ns: u64,
        made: &mut Made,
    ) -> Ran {
        let mut count = 0;
        for (index, (frame, shown)) in made.outputs.iter_mut().zip(&made.shown).enumerate() {
            if frame.is_empty() && shown.is_empty() {
                continue;
            }
            count += 1;
            let port = exec.port(index);
            if (port.inspected >> frame.format & 1 == 1 || !is_same(frame, shown))
                && let Err(objection) = self.rules[index].inspect(frame, shown)
            {
                clear(std::slice::from_mut(frame));
                refused = Some(Box::new(objection));
            } else if (port.width, port.height) != (frame.width, frame.height) {
                let (from, to) = ((port.width, port.height), (frame.width, frame.height));
                (port.width, port.height) = to;
                if from != (0, 0) {
                    self.resize(Resized { output: index, tick: *tick, from, to });
                }
            }
        }
        if let Some(refused) = refused {
            return self.bad_output(exec, made, around, tick, *refused, end_ns);
        }
        let silent = count == 0 && exec.outputs_len != 0;
        if exec.troubled || silent || kept_more() {
            return self.accept_troubled(exec, around, tick, silent, end_ns, made);
        }
        Ran::Ok
    }

    /// The rest of [`Self::accept`] for a node of whom something is remembered, or that made nothing or kept a frame.
    #[cold]
    fn accept_troubled(
        &self,
        exec: &mut Exec,
        around: &Surroundings,
        tick: &Tick,
        silent: bool,
        end_ns: u64,
        made: &mut Made,
    ) -> Ran {
        exec.bad_in_a_row = 0;
        if exec.instance.kept.count() > MOST_KEPT_FRAMES {
            made.clear();
            exec.failure.clear();
            exec.failure.push_str("it keeps more frames than any node may: a leak");
            let leak = Box::new((Cause::Leak, String::new()));
            return self.failed(exec, around, abi::STATUS_ERROR, Some(leak), tick, end_ns);
        }
        if silent {
            exec.silent_calls = exec.silent_calls.saturating_add(1);
            let silent = exec.silent_calls;
            if silent >= SILENT_CALLS
                && silent.is_multiple_of(SILENT_CALLS)
                && self.outputs_read.load(Ordering::Relaxed) != 0
            {
                let words = || format!("its inputs are complete, but it made nothing for {silent} ticks");
                self.note(around, Cause::Silent, Action::Note, Some(tick.seq), words);
            }
        } else {
            exec.silent_calls = 0;
        }
        if exec.failed_at_ns != 0 {
            self.stats.recovery.record(end_ns.saturating_sub(exec.failed_at_ns));
            exec.failed_at_ns = 0;
        }
        if exec.failures_in_a_row != 0 {
            exec.failures_in_a_row = 0;
            self.failures.store(0, Ordering::Relaxed);
        }
        exec.troubled = silent;
        Ran::Ok
    }

    #[cold]
    fn resize(&self, resized: Resized) {
        let mut newest = lock(&self.resized);
        if newest.len() >= REMEMBERED_SIZES {
            newest.pop_front();
        }
        newest.push_back(resized);
    }
}
