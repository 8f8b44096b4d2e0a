//! A queue that passes all packets of some outputs to one reader outside the graph, on a thread of the caller.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

use crate::clock;
use crate::memory::FrameRef;
use crate::preview::Listener;
use crate::sync::lock;

/// A packet of an output.
pub struct Heard {
    /// Position of the output among those that are listened to.
    pub port: u32,
    /// The packet itself.
    pub frame: FrameRef,
    /// When it was made, of [`clock::now_ns`].
    pub made_ns: u64,
}

/// Behaviour if the queue is full.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Full {
    /// The node waits: no packet is lost.
    Wait,
    /// The oldest packet is dropped and counted.
    Drop,
}

#[derive(Default)]
struct State {
    packets: VecDeque<Heard>,
    dropped: u64,
    /// Whether nodes never wait for room: see [`Inbox::without_limit`].
    is_unlimited: bool,
}

/// A queue from the engine's threads to one reader.
pub struct Inbox {
    state: Mutex<State>,
    changed: Condvar,
    most: usize,
    full: Full,
}

impl Inbox {
    /// A queue for `most` packets.
    pub fn new(most: usize, full: Full) -> Self {
        Self { state: Mutex::default(), changed: Condvar::new(), most, full }
    }

    /// Listeners that put the packets of these outputs (node, output) into the queue.
    pub fn listeners(self: &Arc<Self>, outputs: &[(String, String)]) -> Vec<Listener> {
        let listener = |(port, (node, output)): (usize, &(String, String))| {
            let inbox = Arc::clone(self);
            let hear = move |frame: &FrameRef| inbox.hear(port as u32, frame);
            Listener { node: node.clone(), output: output.clone(), hear: Arc::new(hear) }
        };
        outputs.iter().enumerate().map(listener).collect()
    }

    /// Queues a packet of a node, on the node's thread.
    fn hear(&self, port: u32, frame: &FrameRef) {
        let heard = Heard { port, frame: frame.clone(), made_ns: clock::now_ns() };
        let mut state = lock(&self.state);
        while !state.is_unlimited && state.packets.len() >= self.most {
            if self.full == Full::Drop {
                state.packets.pop_front();
                state.dropped += 1;
            } else {
                state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
            }
        }
        state.packets.push_back(heard);
        drop(state);
        self.changed.notify_all();
    }

    /// Takes all packets; waits up to `most` for the first one.
    pub fn take(&self, most: Duration) -> VecDeque<Heard> {
        let until = Instant::now() + most;
        let mut state = lock(&self.state);
        while state.packets.is_empty() {
            let Some(left) = until.checked_duration_since(Instant::now()).filter(|left| !left.is_zero()) else { break };
            state = self.changed.wait_timeout(state, left).unwrap_or_else(PoisonError::into_inner).0;
        }
        let packets = std::mem::take(&mut state.packets);
        drop(state);
        self.changed.notify_all();
        packets
    }

    /// Packets that were dropped because nobody took them.
    pub fn dropped(&self) -> u64 {
        lock(&self.state).dropped
    }

    /// Runs `work`, which waits for the graph, with an unlimited queue: a node that waited for room would wait for this
    /// thread.
    pub fn without_limit<R>(&self, work: impl FnOnce() -> R) -> R {
        self.lift(true);
        let done = work();
        self.lift(false);
        done
    }

    fn lift(&self, is_unlimited: bool) {
        lock(&self.state).is_unlimited = is_unlimited;
        self.changed.notify_all();
    }

    /// Ends all waits for room, because the run ends.
    pub fn close(&self) {
        self.lift(true);
    }
}

#[cfg(test)]
mod tests {
    use panoscope_abi::Tick;

    use super::*;

    fn packet(seq: u64) -> FrameRef {
        FrameRef::empty(Tick { seq, ..Tick::default() })
    }

    fn seqs(packets: VecDeque<Heard>) -> Vec<u64> {
        packets.into_iter().map(|heard| heard.frame.tick().seq).collect()
    }

    #[test]
    fn a_full_queue_drops_the_oldest_or_makes_the_node_wait() {
        let live = Inbox::new(2, Full::Drop);
        (0..5).for_each(|seq| live.hear(0, &packet(seq)));
        assert_eq!((seqs(live.take(Duration::ZERO)), live.dropped()), (vec![3, 4], 3));
        let batch = Arc::new(Inbox::new(2, Full::Wait));
        let node = Arc::clone(&batch);
        let node = std::thread::spawn(move || (0..5).for_each(|seq| node.hear(0, &packet(seq))));
        let mut all = Vec::new();
        while all.len() < 5 {
            all.extend(seqs(batch.take(Duration::from_secs(5))));
        }
        node.join().expect("no panic");
        assert_eq!((all, batch.dropped()), (vec![0, 1, 2, 3, 4], 0));
    }

    #[test]
    fn nobody_waits_for_room_while_a_change_waits_for_the_node() {
        let inbox = Arc::new(Inbox::new(1, Full::Wait));
        let node = Arc::clone(&inbox);
        inbox.hear(0, &packet(0));
        let node = std::thread::spawn(move || node.hear(0, &packet(1)));
        inbox.without_limit(|| node.join().expect("no panic"));
        assert_eq!(seqs(inbox.take(Duration::ZERO)), [0, 1]);
    }
}
