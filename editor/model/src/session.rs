//! The running graph behind the window: an engine and a thread that applies changes to it.
//!
//! The window requests a text to run; a newer request replaces an older one. Changes are applied one after the other, off the window's
//! thread, each as one transaction. When a change fails, the old graph keeps running and [`Status`] has the reason.
//!
//! With [`Session::attached`] the graph runs on another machine, and that machine applies the changes.

mod attached;
mod recording;

use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use panoscope_engine::sync::lock;
use panoscope_engine::trace::Tracer;
use panoscope_engine::{ApplyError, Engine, Options, Outcome, StartError};
use panoscope_graph::{Diagnostics, GraphText, Severity};
use panoscope_host::attach::Attachment;
use panoscope_host::loader::graph_file::{self, RunError};
use panoscope_host::loader::live::LiveError;
use panoscope_host::loader::sealed::readable;
use panoscope_host::loader::verify::Seal;
use panoscope_host::loader::{self as loader, Live, Loader};
use serde::{Deserialize, Serialize};

use crate::first_previews::FirstPreviews;
use crate::trace::Trace;
use recording::RunRecorder;
pub use recording::{FinishedRecording, folder as recordings_folder};

/// Maximum time for nodes to finish their files.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(30);

/// The phase of a run.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Phase {
    /// Nothing was started yet.
    #[default]
    Idle,
    /// Nodes are being opened.
    Starting,
    /// The graph runs.
    Running,
    /// All sources have ended; files are finished.
    Ended,
    /// A node failed and the graph's policy stopped the run; with the reason.
    Failed(String),
}

/// Why the newest text does not run.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RunProblem {
    /// The node that caused it, if there is one.
    pub node: Option<String>,
    /// Message for the user.
    pub message: String,
    /// Where the text is not a valid graph: its first mistake on one line, such as the file that is missing. `message` is the whole
    /// listing.
    pub mistake: Option<String>,
}

impl RunProblem {
    /// The problem on one line.
    pub fn line(&self) -> &str {
        self.mistake.as_deref().unwrap_or_else(|| self.message.lines().next().unwrap_or_default())
    }
}

/// The first mistake of a graph on one line; names the file that is missing.
pub fn first_mistake(diagnostics: &Diagnostics) -> Option<String> {
    let first = diagnostics.iter().find(|d| d.severity == Severity::Error)?;
    // The message of a missing file names the parameter only; its help names the file.
    let missing = first.help.strip_prefix("looked for ").filter(|_| first.code == "missing-file");
    let missing = missing.and_then(|help| help.split(';').next()).map(Path::new);
    let line = match missing.and_then(|path| Some((path.file_name()?, path.parent()?))) {
        Some((name, folder)) => {
            format!("the file {} does not exist in {}", name.to_string_lossy(), folder.display())
        }
        None => first.message.clone(),
    };
    Some(readable(&line))
}

/// The state of the session, for the window.
#[derive(Clone, Debug, Default)]
pub struct Status {
    /// Phase of the run.
    pub phase: Phase,
    /// The text of the running graph.
    pub running: Arc<str>,
    /// Why the newest text does not run.
    pub problem: Option<RunProblem>,
    /// Whether a change is being applied or waits.
    pub busy: bool,
    /// Description of the last change, with the time that ticks were held.
    pub last: String,
    /// Number of ticks of the busiest source when `running` was applied.
    pub tick: u64,
    /// Incremented with every change; previews then subscribe again.
    pub generation: u64,
    /// The file that the run is recorded to.
    pub recording: Option<PathBuf>,
    /// The last recording that is finished.
    pub recorded: Option<FinishedRecording>,
}

#[derive(Default)]
struct Requests {
    text: Option<String>,
    /// With a machine: the text that `text` was edited from.
    base: Option<String>,
    restart: bool,
    /// The file to record the next run to; `Some(None)` for none.
    record: Option<Option<PathBuf>>,
    reload: bool,
    stop: bool,
    quit: bool,
}

impl Requests {
    fn any(&self) -> bool {
        self.text.is_some() || self.restart || self.reload || self.stop || self.quit
    }
}

/// Called when the window should draw again.
pub type Wake = dyn Fn() + Send + Sync;

