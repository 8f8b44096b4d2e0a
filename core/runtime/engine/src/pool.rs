//! The thread pool: node tasks, and parallel loops inside nodes.

use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::ffi::c_void;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, LazyLock, Mutex, OnceLock, PoisonError};
use std::thread::JoinHandle;
use std::time::Instant;

use arc_swap::ArcSwap;
use panoscope_abi::ChunkFn;

use crate::clock;
use crate::current_node::{self, CurrentWork};
use crate::outbox::panic_words;
use crate::retained;
use crate::scratch::Scratch;
use crate::sync::lock;
use crate::thread_id;

/// Maximum wait of a patient task behind urgent ones.
const MAX_PATIENCE_NS: u64 = 100_000_000;
/// Time that urgent tasks wait while no worker returns from its task, until another worker is added.
const MAX_STALL_NS: u64 = 100_000_000;

/// Runs a node task; called on a worker.
pub type Task = Arc<dyn Fn(u32, &mut Scratch) + Send + Sync>;

/// A parallel loop. It is on the stack of its caller, who waits until all chunks are done.
struct Loop {
    body: unsafe extern "C" fn(*mut c_void, usize),
    data: *mut c_void,
    chunks: usize,
    next: AtomicUsize,
    /// Workers inside `help` of this loop.
    helpers: AtomicU32,
    caller: std::thread::Thread,
    caller_number: u32,
    /// Urgency of the node that it belongs to.
    urgency: Urgency,
    /// The work of the node that it belongs to.
    doing: CurrentWork,
    /// The frames retained by the instance whose call it is part of.
    scope: retained::Scope,
    /// Whether a helper retained a frame for it, or was refused one.
    attention: AtomicBool,
}

/// Order of tasks when there are more tasks than threads.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Urgency {
    /// A tick waits for it.
    #[default]
    Urgent,
    /// Its readers take the newest value that exists, so it may wait for urgent tasks.
    Patient,
}

impl Loop {
    /// Runs chunks until none is left. A helper leaves a patient loop when an urgent task waits; the loop's caller
    /// continues.
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
// SAFETY: a loop is on the list only while its caller waits for it, and workers enter it under the pool's lock.
unsafe impl Send for LoopPtr {}

struct State {
    urgent: VecDeque<u32>,
    /// Patient tasks, each with the time at which it was queued.
    patient: VecDeque<(u32, u64)>,
    loops: Vec<LoopPtr>,
    idle: usize,
    stop: bool,
    /// Workers that are running.
    started: usize,
    /// Workers inside a chunk of another thread's loop, and that thread.
    helping: Vec<(u32, u32)>,
    /// Abandoned threads: they end when they return, and no worker helps them.
    given_up: Vec<u32>,
    /// Workers that were started and not abandoned.
    live: usize,
    /// Extra workers while all others are stuck, see [`Pool::relieve`].
    reliefs: Vec<u32>,
    /// Number of times that a worker returned for another task.
    turns: u64,
    /// Time since which urgent tasks wait while `returns` does not change; 0 if none waits.
    stalled: (u64, u64),
}

impl State {
    /// Wait of the oldest patient task, ns.
    fn patient_for(&self, now_ns: u64) -> u64 {
        self.patient.front().map_or(0, |(_, since_ns)| now_ns.saturating_sub(*since_ns))
    }

    /// A thread with all workers that are inside its loops, inside theirs, and so on.
    fn stuck_with(&self, thread: u32) -> Vec<u32> {
        let mut all = vec![thread];
        let mut at = 0;
        while let Some(&caller) = all.get(at) {
            for &(worker, of) in &self.helping {
                if of == caller && !all.contains(&worker) {
                    all.push(worker);
                }
            }
            at += 1;
        }
        all
    }
}

/// Receives the name of a worker that panicked and its message.
pub(crate) type PanicFn = Box<dyn Fn(&str, &str) + Send + Sync>;

struct Inner {
    state: Mutex<State>,
    /// Number of waiting urgent tasks; read without the lock.
    urgent_tasks: AtomicUsize,
    wake: Condvar,
    /// A worker has started.
    arrived: Condvar,
    threads: usize,
    panicked: OnceLock<PanicFn>,
}

/// A pool of `threads` workers.
pub struct Pool {
    inner: Arc<Inner>,
    workers: Mutex<Vec<(u32, JoinHandle<()>)>>,
    task: Mutex<Option<Task>>,
}

thread_local! {
    /// The pool that runs the loops of this thread.
    static CURRENT: RefCell<Option<Arc<Inner>>> = const { RefCell::new(None) };
    static URGENCY: Cell<Urgency> = const { Cell::new(Urgency::Urgent) };
}

/// Sets the urgency of the calling thread's work.
#[inline]
pub(crate) fn set_urgency(urgency: Urgency) {
    URGENCY.with(|u| u.set(urgency));
}

/// Ends [`Pool::visit`] on drop, on the same thread.
pub struct Visit<'p> {
    before: Option<Arc<Inner>>,
    pool: std::marker::PhantomData<(&'p Pool, *const ())>,
}

impl Drop for Visit<'_> {
    fn drop(&mut self) {
        CURRENT.set(self.before.take());
    }
}

