//! What went wrong while a graph ran: time, node, cause, what was done.

use std::collections::VecDeque;
use std::fs::File;
use std::io::Write;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

use crate::outbox::Outbox;

/// Takes a fault as it happens, on a thread of the log's own, one after the other.
pub type FaultFn = dyn Fn(&Fault) + Send + Sync;

/// What went wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Cause {
    /// The node answered with an error.
    Error,
    /// The node panicked or threw.
    Panic,
    /// The node did not return.
    Hang,
    /// The node did not open again.
    Open,
    /// An output whose description does not fit its buffer, its declaration or the contract's sizes.
    BadOutput,
    /// An output of a format that its reader does not take.
    Format,
    /// An output of another size than before, on which a reader failed.
    Size,
    /// An output that holds NaN or infinity where the contract wants numbers.
    NotANumber,
    /// An output larger than any frame may be.
    TooMuch,
    /// Frame memory is used up.
    Exhausted,
    /// Capture times of a source that stand still or run backwards.
    CaptureTime,
    /// Complete inputs, no output, many times in a row.
    Silent,
    /// A call took longer than the node's budget.
    Slow,
    /// Frames kept and not given back.
    Leak,
    /// The recording of the run has a gap, or has ended.
    Recording,
    /// A buffer given back that the node does not keep.
    Release,
    /// The node's plugin ended the program: it crashed or called `exit`.
    Crash,
}

/// How many causes there are.
pub(crate) const CAUSES: usize = Cause::Crash as usize + 1;

/// What was done about a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Action {
    /// The node is opened again, its outputs are empty until then.
    Restart,
    /// The call was left behind with its thread, both were replaced and the node is opened again.
    Abandon,
    /// The node is left out from now on.
    Bypass,
    /// The run ends.
    Stop,
    /// The source has ended, too early; the rest of the graph finishes.
    End,
    /// The packet was not delivered; the node goes on.
    Withhold,
    /// Written down; the node goes on.
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
    /// What went wrong.
    pub cause: Cause,
    /// Details for people.
    pub words: String,
    /// What was done.
    pub done: Action,
    /// Number of the tick, where there was one.
    pub seq: Option<u64>,
    /// For a hang: time from the end of the node's budget until it was seen.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub late_ms: Option<f64>,
    /// How often this node had this cause so far. Of causes that may come with every tick, powers of two are written.
    pub count: u64,
}

const REMEMBERED: usize = 4096;

/// Passes faults on, on a thread of its own, and remembers the newest.
pub(crate) struct FaultLog {
    out: Option<Outbox<Fault>>,
    recent: Arc<Mutex<VecDeque<Fault>>>,
}

/// In faults of the log itself, the name in the node's place.
const NAME: &str = "faults";

fn own_fault(words: String, count: u64) -> Fault {
    let (node, cause) = (NAME.to_owned(), Cause::Recording);
    Fault { unix_ms: unix_ms(), run_ms: 0.0, node, cause, words, done: Action::Note, seq: None, late_ms: None, count }
}

/// What stands for faults that came faster than they were written.
fn skipped_tick(count: u64) -> Fault {
    own_fault(format!("{count} faults were left out: they came faster than they were written"), count)
}

impl FaultLog {
    pub fn new(sink: Option<Box<FaultFn>>) -> Self {
        let recent: Arc<Mutex<VecDeque<Fault>>> = Arc::default();
        let told = Arc::clone(&recent);
        let out = sink.map(|sink| {
            let panicked = move |words: &str| {
                let words = format!("thread `{NAME}` panicked on a fault, which is lost: {words}");
                told.lock().unwrap_or_else(PoisonError::into_inner).push_back(own_fault(words, 1));
            };
            Outbox::new(NAME, skipped_tick, move |fault| sink(&fault), panicked)
        });
        Self { out, recent }
    }

    /// Takes one fault.
    pub fn put(&self, fault: Fault) {
        let mut recent = self.recent.lock().unwrap_or_else(PoisonError::into_inner);
        // Put in under the lock, so that both have the same order.
        if let Some(out) = &self.out {
            out.put(fault.clone());
        }
        if recent.len() >= REMEMBERED {
            recent.pop_front();
        }
        recent.push_back(fault);
    }

    /// Waits until all faults are passed on, at most `limit`; `false` when they are not by then.
    pub fn flush(&self, limit: Duration) -> bool {
        self.out.as_ref().is_none_or(|out| out.flush(limit))
    }

    /// The newest faults, oldest first.
    pub fn recent(&self) -> Vec<Fault> {
        self.recent.lock().unwrap_or_else(PoisonError::into_inner).iter().cloned().collect()
    }
}

/// The wall clock in ms since 1970.
pub fn unix_ms() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_millis() as u64)
}

/// A file of faults.
struct FaultFile {
    file: File,
    /// A line could not be written, and that was told.
    told: bool,
}

impl FaultFile {
    /// Appends a line, whole or not at all. A full disk must not stop the picture; it is told once.
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

/// A sink for [`crate::Options::faults`] that appends one JSON line per fault to a file.
pub fn json_lines(path: &Path) -> std::io::Result<Box<FaultFn>> {
    if let Some(folder) = path.parent().filter(|p| !p.as_os_str().is_empty()) {
        std::fs::create_dir_all(folder)?;
    }
    let file = Mutex::new(FaultFile { file: File::options().create(true).append(true).open(path)?, told: false });
    Ok(Box::new(move |fault| {
        if let Ok(mut line) = serde_json::to_vec(fault) {
            line.push(b'\n');
            file.lock().unwrap_or_else(PoisonError::into_inner).append(&line);
        }
    }))
}
