//! The log of nodes and of the engine.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use panoscope_base::secret::redact;

use crate::outbox::{self, Outbox};

/// Severity of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// A node failed.
    Error,
    /// A problem that the user should know.
    Warn,
    /// Progress.
    Info,
    /// For debugging a node.
    Debug,
}

/// Receives a line: level, node, text. Called on the log's thread, one line at a time.
pub type LogFn = dyn Fn(Level, &str, &str) + Send + Sync;

/// Level, node, text.
type Line = (Level, String, String);

/// The newest lines.
#[derive(Default)]
struct Recent(Mutex<VecDeque<Line>>);

/// The engine's log: passes lines on and keeps the newest ones. Writers never wait for the reader.
pub struct Log {
    out: Option<Outbox<Line>>,
    recent: Arc<Recent>,
}

const REMEMBERED: usize = 256;
/// Name in place of a node's in lines about the log itself.
const NAME: &str = "log";

impl Recent {
    fn lines(&self) -> MutexGuard<'_, VecDeque<Line>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn push(lines: &mut VecDeque<Line>, line: Line) {
        if lines.len() >= REMEMBERED {
            lines.pop_front();
        }
        lines.push_back(line);
    }
}

impl Log {
    /// A log that calls `sink`, if there is one.
    pub fn new(sink: Option<Box<LogFn>>) -> Self {
        let recent = Arc::new(Recent::default());
        let told = Arc::clone(&recent);
        let out = sink.map(|sink| {
            let note = |n| {
                (Level::Warn, NAME.to_owned(), format!("{n} lines were skipped: they came faster than they were read"))
            };
            let write = move |(level, node, words): Line| sink(level, &node, &words);
            let panicked = move |words: &str| {
                let words = format!("thread `{NAME}` panicked on a line, which is lost: {words}");
                Recent::push(&mut told.lines(), (Level::Error, NAME.to_owned(), words));
            };
            Outbox::new(NAME, note, write, panicked)
        });
        Self { out, recent }
    }

    /// Adds a line, without the secrets of addresses in it.
    pub fn write(&self, level: Level, node: &str, message: &str) {
        let line = (level, node.to_owned(), redact(message).into_owned());
        let mut lines = self.recent.lines();
        // Under the lock, so that both have the same order.
        if let Some(out) = &self.out {
            out.put(line.clone());
        }
        Recent::push(&mut lines, line);
    }

    /// Waits up to `limit` until all lines are passed on; `false` if they are not.
    pub fn flush(&self, limit: Duration) -> bool {
        self.out.as_ref().is_none_or(|out| out.flush(limit))
    }

    /// The newest lines, oldest first.
    pub fn recent(&self) -> Vec<(Level, String, String)> {
        self.recent.lines().iter().cloned().collect()
    }
}

/// Waits up to `limit` until the lines and faults of all engines of the process are passed on; `false` if they are not.
/// For a program that is crashing: takes no lock and allocates nothing.
pub fn flush_all(limit: Duration) -> bool {
    outbox::flush_all(limit)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc;

    #[test]
    fn a_reader_that_stands_still_holds_nobody_up() {
        let (go, gate) = mpsc::channel::<()>();
        let gate = Mutex::new(gate);
        let (seen, lines) = mpsc::channel();
        let log = Log::new(Some(Box::new(move |level, node, words| {
            let _ = gate.lock().unwrap_or_else(PoisonError::into_inner).recv();
            let _ = seen.send((level, node.to_owned(), words.to_owned()));
        })));
        let total = 5_000;
        (0..total).for_each(|n| log.write(Level::Info, "node", &n.to_string()));
        assert_eq!(log.recent().last().map(|l| l.2.clone()), Some((total - 1).to_string()), "remembered at once");
        drop(go);
        assert!(log.flush(Duration::from_secs(60)));
        let lines: Vec<Line> = lines.try_iter().collect();
        let skipped_tick = lines.iter().find(|l| l.1 == NAME).expect("the count of skipped lines");
        assert!(skipped_tick.2.contains("lines were skipped"), "{skipped_tick:?}");
    }
}
