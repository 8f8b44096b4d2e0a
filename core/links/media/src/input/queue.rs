//! A bounded queue between a pipeline's thread and its reader.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Wakes a thread that waits for several inputs.
#[derive(Debug, Default)]
pub struct Signal {
    changes: Mutex<u64>,
    changed: Condvar,
}

impl Signal {
    /// Number of changes so far, for [`Self::wait`].
    pub fn changes(&self) -> u64 {
        *locked(&self.changes)
    }

    /// Reports a change and wakes all waiting threads.
    pub fn notify(&self) {
        *locked(&self.changes) += 1;
        self.changed.notify_all();
    }

    /// Waits until there are more than `seen` changes, at most for `limit`.
    pub fn wait(&self, seen: u64, limit: Duration) {
        let guard = locked(&self.changes);
        drop(self.changed.wait_timeout_while(guard, limit, |changes| *changes == seen));
    }
}

/// Behaviour of a full queue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Policy {
    /// The oldest one is dropped and counted: the newest wins.
    NewestWins,
    /// None: the pipeline waits.
    Lossless,
}

/// One entry: a frame, or a mark that it is damaged.
#[derive(Debug)]
pub struct Item<T> {
    /// Number since the pipeline started, from 1; dropped and damaged frames are counted.
    pub number: u64,
    /// Presentation time in the stream, ns.
    pub pts_ns: Option<i64>,
    /// Arrival at this machine, ns of `CLOCK_MONOTONIC`.
    pub arrived_ns: i64,
    /// The item that the reader made from the sample.
    pub content: T,
}

/// Reason why no further frame follows.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum End {
    /// The source has ended.
    EndOfStream,
    /// The pipeline has failed; what its element reported.
    Failed(String),
}

#[derive(Debug)]
struct State<T> {
    items: VecDeque<Item<T>>,
    pushed: u64,
    dropped: u64,
    end: Option<End>,
    policy: Policy,
    is_closed: bool,
    is_refusing: bool,
}

/// The queue.
#[derive(Debug)]
pub struct Queue<T> {
    state: Mutex<State<T>>,
    space: Condvar,
    filled: Condvar,
    capacity: usize,
}

impl<T> Queue<T> {
    /// An empty queue for `capacity` images.
    pub fn new(policy: Policy, capacity: usize) -> Self {
        let state = State {
            items: VecDeque::new(),
            pushed: 0,
            dropped: 0,
            end: None,
            policy,
            is_closed: false,
            is_refusing: false,
        };
        Self { state: Mutex::new(state), space: Condvar::new(), filled: Condvar::new(), capacity }
    }

    /// Appends an image. Returns `false` once the queue is closed.
    pub fn push(&self, pts_ns: Option<i64>, arrived_ns: i64, content: T) -> bool {
        let mut state = locked(&self.state);
        let must_wait = |state: &mut State<T>| {
            let is_full = state.policy == Policy::Lossless && state.items.len() >= self.capacity;
            is_full && !state.is_closed && !state.is_refusing
        };
        state = self.space.wait_while(state, must_wait).unwrap_or_else(PoisonError::into_inner);
        if state.is_closed {
            return false;
        }
        if state.is_refusing {
            return true;
        }
        if state.items.len() >= self.capacity {
            state.items.pop_front();
            state.dropped += 1;
        }
        state.pushed += 1;
        let number = state.pushed;
        state.items.push_back(Item { number, pts_ns, arrived_ns, content });
        self.filled.notify_all();
        true
    }

    /// Sets the behaviour of a full queue.
    pub fn set_policy(&self, policy: Policy) {
        locked(&self.state).policy = policy;
        self.space.notify_all();
    }

    /// While set, frames are discarded without waiting and without being counted.
    pub fn refuse(&self, is_refusing: bool) {
        locked(&self.state).is_refusing = is_refusing;
        self.space.notify_all();
    }

    /// Reports the end; the first report stays.
    pub fn end(&self, end: End) {
        locked(&self.state).end.get_or_insert(end);
        self.filled.notify_all();
    }

    /// The end, once it has been reported; images may still wait.
    pub fn ended(&self) -> Option<End> {
        locked(&self.state).end.clone()
    }

