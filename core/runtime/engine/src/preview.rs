//! Subscriptions to ports of a running graph that do not slow it.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, Weak};

use panoscope_abi::{Frame, Tick};

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
    recent: Mutex<Recent>,
    hear: Option<Arc<HearFn>>,
}

/// The newest packets of a port, oldest first.
struct Recent {
    packets: VecDeque<FrameRef>,
    /// Maximum number of packets.
    keep: usize,
    /// Whether the newest one was not taken yet.
    is_new: bool,
}

impl Recent {
    fn push(&mut self, packet: FrameRef) {
        self.shrink(self.keep - 1);
        self.packets.push_back(packet);
        self.is_new = true;
    }

    fn shrink(&mut self, most: usize) {
        self.packets.drain(..self.packets.len().saturating_sub(most));
    }

    /// Removes the packets up to one of `tick` and returns that one.
    fn take_tick(&mut self, tick: Tick) -> Option<FrameRef> {
        let at = self.packets.iter().rposition(|packet| is_of(packet, tick))?;
        self.is_new = at + 1 < self.packets.len();
        self.packets.drain(..=at).next_back()
    }
}

fn is_of(packet: &FrameRef, tick: Tick) -> bool {
    (packet.tick().source, packet.tick().seq) == (tick.source, tick.seq)
}

/// The newest packets of a port: one, if not told otherwise by [`Self::keep`]. Its reader holds another one.
pub struct Preview {
    subscription: Arc<Subscription>,
}

impl Preview {
    /// The newest packet since the last call.
    pub fn take(&self) -> Option<FrameRef> {
        let mut recent = lock(&self.subscription.recent);
        if !std::mem::take(&mut recent.is_new) {
            return None;
        }
        if recent.keep > 1 { recent.packets.back().cloned() } else { recent.packets.pop_back() }
    }

    /// Keeps the newest `count` packets for [`Self::take_pair`], at least one.
    pub fn keep(&self, count: usize) {
        let mut recent = lock(&self.subscription.recent);
        recent.keep = count.max(1);
        let keep = recent.keep;
        recent.shrink(keep);
    }

    /// The kept packet of a tick; it and those before it are removed.
    pub fn take_tick(&self, tick: Tick) -> Option<FrameRef> {
        lock(&self.subscription.recent).take_tick(tick)
    }

    /// The newest packets of one tick that two outputs keep, since the last pair. A reader that takes the newest packet of each can miss such a
    /// tick for ever: outputs of one tick appear one after the other, and a reader may always look between them.
    pub fn take_pair(&self, other: &Self) -> Option<(FrameRef, FrameRef)> {
        // Never both locks at a time.
        let ticks: Vec<Tick> = lock(&other.subscription.recent).packets.iter().map(FrameRef::tick).collect();
        let mut recent = lock(&self.subscription.recent);
        let in_both = |packet: &&FrameRef| ticks.iter().any(|tick| is_of(packet, *tick));
        let tick = recent.packets.iter().rev().find(in_both)?.tick();
        let found = recent.take_tick(tick)?;
        drop(recent);
        Some((found, lock(&other.subscription.recent).take_tick(tick)?))
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
        let subscription = Arc::new(Subscription {
            recent: Mutex::new(Recent { packets: VecDeque::with_capacity(1), keep: 1, is_new: false }),
            hear,
        });
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
                        None => lock(&subscription.recent).push(FrameRef::clone(&borrowed)),
                    }
                }
                true
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A packet of one byte.
    fn packet(source: u32, seq: u64) -> FrameRef {
        let (buffer, data) = crate::memory::memory().allocate(1).expect("memory");
        let tick = Tick { source, seq, ..Tick::default() };
        // SAFETY: the one reference of a new buffer.
        unsafe { FrameRef::adopt(Frame { buffer, data, len: 1, tick, ..Frame::EMPTY }) }
    }

    fn seqs(pair: Option<(FrameRef, FrameRef)>) -> Option<(u64, u64)> {
        pair.map(|(a, b)| (a.tick().seq, b.tick().seq))
    }

    #[test]
    fn a_pair_is_of_one_tick_however_late_the_second_output_is() {
        let subscribers = Subscribers::new(2);
        let (a, b) = (subscribers.subscribe(0).expect("a port"), subscribers.subscribe(1).expect("a port"));
        a.keep(4);
        b.keep(4);
        let show = |a: FrameRef, b: FrameRef| subscribers.show(&[*a.frame(), *b.frame()]);
        // The second output is two ticks late, whenever a reader looks.
        for seq in 2..6 {
            show(packet(1, seq), packet(1, seq - 2));
        }
        assert_eq!(seqs(a.take_pair(&b)), Some((3, 3)));
        assert!(a.take_pair(&b).is_none(), "each tick once");
        // The newest one of each is offered too.
        assert_eq!(a.take().map(|packet| packet.tick().seq), Some(5));
        assert!(a.take().is_none(), "once");
        show(packet(1, 6), packet(1, 4));
        assert_eq!(seqs(b.take_pair(&a)), Some((4, 4)), "either way");
        show(packet(1, 6), packet(1, 5));
        show(packet(1, 7), packet(1, 6));
        assert_eq!(b.take_tick(packet(1, 5).tick()).map(|packet| packet.tick().seq), Some(5));
        // Another source has other ticks.
        show(packet(1, 7), packet(2, 7));
        show(packet(1, 8), packet(2, 8));
        show(packet(1, 9), packet(2, 9));
        show(packet(1, 10), packet(2, 10));
        assert!(a.take_pair(&b).is_none());
    }

    #[test]
    fn a_reader_that_keeps_one_packet_holds_no_more() {
        let subscribers = Subscribers::new(1);
        let preview = subscribers.subscribe(0).expect("a port");
        (0..3).for_each(|seq| subscribers.show(&[*packet(1, seq).frame()]));
        assert_eq!(lock(&preview.subscription.recent).packets.len(), 1);
        assert_eq!(preview.take().map(|packet| packet.tick().seq), Some(2));
        assert!(preview.take().is_none() && lock(&preview.subscription.recent).packets.is_empty());
    }
}
