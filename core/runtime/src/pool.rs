//! The one thread pool: node tasks, and loops of kernels inside nodes.

use std::cell::Cell;
use std::collections::VecDeque;
use std::ffi::c_void;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, LazyLock, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use arc_swap::ArcSwap;
use panoscope_abi::ChunkFn;

use crate::clock;
use crate::ending::who::{self, Doing};
use crate::exec::Walk;

/// Longest that a patient task waits behind urgent ones.
const LONGEST_PATIENCE_NS: u64 = 100_000_000;

/// Runs a node task; called on a worker.
pub type Task = Arc<dyn Fn(u32, &mut Walk) + Send + Sync>;

/// A loop whose caller waits on the stack until all chunks are done.
struct Loop {
    body: unsafe extern "C" fn(*mut c_void, usize),
    data: *mut c_void,
    chunks: usize,
    next: AtomicUsize,
    /// Workers inside `help` of this loop.
    helpers: AtomicU32,
    caller: std::thread::Thread,
    caller_number: u32,
    /// Of the node that it belongs to.
    urgency: Urgency,
    /// The node that it belongs to.
    doing: Doing,
}

/// What comes first where there are fewer threads than work.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Urgency {
    /// Somebody's tick waits for it.
    #[default]
    Urgent,
    /// Whoever reads it takes what there is: it may wait for what is urgent.
    Patient,
}

impl Loop {
    /// Runs chunks until none is left. A helper of a patient loop leaves it when something urgent waits; the loop's caller goes on.
    fn help(&self, inner: &Inner) {
        while self.urgency == Urgency::Urgent || inner.urgent_tasks.load(Ordering::Relaxed) == 0 {
            if !self.run_chunk() {
                return;
            }
        }
    }

    fn run_chunks(&self) {
        while self.run_chunk() {}
    }

    /// Runs the next chunk; `false` when there is none.
    fn run_chunk(&self) -> bool {
        let index = self.next.fetch_add(1, Ordering::Relaxed);
        if index >= self.chunks {
            return false;
        }
        // SAFETY: the plugin's promise to `parallel_for`: callable from any thread for each index once.
        unsafe { (self.body)(self.data, index) }
        true
    }
}

#[derive(Clone, Copy)]
struct LoopPtr(*const Loop);
// SAFETY: a loop is on the list only while its caller waits for it; workers enter under the pool's lock.
unsafe impl Send for LoopPtr {}

struct State {
    urgent: VecDeque<u32>,
    /// With the time since when they wait.
    patient: VecDeque<(u32, u64)>,
    loops: Vec<LoopPtr>,
    idle: usize,
    stop: bool,
    /// Workers that have come to life.
    started: usize,
    /// Workers inside a chunk of somebody's loop, and that loop's caller.
    helping: Vec<(u32, u32)>,
    /// Workers that were given up: they leave when they come back.
    given_up: Vec<u32>,
}

struct Inner {
    state: Mutex<State>,
    /// How many urgent tasks wait; told without the lock.
    urgent_tasks: AtomicUsize,
    wake: Condvar,
    /// A worker has come to life.
    arrived: Condvar,
    threads: usize,
    stopping: AtomicBool,
}

/// A pool of `threads` workers.
pub struct Pool {
    inner: Arc<Inner>,
    workers: Mutex<Vec<(u32, JoinHandle<()>)>>,
    task: Mutex<Option<Task>>,
}

thread_local! {
    static CURRENT: Cell<*const Inner> = const { Cell::new(std::ptr::null()) };
    static NUMBER: Cell<u32> = const { Cell::new(0) };
    static URGENCY: Cell<Urgency> = const { Cell::new(Urgency::Urgent) };
}

/// Says how urgent what the calling thread does is from now on.
#[inline]
pub(crate) fn set_urgency(urgency: Urgency) {
    URGENCY.with(|u| u.set(urgency));
}

/// Number of the calling thread if it runs nodes, else 0.
#[inline]
pub(crate) fn thread_number() -> u32 {
    NUMBER.with(Cell::get)
}

/// Ends what [`Pool::visit`] began.
pub struct Visit<'p> {
    before: *const Inner,
    pool: std::marker::PhantomData<&'p Pool>,
}

impl Drop for Visit<'_> {
    fn drop(&mut self) {
        CURRENT.with(|current| current.set(self.before));
    }
}

/// Gives the calling thread its number.
pub(crate) fn set_thread_number(number: u32) {
    NUMBER.with(|n| n.set(number));
}

