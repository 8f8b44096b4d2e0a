//! What the guard knows of its processes and of the run in them, and what it does with each message.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use panoscope_editor_model::arguments::Overlay;
use panoscope_editor_model::observe::{Counters, Output, PreviewRequest};
use panoscope_editor_model::picture::RenderedPacket;
use panoscope_editor_model::texts::{Phrase, phrase};
use panoscope_graph::{GraphOptions, ParamValue};

use super::process::Process;
use super::recovery::Recovery;
use crate::link::{Command, Message, RunState, text_hash};
use crate::{Opened, Refusal, worker};

/// Time without a sign of life after which a process is killed.
const SILENT: Duration = Duration::from_millis(1000);
/// The same at its end, when its last threads end one after the other and files are finished.
const SILENT_AT_END: Duration = Duration::from_secs(5);
/// Time without progress of a process that is otherwise alive.
const STUCK: Duration = Duration::from_secs(5);
/// How long a process may take to give its first sign of life.
const BEGIN: Duration = Duration::from_secs(20);
/// How long the end of a process may take: its files are finished.
const MAX_END: Duration = Duration::from_secs(45);
/// How long a switch may take to be set.
const MAX_SET: Duration = Duration::from_millis(300);

/// A process that waits to take over.
pub(super) struct Spare {
    pub(super) process: Process,
    pub(super) is_ready: bool,
}

/// A switch that is being set.
pub(super) struct Setting {
    pub(super) id: u64,
    pub(super) node: String,
    pub(super) at: Instant,
}

/// The graph that was opened, for processes that are started later.
#[derive(Clone)]
pub(super) struct Known {
    pub(super) file: String,
    pub(super) given: GraphOptions,
    pub(super) opened: Opened,
}

/// Everything that is known of the processes and the run.
pub(super) struct State {
    pub(super) active: Option<Process>,
    pub(super) spare: Option<Spare>,
    pub(super) spare_at: Instant,
    pub(super) next_id: u64,
    /// Whether the active process was requested to run what was prepared.
    pub(super) has_taken: bool,
    /// The active process prepares to show the cameras.
    pub(super) is_preparing: bool,
    pub(super) known: Option<Known>,
    /// What is being prepared.
    pub(super) asked: Option<(String, GraphOptions)>,
    pub(super) prepared: Option<Result<Opened, Refusal>>,
    /// What overlays are looked for.
    pub(super) searched: Option<(String, GraphOptions)>,
    pub(super) overlays: Option<Vec<Overlay>>,
    /// Texts after a crash: the whole graph's, and that of its cameras.
    pub(super) whole: String,
    pub(super) cameras: String,
    pub(super) requests: (HashMap<Output, PreviewRequest>, Duration),
    pub(super) run: RunState,
    /// Number and hash of the text that was sent last.
    pub(super) run_id: u64,
    pub(super) run_hash: u64,
    pub(super) counters: Arc<Counters>,
    pub(super) values: HashMap<String, Vec<ParamValue>>,
    pub(super) previews: HashMap<Output, RenderedPacket>,
    pub(super) setting: Vec<Setting>,
    pub(super) refusals: Vec<String>,
    pub(super) report: Option<Option<serde_json::Value>>,
    pub(super) recovery: Recovery,
    pub(super) looked_at: Instant,
    pub(super) closing_since: Option<Instant>,
}

impl State {
    /// Nothing is known, and no process was started.
    pub(super) fn new(now: Instant) -> Self {
        Self {
            active: None,
            spare: None,
            spare_at: now,
            next_id: 1,
            has_taken: false,
            is_preparing: false,
            known: None,
            asked: None,
            prepared: None,
            searched: None,
            overlays: None,
            whole: String::new(),
            cameras: String::new(),
            requests: (HashMap::new(), Duration::from_millis(100)),
            run: RunState::default(),
            run_id: 0,
            run_hash: 0,
            counters: Arc::default(),
            values: HashMap::new(),
            previews: HashMap::new(),
            setting: Vec::new(),
            refusals: Vec::new(),
            report: None,
            recovery: Recovery::new(now),
            looked_at: now,
            closing_since: None,
        }
    }

    pub(super) fn send(&self, command: Command) {
        if let Some(active) = &self.active {
            active.send(command);
        }
    }

    pub(super) fn send_requests(&self) {
        let requests = self.requests.0.iter().map(|(output, request)| (output.clone(), request.clone())).collect();
        let interval_ms = u64::try_from(self.requests.1.as_millis()).unwrap_or(u64::MAX);
        self.send(Command::Preview { requests, interval_ms });
    }

    /// Runs a text as a change, or anew.
    pub(super) fn run_text(&mut self, text: String, anew: bool) {
        self.run_id += 1;
        self.run_hash = text_hash(&text);
        self.send(Command::Run { id: self.run_id, text, anew });
    }

