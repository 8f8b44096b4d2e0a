//! Where words of nodes and of the engine go.

use std::sync::{Mutex, PoisonError};

/// How much a line matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// A node failed.
    Error,
    /// Something a user should know.
    Warn,
    /// Progress.
    Info,
    /// For whoever debugs a node.
    Debug,
}

/// Takes a line: level, node, words.
pub type LogFn = dyn Fn(Level, &str, &str) + Send + Sync;

/// The engine's log: passes lines on and remembers the newest ones.
pub struct Log {
    sink: Option<Box<LogFn>>,
    last: Mutex<Vec<(Level, String, String)>>,
}

const REMEMBERED: usize = 256;

impl Log {
    /// A log that calls `sink`, if there is one.
    pub fn new(sink: Option<Box<LogFn>>) -> Self {
        Self { sink, last: Mutex::new(Vec::new()) }
    }

    /// Takes a line.
    pub fn say(&self, level: Level, node: &str, message: &str) {
        let mut last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        if last.len() >= REMEMBERED {
            last.remove(0);
        }
        last.push((level, node.to_owned(), message.to_owned()));
        drop(last);
        if let Some(sink) = &self.sink {
            sink(level, node, message);
        }
    }

    /// The newest lines, oldest first.
    pub fn recent(&self) -> Vec<(Level, String, String)> {
        self.last.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}
