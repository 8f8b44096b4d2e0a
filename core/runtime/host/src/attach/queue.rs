//! Frames that wait for a reader that may be slow or stuck: of each state only the newest waits, and the queue has a
//! limit.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex};

use panoscope_engine::sync::lock;

use crate::attach::message;
use crate::attach::tunnel::Frame;

/// Maximum number of frames that wait. A reader that is further behind counts as gone.
const MAX_FRAMES: usize = 4096;
const MAX_BYTES: usize = 128 << 20;

/// The queue is full: the reader is too slow.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("it does not read its messages: {frames} with {bytes} bytes wait")]
pub struct Full {
    /// Frames that wait.
    pub frames: usize,
    /// Their bytes.
    pub bytes: usize,
}

#[derive(Default)]
struct Waiting {
    frames: VecDeque<Frame>,
    bytes: usize,
    is_closed: bool,
}

/// A queue of frames between threads.
#[derive(Default)]
pub struct Queue {
    waiting: Mutex<Waiting>,
    changed: Condvar,
}

impl Queue {
    /// Adds a frame. A state, such as the counters of all nodes, replaces the same state if it still waits. A closed
    /// queue accepts nothing.
    ///
    /// # Errors
    /// The reader is too far behind; the frame is not added.
    pub fn push(&self, frame: Frame) -> Result<(), Full> {
        let mut waiting = lock(&self.waiting);
        if waiting.is_closed {
            return Ok(());
        }
        if let Some(state) = message::state_of(&frame) {
            let is_same = |old: &&mut Frame| old.session == frame.session && message::state_of(old) == Some(state);
            if let Some(old) = waiting.frames.iter_mut().find(is_same) {
                let new_bytes = frame.bytes.len();
                let old_bytes = std::mem::replace(old, frame).bytes.len();
                waiting.bytes = waiting.bytes - old_bytes + new_bytes;
                return Ok(());
            }
        }
        let (frames, bytes) = (waiting.frames.len(), waiting.bytes);
        // One frame always has room.
        if frames >= MAX_FRAMES || (frames > 0 && bytes + frame.bytes.len() > MAX_BYTES) {
            return Err(Full { frames, bytes });
        }
        waiting.bytes += frame.bytes.len();
        waiting.frames.push_back(frame);
        drop(waiting);
        self.changed.notify_one();
        Ok(())
    }

    /// The next frame; waits for one. `None` once the queue is closed and empty.
    pub fn pop(&self) -> Option<Frame> {
        let mut waiting = lock(&self.waiting);
        loop {
            if let Some(frame) = waiting.frames.pop_front() {
                waiting.bytes -= frame.bytes.len();
                return Some(frame);
            }
            if waiting.is_closed {
                return None;
            }
            waiting = self.changed.wait(waiting).unwrap_or_else(std::sync::PoisonError::into_inner);
        }
    }

    /// Closes the queue; frames that wait are still read.
    pub fn close(&self) {
        lock(&self.waiting).is_closed = true;
        self.changed.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::attach::message::{Message, write_message};
    use crate::attach::tunnel::Kind;

    fn frame(session: u32, message: &Message) -> Frame {
        Frame { kind: Kind::Data, session, bytes: write_message(message) }
    }

    fn values(node: &str) -> Message {
        Message::Values(BTreeMap::from([(node.to_owned(), Vec::new())]))
    }

    #[test]
    fn of_a_state_only_the_newest_waits() {
        let queue = Queue::default();
        let ended = Message::Ended { words: "over".to_owned() };
        for number in 0..100_000 {
            queue.push(frame(1, &values(&number.to_string()))).expect("room");
            queue.push(frame(1, &Message::Faults(Vec::new()))).expect("room");
        }
        queue.push(frame(2, &values("other"))).expect("room");
        queue.push(frame(1, &ended)).expect("room");
        queue.push(frame(1, &values("last"))).expect("room");
        queue.close();
        queue.push(frame(1, &ended)).expect("nothing is added");
        let expected = [
            frame(1, &values("last")),
            frame(1, &Message::Faults(Vec::new())),
            frame(2, &values("other")),
            frame(1, &ended),
        ];
        let all: Vec<Frame> = std::iter::from_fn(|| queue.pop()).collect();
        assert_eq!(all, expected);
    }

    #[test]
    fn a_reader_that_never_reads_is_found() {
        let answer = |id| frame(1, &Message::Ran { id, result: Ok(String::new()) });
        let queue = Queue::default();
        let pushed = (0..).map_while(|id| queue.push(answer(id)).ok()).count();
        assert_eq!(pushed, MAX_FRAMES);
        assert!(queue.pop().is_some() && queue.push(answer(0)).is_ok(), "room again");
        // Large ones.
        let queue = Queue::default();
        let packet = || Frame { kind: Kind::Data, session: 1, bytes: vec![b'P'; MAX_BYTES / 4] };
        let pushed = (0..100).map_while(|_| queue.push(packet()).ok()).count();
        assert_eq!(pushed, 4);
    }
}
