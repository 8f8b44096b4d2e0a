//! Faults of a run: time, node, cause, action.

use std::collections::VecDeque;
use std::fs::File;
use std::io::Write;
use std::path::Path;
use std::sync::{Arc, Mutex};
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
    /// An output whose description does not fit its buffer, its declaration or the contract's sizes, or beyond whose end the node wrote.
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
    /// A node that writes files lacks ticks of its source, which were dropped because the nodes of its region are too slow.
    Incomplete,
    /// An input was older than `max_age_ms` of its edge and counted as absent.
    TooOld,
}

/// How many causes there are.
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
    /// Details for people.
    pub words: String,
    /// The engine's response.
    pub done: Action,
    /// Number of the tick, where there was one.
    pub seq: Option<u64>,
    /// For a hang: time from the end of the node's budget until it was detected.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub late_ms: Option<f64>,
    /// Faults of this node with this cause so far. For causes that may come with every tick only powers of two are reported.
    pub count: u64,
}

const REMEMBERED: usize = 4096;

/// Passes faults on, on its own thread, and keeps the newest.
pub(crate) struct FaultLog {
    out: Option<Outbox<Fault>>,
    recent: Arc<Mutex<VecDeque<Fault>>>,
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
        let recent: Arc<Mutex<VecDeque<Fault>>> = Arc::default();
        let told = Arc::clone(&recent);
        let out = sink.map(|sink| {
            let panicked = move |words: &str| {
                let words = format!("thread `{NAME}` panicked on a fault, which is lost: {words}");
                lock(&told).push_back(own_fault(words, 1));
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
        if recent.len() >= REMEMBERED {
            recent.pop_front();
        }
        recent.push_back(fault);
    }

    /// Waits at most `limit` until all faults are passed on; `false` if they are not.
    pub fn flush(&self, limit: Duration) -> bool {
        self.out.as_ref().is_none_or(|out| out.flush(limit))
    }

    /// The newest faults, oldest first.
    pub fn recent(&self) -> Vec<Fault> {
        lock(&self.recent).iter().cloned().collect()
    }
}

/// The wall clock in ms since 1970.
pub fn unix_ms() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_millis() as u64)
}

/// A file of faults.
struct FaultFile {
    file: File,
    /// Whether a failed write was reported.
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

/// A sink for [`crate::Options::faults`] that appends one JSON line per fault to a file. A symbolic link is replaced by a file.
pub fn json_lines(path: &Path) -> std::io::Result<Box<FaultFn>> {
    let file = Mutex::new(FaultFile { file: files::append(path)?, told: false });
    Ok(Box::new(move |fault| {
        if let Ok(mut line) = serde_json::to_vec(fault) {
            line.push(b'\n');
            lock(&file).append(&line);
        }
    }))
}