struct Shared {
    path: PathBuf,
    frames: Option<u64>,
    requests: Mutex<Requests>,
    requested: Condvar,
    status: Mutex<Status>,
    changed: Condvar,
    engine: Mutex<Option<Arc<Engine>>>,
    first_previews: FirstPreviews,
    loader: Mutex<Arc<Loader>>,
    /// Remembers the paths of ticks, if somebody asks for them.
    trace: Mutex<Option<Arc<Trace>>>,
    /// The files that the graph may read; `None` while it does not run under a lock.
    seal: Mutex<Option<Arc<Seal>>>,
    wake: Mutex<Option<Arc<Wake>>>,
    /// The machine that runs the graph, if it is another one.
    attachment: Option<Arc<Attachment>>,
}

/// The running graph. Dropping it ends the run and finishes all files.
pub struct Session {
    shared: Arc<Shared>,
    worker: Option<JoinHandle<()>>,
}

/// Access to the running engine from other threads.
#[derive(Clone)]
pub struct Handle(Arc<Shared>);

impl Handle {
    /// The engine; `None` before the first start.
    pub fn engine(&self) -> Option<Arc<Engine>> {
        lock(&self.0.engine).clone()
    }

    /// The engine, and the generation of its graph.
    pub fn running(&self) -> (Option<Arc<Engine>>, u64) {
        let status = lock(&self.0.status);
        (self.engine(), status.generation)
    }

    /// The previews of a run that begins.
    pub fn first_previews(&self) -> &FirstPreviews {
        &self.0.first_previews
    }

    /// The machine that runs the graph, if it is another one.
    pub fn attachment(&self) -> Option<&Arc<Attachment>> {
        self.0.attachment.as_ref()
    }

    /// The state of the session.
    pub fn status(&self) -> Status {
        lock(&self.0.status).clone()
    }

    /// Asks the window to draw again.
    pub fn wake(&self) {
        self.0.wake();
    }

    /// The folder that relative paths start from.
    pub fn folder(&self) -> &Path {
        self.0.path.parent().unwrap_or(Path::new(""))
    }
}

impl Session {
    /// A session for the graph file at `path`; nothing runs until [`Self::run`]. `plugin_paths` are those of the graph, `frames` is the maximum
    /// number of ticks of each source.
    ///
    /// # Errors
    /// The thread cannot be started.
    pub fn new(path: &Path, plugin_paths: &[PathBuf], frames: Option<u64>) -> std::io::Result<Self> {
        let shared = Arc::new(Shared::new(path, plugin_paths, frames, None));
        let for_worker = Arc::clone(&shared);
        let worker = std::thread::Builder::new().name("changes".to_owned()).spawn(move || {
            Worker { shared: for_worker, live: None, done: true, recorder: RunRecorder::default() }.run()
        })?;
        Ok(Self { shared, worker: Some(worker) })
    }

    /// Remembers the paths of ticks in runs that start from here on.
    pub fn follow_ticks(&self) -> Arc<Trace> {
        Arc::clone(lock(&self.shared.trace).get_or_insert_default())
    }

    /// Sets the function that is called when the window should draw again.
    pub fn set_wake(&self, wake: Arc<Wake>) {
        *lock(&self.shared.wake) = Some(wake);
    }

    /// The loader for graphs that are started from here on, such as one that loads only the plugins of a lock.
    pub fn set_loader(&self, loader: Arc<Loader>) {
        *lock(&self.shared.loader) = loader;
    }

    /// Makes the texts of later requests read only the files of a lock. `None` ends that.
    pub fn set_seal(&self, seal: Option<Arc<Seal>>) {
        *lock(&self.shared.seal) = seal;
    }

    /// A handle for other threads.
    pub fn handle(&self) -> Handle {
        Handle(Arc::clone(&self.shared))
    }

    /// The loader of the plugins.
    pub fn loader(&self) -> Arc<Loader> {
        lock(&self.shared.loader).clone()
    }

    /// The machine that runs the graph, if it is another one.
    pub fn attachment(&self) -> Option<&Arc<Attachment>> {
        self.shared.attachment.as_ref()
    }

    /// Path of the graph file.
    pub fn path(&self) -> &Path {
        &self.shared.path
    }

    /// The state of the session.
    pub fn status(&self) -> Status {
        lock(&self.shared.status).clone()
    }

    fn request(&self, request: impl FnOnce(&mut Requests)) {
        request(&mut lock(&self.shared.requests));
        lock(&self.shared.status).busy = true;
        self.shared.requested.notify_all();
    }

    /// Requests that `text` runs. Replaces earlier requests that were not applied yet.
    pub fn run(&self, text: &str) {
        self.request(|w| w.text = Some(text.to_owned()));
    }

