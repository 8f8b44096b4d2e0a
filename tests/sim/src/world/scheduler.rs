//! Decides which thread runs, and when time passes.

use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use crate::world::random::Dice;

/// Settings of a world.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Seed of all decisions.
    pub seed: u64,
    /// Average number of operations between two decisions about which thread runs.
    pub switch_every: u32,
    /// Whether threads have priorities, which change a few times in a run, instead of equal chances (Burckhardt et al., 2010).
    pub priorities: bool,
    /// On average, one in this many decisions stalls the running thread for up to `longest_stall_ns`; 0 for none.
    pub stall_one_in: u32,
    /// The same for the first thread alone, which changes the work of the others.
    pub stall_first_one_in: u32,
    /// Maximum duration of a stall, ns.
    pub longest_stall_ns: u64,
    /// Maximum delay with which a thread wakes after its deadline, ns.
    pub longest_delay_ns: u64,
    /// Number of decisions after which a run counts as endless.
    pub most_decisions: u64,
    /// Maximum number of threads at a time; `None` for no limit.
    pub most_threads: Option<usize>,
    /// Whether to keep the trace as text, not only its hash.
    pub keep_trace: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            seed: 0,
            switch_every: 12,
            priorities: false,
            stall_one_in: 0,
            stall_first_one_in: 0,
            longest_stall_ns: 20_000_000,
            longest_delay_ns: 60_000,
            most_decisions: 3_000_000,
            most_threads: None,
            keep_trace: false,
        }
    }
}

/// A thread that did not end.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Left {
    /// The thread's name.
    pub name: String,
    /// What it waits for.
    pub waits_for: &'static str,
}

/// Why a run did not end.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Trouble {
    /// All threads wait for each other, including the first one.
    Deadlock,
    /// More decisions than [`Settings::most_decisions`].
    Endless,
    /// The first thread panicked, with this message.
    Panic(String),
}

/// How a run ended.
#[derive(Debug)]
pub struct Ended<R> {
    /// The result of the first thread.
    pub result: Result<R, Trouble>,
    /// Threads that wait for an event that never occurs.
    pub left: Vec<Left>,
    /// Simulated duration of the run, ns.
    pub simulated_ns: u64,
    /// Number of decisions about which thread runs.
    pub decisions: u64,
    /// Number of threads that were started.
    pub threads: usize,
    /// Hash of all decisions and of everything passed to [`note`].
    pub trace_hash: u64,
    /// The trace as text, if it was kept.
    pub trace: Vec<String>,
}

