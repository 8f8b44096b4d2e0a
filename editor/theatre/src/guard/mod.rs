//! The window's side of a graph that runs in a process of its own: starts it, watches it, and replaces it when it crashes or stops answering.
//!
//! A thread of its own acts, so that a window that is not drawn is guarded, too. A second process waits with all plugins loaded: after a crash it
//! shows the cameras at once. The whole graph then starts there as a change of what runs, so that no camera is opened twice.

mod process;
mod recovery;
mod state;
#[cfg(test)]
pub(crate) use recovery::{Recovery, Step};
#[cfg(test)]
mod tests;
mod watch;

use std::collections::HashMap;
use std::io;
use std::path::PathBuf;
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use panoscope_editor_model::arguments::Overlay;
use panoscope_editor_model::observe::{Counters, Output, PreviewRequest};
use panoscope_editor_model::picture::RenderedPacket;
use panoscope_editor_model::session::{Phase, Session, Status, Wake};
use panoscope_editor_model::texts::phrase;
use panoscope_engine::sync::lock;
use panoscope_graph::{GraphOptions, ParamValue};
use panoscope_host::loader::verify::Seal;

use process::Process;
pub use process::Program;
use state::{Known, Setting, State};
use watch::{SPARE_AFTER, Shared};

use super::link::Command;
use super::runner::{Outage, Runner};
use super::{Opened, Refusal};

/// How long a report may take.
const MAX_REPORT: Duration = Duration::from_secs(3);

/// A graph that runs in a process of its own, guarded by this one.
#[derive(Clone)]
pub struct Guard {
    owner: Arc<Owner>,
}

/// Ends the processes with the last handle.
struct Owner {
    shared: Arc<Shared>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

impl Owner {
    /// Ends the processes and waits until all files are finished.
    fn close(&self) {
        self.shared.act(|state| {
            if state.closing_since.is_none() {
                state.closing_since = Some(Instant::now());
                state.send(Command::Close);
            }
        });
        if let Some(thread) = lock(&self.thread).take() {
            let _ = thread.join();
        }
    }
}

impl Drop for Owner {
    fn drop(&mut self) {
        self.close();
    }
}

impl Guard {
    /// Starts the process for the graph file at `path`. Nothing is opened until [`Self::prepare`].
    ///
    /// # Errors
    /// The thread that guards cannot be started.
    pub fn new(program: Program, path: PathBuf) -> io::Result<Self> {
        let state = State::new(Instant::now());
        let shared =
            Shared { program, path, state: Mutex::new(state), changed: Condvar::new(), wake: Mutex::default() };
        let shared = Arc::new(shared);
        let watching = Arc::clone(&shared);
        let thread = std::thread::Builder::new().name("guard".to_owned()).spawn(move || watching.watch())?;
        Ok(Self { owner: Arc::new(Owner { shared, thread: Mutex::new(Some(thread)) }) })
    }

    /// Sets the function that is called when the window should draw again.
    pub fn set_wake(&self, wake: Arc<Wake>) {
        *lock(&self.owner.shared.wake) = Some(wake);
    }

    /// Checks the text of the graph file with arguments, in the process. [`Self::take_prepared`] has the answer.
    pub fn prepare(&self, file: &str, given: &GraphOptions) {
        let refusal = self.owner.shared.refusal(phrase!("worker-restarting"));
        self.owner.shared.act(|state| {
            let is_down = state.known.is_some() && state.active.is_none();
            state.prepared = is_down.then_some(Err(refusal));
            if !is_down {
                state.asked = Some((file.to_owned(), given.clone()));
                state.send(Command::Prepare { file: file.to_owned(), given: given.clone() });
            }
        });
    }

    /// The graph that was prepared, or why it cannot be opened; `None` until that is known.
    pub fn take_prepared(&self) -> Option<Result<Opened, Refusal>> {
        lock(&self.owner.shared.state).prepared.take()
    }

