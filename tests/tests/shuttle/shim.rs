//! Replacements for `std::sync` and `std::thread` in the sources under test.

use std::cell::{Cell, RefCell};

/// Locks and atomics of the scheduler.
pub mod sync {
    pub use shuttle::sync::{Arc, Condvar, LockResult, Mutex, MutexGuard, PoisonError, RwLock, Weak, atomic};
    // Filled once at their first use, which the models leave to one thread.
    pub use std::sync::{LazyLock, OnceLock};
}

/// Hints to the processor: another thread may run.
pub mod hint {
    pub use shuttle::thread::yield_now as spin_loop;
}

/// Threads of the scheduler, with the functions that it lacks.
pub mod thread {
    use std::cell::Cell;
    use std::time::Duration;

    use shuttle::sync::Arc;
    use shuttle::sync::atomic::{AtomicBool, Ordering};
    pub use shuttle::thread::{Thread, current, park, yield_now};

    thread_local! {
        /// Number of threads that were started here and have not ended. All threads of a model share the system's thread.
        static RUNNING: Cell<usize> = const { Cell::new(0) };
    }

    /// Waits until all threads that sources under test started have ended: the scheduler must not cut them off.
    pub fn join_all() {
        while RUNNING.get() > 0 {
            yield_now();
        }
    }

    /// Drops the threads of an interleaving that failed.
    pub fn begin() {
        RUNNING.set(0);
    }

    /// Sets a flag when dropped, also when the thread panics.
    struct Ends(Arc<AtomicBool>);

    impl Drop for Ends {
        fn drop(&mut self) {
            self.0.store(true, Ordering::SeqCst);
            RUNNING.set(RUNNING.get().saturating_sub(1));
        }
    }

    /// A thread that can be asked whether it has ended.
    pub struct JoinHandle<T> {
        inner: Option<shuttle::thread::JoinHandle<T>>,
        ended: Arc<AtomicBool>,
    }

    impl<T> JoinHandle<T> {
        pub fn is_finished(&self) -> bool {
            self.ended.load(Ordering::SeqCst)
        }

        pub fn join(mut self) -> shuttle::thread::Result<T> {
            self.inner.take().expect("joined once").join()
        }
    }

    impl<T> Drop for JoinHandle<T> {
        fn drop(&mut self) {
            // A thread without a handle would be cut off at the end of the model.
            std::mem::forget(self.inner.take());
        }
    }

    /// Starts threads.
    #[derive(Default)]
    pub struct Builder(shuttle::thread::Builder);

    impl Builder {
        pub fn new() -> Self {
            Self::default()
        }

        pub fn name(self, name: String) -> Self {
            Self(self.0.name(name))
        }

        pub fn spawn<T: Send + 'static>(
            self,
            work: impl FnOnce() -> T + Send + 'static,
        ) -> std::io::Result<JoinHandle<T>> {
            let ended = Arc::new(AtomicBool::new(false));
            let ends = Ends(Arc::clone(&ended));
            RUNNING.set(RUNNING.get() + 1);
            let inner = self.0.spawn(move || {
                let _ends = ends;
                work()
            })?;
            Ok(JoinHandle { inner: Some(inner), ended })
        }
    }

    /// There is no time: lets another thread run.
    pub fn sleep(_: Duration) {
        yield_now();
    }

    /// There is no time: may return at once, as the real one may.
    pub fn park_timeout(_: Duration) {
        yield_now();
    }
}

/// `LocalKey::set` of the standard library.
pub trait Assign<T> {
    fn set(&'static self, value: T);
}

impl<T: 'static> Assign<T> for shuttle::thread::LocalKey<RefCell<T>> {
    fn set(&'static self, value: T) {
        self.with(|cell| *cell.borrow_mut() = value);
    }
}

impl<T: 'static> Assign<T> for shuttle::thread::LocalKey<Cell<T>> {
    fn set(&'static self, value: T) {
        self.with(|cell| cell.set(value));
    }
}

/// `LocalKey::replace` of the standard library.
pub trait Exchange<T> {
    fn replace(&'static self, value: T) -> T;
}

impl<T: 'static> Exchange<T> for shuttle::thread::LocalKey<RefCell<T>> {
    fn replace(&'static self, value: T) -> T {
        self.with(|cell| cell.replace(value))
    }
}
