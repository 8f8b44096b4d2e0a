//! Looking at a port of a running graph without slowing it.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, Weak};

use panoscope_abi::Frame;

use crate::memory::FrameRef;
use crate::sync::lock;

/// Hears each packet of a port, on the thread that made it: it must be quick.
pub type HearFn = dyn Fn(&FrameRef) + Send + Sync;

/// A port that is listened to from the first tick on; see [`crate::Options::listen`].
#[derive(Clone)]
pub struct Listener {
    /// The node.
    pub node: String,
    /// Its output.
    pub output: String,
    /// What is done with each packet that is not empty.
    pub hear: Arc<HearFn>,
}

/// Hears each number that a node tells, on the thread that tells it: tick, name, value.
pub type HearNumberFn = dyn Fn(&panoscope_abi::Tick, &str, f64) + Send + Sync;

/// A node whose told numbers are heard from the first tick on; see [`crate::Options::numbers`].
#[derive(Clone)]
pub struct NumberListener {
    /// The node.
    pub node: String,
    /// What is done with each number.
    pub hear: Arc<HearNumberFn>,
}

/// Where a port's packets go.
struct Place {
    newest: Mutex<Option<FrameRef>>,
    hear: Option<Arc<HearFn>>,
}

/// The newest packet of a port; older ones are forgotten. At most two frames are kept alive: the one here and the
/// one its reader looks at.
pub struct Preview {
    place: Arc<Place>,
}

impl Preview {
    /// The newest packet since the last call.
    pub fn take(&self) -> Option<FrameRef> {
        lock(&self.place.newest).take()
    }
}

/// Previews of one node's outputs. The count comes first: it is looked at with every call.
#[repr(C)]
pub(crate) struct Subscribers {
    active: AtomicUsize,
    ports: Mutex<Vec<Vec<Weak<Place>>>>,
}

impl Subscribers {
    pub fn new(outputs: usize) -> Self {
        Self { active: AtomicUsize::new(0), ports: Mutex::new(vec![Vec::new(); outputs]) }
    }

    /// Adds a reader of output `port`.
    pub fn subscribe(&self, port: usize) -> Option<Preview> {
        self.add(port, None)
    }

    /// Adds one that hears every packet of output `port` for as long as the answer is kept.
    pub fn listen(&self, port: usize, hear: Arc<HearFn>) -> Option<Preview> {
        self.add(port, Some(hear))
    }

    fn add(&self, port: usize, hear: Option<Arc<HearFn>>) -> Option<Preview> {
        let place = Arc::new(Place { newest: Mutex::new(None), hear });
        let mut ports = lock(&self.ports);
        ports.get_mut(port)?.push(Arc::downgrade(&place));
        self.active.fetch_add(1, Ordering::Relaxed);
        Some(Preview { place })
    }

    /// Which outputs are looked at, one bit each.
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

    /// Shows the outputs of a tick to the readers.
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
                let Some(place) = reader.upgrade() else {
                    self.active.fetch_sub(1, Ordering::Relaxed);
                    return false;
                };
                if !frame.is_empty() {
                    // SAFETY: the reference stays with the outputs: this one is never dropped.
                    let borrowed = std::mem::ManuallyDrop::new(unsafe { FrameRef::adopt(*frame) });
                    match &place.hear {
                        Some(hear) => hear(&borrowed),
                        None => *lock(&place.newest) = Some(FrameRef::clone(&borrowed)),
                    }
                }
                true
            });
        }
    }
}