    /// As [`Self::run`], for a text that was edited from `base`: a machine that runs another one meanwhile refuses it.
    pub fn run_from(&self, base: &str, text: &str) {
        self.request(|w| {
            // Of requests that were not applied yet, the first one's base counts.
            w.base.get_or_insert_with(|| base.to_owned());
            w.text = Some(text.to_owned());
        });
    }

    /// Ends the run, if any, and starts `text`.
    pub fn restart(&self, text: &str) {
        self.request(|w| {
            w.text = Some(text.to_owned());
            w.restart = true;
        });
    }

    /// Ends the run, if any, and starts `text` with a recording of every output in `file`; without a file the recording ends.
    pub fn record(&self, file: Option<&Path>, text: &str) {
        self.request(|w| {
            (w.text, w.restart) = (Some(text.to_owned()), true);
            w.record = Some(file.map(Path::to_owned));
        });
    }

    /// Ends the run and finishes its files.
    pub fn stop(&self) {
        self.request(|w| w.stop = true);
    }

    /// Swaps rebuilt plugins into the running graph.
    pub fn reload_plugins(&self) {
        self.request(|w| w.reload = true);
    }

    /// Waits until all requests are done; returns `false` after the time `most`.
    pub fn wait_idle(&self, most: Duration) -> bool {
        let until = Instant::now() + most;
        let mut status = lock(&self.shared.status);
        while status.busy {
            let Some(left) = until.checked_duration_since(Instant::now()) else { return false };
            status = self.shared.changed.wait_timeout(status, left).unwrap_or_else(PoisonError::into_inner).0;
        }
        true
    }

    /// Ends the run and waits until all files are finished.
    pub fn close(&mut self) {
        self.request(|w| w.quit = true);
        if let Some(worker) = self.worker.take() {
            let _ = worker.join();
        }
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        self.close();
    }
}

impl Shared {
    fn new(path: &Path, plugin_paths: &[PathBuf], frames: Option<u64>, attachment: Option<Arc<Attachment>>) -> Self {
        Self {
            path: path.to_owned(),
            frames,
            requests: Mutex::default(),
            requested: Condvar::new(),
            status: Mutex::default(),
            changed: Condvar::new(),
            engine: Mutex::default(),
            first_previews: FirstPreviews::default(),
            loader: Mutex::new(Arc::new(Loader::search(&loader::search_path(plugin_paths)))),
            seal: Mutex::default(),
            trace: Mutex::default(),
            wake: Mutex::default(),
            attachment,
        }
    }

    fn wake(&self) {
        let wake = lock(&self.wake).clone();
        if let Some(wake) = wake {
            wake();
        }
    }

    fn update(&self, change: impl FnOnce(&mut Status)) {
        change(&mut lock(&self.status));
        self.changed.notify_all();
        self.wake();
    }
}

struct Worker {
    shared: Arc<Shared>,
    live: Option<Live>,
    /// Whether the engine, if any, is closed.
    done: bool,
    recorder: RunRecorder,
}

impl Worker {
    fn run(mut self) {
        loop {
            let requests = self.next();
            let quit = requests.quit;
            if requests.stop || quit || requests.restart {
                self.end();
            }
            if quit {
                self.shared.update(|s| s.busy = false);
                return;
            }
            if requests.reload {
                self.reload();
            }
            if let Some(file) = requests.record {
                self.recorder.set_file(file);
            }
            if let Some(text) = requests.text {
                self.apply(&text, requests.restart);
            }
            if !self.done && self.live.as_ref().is_some_and(|l| l.engine().is_finished()) {
                self.end();
            }
            let more = lock(&self.shared.requests).any();
            self.shared.update(|s| s.busy = more);
        }
    }