    /// As [`Self::take_prepared`]; waits for the answer.
    pub fn wait_prepared(&self) -> Result<Opened, Box<Refusal>> {
        let mut state = lock(&self.owner.shared.state);
        loop {
            if let Some(prepared) = state.prepared.take() {
                return prepared.map_err(Box::new);
            }
            state = self.owner.shared.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Looks for the overlays that fit the text of the graph file. [`Self::take_overlays`] has the answer.
    pub fn find_overlays(&self, file: &str, given: &GraphOptions) {
        self.owner.shared.act(|state| {
            state.overlays = None;
            state.searched = Some((file.to_owned(), given.clone()));
            state.send(Command::FindOverlays { file: file.to_owned(), given: given.clone() });
        });
    }

    /// The overlays that fit; `None` until that is known.
    pub fn take_overlays(&self) -> Option<Vec<Overlay>> {
        lock(&self.owner.shared.state).overlays.take()
    }

    /// Uses what was prepared last: the text of the graph file, its arguments, and what the process found.
    pub(crate) fn begin(&self, file: &str, given: &GraphOptions, opened: &Opened) {
        self.owner.shared.act(|state| {
            // The one that waits has loaded something else.
            state.spare = None;
            state.spare_at = Instant::now() + SPARE_AFTER;
            state.known = Some(Known { file: file.to_owned(), given: given.clone(), opened: opened.clone() });
            state.has_taken = true;
            state.send(Command::Take);
        });
    }

    /// Numbers of the processes: the one that runs the graph, and the one that waits to take over.
    pub fn processes(&self) -> (Option<i32>, Option<i32>) {
        let state = lock(&self.owner.shared.state);
        let spare = state.spare.as_ref().filter(|spare| spare.is_ready).map(|spare| spare.process.pid());
        (state.active.as_ref().map(Process::pid), spare)
    }
}

impl Runner for Guard {
    fn status(&self) -> Status {
        let state = lock(&self.owner.shared.state);
        let status = state.run.clone().status();
        match &state.active {
            // What was sent last is not answered yet.
            Some(_) if state.run.asked != state.run_id => Status { busy: true, ..status },
            Some(_) => status,
            None => Status { phase: Phase::Starting, busy: true, ..Status::default() },
        }
    }

    fn counters(&self) -> Arc<Counters> {
        Arc::clone(&lock(&self.owner.shared.state).counters)
    }

    fn take_previews(&self) -> HashMap<Output, RenderedPacket> {
        std::mem::take(&mut lock(&self.owner.shared.state).previews)
    }

    fn request_previews(&self, requests: HashMap<Output, PreviewRequest>, interval: Duration) {
        let mut state = lock(&self.owner.shared.state);
        if state.requests != (requests.clone(), interval) {
            state.previews.retain(|output, _| requests.contains_key(output));
            state.requests = (requests, interval);
            state.send_requests();
        }
    }

    fn values(&self, node: &str) -> Option<Vec<ParamValue>> {
        lock(&self.owner.shared.state).values.get(node).cloned()
    }

    fn run(&self, text: &str) {
        let mut state = lock(&self.owner.shared.state);
        // Otherwise the text is kept until the whole graph is started.
        if state.recovery.takes_changes() {
            state.run_text(text.to_owned(), false);
        }
    }

    fn restart(&self, text: &str) {
        let mut state = lock(&self.owner.shared.state);
        if state.recovery.takes_changes() {
            state.run_text(text.to_owned(), true);
        }
    }

    fn keep(&self, whole: &str, cameras: &str) {
        let mut state = lock(&self.owner.shared.state);
        whole.clone_into(&mut state.whole);
        cameras.clone_into(&mut state.cameras);
    }

    fn set_at_once(&self, node: &str, param: &str, on: bool) {
        self.owner.shared.act(|state| {
            let id = state.next_id;
            state.next_id += 1;
            let (node, param) = (node.to_owned(), param.to_owned());
            match state.active {
                Some(_) => {
                    state.setting.push(Setting { id, node: node.clone(), at: Instant::now() });
                    state.send(Command::SetAtOnce { id, node, param, on });
                }
                None => state.refusals.push(node),
            }
        });
    }

    fn take_refusals(&self) -> Vec<String> {
        std::mem::take(&mut lock(&self.owner.shared.state).refusals)
    }

    /// See [`Guard::begin`]: the process that prepared the graph has its files.
    fn seal(&self, _: Option<Arc<Seal>>) {}

    fn report(&self) -> Option<serde_json::Value> {
        let mut state = lock(&self.owner.shared.state);
        state.report = None;
        state.send(Command::Report);
        let until = Instant::now() + MAX_REPORT;
        loop {
            if let Some(report) = state.report.take() {
                return report;
            }
            let left = until.checked_duration_since(Instant::now())?;
            state = self.owner.shared.changed.wait_timeout(state, left).unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    fn outage(&self) -> Option<Outage> {
        lock(&self.owner.shared.state).recovery.outage(Instant::now())
    }

    fn end_outage(&self) {
        lock(&self.owner.shared.state).recovery.done();
    }

    fn resume(&self) {
        self.owner.shared.act(|state| state.recovery.ask(Instant::now()));
    }

    fn close(&mut self) {
        self.owner.close();
    }

    fn session(&self) -> Option<&Session> {
        None
    }
}