/// A number no other thread has.
pub(crate) fn next_thread_number() -> u32 {
    static NEXT: AtomicU32 = AtomicU32::new(1);
    NEXT.fetch_add(1, Ordering::Relaxed)
}

/// Has the calling thread allocate what reading a plan takes once per thread.
pub(crate) fn warm_up() {
    static ANY: LazyLock<ArcSwap<()>> = LazyLock::new(ArcSwap::default);
    drop(ANY.load());
}

impl State {
    /// A loop that has chunks left, of this urgency. Chunks go before tasks: somebody waits for them, and they finish what was begun.
    fn next_loop(&self, urgency: Urgency) -> Option<LoopPtr> {
        self.loops.iter().copied().find(|l| {
            // SAFETY: on the list, so its caller has not returned.
            let l = unsafe { &*l.0 };
            l.urgency == urgency && l.next.load(Ordering::Relaxed) < l.chunks
        })
    }

    /// A task of this urgency; a patient one that has waited too long counts as urgent.
    fn next_task(&mut self, inner: &Inner, urgency: Urgency) -> Option<u32> {
        if urgency == Urgency::Patient {
            return self.patient.pop_front().map(|(task, _)| task);
        }
        let oldest = if self.urgent.is_empty() { None } else { self.patient.front() };
        if oldest.is_some_and(|(_, since_ns)| clock::now_ns().saturating_sub(*since_ns) > LONGEST_PATIENCE_NS) {
            return self.patient.pop_front().map(|(task, _)| task);
        }
        let task = self.urgent.pop_front();
        inner.urgent_tasks.store(self.urgent.len(), Ordering::Relaxed);
        task
    }
}

fn lock(inner: &Inner) -> MutexGuard<'_, State> {
    inner.state.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Pool {
    /// A pool without workers; `start` brings them to life.
    pub fn new(threads: usize) -> Self {
        let state = State {
            urgent: VecDeque::with_capacity(1024),
            patient: VecDeque::with_capacity(1024),
            loops: Vec::with_capacity(64),
            idle: 0,
            stop: false,
            started: 0,
            helping: Vec::with_capacity(64),
            given_up: Vec::new(),
        };
        let inner = Inner {
            state: Mutex::new(state),
            urgent_tasks: AtomicUsize::new(0),
            wake: Condvar::new(),
            arrived: Condvar::new(),
            threads: threads.max(1),
            stopping: AtomicBool::new(false),
        };
        Self { inner: Arc::new(inner), workers: Mutex::new(Vec::new()), task: Mutex::new(None) }
    }

    /// Threads that work.
    pub fn threads(&self) -> usize {
        self.inner.threads
    }

    /// Starts the workers and waits until they are there: what a thread allocates when it begins is not to happen among ticks.
    pub fn start(&self, task: &Task) -> std::io::Result<()> {
        *self.task.lock().unwrap_or_else(PoisonError::into_inner) = Some(Arc::clone(task));
        for _ in 0..self.inner.threads {
            self.add_worker(task)?;
        }
        let mut state = lock(&self.inner);
        while state.started < self.inner.threads {
            state = self.inner.arrived.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        Ok(())
    }

    fn add_worker(&self, task: &Task) -> std::io::Result<()> {
        let number = next_thread_number();
        let (inner, task) = (Arc::clone(&self.inner), Arc::clone(task));
        let handle = std::thread::Builder::new().name(format!("pool-{number}")).spawn(move || {
            set_thread_number(number);
            worker(&inner, &task, number);
        })?;
        self.workers.lock().unwrap_or_else(PoisonError::into_inner).push((number, handle));
        Ok(())
    }

    /// Gives a thread up that does not return from a node, with all workers that are stuck in its loops, and starts new workers in
    /// their place. The thread itself may be no worker. They leave on their own should they ever return.
    pub fn give_up(&self, thread: u32) -> std::io::Result<()> {
        let mut workers = self.workers.lock().unwrap_or_else(PoisonError::into_inner);
        let mut lost = Vec::new();
        let mut state = lock(&self.inner);
        let helpers = state.helping.iter().filter(|(_, caller)| *caller == thread).map(|(worker, _)| *worker);
        for number in helpers.chain([thread]).collect::<Vec<_>>() {
            if let Some(at) = workers.iter().position(|(n, _)| *n == number) {
                // Dropping the handle lets the thread go.
                lost.push(workers.swap_remove(at).0);
            }
        }
        // Nobody else shall enter what the thread is stuck in.
        // SAFETY: on the list, so its caller has not returned.
        state.loops.retain(|l| unsafe { &*l.0 }.caller_number != thread);
        state.given_up.extend(&lost);
        drop(state);
        drop(workers);
        let task = self.task.lock().unwrap_or_else(PoisonError::into_inner).clone();
        for _ in lost {
            if let Some(task) = &task {
                self.add_worker(task)?;
            }
        }
        Ok(())
    }

    /// Makes this pool the one that `parallel_for` uses on the calling thread.
    pub fn enter(&self) {
        CURRENT.with(|current| current.set(Arc::as_ptr(&self.inner)));
    }

    /// Like [`Self::enter`], until the guard goes.
    pub fn visit(&self) -> Visit<'_> {
        let before = CURRENT.with(|current| current.replace(Arc::as_ptr(&self.inner)));
        Visit { before, pool: std::marker::PhantomData }
    }

    /// Queues a node task.
    pub fn push(&self, task: u32, urgency: Urgency) {
        let mut state = lock(&self.inner);
        match urgency {
            Urgency::Urgent => {
                state.urgent.push_back(task);
                self.inner.urgent_tasks.store(state.urgent.len(), Ordering::Relaxed);
            }
            Urgency::Patient => state.patient.push_back((task, clock::now_ns())),
        }
        let wake = state.idle > 0;
        drop(state);
        if wake {
            self.inner.wake.notify_one();
        }
    }

    /// Whether an urgent task waits for a worker.
    #[inline]
    pub fn is_pressed(&self) -> bool {
        self.inner.urgent_tasks.load(Ordering::Relaxed) > 0
    }

    /// Lets the workers finish what is queued and joins them.
    pub fn stop(&self) {
        self.inner.stopping.store(true, Ordering::Relaxed);
        lock(&self.inner).stop = true;
        self.inner.wake.notify_all();
        let workers = std::mem::take(&mut *self.workers.lock().unwrap_or_else(PoisonError::into_inner));
        for (_, worker) in workers {
            let _ = worker.join();
        }
    }
}

