//! The running graph behind the window: an engine, its live changes, and a thread that makes them. No egui here.
//!
//! The window says what text is to run; the newest one wins. Changes are made one after the other, off the window's thread, each as one
//! transaction: what fails leaves the old graph running, with its reason in [`Status`].

use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use panoscope_engine::sync::lock;
use panoscope_engine::{ApplyError, Engine, Options, Outcome, StartError};
use panoscope_graph::{GraphText, check};
use panoscope_loader::live::LiveError;
use panoscope_loader::{self as loader, Live, Loader};

/// How long nodes may take to finish their files.
const PATIENCE: Duration = Duration::from_secs(30);

/// How the run stands.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Phase {
    /// Nothing ran yet.
    #[default]
    Idle,
    /// Nodes are being opened.
    Starting,
    /// Frames flow.
    Running,
    /// All sources have ended; files are finished.
    Ended,
    /// A node failed and the graph said to stop.
    Failed(String),
}

/// Why the newest text does not run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Trouble {
    /// The node it is about, where there is one.
    pub node: Option<String>,
    /// For people.
    pub words: String,
}

/// What the window shows of the session.
#[derive(Clone, Debug, Default)]
pub struct Status {
    /// How the run stands.
    pub phase: Phase,
    /// The text that runs.
    pub running: Arc<str>,
    /// Why the newest text does not.
    pub trouble: Option<Trouble>,
    /// A change is being made.
    pub busy: bool,
    /// What the last change did, and how long ticks were held up.
    pub last: String,
    /// Ticks that the busiest source had made when `running` was put in force.
    pub tick: u64,
    /// Counts changes; previews are subscribed anew when it does.
    pub generation: u64,
}

#[derive(Default)]
struct Wishes {
    text: Option<String>,
    restart: bool,
    reload: bool,
    stop: bool,
    quit: bool,
}

impl Wishes {
    fn any(&self) -> bool {
        self.text.is_some() || self.restart || self.reload || self.stop || self.quit
    }
}

/// Called when there is something new to show.
pub type Wake = dyn Fn() + Send + Sync;

struct Shared {
    path: PathBuf,
    frames: Option<u64>,
    wishes: Mutex<Wishes>,
    wished: Condvar,
    status: Mutex<Status>,
    changed: Condvar,
    engine: Mutex<Option<Arc<Engine>>>,
    loader: Mutex<Arc<Loader>>,
    wake: Mutex<Option<Arc<Wake>>>,
}

/// The running graph. Dropping it ends the run with all files finished.
pub struct Session {
    shared: Arc<Shared>,
    worker: Option<JoinHandle<()>>,
}

/// Lets other threads look at the engine that runs.
#[derive(Clone)]
pub struct Handle(Arc<Shared>);

impl Handle {
    /// The engine, if one was started.
    pub fn engine(&self) -> Option<Arc<Engine>> {
        lock(&self.0.engine).clone()
    }

    /// How it stands.
    pub fn status(&self) -> Status {
        lock(&self.0.status).clone()
    }

    /// Asks the window to look again.
    pub fn wake(&self) {
        self.0.wake();
    }

    /// The folder that relative paths start from.
    pub fn folder(&self) -> &Path {
        self.0.path.parent().unwrap_or(Path::new(""))
    }
}

impl Session {
    /// A session for the graph file at `path`; nothing runs until [`Self::run`]. `plugin_paths` are those of the graph, `frames` the most ticks each
    /// source makes.
    ///
    /// # Errors
    /// The system gave no thread.
    pub fn new(path: &Path, plugin_paths: &[PathBuf], frames: Option<u64>) -> std::io::Result<Self> {
        let shared = Arc::new(Shared {
            path: path.to_owned(),
            frames,
            wishes: Mutex::default(),
            wished: Condvar::new(),
            status: Mutex::default(),
            changed: Condvar::new(),
            engine: Mutex::default(),
            loader: Mutex::new(Arc::new(Loader::search(&loader::search_path(plugin_paths)))),
            wake: Mutex::default(),
        });
        let for_worker = Arc::clone(&shared);
        let worker = std::thread::Builder::new()
            .name("changes".to_owned())
            .spawn(move || Worker { shared: for_worker, live: None, done: true }.run())?;
        Ok(Self { shared, worker: Some(worker) })
    }

    /// Sets what is called when there is something new to show.
    pub fn set_wake(&self, wake: Arc<Wake>) {
        *lock(&self.shared.wake) = Some(wake);
    }

    /// For other threads.
    pub fn handle(&self) -> Handle {
        Handle(Arc::clone(&self.shared))
    }

    /// Where plugins come from.
    pub fn loader(&self) -> Arc<Loader> {
        lock(&self.shared.loader).clone()
    }

    /// The graph file.
    pub fn path(&self) -> &Path {
        &self.shared.path
    }

    /// How it stands.
    pub fn status(&self) -> Status {
        lock(&self.shared.status).clone()
    }

    fn wish(&self, wish: impl FnOnce(&mut Wishes)) {
        wish(&mut lock(&self.shared.wishes));
        lock(&self.shared.status).busy = true;
        self.shared.wished.notify_all();
    }

    /// Makes `text` what runs. Texts that were wished for in between are left out.
    pub fn run(&self, text: &str) {
        self.wish(|w| w.text = Some(text.to_owned()));
    }

    /// Ends the run, if any, and starts `text` anew.
    pub fn restart(&self, text: &str) {
        self.wish(|w| {
            w.text = Some(text.to_owned());
            w.restart = true;
        });
    }

