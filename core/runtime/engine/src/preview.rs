//! Subscriptions to ports of a running graph that do not slow it.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, Weak};

use panoscope_abi::Frame;

use crate::memory::FrameRef;
use crate::sync::lock;

/// Receives each packet of a port, on the thread that made it, so it must be quick.
pub type HearFn = dyn Fn(&FrameRef) + Send + Sync;

/// A listener on a port from the first tick on; see [`crate::Options::listen`].
#[derive(Clone)]
pub struct Listener {
    /// The node.
    pub node: String,
    /// Its output.
    pub output: String,
    /// Receives each packet that is not empty.
    pub hear: Arc<HearFn>,
}

/// Receives each metric that a node reports, on the node's thread: tick, name, value.
pub type HearNumberFn = dyn Fn(&panoscope_abi::Tick, &str, f64) + Send + Sync;

/// A listener on the metrics of a node from the first tick on; see [`crate::Options::numbers`].
#[derive(Clone)]
pub struct NumberListener {
    /// The node.
    pub node: String,
    /// Receives each metric.
    pub hear: Arc<HearNumberFn>,
}

/// A target of a port's packets.
struct Subscription {
    newest: Mutex<Option<FrameRef>>,
    hear: Option<Arc<HearFn>>,
}

/// The newest packet of a port. Keeps at most two frames alive: the one here and the
/// one that its reader holds.
pub struct Preview {
    subscription: Arc<Subscription>,
}

impl Preview {
    /// The newest packet since the last call.
    pub fn take(&self) -> Option<FrameRef> {
        lock(&self.subscription.newest).take()
    }
}

/// Previews of one node's outputs. The count comes first, because every call reads it.
#[repr(C)]
pub(crate) struct Subscribers {
    active: AtomicUsize,
    ports: Mutex<Vec<Vec<Weak<Subscription>>>>,
}

impl Subscribers {
    pub fn new(outputs: usize) -> Self {
        Self { active: AtomicUsize::new(0), ports: Mutex::new(vec![Vec::new(); outputs]) }
    }

    /// Adds a reader of output `port`.
    pub fn subscribe(&self, port: usize) -> Option<Preview> {
        self.add(port, None)
    }

    /// Adds a listener to output `port`, active until the returned preview is dropped.
    pub fn listen(&self, port: usize, hear: Arc<HearFn>) -> Option<Preview> {
        self.add(port, Some(hear))
    }

    fn add(&self, port: usize, hear: Option<Arc<HearFn>>) -> Option<Preview> {
        let subscription = Arc::new(Subscription { newest: Mutex::new(None), hear });
        let mut ports = lock(&self.ports);
        ports.get_mut(port)?.push(Arc::downgrade(&subscription));
        self.active.fetch_add(1, Ordering::Relaxed);
        Some(Preview { subscription })
    }

    /// Outputs with a subscriber, one bit each.
    pub fn bits(&self) -> u64 {
        let ports = lock(&self.ports);
        let looked_at = ports.iter().enumerate().filter(|(_, readers)| readers.iter().any(|r| r.strong_count() > 0));
        looked_at.fold(0, |bits, (port, _)| bits | 1u64.checked_shl(port as u32).unwrap_or(0))
    }

    /// Takes over the readers of a node's predecessor.
    pub fn adopt(&self, old: &Subscribers) {
        let (mut to, mut from) = (lock(&self.ports), lock(&old.ports));
        let mut moved = 0;
        for (to, from) in to.iter_mut().zip(from.iter_mut()) {
            moved += from.len();
            to.append(from);
        }
        old.active.fetch_sub(moved, Ordering::Relaxed);
        self.active.fetch_add(moved, Ordering::Relaxed);
    }

    /// Passes the outputs of a tick to the subscribers.
    #[inline]
    pub fn show(&self, outputs: &[Frame]) {
        if self.active.load(Ordering::Relaxed) != 0 {
            self.show_all(outputs);
        }
    }

    #[cold]
    fn show_all(&self, outputs: &[Frame]) {
        let mut ports = lock(&self.ports);
        for (readers, frame) in ports.iter_mut().zip(outputs) {
            readers.retain(|reader| {
                let Some(subscription) = reader.upgrade() else {
                    self.active.fetch_sub(1, Ordering::Relaxed);
                    return false;
                };
                if !frame.is_empty() {
                    // SAFETY: the reference stays with the outputs; `ManuallyDrop` never releases this copy.
                    let borrowed = std::mem::ManuallyDrop::new(unsafe { FrameRef::adopt(*frame) });
                    match &subscription.hear {
                        Some(hear) => hear(&borrowed),
                        None => *lock(&subscription.newest) = Some(FrameRef::clone(&borrowed)),
                    }
                }
                true
            });
        }
    }
}