fn worker(inner: &Arc<Inner>, task: &Task, number: u32) {
    CURRENT.with(|current| current.set(Arc::as_ptr(inner)));
    warm_up();
    let mut walk = Walk::default();
    let mut state = lock(inner);
    state.started += 1;
    inner.arrived.notify_all();
    loop {
        if let Some(at) = state.given_up.iter().position(|n| *n == number) {
            state.given_up.swap_remove(at);
            return;
        }
        let found = state.next_loop(Urgency::Urgent);
        let urgent = if found.is_none() { state.next_task(inner, Urgency::Urgent) } else { None };
        let found = found.or_else(|| if urgent.is_none() { state.next_loop(Urgency::Patient) } else { None });
        if let Some(found) = found {
            // SAFETY: as above; counted as helper under the lock, so the caller waits for us.
            let this = unsafe { &*found.0 };
            this.helpers.fetch_add(1, Ordering::Relaxed);
            state.helping.push((number, this.caller_number));
            drop(state);
            set_urgency(this.urgency);
            who::help(this.doing, || this.help(inner));
            let caller = this.caller.clone();
            if this.helpers.fetch_sub(1, Ordering::Release) == 1 {
                // `this` may be gone now; its caller's handle was copied.
                caller.unpark();
            }
            state = lock(inner);
            if let Some(at) = state.helping.iter().position(|(n, _)| *n == number) {
                state.helping.swap_remove(at);
            }
            continue;
        }
        if let Some(next) = urgent.or_else(|| state.next_task(inner, Urgency::Patient)) {
            drop(state);
            task(next, &mut walk);
            state = lock(inner);
            continue;
        }
        if state.stop {
            return;
        }
        state.idle += 1;
        state = inner.wake.wait(state).unwrap_or_else(PoisonError::into_inner);
        state.idle -= 1;
    }
}