    /// Ends the run; files are finished.
    pub fn stop(&self) {
        self.wish(|w| w.stop = true);
    }

    /// Swaps rebuilt plugins in.
    pub fn reload_plugins(&self) {
        self.wish(|w| w.reload = true);
    }

    /// Waits until all that was wished for is done; `false` when it is not by then.
    pub fn settle(&self, most: Duration) -> bool {
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
        self.wish(|w| w.quit = true);
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
    live: Option<Live<Arc<Engine>>>,
    /// The engine, if any, is closed.
    done: bool,
}

impl Worker {
    fn run(mut self) {
        loop {
            let wishes = self.next();
            let quit = wishes.quit;
            if wishes.stop || quit || wishes.restart {
                self.end();
            }
            if quit {
                self.shared.update(|s| s.busy = false);
                return;
            }
            if wishes.reload {
                self.reload();
            }
            if let Some(text) = wishes.text {
                self.make(&text, wishes.restart);
            }
            if !self.done && self.live.as_ref().is_some_and(|l| l.engine().is_finished()) {
                self.end();
            }
            let more = lock(&self.shared.wishes).any();
            self.shared.update(|s| s.busy = more);
        }
    }

    /// Waits for a wish, or for the end of the run.
    fn next(&mut self) -> Wishes {
        let mut wishes = lock(&self.shared.wishes);
        loop {
            if wishes.any() {
                return std::mem::take(&mut *wishes);
            }
            if !self.done && self.live.as_ref().is_some_and(|l| l.engine().is_finished()) {
                return Wishes::default();
            }
            let wait = Duration::from_millis(if self.done { 10_000 } else { 100 });
            wishes = self.shared.wished.wait_timeout(wishes, wait).unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// Ends the run with all files finished.
    fn end(&mut self) {
        let Some(live) = &self.live else { return };
        if self.done {
            return;
        }
        let outcome = live.engine().close(PATIENCE);
        self.done = true;
        self.shared.update(|s| {
            s.phase = match outcome {
                Outcome::Done => Phase::Ended,
                Outcome::Failed(reason) => Phase::Failed(reason),
            };
        });
    }

    fn make(&mut self, text: &str, restart: bool) {
        if !self.done
            && let Some(live) = &mut self.live
        {
            let result = live.apply_text(text);
            *lock(&self.shared.loader) = Arc::clone(live.loader());
            return self.tell(result.map(|applied| applied.to_string()).map_err(|e| trouble(&e)), text);
        }
        // A run that has ended stays so until it is started anew.
        if self.live.is_none() || restart {
            self.start(text);
        }
    }

    fn start(&mut self, text: &str) {
        self.shared.update(|s| s.phase = Phase::Starting);
        let result = self.open(text);
        let words = result.map(|live| {
            *lock(&self.shared.engine) = Some(Arc::clone(&live.0));
            self.live = Some(live.1);
            self.done = false;
            self.shared.update(|s| s.phase = Phase::Running);
            "started".to_owned()
        });
        if words.is_err() {
            self.shared.update(|s| s.phase = if self.live.is_some() { Phase::Ended } else { Phase::Idle });
        }
        self.tell(words, text);
    }

    fn open(&self, text: &str) -> Result<(Arc<Engine>, Live<Arc<Engine>>), Trouble> {
        let path = &self.shared.path;
        let parsed = GraphText::parse(path, text);
        let folders = loader::search_path(&parsed.plugin_paths());
        let mut loader = lock(&self.shared.loader).clone();
        if folders.iter().any(|f| !loader.folders().contains(f)) {
            loader = Arc::new(loader.rescan_in(&folders));
            *lock(&self.shared.loader) = Arc::clone(&loader);
        }
        let catalog = loader.catalog(&parsed.plugins());
        let plain = |words: String| Trouble { node: None, words };
        let (graph, _) = check(&parsed, &catalog).into_result().map_err(|d| plain(d.render(false)))?;
        let options = Options {
            frames: self.shared.frames,
            graph_dir: path.parent().unwrap_or(Path::new("")).to_owned(),
            ..Options::default()
        };
        let engine = Engine::start(graph, &catalog, &loader, options).map_err(|error| match &error {
            StartError::Open { node, .. } => Trouble { node: Some(node.clone()), words: error.to_string() },
            _ => plain(error.to_string()),
        })?;
        let engine = Arc::new(engine);
        Ok((Arc::clone(&engine), Live::new(engine, path, text.to_owned(), Vec::new(), loader)))
    }

    fn reload(&mut self) {
        if self.done {
            return;
        }
        if let Some(live) = &mut self.live {
            let text = live.text().to_owned();
            let result = live.reload_plugins();
            *lock(&self.shared.loader) = Arc::clone(live.loader());
            self.tell(result.map(|applied| applied.to_string()).map_err(|e| trouble(&e)), &text);
        }
    }

    fn tell(&self, result: Result<String, Trouble>, text: &str) {
        let tick = self.live.as_ref().map_or(0, |live| live.engine().ticks());
        self.shared.update(|s| match result {
            Ok(words) => {
                s.running = text.into();
                s.tick = tick;
                s.trouble = None;
                s.last = words;
                s.generation += 1;
            }
            Err(trouble) => s.trouble = Some(trouble),
        });
    }
}

fn trouble(error: &LiveError) -> Trouble {
    let node = match error {
        LiveError::Apply(
            ApplyError::Open { node, .. } | ApplyError::NoReturn { node, .. } | ApplyError::Busy { node, .. },
        ) => Some(node.clone()),
        _ => None,
    };
    Trouble { node, words: error.to_string() }
}
