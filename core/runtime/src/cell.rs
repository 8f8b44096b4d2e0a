//! A node of a running graph: its instance, its inputs, its counters.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU8, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use panoscope_abi::{self as abi, PortRange, Str, Tick};
use panoscope_graph::{NodeKind, OnFault};

use crate::clock;
use crate::exec::{Busy, Exec, ExecPlace, Instance, clear};
use crate::fault::{Action, Cause, Fault, FaultLog, unix_ms};
use crate::host::CallContext;
use crate::join::Join;
use crate::log::{Level, Log};
use crate::outputs::OutputRule;
use crate::params::{InForce, Snapshot};
use crate::preview::Taps;
use crate::record::format::Event;
use crate::record::{Recorder, Script};
use crate::stats::{NodeStats, bump};
use crate::threads::ingest_ring;

/// Frames that a node may keep beyond its calls.
pub(crate) const MOST_KEPT_FRAMES: usize = 128;
/// Calls in a row without any output after which a node is called silent.
const SILENT_CALLS: u32 = 30;
/// Bad outputs in a row after which an instance is not trusted any more.
const MOST_BAD_OUTPUTS: u32 = 10;
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

/// A node of a running graph.
pub(crate) struct Cell {
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
    pub exec: ExecPlace,
    /// The running call.
    pub busy: Busy,
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
    pub outputs_read: AtomicU64,
    pub taps: Taps,
    /// The node's own thread, if it has one.
    pub thread: Mutex<Option<std::thread::Thread>>,
    pub wake: AtomicBool,
    /// Taken out of the graph: its thread closes the instance when it leaves.
    pub retired: AtomicBool,
    /// Whether its thread is to leave, see [`Leave`].
    pub leave: Leave,
    pub has_thread: AtomicBool,
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
    fault_counts: [AtomicU64; CAUSES],
}

/// An output changed its size.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Resized {
    pub output: usize,
    pub tick: Tick,
    pub from: (u32, u32),
    pub to: (u32, u32),
}

/// A wish that a thread leaves, which it answers before it does.
#[derive(Default)]
pub(crate) struct Leave(AtomicU8);

impl Leave {
    const WISHED: u8 = 1;
    const GRANTED: u8 = 2;

    pub fn wish(&self) {
        let _ = self.0.compare_exchange(0, Self::WISHED, Ordering::AcqRel, Ordering::Relaxed);
    }

    pub fn is_wished(&self) -> bool {
        self.0.load(Ordering::Relaxed) != 0
    }

    /// Called by the thread: whether it leaves now.
    pub fn grant(&self) -> bool {
        self.0.load(Ordering::Relaxed) != 0 && {
            let _ = self.0.compare_exchange(Self::WISHED, Self::GRANTED, Ordering::AcqRel, Ordering::Relaxed);
            self.0.load(Ordering::Acquire) == Self::GRANTED
        }
    }

    /// Takes the wish back; `false` when the thread has set out to leave.
    pub fn take_back(&self) -> bool {
        self.0.compare_exchange(Self::WISHED, 0, Ordering::AcqRel, Ordering::Acquire) != Err(Self::GRANTED)
    }