/// Makes the calling thread allocate what the first read of a plan needs.
pub(crate) fn warm_up() {
    static ANY: LazyLock<ArcSwap<()>> = LazyLock::new(ArcSwap::default);
    drop(ANY.load());
}

impl State {
    /// A loop of this urgency with chunks left. Chunks precede tasks, because a caller waits for them.
    fn next_loop(&self, urgency: Urgency) -> Option<LoopPtr> {
        self.loops.iter().copied().find(|l| {
            // SAFETY: the loop is on the list, so its caller has not returned.
            let l = unsafe { &*l.0 };
            l.urgency == urgency && l.next.load(Ordering::Relaxed) < l.chunks
        })
    }

    /// A task of this urgency; a patient one that has waited too long counts as urgent.
    fn next_task(&mut self, inner: &Inner, urgency: Urgency) -> Option<u32> {
        if urgency == Urgency::Patient {
            return self.patient.pop_front().map(|(task, _)| task);
        }
        // Without urgent tasks there is nothing to compare with, so skip reading the clock.
        let compared = (!self.urgent.is_empty() || !self.reliefs.is_empty()) && !self.patient.is_empty();
        if compared && self.patient_for(clock::now_ns()) > MAX_PATIENCE_NS {
            return self.patient.pop_front().map(|(task, _)| task);
        }
        let task = self.urgent.pop_front();
        inner.urgent_tasks.store(self.urgent.len(), Ordering::Relaxed);
        task
    }
}

