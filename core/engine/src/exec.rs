//! What runs a node: its instance and the memory of its calls, owned by one thread at a time.

use std::ffi::c_void;
use std::sync::Arc;
use std::sync::atomic::{AtomicPtr, AtomicU32, AtomicU64, Ordering};

use panoscope_abi::{self as abi, Frame, PortRange, Tick};

use crate::claims::Holds;
use crate::ending::who::{self, Phase};
use crate::keep::Kept;
use crate::memory::FrameRef;
use crate::outputs::OutputRule;
use crate::params::Snapshot;
use crate::stats::Histogram;

/// An open instance of a node type, closed when dropped.
pub(crate) struct Instance {
    /// May be null: a C plugin without state needs none.
    pub raw: *mut c_void,
    pub node_type: &'static abi::NodeType,
    pub open: bool,
    /// Whether it was handed to its node; one that never was has nothing to complete.
    pub begun: bool,
    /// Frames that it holds beyond its calls.
    pub kept: Kept,
    /// Files that it claims.
    pub holds: Box<Holds>,
}

// SAFETY: the contract lets an instance move between threads; it is used by one at a time.
unsafe impl Send for Instance {}

unsafe extern "C" fn collect(sink: *mut c_void, bytes: *const u8, len: usize) {
    // SAFETY: `sink` is the `Vec` that `save_state` passed; `bytes` are lent for the call.
    unsafe {
        if let Some(sink) = sink.cast::<Vec<u8>>().as_mut()
            && len > 0
        {
            sink.extend_from_slice(std::slice::from_raw_parts(bytes, len));
        }
    }
}

impl Instance {
    pub fn none(node_type: &'static abi::NodeType) -> Self {
        let kept = Kept::new(std::ptr::from_ref(node_type).cast());
        Self { raw: std::ptr::null_mut(), node_type, open: false, begun: false, kept, holds: Box::default() }
    }

    /// The instance, handed to its node.
    pub fn begun(mut self) -> Self {
        self.begun = true;
        self
    }

    pub fn is_open(&self) -> bool {
        self.open
    }

    /// Closes now instead of at drop.
    pub fn close(&mut self) {
        let raw = std::mem::replace(&mut self.raw, std::ptr::null_mut());
        let was_open = std::mem::replace(&mut self.open, false);
        if let Some(close) = self.node_type.close.filter(|_| was_open) {
            // SAFETY: opened by `open` and closed once.
            who::with(&self.kept.who(), Phase::Close, || self.kept.during(|| unsafe { close(raw) }));
        }
        self.kept.reclaim();
        self.holds.release();
    }

    /// Whether there may be a state for a successor.
    pub fn saves_state(&self) -> bool {
        self.open && self.node_type.save_state.is_some()
    }

    /// State for a successor; `None` when there is none.
    pub fn save_state(&mut self, host: &abi::Host) -> Option<Vec<u8>> {
        let save = self.node_type.save_state.filter(|_| self.open)?;
        let host = abi::Host { save: Some(collect), ..*host };
        let mut bytes: Vec<u8> = Vec::new();
        let (raw, who) = (self.raw, self.kept.who());
        let status = who::with(&who, Phase::SaveState, || {
            // SAFETY: an open instance that no other thread uses; the sink outlives the call.
            self.kept.during(|| unsafe { save(raw, &raw const host, (&raw mut bytes).cast()) })
        });
        (status == abi::STATUS_OK && !bytes.is_empty()).then_some(bytes)
    }

    /// Takes over a predecessor's state; `false` when it was not understood.
    pub fn load_state(&mut self, bytes: &[u8]) -> bool {
        let Some(load) = self.node_type.load_state.filter(|_| self.open) else { return false };
        let (raw, who) = (self.raw, self.kept.who());
        who::with(&who, Phase::LoadState, || {
            // SAFETY: an open instance that no other thread uses; the bytes are lent for the call.
            self.kept.during(|| unsafe { load(raw, bytes.as_ptr(), bytes.len()) == abi::STATUS_OK })
        })
    }
}

impl Drop for Instance {
    fn drop(&mut self) {
        self.close();
    }
}

/// A call was left behind by the watchdog.
pub(crate) const ABANDONED: u64 = u64::MAX;