    /// For the next thread.
    pub fn reset(&self) {
        self.0.store(0, Ordering::Release);
    }
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
        let exec = Exec::new(spec.node_type, slots, spec.ranges.clone(), Arc::clone(&snapshot));
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
            rules: OutputRule::of(spec.node_type),
            exec: ExecPlace::new(exec),
            busy: Busy::default(),
            join: Mutex::new(join),
            values: InForce::new(snapshot),
            replacement: Mutex::new(None),
            replace: AtomicBool::new(false),
            broken: Mutex::new(Vec::new()),
            wants_mending: AtomicBool::new(false),
            mending: AtomicU64::new(0),
            opening_since_ns: AtomicU64::new(0),
            failures: AtomicU32::new(0),
            stuck: Arc::default(),
            stats: NodeStats::default(),
            metrics: Mutex::new(Vec::new()),
            outputs_read: AtomicU64::new(spec.outputs_read),
            taps: Taps::new(spec.node_type.outputs_len),
            thread: Mutex::new(None),
            wake: AtomicBool::new(false),
            retired: AtomicBool::new(false),
            leave: Leave::default(),
            has_thread: AtomicBool::new(false),
            last_capture_ns: AtomicI64::new(i64::MIN),
            done_ticks: AtomicU64::new(0),
            made: AtomicU64::new(0),
            ingest_ns: ingest_ring(spec.source),
            ranges: Mutex::new(spec.ranges.clone()),
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
    }

    pub fn on_fault(&self) -> OnFault {
        let number = self.on_fault.load(Ordering::Relaxed);
        [OnFault::Restart, OnFault::Bypass, OnFault::Stop].into_iter().find(|o| *o as u8 == number).unwrap_or_default()
    }

    /// Whether the node runs on a thread of its own.
    pub fn owns_thread(&self) -> bool {
        self.source || self.kind != NodeKind::Compute
    }

    /// The values in force.
    pub fn snapshot(&self) -> Arc<Snapshot> {
        self.values.get()
    }

    /// Puts new values in force from the next tick on.
    pub fn set_snapshot(&self, snapshot: Arc<Snapshot>) {
        self.values.set(snapshot);
    }

    /// Hands over an instance that was opened beside the running one, with the values it was opened with where they are new.
    pub fn replace_instance(&self, instance: Instance, snapshot: Option<Arc<Snapshot>>) {
        let old = lock(&self.replacement).replace((instance, snapshot));
        self.replace.store(true, Ordering::Release);
        drop(old);
    }

    /// Ends the instance, if nobody runs the node; files are finished then. Answers whether it could be had.
    pub fn close_instance(&self) -> bool {
        drop(lock(&self.replacement).take());
        lock(&self.broken).clear();
        match self.exec.take() {
            Some(mut exec) => {
                exec.inputs.clear();
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
            rules: &[],
            stats: &self.stats,
            log: &around.log,
            node_id: &self.id,
            failure: &mut failure,
            refused: None,
            random: None,
            tick: Tick::default(),
            wait_for_memory: around.unhurried(),
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
        let led = around.script.as_ref().and_then(|s| s.lead(self, exec, around, tick));
        if led.is_none() && self.replace.load(Ordering::Relaxed) {
            self.take_replacement(exec, around, tick);
        }
        if let Some(snapshot) = self.values.newer(&exec.snapshot) {
            exec.snapshot = snapshot;
            self.write_down(around, |node| Event::Values {
                node,
                source: tick.source,
                seq: tick.seq,
                values: exec.snapshot.owned().to_vec(),
            });
        }
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
        let (status, refused) = self.call(exec, around, tick);
        if !self.busy.end(start_ns) {
            return (Ran::Abandoned, start_ns);
        }
        let end_ns = clock::now_ns();
        if let Some((count, before)) = around.thread_allocations.zip(allocations) {
            self.stats.allocations.fetch_add(count().wrapping_sub(before), Ordering::Relaxed);
        }
        let spent_ns = end_ns.saturating_sub(start_ns);
        self.stats.time.record(spent_ns);
        let budget_ns = self.budget_ns.load(Ordering::Relaxed);
        if budget_ns != 0 && spent_ns > budget_ns {
            bump(&self.stats.over_budget);
            let words = || format!("took {:.1} ms of {:.1} ms", spent_ns as f64 / 1e6, budget_ns as f64 / 1e6);
            self.note(around, Cause::Slow, Action::Note, Some(tick.seq), words);
        }
        let ran = match status {
            abi::STATUS_OK => self.accept(exec, around, tick, refused, end_ns),
            abi::STATUS_END if self.source => {
                clear(&mut exec.outputs);
                Ran::End
            }
            status => {
                clear(&mut exec.outputs);
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
            exec.snapshot = snapshot;
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
        let period_ns = self.period_ns.load(Ordering::Relaxed);
        if period_ns > 0 && exec.last_fired_ns.is_some_and(|last| tick.capture_ns - last < period_ns) {
            return false;
        }
        if exec.bypassed || !(exec.instance.is_open() || (around.batch && self.open_in_batch(exec, around, tick))) {
            return false;
        }
        if !self.source {
            exec.last_fired_ns = Some(tick.capture_ns);
        }
        true
    }

    fn call(&self, exec: &mut Exec, around: &Surroundings, tick: &mut Tick) -> (abi::Status, Option<(Cause, String)>) {
        let Some(process) = self.node_type.process else { return (abi::STATUS_INVALID, None) };
        exec.shown.fill(abi::Frame::EMPTY);
        let mut context = CallContext {
            outputs: exec.outputs.as_mut_ptr(),
            shown: exec.shown.as_mut_ptr(),
            outputs_len: exec.outputs.len(),
            rules: &self.rules,
            stats: &self.stats,
            log: &around.log,
            node_id: &self.id,
            failure: &mut exec.failure,
            refused: None,
            random: None,
            tick: *tick,
            wait_for_memory: around.unhurried(),
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
            outputs: exec.shown.as_mut_ptr(),
            outputs_len: exec.shown.len(),
            params: exec.snapshot.values().as_ptr(),
            params_len: exec.snapshot.values().len(),
            params_version: exec.snapshot.version(),
            outputs_read: self.outputs_read.load(Ordering::Relaxed),
        };
        let keeper = exec.instance.kept.enter();
        // SAFETY: the contract: an open instance that no other thread uses, and a call whose parts outlive it.
        let status = unsafe { process(exec.instance.raw, &raw mut call) };
        drop(keeper);
        let refused = context.refused.take();
        if self.source {
            tick.capture_ns = call.tick.capture_ns;
            for frame in exec.outputs.iter_mut().filter(|f| !f.is_empty()) {
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
        mut refused: Option<(Cause, String)>,
        end_ns: u64,
    ) -> Ran {
        let mut made = 0;
        let Exec { outputs, shown, sizes, .. } = exec;
        for (index, rule) in self.rules.iter().enumerate() {
            let frame = &mut outputs[index];
            if frame.is_empty() && shown[index].is_empty() {
                continue;
            }
            made += 1;
            if let Err(objection) = rule.inspect(frame, &shown[index]) {
                clear(std::slice::from_mut(frame));
                refused = Some(objection);
            } else if sizes[index] != (frame.width, frame.height) {
                let to = (frame.width, frame.height);
                let from = std::mem::replace(&mut sizes[index], to);
                if from != (0, 0) {
                    self.resize(Resized { output: index, tick: *tick, from, to });
                }
            }
        }
        if let Some((cause, words)) = refused {
            return self.bad_output(exec, around, tick, cause, words, end_ns);
        }
        exec.bad_in_a_row = 0;
        if exec.instance.kept.count() > MOST_KEPT_FRAMES {
            clear(&mut exec.outputs);
            exec.failure.clear();
            exec.failure.push_str("it keeps more frames than any node may: a leak");
            return self.failed(exec, around, abi::STATUS_ERROR, Some((Cause::Leak, String::new())), tick, end_ns);
        }
        if made == 0 && !self.rules.is_empty() {
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

    /// A description or contents that do not pass: the packet is withheld; who goes on like that is opened again.
    #[cold]
    fn bad_output(
        &self,
        exec: &mut Exec,
        around: &Surroundings,
        tick: &Tick,
        cause: Cause,
        words: String,
        end_ns: u64,
    ) -> Ran {
        exec.bad_in_a_row += 1;
        if exec.bad_in_a_row >= MOST_BAD_OUTPUTS || (cause == Cause::BadOutput && self.on_fault() != OnFault::Restart) {
            clear(&mut exec.outputs);
            exec.failure.clear();
            exec.failure.push_str(&words);
            return self.failed(exec, around, abi::STATUS_ERROR, Some((cause, words)), tick, end_ns);
        }
        bump(&self.stats.faults);
        if self.count(cause).is_power_of_two() {
            around.log.say(Level::Error, &self.id, &words);
        }
        self.note_counted(around, cause, Action::Withhold, Some(tick.seq), || words);
        Ran::Ok
    }

    /// In batch a failed node is opened again before a tick that does not depend on the clock.
    #[cold]
    fn open_in_batch(&self, exec: &mut Exec, around: &Surroundings, tick: &Tick) -> bool {
        if self.on_fault() != OnFault::Restart {
            return false;
        }
        if exec.skip_calls > 0 {
            exec.skip_calls -= 1;
            return false;
        }
        lock(&self.broken).clear();
        let snapshot = Arc::clone(&exec.snapshot);
        match self.open(around, &snapshot) {
            Ok(instance) => {
                bump(&self.stats.restarts);
                around.log.say(Level::Info, &self.id, "opened again");
                exec.instance = instance;
                self.opened(&snapshot, around, tick);
                true
            }
            Err(words) => {
                exec.failures_in_a_row += 1;
                exec.skip_calls = skipped_calls(exec.failures_in_a_row);
                self.open_failed(around, &words, Some(tick.seq));
                false
            }
        }
    }

    /// Writes down that a node did not open again.
    pub fn open_failed(&self, around: &Surroundings, words: &str, seq: Option<u64>) {
        bump(&self.stats.faults);
        around.log.say(Level::Error, &self.id, &format!("could not be opened again: {words}"));
        self.tell(around, Cause::Open, Action::Restart, seq, None, words.to_owned());
    }

    #[cold]
    fn failed(
        &self,
        exec: &mut Exec,
        around: &Surroundings,
        status: abi::Status,
        refused: Option<(Cause, String)>,
        tick: &Tick,
        now_ns: u64,
    ) -> Ran {
        if status == abi::STATUS_EXHAUSTED {
            bump(&self.stats.dropped);
            let words = "the tick was dropped: frame memory is used up";
            if (self.count(Cause::Exhausted) + 1).is_power_of_two() {
                around.log.say(Level::Warn, &self.id, words);
            }
            self.note(around, Cause::Exhausted, Action::Withhold, Some(tick.seq), || words.to_owned());
            return Ran::Fault;
        }
        bump(&self.stats.faults);
        let mut words = std::mem::take(&mut exec.failure);
        let mut cause = if status == abi::STATUS_PANIC { Cause::Panic } else { Cause::Error };
        if let Some((because, details)) = refused {
            cause = because;
            if !details.is_empty() && details != words {
                words = if words.is_empty() { details } else { format!("{details} ({words})") };
            }
        }
        if words.is_empty() {
            words = "it failed without a word".to_owned();
        }
        around.log.say(Level::Error, &self.id, &words);
        exec.failures_in_a_row += 1;
        exec.skip_calls = skipped_calls(exec.failures_in_a_row);
        exec.failed_at_ns = now_ns;
        exec.bad_in_a_row = 0;
        exec.silent_calls = 0;
        self.failures.store(exec.failures_in_a_row, Ordering::Relaxed);
        // What the instance holds after a fault is not to be trusted. It may take long to close.
        lock(&self.broken).push(std::mem::replace(&mut exec.instance, Instance::none(self.node_type)));
        let (done, ran) = match self.on_fault() {
            OnFault::Restart => (Action::Restart, Ran::Fault),
            OnFault::Bypass => (Action::Bypass, Ran::Fault),
            OnFault::Stop => (Action::Stop, Ran::Stop),
        };
        exec.bypassed = done == Action::Bypass;
        self.wants_mending.store(true, Ordering::Release);
        self.tell(around, cause, done, Some(tick.seq), None, words);
        ran
    }

    fn count(&self, cause: Cause) -> u64 {
        self.fault_counts[cause as usize].load(Ordering::Relaxed)
    }

    /// Writes down a fault that may come with every tick.
    #[cold]
    pub fn note(
        &self,
        around: &Surroundings,
        cause: Cause,
        done: Action,
        seq: Option<u64>,
        words: impl FnOnce() -> String,
    ) {
        self.note_counted(around, cause, done, seq, words);
    }

    fn note_counted(
        &self,
        around: &Surroundings,
        cause: Cause,
        done: Action,
        seq: Option<u64>,
        words: impl FnOnce() -> String,
    ) {
        if (self.count(cause) + 1).is_power_of_two() {
            self.tell(around, cause, done, seq, None, words());
        } else {
            bump(&self.fault_counts[cause as usize]);
        }
    }

    /// Writes down a fault.
    pub fn tell(
        &self,
        around: &Surroundings,
        cause: Cause,
        done: Action,
        seq: Option<u64>,
        late_ms: Option<f64>,
        words: String,
    ) {
        let count = self.fault_counts[cause as usize].fetch_add(1, Ordering::Relaxed) + 1;
        let fault = Fault {
            unix_ms: unix_ms(),
            run_ms: clock::now_ns().saturating_sub(around.start_ns) as f64 / 1e6,
            node: self.id.clone(),
            cause,
            words,
            done,
            seq,
            late_ms,
            count,
        };
        if let Some(recorder) = &around.recorder {
            recorder.say(Event::Fault(fault.clone()));
        }
        around.faults.put(fault);
    }
}

/// How long a failed node rests before it is opened again: 0, 10, 20, 40 ... 2,000 ms.
pub(crate) fn backoff_ms(failures: u32) -> u64 {
    if failures <= 1 { 0 } else { (10u64 << (failures - 2).min(8)).min(2000) }
}

/// The same in calls, for batch: 0, 1, 3, 7 ... 255.
fn skipped_calls(failures: u32) -> u32 {
    (1u32 << (failures.max(1) - 1).min(8)) - 1
}