    /// Releases the pipeline's thread; no further image is taken.
    pub fn close(&self) {
        let mut state = locked(&self.state);
        state.is_closed = true;
        state.items.clear();
        self.space.notify_all();
    }

    /// Drops waiting frames, clears the end, and numbers the next frame `pushed + 1`.
    pub fn restart(&self, pushed: u64) {
        let mut state = locked(&self.state);
        state.items.clear();
        (state.pushed, state.end) = (pushed, None);
        self.space.notify_all();
    }

    /// Waits until there is an image or the end, at most for `limit`. Returns whether there is.
    pub fn wait(&self, limit: Duration) -> bool {
        let state = locked(&self.state);
        let is_idle = |state: &mut State<T>| state.items.is_empty() && state.end.is_none();
        let (state, _) = self.filled.wait_timeout_while(state, limit, is_idle).unwrap_or_else(PoisonError::into_inner);
        !state.items.is_empty() || state.end.is_some()
    }

    /// Waits until there is an image, at most for `limit`; returns whether there is.
    pub fn wait_for_item(&self, limit: Duration) -> bool {
        self.wait(limit);
        !locked(&self.state).items.is_empty()
    }

    /// The oldest image, waiting for it at most for `limit`; `None` at the end or after the limit.
    pub fn pop(&self, limit: Duration) -> Option<Item<T>> {
        let begin = Instant::now();
        self.wait(limit.saturating_sub(begin.elapsed()));
        let item = locked(&self.state).items.pop_front();
        self.space.notify_all();
        item
    }

    /// Arrival times of the waiting images, oldest first, ns of `CLOCK_MONOTONIC`.
    pub fn arrivals(&self, out: &mut Vec<i64>) {
        out.clear();
        out.extend(locked(&self.state).items.iter().map(|item| item.arrived_ns));
    }

    /// Removes all images that arrived before `time_ns`; returns how many.
    pub fn discard_before(&self, time_ns: i64) -> u64 {
        let mut state = locked(&self.state);
        let count = state.items.iter().take_while(|item| item.arrived_ns < time_ns).count();
        state.items.drain(..count);
        self.space.notify_all();
        count as u64
    }

    /// Number of frames received from the pipeline.
    pub fn pushed(&self) -> u64 {
        locked(&self.state).pushed
    }

    /// Images that a full queue dropped.
    pub fn dropped(&self) -> u64 {
        locked(&self.state).dropped
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;

    #[test]
    fn a_live_queue_drops_the_oldest_and_counts_it() {
        let queue = Queue::new(Policy::NewestWins, 2);
        for index in 0..5 {
            assert!(queue.push(None, index, index));
        }
        assert_eq!((queue.pushed(), queue.dropped()), (5, 3));
        let item = queue.pop(Duration::ZERO).map(|item| (item.number, item.content));
        assert_eq!(item, Some((4, 3)));
        assert_eq!(queue.discard_before(5), 1);
        queue.end(End::EndOfStream);
        queue.end(End::Failed("later".to_owned()));
        assert_eq!((queue.pop(Duration::from_secs(60)).is_none(), queue.ended()), (true, Some(End::EndOfStream)));
    }

    #[test]
    fn a_lossless_queue_makes_its_writer_wait_until_it_is_closed() {
        let queue = Arc::new(Queue::new(Policy::Lossless, 2));
        let writer = {
            let queue = queue.clone();
            std::thread::spawn(move || (0..100).take_while(|index| queue.push(None, *index, *index)).count())
        };
        for index in 0..50 {
            assert_eq!(queue.pop(Duration::from_secs(60)).map(|item| item.content), Some(index));
        }
        queue.close();
        let written = writer.join().expect("the writer");
        assert!((50..=52).contains(&written), "{written}");
        assert_eq!(queue.dropped(), 0);
    }

    #[test]
    fn a_signal_wakes_its_waiter() {
        let signal = Arc::new(Signal::default());
        let seen = signal.changes();
        let other = signal.clone();
        let thread = std::thread::spawn(move || other.notify());
        signal.wait(seen, Duration::from_secs(60));
        assert_eq!(signal.changes(), seen + 1);
        thread.join().expect("the notifier");
    }
}