impl Pool {
    /// A pool without workers; `start` starts them.
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
            live: 0,
            reliefs: Vec::new(),
            turns: 0,
            stalled: (0, 0),
        };
        let inner = Inner {
            state: Mutex::new(state),
            urgent_tasks: AtomicUsize::new(0),
            wake: Condvar::new(),
            arrived: Condvar::new(),
            threads: threads.max(1),
            panicked: OnceLock::new(),
        };
        Self { inner: Arc::new(inner), workers: Mutex::new(Vec::new()), task: Mutex::new(None) }
    }

    /// Number of workers.
    pub fn threads(&self) -> usize {
        self.inner.threads
    }

    /// Sets the receiver of panics of workers. A worker continues after a panic.
    pub(crate) fn on_panic(&self, tell: PanicFn) {
        let _ = self.inner.panicked.set(tell);
    }

    /// Starts the workers and waits until they run, so that the allocations of a starting thread do not fall between
    /// ticks.
    pub fn start(&self, task: &Task) -> std::io::Result<()> {
        *lock(&self.task) = Some(Arc::clone(task));
        self.fill(task)?;
        let mut state = lock(&self.inner.state);
        while state.started < self.inner.threads {
            state = self.inner.arrived.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        Ok(())
    }

    /// Starts workers until there are as many as there should be.
    fn fill(&self, task: &Task) -> std::io::Result<()> {
        loop {
            let mut state = lock(&self.inner.state);
            if state.live >= self.inner.threads {
                return Ok(());
            }
            state.live += 1;
            drop(state);
            if let Err(error) = self.add_worker(task, thread_id::next(), false) {
                lock(&self.inner.state).live -= 1;
                return Err(error);
            }
        }
    }

    /// Starts a worker that the caller has counted.
    fn add_worker(&self, task: &Task, number: u32, relief: bool) -> std::io::Result<()> {
        let (inner, task) = (Arc::clone(&self.inner), Arc::clone(task));
        let name = format!("pool-{number}");
        let started = std::thread::Builder::new().name(name.clone()).spawn(move || {
            thread_id::set(number);
            while let Err(payload) = catch_unwind(AssertUnwindSafe(|| worker(&inner, &task, number, relief))) {
                if let Some(tell) = inner.panicked.get() {
                    tell(&name, panic_words(&*payload));
                }
            }
        });
        let mut workers = lock(&self.workers);
        workers.retain(|(_, worker)| !worker.is_finished());
        workers.push((number, started?));
        Ok(())
    }

    /// Abandons a thread that does not return from a node, with all workers that are stuck in its loops or in theirs,
    /// and starts new workers in their place. The thread need not be a worker. Abandoned threads end when they return.
    pub fn give_up(&self, thread: u32) -> std::io::Result<()> {
        if thread == 0 {
            return Ok(());
        }
        let mut workers = lock(&self.workers);
        let mut state = lock(&self.inner.state);
        let stuck = state.stuck_with(thread);
        for number in &stuck {
            if let Some(at) = workers.iter().position(|(n, _)| n == number) {
                // Dropping the handle detaches the thread.
                drop(workers.swap_remove(at));
                match state.reliefs.iter().position(|n| n == number) {
                    Some(at) => _ = state.reliefs.swap_remove(at),
                    None => state.live -= 1,
                }
            }
        }
        // No other worker may enter the loops that they are stuck in.
        // SAFETY: the loop is on the list, so its caller has not returned.
        state.loops.retain(|l| !stuck.contains(&unsafe { &*l.0 }.caller_number));
        state.given_up.extend(&stuck);
        drop(state);
        drop(workers);
        let task = lock(&self.task).clone();
        task.map_or(Ok(()), |task| self.fill(&task))
    }

    /// Records the return of an abandoned thread that is not a worker.
    pub(crate) fn left(&self, thread: u32) {
        lock(&self.inner.state).given_up.retain(|n| *n != thread);
    }

    /// Called a few times per second. If urgent tasks wait and no worker returns, because all are in calls that may be
    /// hung, adds a worker so that unrelated nodes continue. That worker ends when no urgent task waits.
    pub(crate) fn relieve(&self, now_ns: u64) -> std::io::Result<bool> {
        let mut state = lock(&self.inner.state);
        let waiting = !state.urgent.is_empty() || state.patient_for(now_ns) > MAX_PATIENCE_NS;
        let (since_ns, turns) = state.stalled;
        if !waiting || state.idle > 0 || since_ns == 0 || turns != state.turns {
            state.stalled = (if waiting { now_ns.max(1) } else { 0 }, state.turns);
            return Ok(false);
        }
        if now_ns.saturating_sub(since_ns) < MAX_STALL_NS || state.reliefs.len() >= self.inner.threads {
            return Ok(false);
        }
        let number = thread_id::next();
        state.reliefs.push(number);
        state.stalled = (now_ns, turns);
        drop(state);
        let task = lock(&self.task).clone();
        let started = task.map_or(Ok(false), |task| self.add_worker(&task, number, true).map(|()| true));
        if !matches!(started, Ok(true)) {
            lock(&self.inner.state).reliefs.retain(|n| *n != number);
        }
        started
    }

    /// Makes this pool the one that `parallel_for` uses on the calling thread.
    pub fn enter(&self) {
        CURRENT.set(Some(Arc::clone(&self.inner)));
    }

    /// Like [`Self::enter`], until the guard is dropped.
    pub fn visit(&self) -> Visit<'_> {
        Visit { before: CURRENT.replace(Some(Arc::clone(&self.inner))), pool: std::marker::PhantomData }
    }

    /// Queues a node task.
    pub fn push(&self, task: u32, urgency: Urgency) {
        let mut state = lock(&self.inner.state);
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

    /// Lets the workers finish the queue and joins them until the deadline. A worker that is still busy then
    /// is detached. Returns whether all were joined.
    pub fn stop(&self, until: Instant) -> bool {
        lock(&self.inner.state).stop = true;
        self.inner.wake.notify_all();
        let workers = std::mem::take(&mut *lock(&self.workers));
        workers.into_iter().fold(true, |all, (_, worker)| join_until(worker, until) && all)
    }
}