    /// Makes a process load what the graph needs.
    pub(super) fn reload(&self, process: &Process) {
        let Some(Known { file, given, opened }) = self.known.clone() else { return };
        let watched = worker::watched(&opened);
        let (lock, sealed) = (opened.lock, opened.sealed);
        process.send(Command::Reload { file, text: self.whole.clone(), given, lock, sealed, watched });
    }

    /// Shows the cameras in the active process, which has loaded what they need.
    pub(super) fn show_cameras(&mut self) {
        (self.is_preparing, self.has_taken) = (false, true);
        self.send(Command::Take);
        self.run_text(self.cameras.clone(), true);
        self.send_requests();
    }

    /// What was known of the run is not known any more.
    pub(super) fn forget_run(&mut self) {
        self.run = RunState::default();
        self.counters = Arc::default();
        self.previews.clear();
        self.values.clear();
        (self.has_taken, self.is_preparing) = (false, false);
        let lost = std::mem::take(&mut self.setting);
        self.refusals.extend(lost.into_iter().map(|setting| setting.node));
    }

    /// Takes a message of the active process.
    pub(super) fn take_message(&mut self, message: Message) {
        match message {
            Message::Prepared(Ok(None)) if self.is_preparing => self.show_cameras(),
            Message::Prepared(Err(refusal)) if self.is_preparing => {
                if let Some(active) = &self.active {
                    active.kill(phrase!("worker-not-restarted", reason = &refusal.line));
                }
            }
            Message::Prepared(answer) => {
                self.asked = None;
                self.prepared = answer.map(|opened| opened.map(|opened| *opened)).transpose();
            }
            Message::Overlays(overlays) => {
                self.searched = None;
                self.overlays = Some(overlays);
            }
            Message::Status(run) => self.run = run,
            Message::Counters(counters) => self.counters = Arc::new(counters.counters()),
            Message::Values(values) => self.values.extend(values),
            Message::Set { id, ok } => {
                let answered = self.setting.extract_if(.., |setting| setting.id == id);
                let nodes: Vec<String> = answered.map(|setting| setting.node).collect();
                self.refusals.extend(nodes.into_iter().filter(|_| !ok));
            }
            Message::Report(report) => self.report = Some(report),
            // Read by the process's own thread.
            Message::Beat { .. } | Message::Picture(_) => {}
        }
    }

    /// Counts switches that were not set in time as refused.
    pub(super) fn see_late_switches(&mut self) -> bool {
        let late = self.setting.extract_if(.., |setting| setting.at.elapsed() > MAX_SET);
        let late: Vec<String> = late.map(|setting| setting.node).collect();
        self.refusals.extend(late.iter().cloned());
        !late.is_empty()
    }

    /// Ends processes that do not answer. `passed` is the time since the last look.
    pub(super) fn watch_silence(&self, passed: Duration) {
        self.end_silent(passed, SILENT, || phrase!("worker-silent"));
    }

    fn end_silent(&self, passed: Duration, most: Duration, why: fn() -> Phrase) {
        let active = self.active.iter().map(|process| (process, self.has_taken));
        for (process, has_run) in active.chain(self.spare.iter().map(|spare| (&spare.process, false))) {
            let (beat, round) = process.silence(passed);
            if process.has_ended() {
                // Silence is not the reason of an end that came before it.
                continue;
            }
            match beat {
                None if round > BEGIN => process.kill(phrase!("worker-never-began")),
                Some(beat) if beat > most => process.kill(why()),
                Some(_) if has_run && round > STUCK => process.kill(phrase!("worker-stuck")),
                _ => {}
            }
        }
    }

    /// Finds out what became of the start of the whole graph.
    pub(super) fn judge_start(&mut self, now: Instant) -> bool {
        if !self.recovery.is_starting() || self.run.busy || self.run.asked != self.run_id {
            return false;
        }
        if self.run.running == self.run_hash && self.run.is_running() {
            self.recovery.runs(now);
        } else {
            let why = self
                .run
                .problem()
                .map_or_else(|| phrase!("worker-run-ended"), |problem| phrase!("worker-refused", reason = problem));
            self.recovery.refused(phrase!("worker-not-started-again", reason = why), now);
        }
        true
    }

    /// Whether the processes have ended, or are not waited for any longer.
    pub(super) fn see_close(&mut self, since: Instant, passed: Duration) -> bool {
        self.spare = None;
        self.has_taken = false;
        self.end_silent(passed, SILENT_AT_END, || phrase!("worker-silent-at-end"));
        let is_late = since.elapsed() > MAX_END;
        if self.active.as_ref().is_none_or(|active| is_late || active.end().is_some()) {
            self.active = None;
            return true;
        }
        false
    }
}