    /// Waits for a request, or for the end of the run.
    fn next(&mut self) -> Requests {
        let mut requests = lock(&self.shared.requests);
        loop {
            if requests.any() {
                return std::mem::take(&mut *requests);
            }
            if !self.done && self.live.as_ref().is_some_and(|l| l.engine().is_finished()) {
                return Requests::default();
            }
            let wait = Duration::from_millis(if self.done { 10_000 } else { 100 });
            requests = self.shared.requested.wait_timeout(requests, wait).unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// Ends the run and finishes its files.
    fn end(&mut self) {
        let Some(live) = &self.live else { return };
        if self.done {
            return;
        }
        let outcome = live.engine().close(CLOSE_TIMEOUT);
        self.done = true;
        let recorded = self.recorder.finish();
        self.shared.update(|s| {
            s.recording = None;
            s.recorded = recorded.or(s.recorded.take());
            s.phase = match outcome {
                Outcome::Done => Phase::Ended,
                Outcome::Failed(reason) => Phase::Failed(reason),
            };
        });
    }

    fn apply(&mut self, text: &str, restart: bool) {
        if !self.done
            && let Some(live) = &mut self.live
        {
            live.set_seal(lock(&self.shared.seal).clone());
            let result = live.apply_text(text);
            *lock(&self.shared.loader) = Arc::clone(live.loader());
            return self.report(result.map(|applied| applied.to_string()).map_err(|e| problem(&e)), text);
        }
        // A run that has ended is not changed; it must be started again.
        if self.live.is_none() || restart {
            self.start(text);
        }
    }

    fn start(&mut self, text: &str) {
        self.shared.update(|s| s.phase = Phase::Starting);
        let result = self.open(text);
        let message = result.map(|live| {
            self.live = Some(live);
            self.done = false;
            "started".to_owned()
        });
        let phase = match (&message, &self.live) {
            (Ok(_), _) => Phase::Running,
            (Err(_), Some(_)) => Phase::Ended,
            (Err(_), None) => Phase::Idle,
        };
        if phase != Phase::Running {
            self.recorder.finish();
        }
        let recording = self.recorder.file();
        self.shared.update(|s| s.recording = recording);
        // The phase last: who sees the graph running also sees its text and generation.
        self.report(message, text);
        self.shared.update(|s| s.phase = phase);
    }

    fn open(&mut self, text: &str) -> Result<Live, RunProblem> {
        let parsed = GraphText::parse(&self.shared.path, text);
        let folders = loader::search_path(&parsed.plugin_paths());
        let mut loader = lock(&self.shared.loader).clone();
        if folders.iter().any(|f| !loader.folders().contains(f)) {
            loader = Arc::new(loader.rescan_in(&folders));
            *lock(&self.shared.loader) = Arc::clone(&loader);
        }
        let plain = |message: String| RunProblem { node: None, message: readable(&message), mistake: None };
        let mut ready = graph_file::ready_with(&parsed, loader)
            .map_err(|d| RunProblem { mistake: first_mistake(&d), ..plain(d.render(false)) })?;
        ready.seal.clone_from(&lock(&self.shared.seal));
        let recorder = self.recorder.start(&ready).map_err(|error| plain(error.to_string()))?;
        let (shared, generation) = (Arc::clone(&self.shared), lock(&self.shared.status).generation + 1);
        let options = Options {
            frames: self.shared.frames,
            before_first_tick: Some(Box::new(move |engine| shared.first_previews.subscribe(engine, generation))),
            observer: recorder.map(|recorder| recorder as _),
            tracer: lock(&self.shared.trace).clone().map(|trace| trace as Arc<dyn Tracer>),
            // Windows start graphs without being asked: when they open, and after a crash.
            keep_outputs: true,
            ..Options::default()
        };
        ready.start(options).map_err(|error| match &error {
            RunError::Start(StartError::Open { node, .. }) => {
                RunProblem { node: Some(node.clone()), ..plain(error.to_string()) }
            }
            _ => plain(error.to_string()),
        })
    }

    fn reload(&mut self) {
        if self.done {
            return;
        }
        if let Some(live) = &mut self.live {
            let text = Arc::clone(&lock(&self.shared.status).running);
            let result = live.reload_plugins();
            *lock(&self.shared.loader) = Arc::clone(live.loader());
            self.report(result.map(|applied| applied.to_string()).map_err(|e| problem(&e)), &text);
        }
    }

    fn report(&self, result: Result<String, RunProblem>, text: &str) {
        let engine = self.live.as_ref().map(|live| Arc::clone(live.engine()));
        let tick = engine.as_ref().map_or(0, |engine| engine.ticks());
        self.shared.update(|s| match result {
            Ok(message) => {
                // Both at a time: see [`Handle::running`].
                *lock(&self.shared.engine) = engine;
                s.running = text.into();
                s.tick = tick;
                s.problem = None;
                s.last = message;
                s.generation += 1;
            }
            Err(problem) => s.problem = Some(problem),
        });
    }
}

fn problem(error: &LiveError) -> RunProblem {
    let node = match error {
        LiveError::Apply(
            ApplyError::Open { node, .. }
            | ApplyError::NoReturn { node, .. }
            | ApplyError::Busy { node, .. }
            | ApplyError::Memory { node, .. },
        ) => Some(node.clone()),
        _ => None,
    };
    let mistake = match error {
        LiveError::Check(diagnostics) => first_mistake(diagnostics),
        _ => None,
    };
    RunProblem { node, message: readable(&error.to_string()), mistake }
}
