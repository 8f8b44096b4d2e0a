//! The instance of a node and the state of its calls, owned by one thread at a time.

use std::ffi::c_void;
use std::sync::Arc;
use std::sync::atomic::{AtomicPtr, Ordering};

use panoscope_abi::{self as abi, PortRange};

use crate::decide::Ages;
use crate::instance::Instance;
use crate::outputs::OutputRule;
use crate::params::Snapshot;
use crate::rate::Rate;
use crate::stats::Histogram;

/// An output, for the checks after a call.
#[derive(Clone, Copy)]
pub(crate) struct Port {
    pub formats: u32,
    /// Size when it was last made, [`Port::NEVER`] before.
    pub width: u32,
    pub height: u32,
    /// Formats whose contents are checked, one bit each, see [`OutputRule::inspect`].
    pub inspected: u32,
}

impl Port {
    /// Width and height of an output that was not made yet.
    pub const NEVER: (u32, u32) = (u32::MAX, u32::MAX);

    fn new(formats: u32, inspected: u32) -> Self {
        Self { formats, width: Self::NEVER.0, height: Self::NEVER.1, inspected }
    }
}

/// The instance and the state of its calls; owned by the thread that runs the node. Fields are in order of use: those
/// that every call touches lie in the first two cache lines.
#[repr(C, align(64))]
pub(crate) struct Exec {
    pub instance: Instance,
    pub process: ProcessFn,
    params: *const abi::ParamValue,
    params_len: usize,
    pub params_version: u64,
    /// The node's configuration epoch that this copy of its settings belongs to.
    pub config_epoch: u64,
    pub time: Arc<Histogram>,
    pub max_ns: u64,
    first: Port,
    pub outputs_len: u32,
    pub source: bool,
    /// Whether the node fetches frames from the GPU before it reads them.
    pub fetches: bool,
    pub bypassed: bool,
    /// Whether one of the counts of faults below is not 0.
    pub troubled: bool,
    /// Whether there is a rate or a budget.
    pub limited: bool,
    // A successful call of a node with one output and no limits touches nothing below.
    more: Box<[Port]>,
    pub rate: Rate,
    pub budget_ns: u64,
    pub ranges: Vec<PortRange>,
    pub failure: String,
    snapshot: Arc<Snapshot>,
    /// In batch: calls to skip before the node reopens.
    pub skip_calls: u32,
    pub failures_in_a_row: u32,
    pub silent_calls: u32,
    pub bad_in_a_row: u32,
    pub times: CallTimes,
    /// Time of the last failure, until a call succeeds; 0 for none.
    pub failed_at_ns: u64,
}

/// The times of one call. Between two calls only the arrival that a source declared is kept.
#[derive(Default)]
pub(crate) struct CallTimes {
    /// The moment for which ages are given, once one was asked for.
    pub now_ns: Option<i64>,
    /// Inputs whose time was asked for, one bit each.
    pub asked: u64,
    /// Results of the recorded run, in a replay.
    pub recorded: Option<Box<Ages>>,
    /// Lag that the node declared for its outputs, as [`Tick::flags`].
    pub lag: u32,
    /// For a source: arrival of the tick, ns of the host's clock.
    pub arrived_ns: Option<i64>,
}

impl CallTimes {
    /// Takes the arrival that a source declared for the tick of its last call, ns of the host's clock.
    pub fn take_arrived_ns(&mut self) -> Option<i64> {
        self.arrived_ns.take()
    }
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
            config_epoch: 0,
            time,
            max_ns: 0,
            first: rules.first().map_or(first, port),
            outputs_len: rules.len() as u32,
            source: node_type.flags & abi::NODE_SOURCE != 0,
            fetches: node_type.flags & abi::NODE_FETCHES != 0,
            bypassed: false,
            troubled: true,
            limited: false,
            more: rules.iter().skip(1).map(port).collect(),
            rate: Rate::NONE,
            budget_ns: 0,
            ranges,
            failure: String::new(),
            snapshot,
            skip_calls: 0,
            failures_in_a_row: 0,
            silent_calls: 0,
            bad_in_a_row: 0,
            times: CallTimes::default(),
            failed_at_ns: 0,
        })
    }

    /// Output `index`, which must exist.
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

    /// Applies new values.
    pub fn set_snapshot(&mut self, snapshot: Arc<Snapshot>) {
        self.params = snapshot.values().as_ptr();
        self.params_len = snapshot.values().len();
        self.params_version = snapshot.version();
        self.snapshot = snapshot;
    }

    /// The current values, in the contract's layout.
    #[inline]
    pub fn params(&self) -> (*const abi::ParamValue, usize) {
        (self.params, self.params_len)
    }

    /// Prefetches the cache lines of a call that follows soon.
    #[inline]
    pub fn prefetch(this: *const Self) {
        prefetch(this.cast());
        prefetch(this.cast::<u8>().wrapping_add(64));
    }
}

/// Prefetches a cache line. Only a hint: any address is valid.
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

/// Holds the [`Exec`] while no thread runs the node. Taking it is one atomic swap.
pub(crate) struct ExecPlace(AtomicPtr<Exec>);

impl ExecPlace {
    pub fn new(exec: Box<Exec>) -> Self {
        Self(AtomicPtr::new(Box::into_raw(exec)))
    }

    /// The `Exec`, unless a thread runs the node.
    pub fn take(&self) -> Option<Box<Exec>> {
        let raw = self.0.swap(std::ptr::null_mut(), Ordering::Acquire);
        // SAFETY: only `new` and `put` store pointers, made by `into_raw`; the swap hands each to one caller.
        (!raw.is_null()).then(|| unsafe { Box::from_raw(raw) })
    }

    /// Puts back the `Exec` that was taken, or its replacement. Only the thread that took it may do so, or the watchdog
    /// on its behalf.
    pub fn put(&self, exec: Box<Exec>) {
        self.0.store(Box::into_raw(exec), Ordering::Release);
    }

    /// Calls `change` with the `Exec`; `None` if a thread runs the node.
    pub fn with<R>(&self, change: impl FnOnce(&mut Exec) -> R) -> Option<R> {
        let mut exec = self.take()?;
        let result = change(&mut exec);
        self.put(exec);
        Some(result)
    }

    /// Its address, for [`Exec::prefetch`].
    #[inline]
    pub fn address(&self) -> *const Exec {
        self.0.load(Ordering::Relaxed)
    }

    /// Whether no thread runs the node.
    pub fn is_home(&self) -> bool {
        !self.0.load(Ordering::Acquire).is_null()
    }
}

impl Drop for ExecPlace {
    fn drop(&mut self) {
        drop(self.take());
    }
}
