//! As `std::thread`.

use std::num::NonZero;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

pub use std::thread::{Result, panicking};

use crate::world::scheduler::{self, Key, TaskRef};

/// Number of processors of a simulated machine.
const PROCESSORS: NonZero<usize> = NonZero::new(4).expect("not 0");

/// As `std::thread::available_parallelism`.
///
/// # Errors
/// Never.
pub fn available_parallelism() -> std::io::Result<NonZero<usize>> {
    Ok(PROCESSORS)
}

/// As `std::thread::Thread`.
#[derive(Clone)]
pub struct Thread(Option<TaskRef>);

impl Thread {
    /// Ends the thread's park, or makes its next one return at once.
    pub fn unpark(&self) {
        if let Some(task) = &self.0 {
            task.unpark();
        }
    }

    /// The thread's name.
    pub fn name(&self) -> Option<String> {
        self.0.as_ref().map(TaskRef::name)
    }
}

/// The calling thread.
pub fn current() -> Thread {
    Thread(TaskRef::current())
}

/// Waits until another thread unparks this one.
pub fn park() {
    scheduler::park(None);
}

fn nanoseconds(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX / 2)
}

/// Waits until another thread unparks this one, or for `limit`.
pub fn park_timeout(limit: Duration) {
    scheduler::park(Some(nanoseconds(limit)));
}

/// Waits for `time`.
pub fn sleep(time: Duration) {
    if scheduler::is_inside() {
        scheduler::wait_for(Key::Sleep, Some(nanoseconds(time)), "time", false);
    }
}

/// Lets another thread run.
pub fn yield_now() {
    scheduler::yield_now();
}

/// As `std::thread::Builder`.
#[derive(Debug, Default)]
pub struct Builder {
    name: Option<String>,
}

impl Builder {
    /// A thread without a name.
    pub fn new() -> Self {
        Self::default()
    }

    /// Sets the thread's name.
    #[must_use]
    pub fn name(self, name: String) -> Self {
        Self { name: Some(name) }
    }

    /// Has no effect.
    #[must_use]
    pub fn stack_size(self, _bytes: usize) -> Self {
        self
    }

    /// Starts the thread.
    ///
    /// # Errors
    /// The system cannot start a thread, or the calling thread belongs to no world.
    pub fn spawn<T: Send + 'static>(self, work: impl FnOnce() -> T + Send + 'static) -> std::io::Result<JoinHandle<T>> {
        let result = Arc::new(Mutex::new(None));
        let place = Arc::clone(&result);
        let task = scheduler::spawn(self.name.unwrap_or_default(), move || {
            let outcome = catch_unwind(AssertUnwindSafe(work));
            *place.lock().unwrap_or_else(PoisonError::into_inner) = Some(outcome);
        })?;
        Ok(JoinHandle { thread: Thread(Some(task)), result })
    }
}

/// Starts a thread. Panics outside of a world.
pub fn spawn<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> JoinHandle<T> {
    Builder::new().spawn(work).expect("a thread of a simulated world")
}

/// As `std::thread::JoinHandle`.
pub struct JoinHandle<T> {
    thread: Thread,
    result: Arc<Mutex<Option<Result<T>>>>,
}

impl<T> JoinHandle<T> {
    /// The thread.
    pub fn thread(&self) -> &Thread {
        &self.thread
    }

    /// Whether the thread has ended.
    pub fn is_finished(&self) -> bool {
        self.thread.0.as_ref().is_none_or(TaskRef::has_ended)
    }

    /// Waits for the thread's end.
    ///
    /// # Errors
    /// The thread panicked.
    pub fn join(self) -> Result<T> {
        if let Some(task) = &self.thread.0 {
            task.wait_for_end();
        }
        let result = self.result.lock().unwrap_or_else(PoisonError::into_inner).take();
        result.unwrap_or_else(|| Err(Box::new("the thread left no result")))
    }
}
