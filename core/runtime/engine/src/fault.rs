//! Faults of a run: time, node, cause, action.

use std::collections::VecDeque;
use std::fs::File;
use std::io::Write;
use std::path::Path;
use std::sync::{Arc, Mutex, Weak};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

use crate::files;
use crate::outbox::Outbox;
use crate::sync::lock;

/// Receives faults, on the fault log's thread, one at a time.
pub type FaultFn = dyn Fn(&Fault) + Send + Sync;

/// The cause of a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Cause {
    /// The node returned an error.
    Error,
    /// The node panicked or threw.
    Panic,
    /// The node did not return.
    Hang,
    /// The node did not reopen.
    Open,
    /// An output whose description does not fit its buffer, its declaration or the contract's sizes, or beyond whose
    /// end the node wrote.
    BadOutput,
    /// An output of a format that its reader does not accept.
    Format,
    /// An output of another size than before, on which a reader failed.
    Size,
    /// An output with NaN or infinity where the contract requires finite numbers.
    NotANumber,
    /// An output larger than any frame may be.
    TooMuch,
    /// Frame memory is used up.
    Exhausted,
    /// Capture times of a source that repeat or run backwards.
    CaptureTime,
    /// No output in spite of complete inputs, many times in a row.
    Silent,
    /// A call took longer than the node's budget.
    Slow,
    /// Frames retained and never released.
    Leak,
    /// The recording of the run has a gap, or has ended.
    Recording,
    /// A buffer released that the node does not hold.
    Release,
    /// The node's plugin ended the program: it crashed or called `exit`.
    Crash,
    /// A node that writes files lacks ticks of its source that were dropped because the nodes of its region are too
    /// slow.
    Incomplete,
    /// An input was older than `max_age_ms` of its edge and counted as absent.
    TooOld,
}

/// Number of causes.
pub(crate) const CAUSES: usize = Cause::TooOld as usize + 1;

/// The engine's response to a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Action {
    /// The node restarts; its outputs are empty until then.
    Restart,
    /// The call was abandoned with its thread; both were replaced and the node restarts.
    Abandon,
    /// The node is bypassed from now on.
    Bypass,
    /// The run ends.
    Stop,
    /// The source ended early; the rest of the graph finishes.
    End,
    /// The packet was not delivered; the node continues.
    Withhold,
    /// Only reported; the node continues.
    Note,
}

/// One fault.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Fault {
    /// Milliseconds since 1970, wall clock.
    pub unix_ms: u64,
    /// Milliseconds since the graph started.
    pub run_ms: f64,
    /// The node.
    pub node: String,
    /// The cause of a fault.
    pub cause: Cause,
    /// Details for the user.
    pub words: String,
    /// The engine's response.
    pub done: Action,
    /// Number of the tick, where there was one.
    pub seq: Option<u64>,
    /// For a hang: time from the end of the node's budget until it was detected.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub late_ms: Option<f64>,
    /// Faults of this node with this cause so far. For causes that may come with every tick only powers of two are
    /// reported.
    pub count: u64,
}

const REMEMBERED: usize = 4096;

/// The newest faults of a run, oldest first.
#[derive(Default)]
struct Recent {
    faults: VecDeque<Fault>,
    /// Faults so far, also those that are no longer kept.
    count: u64,
}

impl Recent {
    fn push(&mut self, fault: Fault) {
        if self.faults.len() >= REMEMBERED {
            self.faults.pop_front();
        }
        self.faults.push_back(fault);
        self.count += 1;
    }
}

/// A position in the faults of a run, with the newest faults before it; see
/// [`Engine::faults_since`](crate::Engine::faults_since).
pub struct FaultCursor {
    /// The log that it was moved in last.
    log: Weak<Mutex<Recent>>,
    /// Faults of the run before it.
    count: u64,
    newest: VecDeque<Fault>,
    max: usize,
}

impl FaultCursor {
    /// Before the first fault. It keeps at most `max` faults, and never more than 4,096.
    pub fn new(max: usize) -> Self {
        Self { log: Weak::new(), count: 0, newest: VecDeque::new(), max }
    }

    /// The newest faults before it, oldest first.
    pub fn newest(&self) -> impl DoubleEndedIterator<Item = &Fault> {
        self.newest.iter()
    }
}

/// Passes faults on, on its own thread, and keeps the newest.
pub(crate) struct FaultLog {
    out: Option<Outbox<Fault>>,
    recent: Arc<Mutex<Recent>>,
}

/// Name in place of a node's in faults of the log itself.
const NAME: &str = "faults";

fn own_fault(words: String, count: u64) -> Fault {
    let (node, cause) = (NAME.to_owned(), Cause::Recording);
    Fault { unix_ms: unix_ms(), run_ms: 0.0, node, cause, words, done: Action::Note, seq: None, late_ms: None, count }
}

/// A fault that stands for those that came faster than they were written.
fn skipped_tick(count: u64) -> Fault {
    own_fault(format!("{count} faults were skipped: they came faster than they were written"), count)
}

