//! What the theatre writes into the audit log.

use std::collections::HashMap;
use std::path::Path;
use std::time::{Duration, Instant};

use panoscope_editor_model::observe::Counters;
use panoscope_host::audit::{Auditor, Event};

use super::settings;
use super::{Opened, Verified, time};
use panoscope_graph::ParamValue;

/// A setting that does not change for this long is logged: a dragged slider gives one line.
const SETTLED: Duration = Duration::from_secs(1);
/// Minimum time between two lines about equal faults of one node.
const FAULT_INTERVAL: Duration = Duration::from_secs(10);

/// The last logged fault of a node.
struct LoggedFault {
    cause: String,
    done: String,
    at: Instant,
}

/// The audit log of one window; does nothing where the window has none.
#[derive(Default)]
pub(super) struct Audit {
    auditor: Option<Auditor>,
    /// Settings that still change: value and time of the last change, by node and parameter.
    changing: Vec<((String, String), String, Instant)>,
    /// Number of faults by node, as in the last reading.
    counts: HashMap<String, u64>,
    faults: HashMap<String, LoggedFault>,
}

/// The name of a graph file.
fn name_of(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// Logs that a graph was not opened.
pub(super) fn refused(folder: &Path, path: &Path, reason: &str) {
    // Without a thread for the log there is none for a theatre either.
    if let Ok(auditor) = Auditor::new(folder) {
        auditor.log(Event::Refused { graph: name_of(path), reason: reason.to_owned() });
    }
}

impl Audit {
    /// A log in `folder`; `None` for a window without a log.
    pub fn new(folder: Option<&Path>) -> std::io::Result<Self> {
        let mut audit = Self::default();
        audit.auditor = folder.map(Auditor::new).transpose()?;
        Ok(audit)
    }

    /// Why events cannot be written.
    pub fn problem(&self) -> Option<String> {
        self.auditor.as_ref()?.problem()
    }

    /// Logs an event, after the settings that changed before it.
    pub fn log(&mut self, event: Event) {
        self.settle(Duration::ZERO);
        self.push(event);
    }

    fn push(&self, event: Event) {
        if let Some(auditor) = &self.auditor {
            auditor.log(event);
        }
    }

    /// A graph was opened, or exchanged for another one.
    pub fn opened(&mut self, path: &Path, graph: &Opened) {
        if let (Verified::Differs(_), Some(reason)) = (&graph.verified, &graph.overridden) {
            self.log(Event::Override { by: "--unlocked".to_owned(), reason: reason.clone() });
        }
        self.log(Event::Opened {
            program: env!("CARGO_PKG_VERSION").to_owned(),
            graph: name_of(path),
            graph_sha256: panoscope_host::loader::sealed::Fingerprint::of(graph.text.as_bytes()).sha256,
            lock: graph.lock.clone(),
        });
    }

    /// A setting was changed; logged once it stays.
    pub fn setting(&mut self, node: &str, param: &str, value: &ParamValue) {
        let key = (node.to_owned(), param.to_owned());
        self.changing.retain(|(other, ..)| *other != key);
        self.changing.push((key, settings::message(value, ""), time::now()));
    }

    /// Logs settings that have not changed for a time.
    fn settle(&mut self, quiet: Duration) {
        let (settled, changing) =
            std::mem::take(&mut self.changing).into_iter().partition(|(_, _, since)| time::since(*since) >= quiet);
        self.changing = changing;
        for ((node, param), value, _) in settled {
            self.push(Event::Setting { node, param, value });
        }
    }

    /// Logs what is new since the last frame.
    pub fn update(&mut self, counters: &Counters) {
        if self.auditor.is_none() {
            return;
        }
        self.settle(SETTLED);
        let now = time::now();
        for (node, window) in &counters.nodes {
            let count = window.faults + window.restarts;
            let before = self.counts.insert(node.clone(), count).unwrap_or(0);
            let Some(fault) = counters.faults.get(node).filter(|_| count > before) else { continue };
            // The words of a fault may name files.
            let (cause, done) =
                (format!("{:?}", fault.cause).to_lowercase(), format!("{:?}", fault.done).to_lowercase());
            let is_known = self.faults.get(node).is_some_and(|last| {
                last.cause == cause && last.done == done && now.duration_since(last.at) < FAULT_INTERVAL
            });
            if !is_known {
                let last = LoggedFault { cause: cause.clone(), done: done.clone(), at: now };
                self.faults.insert(node.clone(), last);
                self.log(Event::Fault { node: node.clone(), cause, done });
            }
        }
    }

    /// Logs the end, and waits a few seconds until all is written.
    pub fn close(&mut self) {
        if self.auditor.is_some() {
            self.log(Event::Closed);
        }
        if let Some(mut auditor) = self.auditor.take() {
            auditor.close();
        }
    }
}

impl Drop for Audit {
    fn drop(&mut self) {
        self.close();
    }
}
