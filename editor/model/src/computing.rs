//! Computes what a recording lacks: a graph runs on the recorded sources, on a thread of its own, and all its outputs go to a second recording.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use panoscope_engine::sync::lock;
use panoscope_engine::{Options, Outcome};
use panoscope_host::loader::Loader;
use panoscope_record::{RecordOptions, Recording, RecordingError, Replay, ReplayError, ReplayOptions};

/// Time between two looks at the progress.
const STEP: Duration = Duration::from_millis(100);
/// Time limit for ending the run.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(5);

/// The graph that is computed on a recording.
pub struct Request {
    /// Path and text of the graph, whose sources are those of the recording.
    pub graph: (PathBuf, String),
    /// The loader of plugins.
    pub loader: Arc<Loader>,
}

/// Why outputs could not be computed.
#[derive(Debug, thiserror::Error)]
enum ComputeError {
    #[error(transparent)]
    Replay(#[from] ReplayError),
    #[error(transparent)]
    Recording(#[from] RecordingError),
    #[error("{reason}")]
    Run { reason: String },
}

#[derive(Default)]
struct Shared {
    quits: AtomicBool,
    percent: AtomicU8,
    result: Mutex<Option<Result<Arc<Recording>, ComputeError>>>,
}

/// A computation in progress, or its result. Dropping it ends it.
pub struct Computation {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
    /// The text of the graph.
    text: String,
}

impl Computation {
    /// Starts to compute a graph on the sources of `recording`; its nodes with side effects do not run. `wake` is called at every step and at the end.
    ///
    /// # Errors
    /// The thread cannot be started.
    pub fn start(
        recording: Arc<Recording>,
        request: Request,
        wake: impl Fn() + Send + 'static,
    ) -> std::io::Result<Self> {
        let shared = Arc::<Shared>::default();
        let (for_thread, text) = (Arc::clone(&shared), request.graph.1.clone());
        let thread = std::thread::Builder::new().name("computing".to_owned()).spawn(move || {
            let result = compute(&recording, request, &for_thread, &wake);
            *lock(&for_thread.result) = Some(result.map(Arc::new));
            wake();
        })?;
        Ok(Self { shared, thread: Some(thread), text })
    }

    /// How far it is, %; `None` once it has ended.
    pub fn percent(&self) -> Option<u8> {
        lock(&self.shared.result).is_none().then(|| self.shared.percent.load(Ordering::Relaxed))
    }

    /// All outputs of the graph, once they are computed.
    pub fn recording(&self) -> Option<Arc<Recording>> {
        lock(&self.shared.result).as_ref()?.as_ref().ok().cloned()
    }

    /// Why there are none.
    pub fn problem(&self) -> Option<String> {
        lock(&self.shared.result).as_ref()?.as_ref().err().map(ToString::to_string)
    }

    /// Whether it is of this text.
    pub fn is_of(&self, text: &str) -> bool {
        self.text == text
    }
}

impl Drop for Computation {
    fn drop(&mut self) {
        self.shared.quits.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// The file beside a recording that takes what is computed. It has no name any more once it is opened.
fn file_beside(recording: &Path) -> PathBuf {
    let name = recording.file_stem().unwrap_or_default().to_string_lossy();
    recording.with_file_name(format!(".{name}_computed_{}.mcap", std::process::id()))
}

/// Removes a file at its end.
struct Unnamed(PathBuf);

impl Drop for Unnamed {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

fn compute(
    recording: &Arc<Recording>,
    request: Request,
    shared: &Shared,
    wake: &impl Fn(),
) -> Result<Recording, ComputeError> {
    let file = Unnamed(file_beside(recording.path()));
    let record = RecordOptions { file: Some(file.0.clone()), all_ports: true, ..RecordOptions::default() };
    let options = ReplayOptions {
        graph: Some(request.graph),
        record: Some(record),
        loader: Some(request.loader),
        // The graph in the window runs on meanwhile.
        engine: Options { threads: 1, ..Options::default() },
        ..ReplayOptions::default()
    };
    let replay = Replay::start(recording, options)?;
    let ticks = recording.sources.values().map(Vec::len).max().unwrap_or(0).max(1) as u64;
    while !replay.engine().wait(Some(STEP)) {
        if shared.quits.load(Ordering::Relaxed) {
            replay.engine().stop();
        }
        let percent = (replay.engine().ticks() * 100 / ticks).min(99) as u8;
        if shared.percent.swap(percent, Ordering::Relaxed) != percent {
            wake();
        }
    }
    let outcome = replay.engine().close(CLOSE_TIMEOUT);
    let recorded = replay.recorder().map(|recorder| recorder.finish());
    if let Outcome::Failed(reason) = outcome {
        return Err(ComputeError::Run { reason });
    }
    if let Some(reason) = recorded.and_then(|recorded| recorded.failed) {
        return Err(ComputeError::Run { reason });
    }
    Ok(Recording::open(&file.0)?)
}
