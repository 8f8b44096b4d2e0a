//! What runs a node: its instance and the memory of its calls, owned by one thread at a time.

use std::ffi::c_void;
use std::sync::Arc;
use std::sync::atomic::{AtomicPtr, AtomicU32, AtomicU64, Ordering};

use panoscope_abi::{self as abi, Frame, PortRange, Tick};

use crate::keep::Kept;
use crate::memory::FrameRef;
use crate::params::Snapshot;

/// An open instance of a node type, closed when dropped.
pub(crate) struct Instance {
    /// May be null: a C plugin without state needs none.
    pub raw: *mut c_void,
    pub node_type: &'static abi::NodeType,
    pub open: bool,
    /// Frames that it holds beyond its calls.
    pub kept: Kept,
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
        Self { raw: std::ptr::null_mut(), node_type, open: false, kept: Kept::default() }
    }

    pub fn is_open(&self) -> bool {
        self.open
    }

    /// Closes now instead of at drop.
    pub fn close(&mut self) {
        let raw = std::mem::replace(&mut self.raw, std::ptr::null_mut());
        let was_open = std::mem::replace(&mut self.open, false);
        if let Some(close) = self.node_type.close.filter(|_| was_open) {
            let _keeper = self.kept.enter();
            // SAFETY: opened by `open` and closed once.
            unsafe { close(raw) }
        }
        self.kept.reclaim();
    }

    /// State for a successor; `None` when there is none.
    pub fn save_state(&mut self, host: &abi::Host) -> Option<Vec<u8>> {
        let save = self.node_type.save_state.filter(|_| self.open)?;
        let host = abi::Host { save: Some(collect), ..*host };
        let mut bytes: Vec<u8> = Vec::new();
        // SAFETY: an open instance that no other thread uses; the sink outlives the call.
        let status = unsafe { save(self.raw, &raw const host, (&raw mut bytes).cast()) };
        (status == abi::STATUS_OK && !bytes.is_empty()).then_some(bytes)
    }

    /// Takes over a predecessor's state; `false` when it was not understood.
    pub fn load_state(&mut self, bytes: &[u8]) -> bool {
        let Some(load) = self.node_type.load_state.filter(|_| self.open) else { return false };
        // SAFETY: an open instance that no other thread uses; the bytes are lent for the call.
        unsafe { load(self.raw, bytes.as_ptr(), bytes.len()) == abi::STATUS_OK }
    }
}

impl Drop for Instance {
    fn drop(&mut self) {
        self.close();
    }
}

/// A call was left behind by the watchdog.
pub(crate) const ABANDONED: u64 = u64::MAX;

/// The running call as the watchdog sees it.
#[derive(Default)]
#[repr(align(64))]
pub(crate) struct Busy {
    /// Start of the call in ns of the host's clock; 0 when idle, [`ABANDONED`] once the watchdog gave it up.
    pub since_ns: AtomicU64,
    pub source: AtomicU32,
    /// Number of the thread, see [`crate::pool::thread_number`].
    pub thread: AtomicU32,
    pub seq: AtomicU64,
    pub capture_ns: AtomicU64,
}

impl Busy {
    #[inline]
    pub fn begin(&self, tick: &Tick, start_ns: u64) {
        self.source.store(tick.source, Ordering::Relaxed);
        self.seq.store(tick.seq, Ordering::Relaxed);
        self.capture_ns.store(tick.capture_ns as u64, Ordering::Relaxed);
        self.thread.store(crate::pool::thread_number(), Ordering::Relaxed);
        self.since_ns.store(start_ns.max(1), Ordering::Release);
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
            source: self.source.load(Ordering::Relaxed),
            flags: 0,
            seq: self.seq.load(Ordering::Relaxed),
            capture_ns: self.capture_ns.load(Ordering::Relaxed) as i64,
        }
    }
}

/// The instance and what a call needs; owned by whoever runs the node.
pub(crate) struct Exec {
    pub instance: Instance,
    pub inputs: Vec<FrameRef>,
    pub ranges: Vec<PortRange>,
    /// What the node made, as the host knows it.
    pub outputs: Vec<Frame>,
    /// The same as the node sees it; never believed.
    pub shown: Vec<Frame>,
    /// Size of each output when it was last made.
    pub sizes: Vec<(u32, u32)>,
    pub failure: String,
    pub snapshot: Arc<Snapshot>,
    pub bypassed: bool,
    /// In batch: calls to leave out before the node is opened again.
    pub skip_calls: u32,
    pub failures_in_a_row: u32,
    pub silent_calls: u32,
    pub bad_in_a_row: u32,
    /// When the last failure was, until a call goes well; 0 for none.
    pub failed_at_ns: u64,
    pub last_fired_ns: Option<i64>,
}

impl Exec {
    pub fn new(
        node_type: &'static abi::NodeType,
        slots: usize,
        ranges: Vec<PortRange>,
        snapshot: Arc<Snapshot>,
    ) -> Box<Self> {
        Box::new(Self {
            instance: Instance::none(node_type),
            inputs: Vec::with_capacity(slots),
            ranges,
            outputs: vec![Frame::EMPTY; node_type.outputs_len],
            shown: vec![Frame::EMPTY; node_type.outputs_len],
            sizes: vec![(0, 0); node_type.outputs_len],
            failure: String::new(),
            snapshot,
            bypassed: false,
            skip_calls: 0,
            failures_in_a_row: 0,
            silent_calls: 0,
            bad_in_a_row: 0,
            failed_at_ns: 0,
            last_fired_ns: None,
        })
    }
}

impl Drop for Exec {
    fn drop(&mut self) {
        clear(&mut self.outputs);
    }
}

/// Gives back what stands in the outputs.
pub(crate) fn clear(outputs: &mut [Frame]) {
    for frame in outputs {
        drop(FrameRef::adopt(std::mem::replace(frame, Frame::EMPTY)));
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
