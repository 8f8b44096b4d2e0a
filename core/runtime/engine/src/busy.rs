//! The running call of a node, as the watchdog sees it.

use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

use panoscope_abi::Tick;

/// Start time of a call that the watchdog abandoned.
pub(crate) const ABANDONED: u64 = u64::MAX;

/// Purpose of a call of a plugin.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum CallKind {
    /// A tick.
    #[default]
    Process,
    /// Check of its parameters.
    Check,
    Open,
    /// Completion of its output.
    Finish,
    Close,
    SaveState,
    LoadState,
}

impl CallKind {
    const ALL: [CallKind; 7] = [
        CallKind::Process,
        CallKind::Check,
        CallKind::Open,
        CallKind::Finish,
        CallKind::Close,
        CallKind::SaveState,
        CallKind::LoadState,
    ];

    /// The end of a message that begins with "it did not return".
    pub fn return_words(self) -> &'static str {
        match self {
            CallKind::Process => "",
            CallKind::Check => " from checking its parameters",
            CallKind::Open => " from opening",
            CallKind::Finish => " from completing its output",
            CallKind::Close => " from closing",
            CallKind::SaveState => " from saving its state",
            CallKind::LoadState => " from taking over a state",
        }
    }

    /// The end of a message that begins with "while it".
    pub fn while_words(self) -> &'static str {
        match self {
            CallKind::Process => "processed",
            CallKind::Check => "was checked",
            CallKind::Open => "was opened",
            CallKind::Finish => "was asked to complete its output",
            CallKind::Close => "was closed",
            CallKind::SaveState => "was asked for its state",
            CallKind::LoadState => "was given a state",
        }
    }
}

/// The watchdog abandoned a call: its thread returns without touching anything.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Abandoned;

/// The running call as the watchdog sees it.
#[derive(Default)]
pub(crate) struct Busy {
    /// Start of the call in ns of the host's clock; 0 when idle, [`ABANDONED`] once the watchdog abandoned it.
    pub since_ns: AtomicU64,
    /// The tick's source; the bits from [`Self::KIND_BITS`] on hold a [`CallKind`].
    source: AtomicU32,
    /// Number of the thread, see [`crate::thread_id`].
    pub thread: AtomicU32,
    seq: AtomicU64,
    capture_ns: AtomicU64,
}

impl Busy {
    /// Source numbers need fewer bits.
    const KIND_BITS: u32 = 28;

    /// Begins a call for a tick.
    #[inline]
    pub fn begin(&self, tick: &Tick, start_ns: u64) {
        self.begin_kind(CallKind::Process, tick, start_ns);
    }

    /// Begins another kind of call, at a tick.
    #[inline]
    pub fn begin_kind(&self, kind: CallKind, tick: &Tick, start_ns: u64) {
        self.source.store(tick.source | (kind as u32) << Self::KIND_BITS, Ordering::Relaxed);
        self.seq.store(tick.seq, Ordering::Relaxed);
        self.capture_ns.store(tick.capture_ns as u64, Ordering::Relaxed);
        self.thread.store(crate::thread_id::current(), Ordering::Relaxed);
        self.since_ns.store(start_ns.max(1), Ordering::Release);
    }

    /// The kind of the call. Like [`Self::tick`] and `thread`, it belongs to the call whose start was read before only
    /// if [`Self::abandon`] succeeds with that start.
    pub fn kind(&self) -> CallKind {
        let number = (self.source.load(Ordering::Relaxed) >> Self::KIND_BITS) as usize;
        CallKind::ALL.get(number).copied().unwrap_or_default()
    }

    /// Ends the call that began at `start_ns`. Returns `false` if the watchdog abandoned it; another call, with another
    /// start, may be running by now.
    #[inline]
    pub fn end(&self, start_ns: u64) -> bool {
        self.since_ns.compare_exchange(start_ns.max(1), 0, Ordering::AcqRel, Ordering::Relaxed).is_ok()
    }

    /// Allows calls again after one that was abandoned.
    pub fn clear(&self) {
        self.since_ns.store(0, Ordering::Release);
    }

    /// Abandons the call that began at `since_ns`; `false` if it has ended.
    pub fn abandon(&self, since_ns: u64) -> bool {
        self.since_ns.compare_exchange(since_ns, ABANDONED, Ordering::AcqRel, Ordering::Relaxed).is_ok()
    }

    pub fn tick(&self) -> Tick {
        Tick {
            source: self.source.load(Ordering::Relaxed) & ((1 << Self::KIND_BITS) - 1),
            flags: 0,
            seq: self.seq.load(Ordering::Relaxed),
            capture_ns: self.capture_ns.load(Ordering::Relaxed) as i64,
        }
    }
}
