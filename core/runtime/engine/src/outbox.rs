//! A bounded queue in front of a slow reader: a terminal that nobody reads, a full pipe, a disk. Writers never wait.
//! Items that find the queue full are counted, and the count takes their place.

use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crate::sync::lock;

/// Length of the queue; further items are skipped.
pub(crate) const MAX_WAITING: usize = 1024;
/// Maximum wait of dropping a queue for unwritten items.
const MAX_FLUSH: Duration = Duration::from_secs(1);

/// Items of all queues of the process that are not written yet.
static UNWRITTEN: AtomicUsize = AtomicUsize::new(0);

/// Writes one item.
type Write<T> = Box<dyn FnMut(T) + Send>;

struct State<T> {
    items: VecDeque<T>,
    skipped_tick: u64,
    writing: bool,
    ended: bool,
}

struct Inner<T> {
    state: Mutex<State<T>>,
    /// Signalled when an item waits or the queue ends.
    wake: Condvar,
    /// Signalled when no item waits.
    done: Condvar,
    /// Makes the item that stands for this many skipped ones.
    note: fn(u64) -> T,
}

/// A bounded queue with its own thread; see the module.
pub(crate) struct Outbox<T: Send + 'static> {
    inner: Arc<Inner<T>>,
    /// Without a thread the caller of `put` writes the item.
    direct: Option<Mutex<Write<T>>>,
}

impl<T> Inner<T> {
    fn state(&self) -> MutexGuard<'_, State<T>> {
        lock(&self.state)
    }

    /// The next item to write; `None` at the end.
    fn next(&self) -> Option<T> {
        let mut state = self.state();
        state.writing = false;
        loop {
            if let Some(item) = state.items.pop_front() {
                state.writing = true;
                return Some(item);
            }
            if state.skipped_tick > 0 {
                state.writing = true;
                UNWRITTEN.fetch_add(1, Ordering::Relaxed);
                return Some((self.note)(std::mem::take(&mut state.skipped_tick)));
            }
            self.done.notify_all();
            if state.ended {
                return None;
            }
            state = self.wake.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }
}

impl<T: Send + 'static> Outbox<T> {
    /// A queue whose thread, of this name, passes items to `write` one after the other. A panic of `write` loses one
    /// item, not the queue; `panicked` receives the panic's message.
    pub fn new(
        name: &str,
        note: fn(u64) -> T,
        write: impl FnMut(T) + Send + 'static,
        panicked: impl Fn(&str) + Send + 'static,
    ) -> Self {
        let state = State { items: VecDeque::new(), skipped_tick: 0, writing: false, ended: false };
        let inner = Arc::new(Inner { state: Mutex::new(state), wake: Condvar::new(), done: Condvar::new(), note });
        let mut write = write;
        let guarded: Write<T> = Box::new(move |item| {
            if let Err(payload) = catch_unwind(AssertUnwindSafe(|| write(item))) {
                panicked(panic_words(&*payload));
            }
        });
        // Passed through a mutex, so that they are still here if no thread can be started.
        let place = Arc::new(Mutex::new(Some(guarded)));
        let (mine, theirs) = (Arc::clone(&inner), Arc::clone(&place));
        let started = std::thread::Builder::new().name(name.to_owned()).spawn(move || {
            let write = lock(&theirs).take();
            let Some(mut write) = write else { return };
            while let Some(item) = mine.next() {
                write(item);
                UNWRITTEN.fetch_sub(1, Ordering::Relaxed);
            }
        });
        let direct = match started {
            Ok(_) => None,
            Err(_) => lock(&place).take().map(Mutex::new),
        };
        Self { inner, direct }
    }

    /// Adds an item; never waits.
    pub fn put(&self, item: T) {
        if let Some(direct) = &self.direct {
            return lock(direct)(item);
        }
        let mut state = self.inner.state();
        if state.items.len() >= MAX_WAITING {
            state.skipped_tick += 1;
            return;
        }
        let mut more = 1;
        if state.skipped_tick > 0 {
            let note = (self.inner.note)(std::mem::take(&mut state.skipped_tick));
            state.items.push_back(note);
            more = 2;
        }
        UNWRITTEN.fetch_add(more, Ordering::Relaxed);
        state.items.push_back(item);
        drop(state);
        self.inner.wake.notify_one();
    }

    /// Waits up to `limit` until all items are written; `false` if they are not.
    pub fn flush(&self, limit: Duration) -> bool {
        let until = Instant::now() + limit;
        let mut state = self.inner.state();
        while state.writing || !state.items.is_empty() || state.skipped_tick > 0 {
            let Some(left) = until.checked_duration_since(Instant::now()).filter(|d| !d.is_zero()) else {
                return false;
            };
            state = self.inner.done.wait_timeout(state, left).unwrap_or_else(PoisonError::into_inner).0;
        }
        true
    }
}