/// What a plugin is called for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Doing {
    /// A tick.
    #[default]
    Process,
    Open,
    Close,
    SaveState,
    LoadState,
}

impl Doing {
    const ALL: [Doing; 5] = [Doing::Process, Doing::Open, Doing::Close, Doing::SaveState, Doing::LoadState];

    /// After "it did not return".
    pub fn words(self) -> &'static str {
        match self {
            Doing::Process => "",
            Doing::Open => " from opening",
            Doing::Close => " from closing",
            Doing::SaveState => " from saving its state",
            Doing::LoadState => " from taking over a state",
        }
    }
}

/// A call was given up: its thread leaves without touching anything.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct LeftBehind;

/// The running call as the watchdog sees it.
#[derive(Default)]
pub(crate) struct Busy {
    /// Start of the call in ns of the host's clock; 0 when idle, [`ABANDONED`] once the watchdog gave it up.
    pub since_ns: AtomicU64,
    /// The tick's source, and from [`Self::DOING_BITS`] on a [`Doing`].
    source: AtomicU32,
    /// Number of the thread, see [`crate::pool::thread_number`].
    pub thread: AtomicU32,
    seq: AtomicU64,
    capture_ns: AtomicU64,
}

impl Busy {
    /// Sources have smaller numbers.
    const DOING_BITS: u32 = 28;

    /// Begins a call for a tick.
    #[inline]
    pub fn begin(&self, tick: &Tick, start_ns: u64) {
        self.begin_doing(Doing::Process, tick, start_ns);
    }

    /// Begins a call for something else, at a tick.
    #[inline]
    pub fn begin_doing(&self, doing: Doing, tick: &Tick, start_ns: u64) {
        self.source.store(tick.source | (doing as u32) << Self::DOING_BITS, Ordering::Relaxed);
        self.seq.store(tick.seq, Ordering::Relaxed);
        self.capture_ns.store(tick.capture_ns as u64, Ordering::Relaxed);
        self.thread.store(crate::pool::thread_number(), Ordering::Relaxed);
        self.since_ns.store(start_ns.max(1), Ordering::Release);
    }

    /// What the call is for. As [`Self::tick`] and `thread` it belongs to the call whose start was read before, if [`Self::abandon`] finds that
    /// one afterwards.
    pub fn doing(&self) -> Doing {
        let number = (self.source.load(Ordering::Relaxed) >> Self::DOING_BITS) as usize;
        Doing::ALL.get(number).copied().unwrap_or_default()
    }

    /// Ends the call that began at `start_ns`; `false` when the watchdog has taken everything over: by now it may be another call's turn,
    /// which began at another time.
    #[inline]
    pub fn end(&self, start_ns: u64) -> bool {
        self.since_ns.compare_exchange(start_ns.max(1), 0, Ordering::AcqRel, Ordering::Relaxed).is_ok()
    }

    /// Makes room for calls after one that was given up.
    pub fn clear(&self) {
        self.since_ns.store(0, Ordering::Release);
    }

    /// Takes a call over that began at `since_ns`; `false` when it has ended.
    pub fn abandon(&self, since_ns: u64) -> bool {
        self.since_ns.compare_exchange(since_ns, ABANDONED, Ordering::AcqRel, Ordering::Relaxed).is_ok()
    }

    pub fn tick(&self) -> Tick {
        Tick {
            source: self.source.load(Ordering::Relaxed) & ((1 << Self::DOING_BITS) - 1),
            flags: 0,
            seq: self.seq.load(Ordering::Relaxed),
            capture_ns: self.capture_ns.load(Ordering::Relaxed) as i64,
        }
    }
}

/// An output as the checks after a call need it.
#[derive(Clone, Copy)]
pub(crate) struct Port {
    pub formats: u32,
    /// Size when it was last made, [`Port::NEVER`] before.
    pub width: u32,
    pub height: u32,
    /// Formats whose contents are looked at, one bit each, see [`OutputRule::inspect`].
    pub inspected: u32,
}

impl Port {
    /// Width and height of an output that was not made yet.
    pub const NEVER: (u32, u32) = (u32::MAX, u32::MAX);

    fn new(formats: u32, inspected: u32) -> Self {
        Self { formats, width: Self::NEVER.0, height: Self::NEVER.1, inspected }
    }
}

