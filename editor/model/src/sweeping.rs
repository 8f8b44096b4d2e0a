//! A sweep under way: on a thread of its own with engines of its own, so that the graph in the window goes on. No egui here.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

use panoscope_eval::sweep::{Point, Request, Sweep};
use panoscope_loader::Loader;
use panoscope_record::Recording;

use panoscope_engine::sync::lock;

/// How much less than the graph in the window a sweep is to have of the processor.
const NICENESS: libc::c_int = 10;

/// How a sweep stands.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Progress {
    /// The parameter, with its unit.
    pub param: String,
    /// Unit of the parameter.
    pub unit: String,
    /// The values are words, whose numbers are positions only.
    pub words: bool,
    /// What is measured.
    pub measure: String,
    /// Points so far.
    pub points: Vec<Point>,
    /// How many there are to be; 0 while the sweep is being looked at.
    pub total: usize,
    /// It is over.
    pub done: bool,
    /// It was cancelled.
    pub cancelled: bool,
    /// Why it did not begin.
    pub failed: Option<String>,
}

/// A sweep under way. Dropping it ends it.
pub struct Job {
    progress: Arc<Mutex<Progress>>,
    cancel: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Job {
    /// Begins. `recording` gives the pictures where it is not empty; `wake` is called with every point.
    ///
    /// # Errors
    /// The system gave no thread.
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
            // SAFETY: sets the niceness of this thread; those that it starts take it over.
            unsafe { libc::setpriority(libc::PRIO_PROCESS, 0, NICENESS) };
            let result = sweep(request, &recording, loader, &place, &stop, &wake);
            let mut progress = lock(&place);
            progress.failed = result.err();
            progress.cancelled = stop.load(Ordering::Relaxed);
            progress.done = true;
            drop(progress);
            wake();
        };
        let thread = std::thread::Builder::new().name("sweep".to_owned()).spawn(work)?;
        Ok(Self { progress, cancel, thread: Some(thread) })
    }

    /// How it stands.
    pub fn progress(&self) -> Progress {
        lock(&self.progress).clone()
    }

    /// Ends it soon; what it found stays.
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

fn sweep(
    mut request: Request,
    recording: &Path,
    loader: Arc<Loader>,
    place: &Mutex<Progress>,
    stop: &AtomicBool,
    wake: &dyn Fn(),
) -> Result<(), String> {
    if !recording.as_os_str().is_empty() {
        request.recording = Some(Arc::new(Recording::open(recording).map_err(|e| e.to_string())?));
    }
    let sweep = Sweep::new(request, loader).map_err(|e| e.to_string())?;
    {
        let mut progress = lock(place);
        progress.total = sweep.len();
        sweep.unit().clone_into(&mut progress.unit);
        progress.words = sweep.has_words();
    }
    let each = |point| {
        lock(place).points.push(point);
        wake();
    };
    sweep.run(&|| stop.load(Ordering::Relaxed), each).map_err(|e| e.to_string())
}