impl<T: Send + 'static> Drop for Outbox<T> {
    fn drop(&mut self) {
        self.inner.state().ended = true;
        self.inner.wake.notify_all();
        // A thread that cannot write now is detached.
        self.flush(MAX_FLUSH);
    }
}

/// Waits up to `limit` until all queues of the process are written. Takes no lock and allocates nothing, so that it may
/// be called while the program crashes.
pub(crate) fn flush_all(limit: Duration) -> bool {
    const STEP_MS: u64 = 2;
    for _ in 0..limit.as_millis() as u64 / STEP_MS + 1 {
        if UNWRITTEN.load(Ordering::Relaxed) == 0 {
            return true;
        }
        std::thread::sleep(Duration::from_millis(STEP_MS));
    }
    false
}

/// The message of a panic.
pub fn panic_words(payload: &(dyn std::any::Any + Send)) -> &str {
    let text = payload.downcast_ref::<&str>().copied();
    text.or_else(|| payload.downcast_ref::<String>().map(String::as_str)).unwrap_or("without a message")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc;

    #[test]
    fn whoever_puts_something_in_never_waits_and_what_is_left_out_is_counted() {
        let (go, gate) = mpsc::channel::<()>();
        let written = Arc::new(Mutex::new(Vec::new()));
        let list = Arc::clone(&written);
        let write = move |line: String| {
            let _ = gate.recv();
            list.lock().expect("no panic").push(line);
        };
        let outbox = Outbox::new("test", |n| format!("{n} left out"), write, |_| {});
        let total = MAX_WAITING + 50;
        (0..total).for_each(|n| outbox.put(n.to_string()));
        assert!(!outbox.flush(Duration::from_millis(1)), "nobody reads");
        drop(go);
        assert!(outbox.flush(Duration::from_secs(60)), "it is read now");
        let written = written.lock().expect("no panic");
        let said: u64 = written.iter().filter_map(|l| l.strip_suffix(" left out")?.parse::<u64>().ok()).sum();
        let lines: Vec<usize> = written.iter().filter_map(|l| l.parse().ok()).collect();
        assert!(said > 0);
        assert_eq!(lines.len() as u64 + said, total as u64, "each is written or counted");
        assert!(lines.is_sorted(), "in order");
    }

    #[test]
    fn a_panic_while_writing_is_told_and_the_next_item_is_written() {
        let (told, words) = mpsc::channel();
        let (done, seen) = mpsc::channel();
        let write = move |n: u32| {
            assert!(n != 1, "no room for {n}");
            let _ = done.send(n);
        };
        let outbox = Outbox::new("test", |_| 0, write, move |words| drop(told.send(words.to_owned())));
        (1..=3).for_each(|n| outbox.put(n));
        assert_eq!(words.recv().expect("it is told"), "no room for 1");
        assert_eq!([seen.recv(), seen.recv()], [Ok(2), Ok(3)]);
    }
}