impl FaultLog {
    pub fn new(sink: Option<Box<FaultFn>>) -> Self {
        let recent: Arc<Mutex<Recent>> = Arc::default();
        let told = Arc::clone(&recent);
        let out = sink.map(|sink| {
            let panicked = move |words: &str| {
                let words = format!("thread `{NAME}` panicked on a fault, which is lost: {words}");
                lock(&told).push(own_fault(words, 1));
            };
            Outbox::new(NAME, skipped_tick, move |fault| sink(&fault), panicked)
        });
        Self { out, recent }
    }

    /// Adds a fault.
    pub fn put(&self, fault: Fault) {
        let mut recent = lock(&self.recent);
        // Under the lock, so that both have the same order.
        if let Some(out) = &self.out {
            out.put(fault.clone());
        }
        recent.push(fault);
    }

    /// Waits up to `limit` until all faults are passed on; `false` if they are not.
    pub fn flush(&self, limit: Duration) -> bool {
        self.out.as_ref().is_none_or(|out| out.flush(limit))
    }

    /// The newest faults, oldest first.
    pub fn recent(&self) -> Vec<Fault> {
        lock(&self.recent).faults.iter().cloned().collect()
    }

    /// Moves a cursor past the newest fault; one of another log starts at the first fault. Returns whether its faults
    /// changed.
    pub fn advance(&self, cursor: &mut FaultCursor) -> bool {
        let this = Arc::downgrade(&self.recent);
        let mut changed = false;
        if !Weak::ptr_eq(&cursor.log, &this) {
            changed = !cursor.newest.is_empty();
            *cursor = FaultCursor { log: this, ..FaultCursor::new(cursor.max) };
        }
        let recent = lock(&self.recent);
        let new = usize::try_from(recent.count - cursor.count).unwrap_or(usize::MAX).min(recent.faults.len());
        cursor.count = recent.count;
        cursor.newest.extend(recent.faults.range(recent.faults.len() - new..).cloned());
        let excess = cursor.newest.len().saturating_sub(cursor.max.min(REMEMBERED));
        cursor.newest.drain(..excess);
        changed || new > 0
    }
}

/// The wall clock in ms since 1970.
pub fn unix_ms() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_millis() as u64)
}

/// A file of faults.
struct FaultFile {
    file: File,
    /// Whether a failed write was reported already.
    told: bool,
}

impl FaultFile {
    /// Appends a line, whole or not at all. A full disk does not stop the run and is reported once.
    fn append(&mut self, line: &[u8]) {
        let before = self.file.metadata().map(|found| found.len());
        if let Err(error) = self.file.write_all(line) {
            if !std::mem::replace(&mut self.told, true) {
                eprintln!("panoscope: faults are missing in the fault log: {error}");
            }
            if let Ok(len) = before {
                let _ = self.file.set_len(len);
            }
        }
    }
}

/// A sink for [`crate::Options::faults`] that appends one JSON line per fault to a file. A symbolic link is replaced by
/// a file.
pub fn json_lines(path: &Path) -> std::io::Result<Box<FaultFn>> {
    let file = Mutex::new(FaultFile { file: files::append(path)?, told: false });
    Ok(Box::new(move |fault| {
        if let Ok(mut line) = serde_json::to_vec(fault) {
            line.push(b'\n');
            lock(&file).append(&line);
        }
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn put(log: &FaultLog, words: &str) {
        log.put(own_fault(words.to_owned(), 1));
    }

    fn words(cursor: &FaultCursor) -> Vec<&str> {
        cursor.newest().map(|fault| fault.words.as_str()).collect()
    }

    #[test]
    fn a_cursor_meets_each_fault_once_and_starts_again_in_another_run() {
        let (log, other) = (FaultLog::new(None), FaultLog::new(None));
        let mut cursor = FaultCursor::new(2);
        assert!(!log.advance(&mut cursor));
        ["a", "b", "c"].iter().for_each(|name| put(&log, name));
        assert!(log.advance(&mut cursor) && !log.advance(&mut cursor));
        assert_eq!(words(&cursor), ["b", "c"]);
        put(&log, "d");
        assert!(log.advance(&mut cursor));
        assert_eq!(words(&cursor), ["c", "d"]);
        assert!(other.advance(&mut cursor) && !other.advance(&mut cursor));
        assert_eq!(words(&cursor), [""; 0]);
    }

    #[test]
    fn faults_beyond_those_kept_are_new_to_a_cursor() {
        let (log, mut cursor) = (FaultLog::new(None), FaultCursor::new(usize::MAX));
        for round in 0..2 {
            (0..REMEMBERED + 3).for_each(|k| put(&log, &format!("{round} {k}")));
            assert!(log.advance(&mut cursor));
            assert_eq!(words(&cursor).len(), REMEMBERED);
            assert_eq!(words(&cursor)[0], format!("{round} 3"));
        }
    }
}