/// Runs `body(data, i)` for `i` in `0..chunks`; the caller takes part and, when out of chunks, waits for helpers of
/// this loop only.
///
/// # Safety
/// `body` may be called from any thread, once per index, with `data` until this returns.
pub unsafe fn parallel_for(chunks: usize, body: ChunkFn, data: *mut c_void) -> bool {
    let Some(body) = body else { return false };
    let inner = CURRENT.with(Cell::get);
    // SAFETY: set by `enter` or `worker` on this thread while the pool lives.
    let inner = unsafe { inner.as_ref() };
    let Some(inner) = inner.filter(|i| i.threads > 1 && chunks > 1) else {
        for index in 0..chunks {
            // SAFETY: the caller's promise.
            unsafe { body(data, index) }
        }
        return true;
    };
    let this = Loop {
        body,
        data,
        chunks,
        next: AtomicUsize::new(0),
        helpers: AtomicU32::new(0),
        caller: std::thread::current(),
        caller_number: thread_number(),
        urgency: URGENCY.with(Cell::get),
        doing: who::doing(),
    };
    let wanted = (inner.threads - 1).min(chunks - 1);
    let mut state = lock(inner);
    state.loops.push(LoopPtr(&raw const this));
    let wake = state.idle.min(wanted);
    drop(state);
    for _ in 0..wake {
        inner.wake.notify_one();
    }
    this.run_chunks();
    let mut state = lock(inner);
    state.loops.retain(|l| !std::ptr::eq(l.0, &raw const this));
    drop(state);
    // No worker can enter any more. Helpers run at most one chunk each now: a short wait.
    let mut spins = 0;
    while this.helpers.load(Ordering::Acquire) != 0 {
        if spins < 64 {
            spins += 1;
            std::hint::spin_loop();
        } else {
            std::thread::park_timeout(std::time::Duration::from_micros(200));
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::AtomicU64;

    unsafe extern "C" fn add(data: *mut c_void, index: usize) {
        // SAFETY: the test passes a counter.
        unsafe { &*data.cast::<AtomicU64>() }.fetch_add(index as u64 + 1, Ordering::Relaxed);
    }

    #[test]
    fn every_chunk_runs_once() {
        for threads in [1, 2, 8] {
            let pool = Pool::new(threads);
            pool.start(&(Arc::new(|_: u32, _: &mut Walk| {}) as Task)).expect("threads");
            pool.enter();
            for chunks in [0usize, 1, 2, 7, 1000] {
                let sum = AtomicU64::new(0);
                // SAFETY: `add` takes a counter.
                assert!(unsafe { parallel_for(chunks, Some(add), (&raw const sum).cast_mut().cast()) });
                assert_eq!(sum.load(Ordering::Relaxed), (chunks * (chunks + 1) / 2) as u64);
            }
            pool.stop();
            CURRENT.with(|current| current.set(std::ptr::null()));
        }
    }

    unsafe extern "C" fn nested(data: *mut c_void, _: usize) {
        // SAFETY: `add` takes the same counter.
        unsafe { parallel_for(10, Some(add), data) };
    }

    #[test]
    fn urgent_tasks_go_first_and_patient_ones_do_not_starve() {
        let pool = Pool::new(1);
        let (held, hold) = std::sync::mpsc::channel::<()>();
        let (done, seen) = std::sync::mpsc::channel();
        let hold = Mutex::new(hold);
        let task: Task = Arc::new(move |task, _: &mut Walk| {
            if task == 0 {
                // The one worker is kept until all others wait.
                let _ = hold.lock().unwrap_or_else(PoisonError::into_inner).recv();
            }
            let _ = done.send(task);
        });
        pool.start(&task).expect("threads");
        pool.push(0, Urgency::Urgent);
        pool.push(1, Urgency::Patient);
        pool.push(2, Urgency::Urgent);
        pool.push(3, Urgency::Urgent);
        let order = |count: usize| seen.iter().take(count).collect::<Vec<u32>>();
        held.send(()).expect("the worker waits");
        assert_eq!(order(4), [0, 2, 3, 1]);
        assert!(!pool.is_pressed());
        // What has waited too long goes first.
        pool.push(0, Urgency::Urgent);
        pool.push(4, Urgency::Patient);
        std::thread::sleep(std::time::Duration::from_nanos(LONGEST_PATIENCE_NS * 3 / 2));
        pool.push(5, Urgency::Urgent);
        held.send(()).expect("the worker waits");
        assert_eq!(order(3), [0, 4, 5]);
        pool.stop();
    }

    #[test]
    fn loops_nest() {
        let pool = Pool::new(3);
        pool.start(&(Arc::new(|_: u32, _: &mut Walk| {}) as Task)).expect("threads");
        pool.enter();
        let sum = AtomicU64::new(0);
        // SAFETY: `nested` takes a counter.
        unsafe { parallel_for(20, Some(nested), (&raw const sum).cast_mut().cast()) };
        assert_eq!(sum.load(Ordering::Relaxed), 20 * 55);
        pool.stop();
        CURRENT.with(|current| current.set(std::ptr::null()));
    }
}
