//! Writes events on a separate thread, so that no caller waits for the disk.

use std::collections::VecDeque;
use std::path::Path;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use crate::audit::event::Event;
use crate::audit::log::Log;

/// Events that are kept while they cannot be written.
const MAX_WAITING: usize = 4096;
/// Time between two attempts to write them.
const RETRY_INTERVAL: Duration = Duration::from_secs(2);
/// Maximum wait for the last events at the end of the program.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(3);

/// Time now in ms since 1970.
fn now_ms() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.map_or(0, |since| i64::try_from(since.as_millis()).unwrap_or(i64::MAX))
}

/// Appends events to a log. An event that cannot be written is kept and retried; [`Self::problem`] says why.
pub struct Auditor {
    events: Option<Sender<(i64, Event)>>,
    problem: Arc<Mutex<Option<String>>>,
    done: Receiver<()>,
}

impl Auditor {
    /// An auditor for the log in `folder`.
    ///
    /// # Errors
    /// The thread cannot be started.
    pub fn new(folder: &Path) -> std::io::Result<Self> {
        let (events, queue) = channel();
        let (ended, done) = channel();
        let problem = Arc::new(Mutex::new(None));
        let writer =
            Writer { log: Log::new(folder), queue, waiting: VecDeque::new(), lost: 0, problem: Arc::clone(&problem) };
        std::thread::Builder::new().name("audit".to_owned()).spawn(move || {
            writer.run();
            // Nobody waits any more if the time was over.
            let _ = ended.send(());
        })?;
        Ok(Self { events: Some(events), problem, done })
    }

    /// Queues an event with the current time.
    pub fn log(&self, event: Event) {
        if let Some(events) = &self.events {
            // The thread ends only after this sender.
            let _ = events.send((now_ms(), event));
        }
    }

    /// The reason why events cannot be written now.
    pub fn problem(&self) -> Option<String> {
        self.problem.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Writes the waiting events as far as a few seconds allow; later events are dropped.
    pub fn close(&mut self) {
        if self.events.take().is_some() {
            let _ = self.done.recv_timeout(CLOSE_TIMEOUT);
        }
    }
}

impl Drop for Auditor {
    fn drop(&mut self) {
        self.close();
    }
}

struct Writer {
    log: Log,
    queue: Receiver<(i64, Event)>,
    waiting: VecDeque<(i64, Event)>,
    /// Events that were dropped because too many waited.
    lost: u64,
    problem: Arc<Mutex<Option<String>>>,
}

impl Writer {
    fn run(mut self) {
        loop {
            let received = match self.waiting.is_empty() && self.lost == 0 {
                true => self.queue.recv().map_err(|_| RecvTimeoutError::Disconnected),
                false => self.queue.recv_timeout(RETRY_INTERVAL),
            };
            let ended = matches!(received, Err(RecvTimeoutError::Disconnected));
            if let Ok(event) = received {
                self.keep(event);
            }
            while let Ok(event) = self.queue.try_recv() {
                self.keep(event);
            }
            self.write();
            if ended {
                return;
            }
        }
    }

    fn keep(&mut self, event: (i64, Event)) {
        // The first events say how it began; the last ones are counted.
        if self.waiting.len() == MAX_WAITING {
            self.lost += 1;
        } else {
            self.waiting.push_back(event);
        }
    }

    fn write(&mut self) {
        let mut result = Ok(());
        while let Some((unix_ms, event)) = self.waiting.front() {
            result = self.log.append(*unix_ms, event.clone());
            if result.is_err() {
                break;
            }
            self.waiting.pop_front();
        }
        if result.is_ok() && self.lost > 0 {
            result = self.log.append(now_ms(), Event::Lost { count: self.lost });
            if result.is_ok() {
                self.lost = 0;
            }
        }
        *self.problem.lock().unwrap_or_else(PoisonError::into_inner) = result.err().map(|error| error.to_string());
    }
}
