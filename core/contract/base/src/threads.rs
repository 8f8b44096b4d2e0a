//! A pool without an engine, for tests, benches and tools.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use crate::Parallel;

/// Rounds that an idle helper looks for work before it sleeps: benches time loops that follow each other within
/// microseconds.
const SPINS: usize = 2000;

/// A fixed number of threads that wait for loops. One loop runs at a time; a loop started meanwhile runs on its caller
/// alone.
pub struct Threads {
    shared: Arc<Shared>,
    helpers: Vec<JoinHandle<()>>,
    turn: Mutex<()>,
}

/// The loop that helpers work on.
#[derive(Clone, Copy)]
struct Job {
    body: &'static (dyn Fn(usize) + Sync),
    chunks: usize,
}

#[derive(Default)]
struct State {
    /// Present exactly while a `run` may still hand out chunks.
    job: Option<Job>,
    /// Payload of the first panic of a body.
    panic: Option<Box<dyn Any + Send>>,
    stop: bool,
}

#[derive(Default)]
struct Shared {
    state: Mutex<State>,
    /// Signalled when `job` or `stop` is set.
    start: Condvar,
    /// Signalled when `busy` falls to 0.
    idle: Condvar,
    /// Helpers that hold a copy of the job; changed under the lock of `state` only.
    busy: AtomicUsize,
    /// The next chunk to take.
    next: AtomicUsize,
    /// Chunks of the present loop, 0 without one: read by spinning helpers.
    chunks: AtomicUsize,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes chunks until none is left.
    fn drain(&self, job: Job) {
        loop {
            let chunk = self.next.fetch_add(1, Ordering::Relaxed);
            if chunk >= job.chunks {
                return;
            }
            (job.body)(chunk);
        }
    }

    fn help(&self) {
        loop {
            let has_work = || self.next.load(Ordering::Relaxed) < self.chunks.load(Ordering::Acquire);
            let _ = (0..SPINS).find(|_| {
                std::hint::spin_loop();
                has_work()
            });
            let mut state = self.lock();
            let job = loop {
                if state.stop {
                    return;
                }
                match state.job {
                    Some(job) if has_work() => break job,
                    _ => state = self.start.wait(state).unwrap_or_else(PoisonError::into_inner),
                }
            };
            self.busy.fetch_add(1, Ordering::Relaxed);
            drop(state);
            let result = catch_unwind(AssertUnwindSafe(|| self.drain(job)));
            let mut state = self.lock();
            if let Err(panic) = result {
                state.panic.get_or_insert(panic);
            }
            if self.busy.fetch_sub(1, Ordering::Release) == 1 {
                self.idle.notify_all();
            }
        }
    }

    /// Takes the loop back and waits until no helper is inside its body.
    fn finish(&self) -> Option<Box<dyn Any + Send>> {
        self.lock().job = None;
        self.chunks.store(0, Ordering::Release);
        let is_idle = || self.busy.load(Ordering::Acquire) == 0;
        let _ = (0..SPINS).find(|_| {
            std::hint::spin_loop();
            is_idle()
        });
        let mut state = self.lock();
        while !is_idle() {
            state = self.idle.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        state.panic.take()
    }
}

impl Threads {
    /// A pool of `threads` threads, the calling one included.
    ///
    /// # Panics
    /// When the system starts no more threads.
    pub fn new(threads: usize) -> Self {
        let shared = Arc::new(Shared::default());
        let helper = |_| {
            let shared = Arc::clone(&shared);
            std::thread::spawn(move || shared.help())
        };
        Self { helpers: (1..threads).map(helper).collect(), shared, turn: Mutex::default() }
    }
}

impl Parallel for Threads {
    fn threads(&self) -> usize {
        self.helpers.len() + 1
    }

    fn run(&self, chunks: usize, body: &(dyn Fn(usize) + Sync)) {
        let turn = match self.turn.try_lock() {
            Ok(turn) => turn,
            Err(std::sync::TryLockError::Poisoned(turn)) => turn.into_inner(),
            // A loop inside a loop, or one of another thread.
            Err(std::sync::TryLockError::WouldBlock) => return (0..chunks).for_each(body),
        };
        if self.helpers.is_empty() || chunks < 2 {
            return (0..chunks).for_each(body);
        }
        // SAFETY: helpers reach the body only through `State::job` and count themselves in `busy` under the same lock as they take it; `finish`, which
        // runs before this call returns or unwinds, removes the job and waits until `busy` is 0.
        let body: &'static (dyn Fn(usize) + Sync) = unsafe { std::mem::transmute(body) };
        let job = Job { body, chunks };
        {
            let mut state = self.shared.lock();
            self.shared.next.store(0, Ordering::Relaxed);
            self.shared.chunks.store(chunks, Ordering::Release);
            state.job = Some(job);
        }
        self.shared.start.notify_all();
        let own = catch_unwind(AssertUnwindSafe(|| self.shared.drain(job)));
        let helpers = self.shared.finish();
        drop(turn);
        if let Some(panic) = own.err().or(helpers) {
            resume_unwind(panic);
        }
    }
}

impl Drop for Threads {
    fn drop(&mut self) {
        self.shared.lock().stop = true;
        self.shared.start.notify_all();
        for helper in self.helpers.drain(..) {
            // A helper catches the panics of bodies and cannot panic itself.
            let _ = helper.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_chunk_runs_once_in_loops_that_follow_each_other() {
        for threads in [1, 2, 5] {
            let pool = Threads::new(threads);
            assert_eq!(pool.threads(), threads);
            for chunks in [0, 1, 2, 3, 64, 1000].into_iter().cycle().take(600) {
                let counts: Vec<AtomicUsize> = (0..chunks).map(|_| AtomicUsize::new(0)).collect();
                pool.run(chunks, &|chunk| _ = counts[chunk].fetch_add(1, Ordering::Relaxed));
                assert!(
                    counts.iter().all(|count| count.load(Ordering::Relaxed) == 1),
                    "{threads} threads, {chunks} chunks"
                );
            }
        }
    }

    #[test]
    fn helpers_take_part() {
        let pool = Threads::new(2);
        let barrier = std::sync::Barrier::new(2);
        // Returns only if two threads are inside the loop at once.
        pool.run(2, &|_| {
            barrier.wait();
        });
    }

    #[test]
    fn loops_inside_loops_run() {
        let pool = Threads::new(3);
        let sum = AtomicUsize::new(0);
        pool.run(8, &|_| pool.run(8, &|inner| _ = sum.fetch_add(inner, Ordering::Relaxed)));
        assert_eq!(sum.into_inner(), 8 * 28);
    }

    #[test]
    fn a_panic_of_any_thread_reaches_the_caller_and_the_pool_goes_on() {
        let pool = Threads::new(2);
        for panicking in 0..16 {
            let run = || pool.run(16, &|chunk| assert_ne!(chunk, panicking));
            assert!(catch_unwind(AssertUnwindSafe(run)).is_err());
        }
        let sum = AtomicUsize::new(0);
        pool.run(4, &|chunk| _ = sum.fetch_add(chunk, Ordering::Relaxed));
        assert_eq!(sum.into_inner(), 6);
    }
}
