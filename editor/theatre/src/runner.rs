//! What the window needs of a running graph, wherever it runs: in this process, or in one that the window guards.

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use panoscope_editor_model::observe::{Counters, Observer, Output, PreviewRequest};
use panoscope_editor_model::picture::RenderedPacket;
use panoscope_editor_model::session::{Session, Status, Wake};
use panoscope_editor_model::texts::Phrase;
use panoscope_graph::ParamValue;
use panoscope_host::loader::Loader;
use panoscope_host::loader::verify::Seal;

/// A running graph, and how it is observed and steered. No function waits for a node.
pub(crate) trait Runner {
    /// State of the run.
    fn status(&self) -> Status;
    /// The newest counters.
    fn counters(&self) -> Arc<Counters>;
    /// Takes the previews made since the last call.
    fn take_previews(&self) -> HashMap<Output, RenderedPacket>;
    /// Sets which outputs are previewed, and the minimum time between two previews of one.
    fn request_previews(&self, requests: HashMap<Output, PreviewRequest>, interval: Duration);
    /// Values of a node's parameters; `None` while they are not known.
    fn values(&self, node: &str) -> Option<Vec<ParamValue>>;
    /// Requests that `text` runs, as a change of what runs.
    fn run(&self, text: &str);
    /// Ends the run and starts `text`.
    fn restart(&self, text: &str);
    /// The text of the whole graph as it is to run, and the text that shows its cameras alone: what is started after a crash.
    fn keep(&self, whole: &str, cameras: &str);
    /// Sets a switch of a node, even while a change of the graph is being applied.
    fn set_at_once(&self, node: &str, param: &str, on: bool);
    /// Nodes that did not accept [`Self::set_at_once`], since the last call.
    fn take_refusals(&self) -> Vec<String>;
    /// The files that the graph may read from here on are those of the graph that was prepared last.
    fn seal(&self, seal: Option<Arc<Seal>>);
    /// The run's report (JSON), for measurements; may wait.
    fn report(&self) -> Option<serde_json::Value>;
    /// The crash that the run has not recovered from.
    fn outage(&self) -> Option<Outage>;
    /// The views of the whole graph are shown again after an outage.
    fn end_outage(&self);
    /// Starts the whole graph at once during an outage.
    fn resume(&self);
    /// The text that the next changes start from, where the graph runs on another machine.
    fn set_base(&self, _: &str) {}
    /// Ends the run and waits until all files are finished.
    fn close(&mut self);
    /// The session, where the graph runs in this process.
    fn session(&self) -> Option<&Session>;
}

/// How far the recovery from a crash is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OutageStage {
    /// There is no picture.
    Dark,
    /// The cameras are shown alone. The whole graph starts after this time; with `None` only on request.
    Cameras(Option<Duration>),
    /// The whole graph is being started beside the cameras.
    Starting,
    /// The whole graph runs again.
    Running,
}

/// A crash of the process that runs the graph, until the graph's views are shown again.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Outage {
    /// Number of the crash, from 1.
    pub number: u64,
    /// What happened: continues a sentence about the image processing.
    pub why: Phrase,
    /// How far the recovery is.
    pub stage: OutageStage,
}

/// A graph that runs in this process.
pub(crate) struct Local {
    session: Session,
    observer: Observer,
    /// See [`Runner::set_base`].
    base: std::cell::RefCell<String>,
    refusals: std::cell::RefCell<Vec<String>>,
}

impl Local {
    /// Nothing runs until [`Runner::run`].
    ///
    /// # Errors
    /// A thread cannot be started.
    pub fn new(
        path: &Path,
        loader: Arc<Loader>,
        seal: Option<Arc<Seal>>,
        frames: Option<u64>,
        wake: Arc<Wake>,
    ) -> std::io::Result<Self> {
        let session = Session::new(path, &[], frames)?;
        session.set_loader(loader);
        session.set_seal(seal);
        session.set_wake(wake);
        Self::of(session)
    }

    /// Observes a session.
    ///
    /// # Errors
    /// A thread cannot be started.
    pub fn of(session: Session) -> std::io::Result<Self> {
        let observer = Observer::new(session.handle())?;
        Ok(Self { session, observer, base: std::cell::RefCell::default(), refusals: std::cell::RefCell::default() })
    }

    /// See [`Observer::rounds`].
    pub fn rounds(&self) -> u64 {
        self.observer.rounds()
    }
}

impl Runner for Local {
    fn status(&self) -> Status {
        self.session.status()
    }

    fn counters(&self) -> Arc<Counters> {
        self.observer.counters()
    }

    fn take_previews(&self) -> HashMap<Output, RenderedPacket> {
        self.observer.take()
    }

    fn request_previews(&self, requests: HashMap<Output, PreviewRequest>, interval: Duration) {
        self.observer.set_requests(requests, interval);
    }

    fn values(&self, node: &str) -> Option<Vec<ParamValue>> {
        if let Some(machine) = self.session.attachment() {
            return machine.values(node);
        }
        self.session.handle().engine()?.param_values(node)
    }

    fn run(&self, text: &str) {
        match self.session.attachment() {
            Some(_) => self.session.run_from(&self.base.borrow(), text),
            None => self.session.run(text),
        }
    }

    fn set_base(&self, text: &str) {
        text.clone_into(&mut self.base.borrow_mut());
    }

    fn restart(&self, text: &str) {
        self.session.restart(text);
    }

    fn keep(&self, _: &str, _: &str) {}

    fn set_at_once(&self, node: &str, param: &str, on: bool) {
        let set = self.session.handle().engine().map(|engine| engine.set_bool_at_once(node, param, on));
        if !matches!(set, Some(Ok(()))) {
            self.refusals.borrow_mut().push(node.to_owned());
        }
    }

    fn take_refusals(&self) -> Vec<String> {
        self.refusals.take()
    }

    fn seal(&self, seal: Option<Arc<Seal>>) {
        self.session.set_seal(seal);
    }

    fn report(&self) -> Option<serde_json::Value> {
        let report = self.session.handle().engine()?.report();
        serde_json::to_value(report).ok()
    }

    fn outage(&self) -> Option<Outage> {
        None
    }

    fn end_outage(&self) {}

    fn resume(&self) {}

    fn close(&mut self) {
        self.session.close();
    }

    fn session(&self) -> Option<&Session> {
        Some(&self.session)
    }
}