/// Waits for the end of a thread until the deadline. Returns whether it has ended.
pub(crate) fn join_until<T>(thread: JoinHandle<T>, until: Instant) -> bool {
    while !thread.is_finished() {
        if Instant::now() >= until {
            return false;
        }
        std::thread::sleep(std::time::Duration::from_micros(200));
    }
    let _ = thread.join();
    true
}

/// Runs tasks until the pool stops or the worker is abandoned. An extra worker takes only urgent tasks and ends when
/// there is none; it helps in no loop, because the others may be stuck in one.
fn worker(inner: &Arc<Inner>, task: &Task, number: u32, relief: bool) {
    CURRENT.set(Some(Arc::clone(inner)));
    warm_up();
    let mut scratch = Scratch::default();
    let mut state = lock(&inner.state);
    state.started += 1;
    inner.arrived.notify_all();
    loop {
        state.turns = state.turns.wrapping_add(1);
        if let Some(at) = state.given_up.iter().position(|n| *n == number) {
            state.given_up.swap_remove(at);
            return;
        }
        let found = if relief { None } else { state.next_loop(Urgency::Urgent) };
        let urgent = if found.is_none() { state.next_task(inner, Urgency::Urgent) } else { None };
        if relief && urgent.is_none() {
            state.reliefs.retain(|n| *n != number);
            return;
        }
        let found = found.or_else(|| if urgent.is_none() { state.next_loop(Urgency::Patient) } else { None });
        if let Some(found) = found {
            // SAFETY: the loop was on the list and this worker was counted as its helper under the lock, so its caller waits.
            let this = unsafe { &*found.0 };
            this.helpers.fetch_add(1, Ordering::Relaxed);
            state.helping.push((number, this.caller_number));
            drop(state);
            set_urgency(this.urgency);
            // SAFETY: the call that the loop is part of does not end before its helpers have left.
            if current_node::help(this.doing, || unsafe { retained::within(this.scope, || this.help(inner)) }) {
                this.attention.store(true, Ordering::Relaxed);
            }
            let caller = this.caller.clone();
            if this.helpers.fetch_sub(1, Ordering::Release) == 1 {
                // `this` may be gone now; its caller's handle was copied.
                caller.unpark();
            }
            state = lock(&inner.state);
            if let Some(at) = state.helping.iter().position(|(n, _)| *n == number) {
                state.helping.swap_remove(at);
            }
            continue;
        }
        if let Some(next) = urgent.or_else(|| state.next_task(inner, Urgency::Patient)) {
            drop(state);
            task(next, &mut scratch);
            state = lock(&inner.state);
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
    let alone = || {
        for index in 0..chunks {
            // SAFETY: the caller's promise.
            unsafe { body(data, index) }
        }
        true
    };
    // A copy: a chunk may enter another pool, and leave it.
    let inner = CURRENT.try_with(|current| current.borrow().clone()).ok().flatten();
    let Some(inner) = inner.filter(|i| i.threads > 1 && chunks > 1) else { return alone() };
    let inner = &*inner;
    let this = Loop {
        body,
        data,
        chunks,
        next: AtomicUsize::new(0),
        helpers: AtomicU32::new(0),
        caller: std::thread::current(),
        caller_number: thread_id::current(),
        urgency: URGENCY.with(Cell::get),
        doing: current_node::current_work(),
        scope: retained::scope(),
        attention: AtomicBool::new(false),
    };
    let wanted = (inner.threads - 1).min(chunks - 1);
    let mut state = lock(&inner.state);
    if state.given_up.contains(&this.caller_number) {
        // A helper that gets stuck would go unnoticed.
        drop(state);
        return alone();
    }
    state.loops.push(LoopPtr(&raw const this));
    let wake = state.idle.min(wanted);
    drop(state);
    for _ in 0..wake {
        inner.wake.notify_one();
    }
    this.run_chunks();
    let mut state = lock(&inner.state);
    state.loops.retain(|l| !std::ptr::eq(l.0, &raw const this));
    drop(state);
    // No worker can enter from here on, and each helper runs at most one more chunk: the wait is short.
    let mut spins = 0;
    while this.helpers.load(Ordering::Acquire) != 0 {
        if spins < 64 {
            spins += 1;
            std::hint::spin_loop();
        } else {
            std::thread::park_timeout(std::time::Duration::from_micros(200));
        }
    }
    if this.attention.load(Ordering::Relaxed) {
        retained::set_attention();
    }
    true
}

#[cfg(test)]
mod tests;
