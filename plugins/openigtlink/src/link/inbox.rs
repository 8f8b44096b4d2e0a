//! Received messages that wait for a node.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

use panoscope_igtl::Raw;

use super::lock;

/// Maximum number of waiting large messages per device.
const MAX_LARGE: usize = 2;
/// Size from which a message counts as large.
const LARGE_BYTES: usize = 64 << 10;

/// Which messages a node takes.
#[derive(Clone, Debug, Default)]
pub struct Filter {
    /// Device name; empty for all.
    pub device: String,
}

/// A message as it arrived.
#[derive(Debug)]
pub struct Received {
    /// Message type.
    pub kind: String,
    /// Device name.
    pub device: String,
    /// Header and body; the CRC has been checked.
    pub bytes: Vec<u8>,
    /// When its last byte was received.
    pub arrived: Instant,
    /// The same by the system's clock, ns since 1970.
    pub arrived_utc_ns: i128,
}

#[derive(Default)]
struct State {
    messages: VecDeque<Received>,
    is_closed: bool,
}

/// A queue of messages. When it is full, the connection waits in batch mode; in live mode the oldest message of the same device is dropped.
pub struct Inbox {
    filter: Filter,
    most: usize,
    is_batch: bool,
    state: Mutex<State>,
    changed: Condvar,
    dropped: AtomicU64,
    /// Bit set of the wanted entries of [`panoscope_igtl::message::KINDS`].
    wanted: AtomicUsize,
}

impl Inbox {
    /// A queue of at most `most` messages per device.
    pub fn new(filter: Filter, most: usize, is_batch: bool) -> Self {
        let (state, changed, dropped) = (Mutex::default(), Condvar::new(), AtomicU64::new(0));
        Self { filter, most: most.max(1), is_batch, state, changed, dropped, wanted: AtomicUsize::new(usize::MAX) }
    }

    /// Sets which message types are accepted: a bit set of the entries of [`panoscope_igtl::message::KINDS`].
    pub fn set_wanted(&self, kinds: usize) {
        self.wanted.store(kinds, Ordering::Relaxed);
    }

    /// Number of messages dropped because the graph was slow.
    pub fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// Adds a message if the node accepts it.
    pub fn offer(&self, raw: &Raw<'_>, arrived: Instant, arrived_utc_ns: i128) {
        let header = &raw.header;
        let index = panoscope_igtl::message::KINDS.iter().position(|kind| *kind == header.kind);
        let is_wanted = index.is_some_and(|index| self.wanted.load(Ordering::Relaxed) >> index & 1 == 1);
        if !is_wanted || !(self.filter.device.is_empty() || self.filter.device == header.device) {
            return;
        }
        let most = if raw.bytes.len() >= LARGE_BYTES { self.most.min(MAX_LARGE) } else { self.most };
        let is_same = |message: &Received| message.kind == header.kind && message.device == header.device;
        let mut state = lock(&self.state);
        while state.messages.iter().filter(|message| is_same(message)).count() >= most {
            if state.is_closed {
                return;
            }
            if self.is_batch {
                state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
            } else if let Some(oldest) = state.messages.iter().position(is_same) {
                state.messages.remove(oldest);
                self.dropped.fetch_add(1, Ordering::Relaxed);
            }
        }
        if state.is_closed {
            return;
        }
        let (kind, device) = (header.kind.to_string(), header.device.to_string());
        state.messages.push_back(Received { kind, device, bytes: raw.bytes.to_vec(), arrived, arrived_utc_ns });
        drop(state);
        self.changed.notify_all();
    }

    /// Takes the oldest message. Waits up to `limit`, and returns early when a connection ends.
    pub fn take(&self, limit: Duration) -> Option<Received> {
        let mut state = lock(&self.state);
        if state.messages.is_empty() && !state.is_closed {
            state = self.changed.wait_timeout(state, limit).unwrap_or_else(PoisonError::into_inner).0;
        }
        let message = state.messages.pop_front();
        drop(state);
        if self.is_batch {
            self.changed.notify_all();
        }
        message
    }

    /// Wakes threads that wait in [`Self::take`].
    pub fn wake(&self) {
        self.changed.notify_all();
    }

    /// Accepts no more messages.
    pub fn close(&self) {
        lock(&self.state).is_closed = true;
        self.changed.notify_all();
    }
}

impl Drop for Inbox {
    fn drop(&mut self) {
        self.close();
    }
}
