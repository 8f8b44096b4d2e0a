//! Runs a parameter sweep on a thread of its own with engines of its own, while the graph in the window keeps running.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

use panoscope_eval::sweep::{Point, Request, Sweep, SweepError};
use panoscope_host::loader::Loader;
use panoscope_record::{Recording, RecordingError};

use panoscope_engine::sync::lock;

/// Niceness of the sweep's threads, so that the graph in the window has priority.
const NICENESS: libc::c_int = 10;

/// The progress of a sweep.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Progress {
    /// The parameter, as `node.param`.
    pub param: String,
    /// Unit of the parameter.
    pub unit: String,
    /// Whether the values are words; the numbers of the points are then positions in the list of words.
    pub is_text: bool,
    /// The measure, as `node.port.column`.
    pub measure: String,
    /// The points measured so far.
    pub points: Vec<Point>,
    /// Total number of points; 0 while the sweep is being prepared.
    pub total: usize,
    /// Whether it has ended.
    pub done: bool,
    /// Whether it was cancelled.
    pub cancelled: bool,
    /// Why it did not start.
    pub failed: Option<String>,
}

/// A running sweep. Dropping it ends it.
pub struct Job {
    progress: Arc<Mutex<Progress>>,
    cancel: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Job {
    /// Starts a sweep. `recording` replaces the graph's sources unless it is empty; `wake` is called after every point.
    ///
    /// # Errors
    /// The thread cannot be started.
    pub fn start(
        request: Request,
        recording: PathBuf,
        loader: Arc<Loader>,
        wake: impl Fn() + Send + 'static,
    ) -> std::io::Result<Self> {
        let progress =
            Progress { param: request.param.clone(), measure: request.measure.clone(), ..Progress::default() };
        let progress = Arc::new(Mutex::new(progress));
        let cancel = Arc::new(AtomicBool::new(false));
        let (place, stop) = (Arc::clone(&progress), Arc::clone(&cancel));
        let work = move || {
            // SAFETY: `setpriority` takes no pointers; it sets the niceness of this thread, which threads that it starts inherit.
            unsafe { libc::setpriority(libc::PRIO_PROCESS, 0, NICENESS) };
            let result = sweep(request, &recording, loader, &place, &stop, &wake);
            let mut progress = lock(&place);
            progress.failed = result.err().map(|error| error.to_string());
            progress.cancelled = stop.load(Ordering::Relaxed);
            progress.done = true;
            drop(progress);
            wake();
        };
        let thread = std::thread::Builder::new().name("sweep".to_owned()).spawn(work)?;
        Ok(Self { progress, cancel, thread: Some(thread) })
    }

    /// The progress so far.
    pub fn progress(&self) -> Progress {
        lock(&self.progress).clone()
    }

    /// Requests the end of the sweep; the measured points stay.
    pub fn cancel(&self) {
        self.cancel.store(true, Ordering::Relaxed);
    }
}

impl Drop for Job {
    fn drop(&mut self) {
        self.cancel();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Why a sweep failed as a whole.
#[derive(Debug, thiserror::Error)]
enum RunError {
    #[error(transparent)]
    Recording(#[from] RecordingError),
    #[error(transparent)]
    Sweep(#[from] SweepError),
}

fn sweep(
    mut request: Request,
    recording: &Path,
    loader: Arc<Loader>,
    place: &Mutex<Progress>,
    stop: &AtomicBool,
    wake: &dyn Fn(),
) -> Result<(), RunError> {
    if !recording.as_os_str().is_empty() {
        request.recording = Some(Arc::new(Recording::open(recording)?));
    }
    let sweep = Sweep::new(request, loader)?;
    {
        let mut progress = lock(place);
        progress.total = sweep.len();
        sweep.unit().clone_into(&mut progress.unit);
        progress.is_text = sweep.has_words();
    }
    let each = |point| {
        lock(place).points.push(point);
        wake();
    };
    Ok(sweep.run(&|| stop.load(Ordering::Relaxed), each)?)
}