/// The instance and what a call needs; owned by whoever runs the node. The order is that of use: what every call touches stands in
/// the first two cache lines.
#[repr(C, align(64))]
pub(crate) struct Exec {
    pub instance: Instance,
    pub process: ProcessFn,
    params: *const abi::ParamValue,
    params_len: usize,
    pub params_version: u64,
    /// [`crate::cell::Cell::news`] as of the last call: what is copied from there is in force.
    pub news: u64,
    /// Capture time of the last tick that was run, `i64::MIN` for none.
    pub last_fired_ns: i64,
    pub time: Arc<Histogram>,
    pub longest_ns: u64,
    first: Port,
    pub outputs_len: u32,
    pub source: bool,
    pub bypassed: bool,
    /// One of the counts of what went wrong is not 0.
    pub troubled: bool,
    /// There is a period or a budget.
    pub limited: bool,
    // Here ends what a call that goes well touches, if the node has one output and no limits.
    more: Box<[Port]>,
    pub period_ns: i64,
    pub budget_ns: u64,
    pub ranges: Vec<PortRange>,
    pub failure: String,
    snapshot: Arc<Snapshot>,
    /// In batch: calls to leave out before the node is opened again.
    pub skip_calls: u32,
    pub failures_in_a_row: u32,
    pub silent_calls: u32,
    pub bad_in_a_row: u32,
    /// When the last failure was, until a call goes well; 0 for none.
    pub failed_at_ns: u64,
}

type ProcessFn = Option<unsafe extern "C" fn(instance: *mut c_void, call: *mut abi::Call) -> abi::Status>;

const _: () = assert!(std::mem::offset_of!(Exec, more) <= 128);

// SAFETY: `params` points into `snapshot`, which is immutable and shared between threads.
unsafe impl Send for Exec {}

impl Exec {
    pub fn new(
        node_type: &'static abi::NodeType,
        rules: &[OutputRule],
        ranges: Vec<PortRange>,
        snapshot: Arc<Snapshot>,
        time: Arc<Histogram>,
    ) -> Box<Self> {
        let port = |rule: &OutputRule| Port::new(rule.formats(), rule.inspected());
        let first = Port::new(0, 0);
        Box::new(Self {
            instance: Instance::none(node_type),
            process: node_type.process,
            params: snapshot.values().as_ptr(),
            params_len: snapshot.values().len(),
            params_version: snapshot.version(),
            news: 0,
            last_fired_ns: i64::MIN,
            time,
            longest_ns: 0,
            first: rules.first().map_or(first, port),
            outputs_len: rules.len() as u32,
            source: node_type.flags & abi::NODE_SOURCE != 0,
            bypassed: false,
            troubled: true,
            limited: false,
            more: rules.iter().skip(1).map(port).collect(),
            period_ns: 0,
            budget_ns: 0,
            ranges,
            failure: String::new(),
            snapshot,
            skip_calls: 0,
            failures_in_a_row: 0,
            silent_calls: 0,
            bad_in_a_row: 0,
            failed_at_ns: 0,
        })
    }

    /// Output `index`, which the node has.
    #[inline]
    pub fn port(&mut self, index: usize) -> &mut Port {
        if index == 0 { &mut self.first } else { &mut self.more[index - 1] }
    }

    /// Formats of the first output.
    #[inline]
    pub fn first_formats(&self) -> u32 {
        self.first.formats
    }

    pub fn snapshot(&self) -> &Arc<Snapshot> {
        &self.snapshot
    }

    /// Puts values in force.
    pub fn set_snapshot(&mut self, snapshot: Arc<Snapshot>) {
        self.params = snapshot.values().as_ptr();
        self.params_len = snapshot.values().len();
        self.params_version = snapshot.version();
        self.snapshot = snapshot;
    }

    /// The values in force, in the contract's layout.
    #[inline]
    pub fn params(&self) -> (*const abi::ParamValue, usize) {
        (self.params, self.params_len)
    }

    /// Asks the processor for the lines of a call that is soon to be made.
    #[inline]
    pub fn prefetch(this: *const Self) {
        prefetch(this.cast());
        prefetch(this.cast::<u8>().wrapping_add(64));
    }
}