/// What a thread waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Key {
    /// A lock or a condition variable, by address.
    Address(usize),
    /// Another thread unparks it.
    Park,
    /// Only for time to pass.
    Sleep,
    /// The end of a thread.
    End(usize),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Status {
    Ready,
    Waiting { key: Key, until_ns: u64, what: &'static str },
    Ended,
}

const NEVER_NS: u64 = u64::MAX;
/// Time at which a world begins.
const START_NS: u64 = 1_000_000;

/// Signals a thread of the world to run.
#[derive(Default)]
struct Baton {
    given: AtomicBool,
    os: Mutex<Option<std::thread::Thread>>,
}

impl Baton {
    fn give(&self) {
        self.given.store(true, Ordering::Release);
        if let Some(os) = &*lock(&self.os) {
            os.unpark();
        }
    }

    fn take(&self) {
        *lock(&self.os) = Some(std::thread::current());
        while !self.given.swap(false, Ordering::Acquire) {
            std::thread::park();
        }
    }
}

struct Task {
    name: String,
    status: Status,
    baton: Arc<Baton>,
    /// Whether the last wait was ended by another thread.
    notified: bool,
    /// Whether the next park returns at once.
    permit: bool,
    priority: u64,
    /// Joined by the next thread that runs after this one ended, so that its thread-locals are destroyed by then.
    os: Option<JoinHandle<()>>,
}

struct State {
    tasks: Vec<Task>,
    /// Tasks that have not ended, in order of their start.
    live: Vec<usize>,
    /// Ended, not yet joined.
    ended: Vec<usize>,
    now_ns: u64,
    dice: Dice,
    decisions: u64,
    trace_hash: u64,
    trace: Vec<String>,
    /// Set when the first thread has ended.
    first_ended: bool,
    over: Option<Result<(), Trouble>>,
}

pub(crate) struct World {
    settings: Settings,
    state: Mutex<State>,
    over: Condvar,
    /// Operations until the next decision.
    countdown: AtomicU32,
}

thread_local! {
    /// World and number of this thread; constant and without a destructor, so that it can be read while other thread-locals are destroyed.
    static HERE: Cell<Option<(*const World, usize)>> = const { Cell::new(None) };
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn here<'a>() -> Option<(&'a World, usize)> {
    let (world, me) = HERE.get()?;
    // SAFETY: set by `enter` for as long as the thread's closure, which owns an `Arc` of the world, runs.
    Some((unsafe { &*world }, me))
}

/// Whether the calling thread belongs to a world.
pub fn is_inside() -> bool {
    HERE.get().is_some()
}

/// A point at which another thread may run. Does nothing outside a world.
#[inline]
pub fn point() {
    if let Some((world, me)) = here()
        && world.countdown.fetch_sub(1, Ordering::Relaxed) <= 1
    {
        world.decide(me);
    }
}

/// Adds text to the trace: it must be the same in each run of a seed.
pub fn note(words: impl FnOnce() -> String) {
    if let Some((world, me)) = here() {
        let words = words();
        lock(&world.state).record(&world.settings, me, &words);
    }
}

pub(crate) fn now_ns() -> u64 {
    static OUTSIDE_NS: std::sync::atomic::AtomicU64 = std::sync::atomic::AtomicU64::new(1);
    let Some((world, _)) = here() else { return OUTSIDE_NS.fetch_add(1, Ordering::Relaxed) };
    point();
    let mut state = lock(&world.state);
    // A clock never shows the same time twice.
    state.now_ns += state.dice.within(1, 300);
    state.now_ns
}

/// Lets other runnable threads run.
pub(crate) fn yield_now() {
    if let Some((world, me)) = here() {
        let mut state = lock(&world.state);
        state.tasks[me].priority = 0;
        let others = state.live.iter().any(|&task| task != me && state.is_ready(task));
        if others {
            let until_ns = state.now_ns + 1;
            state.tasks[me].status = Status::Waiting { key: Key::Sleep, until_ns, what: "others" };
        }
        world.pass_on(state, me);
    }
}

/// Waits for `key`, at most `limit_ns`. Returns whether another thread ended the wait. May return early if `is_spurious`.
pub(crate) fn wait_for(key: Key, limit_ns: Option<u64>, what: &'static str, is_spurious: bool) -> bool {
    let Some((world, me)) = here() else { panic!("a thread outside of a simulated world would wait for ever") };
    let mut state = lock(&world.state);
    let longest = world.settings.longest_delay_ns;
    let mut until_ns = match limit_ns {
        Some(limit) => state.now_ns.saturating_add(limit).saturating_add(state.dice.within(0, longest)),
        None => NEVER_NS,
    };
    let mut notified = false;
    if is_spurious && state.dice.one_in(97) {
        (until_ns, notified) = (state.now_ns + 1, true);
    }
    let task = &mut state.tasks[me];
    task.notified = notified;
    task.status = Status::Waiting { key, until_ns, what };
    world.pass_on(state, me);
    lock(&world.state).tasks[me].notified
}

/// Parks the calling thread. May return early.
pub(crate) fn park(limit_ns: Option<u64>) {
    point();
    let Some((world, me)) = here() else { return };
    if std::mem::replace(&mut lock(&world.state).tasks[me].permit, false) {
        return;
    }
    wait_for(Key::Park, limit_ns, "unpark", true);
    lock(&world.state).tasks[me].permit = false;
}

/// Ends the wait of all threads that wait for `key`, or of one.
pub(crate) fn wake(key: Key, all: bool) {
    let Some((world, _)) = here() else { return };
    let mut state = lock(&world.state);
    // A thread whose time is over no longer waits: it takes no notification from another.
    let waits = |state: &State, task: usize| matches!(state.tasks[task].status, Status::Waiting { key: k, until_ns, .. } if k == key && until_ns > state.now_ns);
    let waiting: Vec<usize> = state.live.iter().copied().filter(|&task| waits(&state, task)).collect();
    if waiting.is_empty() {
        return;
    }
    let chosen = state.dice.below(waiting.len());
    for (at, task) in waiting.into_iter().enumerate() {
        if all || at == chosen {
            state.tasks[task].status = Status::Ready;
            state.tasks[task].notified = true;
        }
    }
}

/// Handle of a thread of a world.
#[derive(Clone)]
pub(crate) struct TaskRef {
    world: Arc<World>,
    number: usize,
}

impl TaskRef {
    pub fn current() -> Option<Self> {
        let (world, number) = HERE.get()?;
        // SAFETY: `start` took the pointer from an `Arc` that the closure of this thread owns.
        let world = unsafe {
            Arc::increment_strong_count(world);
            Arc::from_raw(world)
        };
        Some(Self { world, number })
    }

    pub fn unpark(&self) {
        point();
        let mut state = lock(&self.world.state);
        let task = &mut state.tasks[self.number];
        match task.status {
            Status::Waiting { key: Key::Park, .. } => {
                task.status = Status::Ready;
                task.notified = true;
            }
            Status::Waiting { .. } | Status::Ready => task.permit = true,
            Status::Ended => {}
        }
    }

    pub fn name(&self) -> String {
        lock(&self.world.state).tasks[self.number].name.clone()
    }

    pub fn has_ended(&self) -> bool {
        point();
        lock(&self.world.state).tasks[self.number].status == Status::Ended
    }

    pub fn wait_for_end(&self) {
        while !self.has_ended() {
            wait_for(Key::End(self.number), None, "the end of a thread", false);
        }
    }
}

/// Starts a thread in the world of the calling one.
pub(crate) fn spawn(name: String, work: impl FnOnce() + Send + 'static) -> std::io::Result<TaskRef> {
    let parent = TaskRef::current().ok_or_else(|| std::io::Error::other("no simulated world"))?;
    let task = parent.world.start(name, work)?;
    point();
    Ok(task)
}

impl State {
    fn is_ready(&self, task: usize) -> bool {
        match self.tasks[task].status {
            Status::Ready => true,
            Status::Waiting { until_ns, .. } => until_ns <= self.now_ns,
            Status::Ended => false,
        }
    }

    fn record(&mut self, settings: &Settings, task: usize, words: &str) {
        for byte in (task as u32).to_le_bytes().iter().chain(words.as_bytes()) {
            self.trace_hash = (self.trace_hash ^ u64::from(*byte)).wrapping_mul(0x100_0000_01b3);
        }
        self.trace_hash = (self.trace_hash ^ self.now_ns).wrapping_mul(0x100_0000_01b3);
        if settings.keep_trace {
            let line = format!("{:>14.6} ms  {:<20} {words}", self.now_ns as f64 / 1e6, self.tasks[task].name);
            self.trace.push(line);
        }
    }

    /// Selects the next thread. Lets time pass if none can run.
    fn choose(&mut self, settings: &Settings) -> Result<usize, Option<Trouble>> {
        loop {
            let mut ready = [0usize; 64];
            let mut count = 0;
            let mut next_ns = NEVER_NS;
            for &task in &self.live {
                if self.is_ready(task) {
                    if count < ready.len() {
                        ready[count] = task;
                        count += 1;
                    }
                } else if let Status::Waiting { until_ns, .. } = self.tasks[task].status {
                    next_ns = next_ns.min(until_ns);
                }
            }
            if count == 0 {
                if next_ns == NEVER_NS {
                    return Err(if self.first_ended { None } else { Some(Trouble::Deadlock) });
                }
                self.now_ns = next_ns;
                continue;
            }
            let ready = &ready[..count];
            let chosen = if settings.priorities {
                ready.iter().copied().max_by_key(|&task| (self.tasks[task].priority, task)).unwrap_or(ready[0])
            } else {
                *self.dice.pick(ready)
            };
            return Ok(chosen);
        }
    }
}

impl World {
    /// Decides whether the calling thread continues.
    #[cold]
    fn decide(&self, me: usize) {
        let mut state = lock(&self.state);
        if self.settings.priorities && state.dice.one_in(40) {
            state.tasks[me].priority = state.dice.bits() >> 8;
        }
        let stall_one_in = if me == 0 { self.settings.stall_first_one_in } else { 0 };
        if state.dice.one_in(self.settings.stall_one_in) || state.dice.one_in(stall_one_in) {
            let until_ns = state.now_ns + state.dice.within(1_000, self.settings.longest_stall_ns);
            state.tasks[me].status = Status::Waiting { key: Key::Sleep, until_ns, what: "the processor" };
        }
        self.pass_on(state, me);
    }

    /// Lets the next thread run; returns when it is the calling thread's turn again.
    fn pass_on(&self, mut state: MutexGuard<'_, State>, me: usize) {
        state.decisions += 1;
        let every = self.settings.switch_every.max(1);
        self.countdown.store(1 + state.dice.below(2 * every as usize) as u32, Ordering::Relaxed);
        let next = if state.decisions > self.settings.most_decisions {
            Err(Some(Trouble::Endless))
        } else {
            state.choose(&self.settings)
        };
        let next = match next {
            Ok(next) => next,
            Err(trouble) => {
                state.over.get_or_insert(trouble.map_or(Ok(()), Err));
                drop(state);
                self.over.notify_all();
                // The run is over; this thread keeps what it holds.
                loop {
                    std::thread::park();
                }
            }
        };
        if next != me {
            state.record(&self.settings, next, "runs");
        }
        state.tasks[next].status = Status::Ready;
        let baton = (next != me).then(|| Arc::clone(&state.tasks[next].baton));
        let mine = Arc::clone(&state.tasks[me].baton);
        drop(state);
        if let Some(baton) = baton {
            baton.give();
            mine.take();
        }
        self.join_ended();
    }

    /// Waits for threads that ended, whose thread-locals may still be being destroyed.
    fn join_ended(&self) {
        let mut state = lock(&self.state);
        if state.ended.is_empty() {
            return;
        }
        let ended = std::mem::take(&mut state.ended);
        let threads: Vec<_> = ended.into_iter().filter_map(|task| state.tasks[task].os.take()).collect();
        drop(state);
        for thread in threads {
            let _ = thread.join();
        }
    }

    fn start(self: &Arc<Self>, name: String, work: impl FnOnce() + Send + 'static) -> std::io::Result<TaskRef> {
        let baton = Arc::new(Baton::default());
        let number = {
            let mut state = lock(&self.state);
            if self.settings.most_threads.is_some_and(|most| state.live.len() >= most) {
                return Err(std::io::Error::from_raw_os_error(libc::EAGAIN));
            }
            let number = state.tasks.len();
            let priority = state.dice.bits() >> 8;
            state.tasks.push(Task {
                name,
                status: Status::Ready,
                baton: Arc::clone(&baton),
                notified: false,
                permit: false,
                priority,
                os: None,
            });
            state.live.push(number);
            number
        };
        let world = Arc::clone(self);
        let started = std::thread::Builder::new().name(format!("sim-{number}")).spawn(move || {
            baton.take();
            HERE.set(Some((Arc::as_ptr(&world), number)));
            world.join_ended();
            work();
            HERE.set(None);
            world.end(number);
        });
        let mut state = lock(&self.state);
        match started {
            Ok(os) => state.tasks[number].os = Some(os),
            Err(error) => {
                state.tasks[number].status = Status::Ended;
                state.live.retain(|&task| task != number);
                return Err(error);
            }
        }
        Ok(TaskRef { world: Arc::clone(self), number })
    }

    fn end(&self, me: usize) {
        let mut state = lock(&self.state);
        state.tasks[me].status = Status::Ended;
        state.live.retain(|&task| task != me);
        state.ended.push(me);
        state.first_ended |= me == 0;
        let waits = |task: &&mut Task| matches!(task.status, Status::Waiting { key, .. } if key == Key::End(me));
        for task in state.tasks.iter_mut().filter(waits) {
            task.status = Status::Ready;
            task.notified = true;
        }
        state.record(&self.settings, me, "ends");
        if state.live.is_empty() {
            state.over.get_or_insert(Ok(()));
            drop(state);
            self.over.notify_all();
            return;
        }
        self.pass_on_at_end(state, me);
    }

    fn pass_on_at_end(&self, mut state: MutexGuard<'_, State>, me: usize) {
        state.decisions += 1;
        match state.choose(&self.settings) {
            Ok(next) => {
                state.record(&self.settings, next, "runs");
                state.tasks[next].status = Status::Ready;
                let baton = Arc::clone(&state.tasks[next].baton);
                drop(state);
                baton.give();
            }
            Err(trouble) => {
                debug_assert!(me == 0 || state.first_ended || trouble.is_some());
                state.over.get_or_insert(trouble.map_or(Ok(()), Err));
                drop(state);
                self.over.notify_all();
            }
        }
    }
}

/// Runs `first` as the first thread of a new world, until all threads have ended or none can continue. One world runs at a time.
pub fn run<R: Send + 'static>(settings: Settings, first: impl FnOnce() -> R + Send + 'static) -> Ended<R> {
    static ALONE: Mutex<()> = Mutex::new(());
    let _alone = lock(&ALONE);
    let mut dice = Dice::new(settings.seed);
    let state = State {
        tasks: Vec::new(),
        live: Vec::new(),
        ended: Vec::new(),
        now_ns: START_NS,
        dice: dice.split(),
        decisions: 0,
        trace_hash: 0xcbf2_9ce4_8422_2325,
        trace: Vec::new(),
        first_ended: false,
        over: None,
    };
    let world =
        Arc::new(World { settings, state: Mutex::new(state), over: Condvar::new(), countdown: AtomicU32::new(1) });
    let result = Arc::new(Mutex::new(None));
    let place = Arc::clone(&result);
    let started = world.start("first".to_owned(), move || {
        stay_on_one_processor();
        let outcome = catch_unwind(AssertUnwindSafe(first));
        *lock(&place) = Some(outcome);
    });
    let baton = Arc::clone(&lock(&world.state).tasks[0].baton);
    if started.is_ok() {
        baton.give();
    }
    let mut state = lock(&world.state);
    let over = loop {
        match state.over.clone() {
            Some(over) => break over,
            None if started.is_err() => break Err(Trouble::Panic("no thread could be started".to_owned())),
            None => state = world.over.wait(state).unwrap_or_else(PoisonError::into_inner),
        }
    };
    let waiting = |&task: &usize| {
        let task = &state.tasks[task];
        let waits_for = match task.status {
            Status::Waiting { what, .. } => what,
            Status::Ready | Status::Ended => "its turn",
        };
        Left { name: task.name.clone(), waits_for }
    };
    let left = state.live.iter().map(waiting).collect();
    let mut ended = Ended {
        result: Err(Trouble::Deadlock),
        left,
        simulated_ns: state.now_ns - START_NS,
        decisions: state.decisions,
        threads: state.tasks.len(),
        trace_hash: state.trace_hash,
        trace: std::mem::take(&mut state.trace),
    };
    let last: Vec<_> =
        std::mem::take(&mut state.ended).into_iter().filter_map(|task| state.tasks[task].os.take()).collect();
    drop(state);
    for thread in last {
        let _ = thread.join();
    }
    ended.result = match (over, lock(&result).take()) {
        (Err(trouble), _) => Err(trouble),
        (Ok(()), Some(Ok(value))) => Ok(value),
        (Ok(()), Some(Err(payload))) => Err(Trouble::Panic(words(&*payload))),
        (Ok(()), None) => Err(Trouble::Deadlock),
    };
    ended
}

fn words(payload: &(dyn std::any::Any + Send)) -> String {
    let text = payload.downcast_ref::<&str>().map(|text| (*text).to_owned());
    text.or_else(|| payload.downcast_ref::<String>().cloned()).unwrap_or_else(|| "without a message".to_owned())
}

/// Restricts the calling thread and those that it starts to one processor: passing a baton between threads is faster there.
fn stay_on_one_processor() {
    // SAFETY: plain system calls on a local set.
    unsafe {
        let here = libc::sched_getcpu();
        if (0..libc::CPU_SETSIZE).contains(&here) {
            let mut set: libc::cpu_set_t = std::mem::zeroed();
            libc::CPU_SET(here as usize, &mut set);
            libc::sched_setaffinity(0, size_of::<libc::cpu_set_t>(), &raw const set);
        }
    }
}
