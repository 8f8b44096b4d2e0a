//! What went wrong while a graph ran: time, node, cause, what was done.

use std::collections::VecDeque;
use std::fs::File;
use std::io::Write;
use std::path::Path;
use std::sync::{Mutex, PoisonError};
use std::time::{SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

/// Takes a fault as it happens.
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
    /// The node's plugin ended the program: it crashed or called `exit`.
    Crash,
}

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

/// Passes faults on and remembers the newest.
pub(crate) struct FaultLog {
    sink: Option<Box<FaultFn>>,
    recent: Mutex<VecDeque<Fault>>,
}

impl FaultLog {
    pub fn new(sink: Option<Box<FaultFn>>) -> Self {
        Self { sink, recent: Mutex::new(VecDeque::new()) }
    }

    /// Takes one fault.
    pub fn put(&self, fault: Fault) {
        if let Some(sink) = &self.sink {
            sink(&fault);
        }
        let mut recent = self.recent.lock().unwrap_or_else(PoisonError::into_inner);
        if recent.len() >= REMEMBERED {
            recent.pop_front();
        }
        recent.push_back(fault);
    }

    /// The newest faults, oldest first.
    pub fn recent(&self) -> Vec<Fault> {
        self.recent.lock().unwrap_or_else(PoisonError::into_inner).iter().cloned().collect()
    }
}

/// The wall clock in ms since 1970.
pub(crate) fn unix_ms() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_millis() as u64)
}

/// A sink for [`crate::Options::faults`] that appends one JSON line per fault to a file.
pub fn json_lines(path: &Path) -> std::io::Result<Box<FaultFn>> {
    if let Some(folder) = path.parent().filter(|p| !p.as_os_str().is_empty()) {
        std::fs::create_dir_all(folder)?;
    }
    let file = Mutex::new(File::options().create(true).append(true).open(path)?);
    Ok(Box::new(move |fault| {
        if let Ok(mut line) = serde_json::to_vec(fault) {
            line.push(b'\n');
            // One write per line: a cut-off run ends with a whole one. A full disk must not stop the picture.
            let _ = file.lock().unwrap_or_else(PoisonError::into_inner).write_all(&line);
        }
    }))
}