/// Asks the processor for a cache line; a hint only, any address will do.
#[inline]
pub(crate) fn prefetch(address: *const u8) {
    #[cfg(target_arch = "x86_64")]
    // SAFETY: a prefetch never faults.
    unsafe {
        std::arch::x86_64::_mm_prefetch::<{ std::arch::x86_64::_MM_HINT_T0 }>(address.cast());
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = address;
}

/// What a call made. Outside a call all frames are empty.
#[derive(Default)]
pub struct Made {
    /// As the host knows it.
    pub(crate) outputs: Vec<Frame>,
    /// The same as the node sees it; never believed.
    pub(crate) shown: Vec<Frame>,
}

impl Made {
    /// Makes room for a node's outputs.
    #[inline]
    pub(crate) fn set_len(&mut self, len: usize) {
        if self.outputs.len() != len {
            self.clear();
            self.outputs.resize(len, Frame::EMPTY);
            self.shown.resize(len, Frame::EMPTY);
        }
    }

    /// Gives everything back.
    #[inline]
    pub(crate) fn clear(&mut self) {
        // SAFETY: outside a call the outputs are empty or hold references: `CallContext` puts nothing else there, and a frame that was only
        // lent has its input's reference when the call ends.
        unsafe { clear(&mut self.outputs) };
    }
}

impl Drop for Made {
    fn drop(&mut self) {
        self.clear();
    }
}

/// What a thread needs to walk ticks through nodes: the memory of the calls that it makes, one after the other.
pub struct Walk {
    /// Inputs of a chain's first node.
    pub(crate) inputs: Vec<FrameRef>,
    /// Of a node and of the one before it, in turn.
    pub(crate) made: [Made; 2],
}

/// Ports that a thread has room for from its start; more are made room for when they are met.
const USUAL_PORTS: usize = 16;

impl Default for Walk {
    fn default() -> Self {
        let made = || Made { outputs: Vec::with_capacity(USUAL_PORTS), shown: Vec::with_capacity(USUAL_PORTS) };
        Self { inputs: Vec::with_capacity(USUAL_PORTS), made: [made(), made()] }
    }
}

impl Walk {
    /// Gives everything back.
    pub(crate) fn clear(&mut self) {
        self.inputs.clear();
        self.made.iter_mut().for_each(Made::clear);
    }
}

/// Gives back what stands in the outputs.
///
/// # Safety
/// Each frame that is not empty holds a reference, as [`FrameRef::adopt`] wants it.
pub(crate) unsafe fn clear(outputs: &mut [Frame]) {
    for frame in outputs.iter_mut().filter(|f| !f.is_empty()) {
        // SAFETY: the caller's promise; the list forgets the frame.
        drop(unsafe { FrameRef::adopt(std::mem::replace(frame, Frame::EMPTY)) });
    }
}

/// Where an [`Exec`] rests while nobody runs the node. Taking it is one atomic swap.
pub(crate) struct ExecPlace(AtomicPtr<Exec>);

impl ExecPlace {
    pub fn new(exec: Box<Exec>) -> Self {
        Self(AtomicPtr::new(Box::into_raw(exec)))
    }

    /// The exec, unless somebody runs the node.
    pub fn take(&self) -> Option<Box<Exec>> {
        let raw = self.0.swap(std::ptr::null_mut(), Ordering::Acquire);
        // SAFETY: only `new` and `put` store pointers, made by `into_raw`; the swap hands each to one caller.
        (!raw.is_null()).then(|| unsafe { Box::from_raw(raw) })
    }

    /// Puts back what was taken, or what replaces it. The place is empty: only its taker, or the watchdog in its stead, may put.
    pub fn put(&self, exec: Box<Exec>) {
        self.0.store(Box::into_raw(exec), Ordering::Release);
    }

    /// Where it is, for [`Exec::prefetch`].
    #[inline]
    pub fn address(&self) -> *const Exec {
        self.0.load(Ordering::Relaxed)
    }

    /// Whether nobody runs the node.
    pub fn is_home(&self) -> bool {
        !self.0.load(Ordering::Acquire).is_null()
    }
}

impl Drop for ExecPlace {
    fn drop(&mut self) {
        drop(self.take());
    }
}
