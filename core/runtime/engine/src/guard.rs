//! Calls into plugins off the hot path: open, close, save and load state. They run on a separate thread with a time
//! limit; if one does not return in time, its thread and instance are abandoned and another thread makes the remaining
//! calls.
//!
//! On the hot path the watchdog does the same: see [`crate::watch`].

use std::collections::VecDeque;
use std::ops::ControlFlow;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crate::busy::CallKind;
use crate::call::open::NotOpened;
use crate::clock;
use crate::instance::Instance;
use crate::log::Level;
use crate::node::NodeRuntime;
use crate::outbox::panic_words;
use crate::params::Snapshot;
use crate::schedule::Shared;
use crate::sleeps::Sleeps;
use crate::sync::lock;
use crate::thread_id;

/// Time limit once the engine stops: long enough for nodes that work.
const MAX_AT_STOP: Duration = Duration::from_secs(1);
/// Time after which the next node closes although the previous one is still closing.
const MAX_TURN: Duration = Duration::from_secs(1);
/// Stack size of the main thread, which some libraries need when they open.
const STACK_BYTES: usize = 8 << 20;

/// A call to make.
pub(crate) struct Call<T> {
    pub runtime: Arc<NodeRuntime>,
    pub kind: CallKind,
    /// Its result is dropped on the calling thread if the wait is over.
    pub run: Box<dyn FnOnce() -> T + Send>,
}

/// A call without a result.
#[derive(Debug, thiserror::Error)]
pub(crate) enum CallError {
    /// It took too long.
    #[error("it did not return{} within {seconds:.1} s and was abandoned with its thread", .kind.return_words())]
    NoReturn {
        /// The called function.
        kind: CallKind,
        /// Duration of the wait.
        seconds: f64,
    },
    /// No thread could be started for the call.
    #[error("a thread for the call could not be started: {cause}")]
    Thread {
        /// The system's error.
        cause: std::io::Error,
    },
    /// The host's own code around the call panicked.
    #[error("the host panicked around it: {words}")]
    Panic {
        /// The node's message.
        words: String,
    },
}

/// Time limit of calls.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limit {
    pub usual: Duration,
    /// Limit once the engine stops.
    pub at_stop: Duration,
}

impl Limit {
    /// A limit that is shorter once the engine stops.
    pub fn until_stop(usual: Duration) -> Self {
        Self { usual, at_stop: usual.min(MAX_AT_STOP) }
    }

    /// The same limit whether the engine stops or not.
    pub fn always(usual: Duration) -> Self {
        Self { usual, at_stop: usual }
    }
}

struct State<T> {
    todo: VecDeque<Call<T>>,
    /// The running call, its kind and its start.
    running: Option<(Arc<NodeRuntime>, CallKind, Instant)>,
    done: VecDeque<(Arc<NodeRuntime>, Result<T, CallError>)>,
    /// Number of the thread that makes the calls; a thread with another number was abandoned. 0 for none.
    thread: u32,
}

struct Line<T> {
    state: Mutex<State<T>>,
    changed: Condvar,
    /// Whether to make the next call after this result.
    goes_on: fn(&T) -> bool,
}

impl<T> Line<T> {
    fn state(&self) -> MutexGuard<'_, State<T>> {
        lock(&self.state)
    }

    /// Makes calls until none is left or the thread is abandoned.
    fn work(&self, number: u32) {
        loop {
            let mut state = self.state();
            if state.thread != number {
                return;
            }
            let Some(Call { runtime, kind, run }) = state.todo.pop_front() else {
                state.thread = 0;
                self.changed.notify_all();
                return;
            };
            state.running = Some((Arc::clone(&runtime), kind, Instant::now()));
            drop(state);
            let answer = catch_unwind(AssertUnwindSafe(run));
            let answer = answer.map_err(|payload| CallError::Panic { words: panic_words(&*payload).to_owned() });
            let mut state = self.state();
            if state.thread != number {
                drop(state);
                // The wait is over: drop the result, which closes an instance that was opened.
                drop(answer);
                runtime.recovery.remove_stuck();
                return;
            }
            state.running = None;
            if answer.as_ref().is_ok_and(|answer| !(self.goes_on)(answer)) {
                state.todo.clear();
            }
            state.done.push_back((runtime, answer));
            self.changed.notify_all();
        }
    }
}

impl Shared {
    /// Makes calls one after the other, until `goes_on` rejects a result, and passes each result to `take` on the
    /// calling thread. A call that takes longer than `limit` is abandoned with its thread; its node counts it as stuck
    /// until it returns. After such a call `take` decides whether the next calls are made.
    pub fn guarded<T: Send + 'static>(
        self: &Arc<Self>,
        limit: Limit,
        goes_on: fn(&T) -> bool,
        calls: impl IntoIterator<Item = Call<T>>,
        mut take: impl FnMut(&Arc<NodeRuntime>, Result<T, CallError>) -> ControlFlow<()>,
    ) {
        let todo: VecDeque<_> = calls.into_iter().collect();
        let state = State { todo, running: None, done: VecDeque::new(), thread: 0 };
        let line = Arc::new(Line { state: Mutex::new(state), changed: Condvar::new(), goes_on });
        let mut stop_since = None;
        let mut sleeps = Sleeps::default();
        let mut state = line.state();
        loop {
            if let Some((runtime, answer)) = state.done.pop_front() {
                drop(state);
                let unanswered = answer.is_err();
                let flow = take(&runtime, answer);
                state = line.state();
                if unanswered && flow.is_break() {
                    state.todo.clear();
                }
                continue;
            }
            if state.thread == 0 {
                let Some(first) = state.todo.front() else { return };
                let name = first.runtime.id.chars().take(15).collect();
                let number = thread_id::next();
                state.thread = number;
                drop(state);
                let started = self.start_caller(&line, number, name);
                state = line.state();
                if let Err(cause) = started {
                    state.thread = 0;
                    let Some(call) = state.todo.pop_front() else { return };
                    state.done.push_back((call.runtime, Err(CallError::Thread { cause })));
                }
                continue;
            }
            let now = Instant::now();
            if stop_since.is_none() && self.is_stopping() {
                stop_since = Some(now);
            }
            if let Some((runtime, kind, since)) = &state.running {
                let spent = now.duration_since(*since);
                let hurried = stop_since.is_some_and(|stop| now.duration_since(stop.max(*since)) >= limit.at_stop);
                if spent >= limit.usual || hurried {
                    let (runtime, kind, number) = (Arc::clone(runtime), *kind, state.thread);
                    (state.running, state.thread) = (None, 0);
                    runtime.recovery.add_stuck();
                    if let Some(group) = &runtime.group {
                        group.kill(&format!("node `{}` did not return{}", runtime.id, kind.return_words()));
                    }
                    let error = CallError::NoReturn { kind, seconds: spent.as_secs_f64() };
                    state.done.push_back((runtime, Err(error)));
                    drop(state);
                    // Workers that are stuck in its loops are replaced too.
                    if let Err(cause) = self.pool.give_up(number) {
                        self.fail_for_good(format!("no thread could be started to replace one that hangs: {cause}"));
                    }
                    state = line.state();
                    continue;
                }
            }
            let step = limit.usual.min(Duration::from_millis(10)).max(Duration::from_millis(1));
            sleeps.begin_wait(clock::now_ns());
            state = line.changed.wait_timeout(state, step).unwrap_or_else(PoisonError::into_inner).0;
            // Calls get back the time that the process slept.
            let slept = Duration::from_nanos(sleeps.end_wait(clock::now_ns(), step.as_nanos() as u64));
            if let Some((_, _, since)) = &mut state.running {
                *since = (*since + slept).min(Instant::now());
            }
            stop_since = stop_since.map(|stop: Instant| (stop + slept).min(Instant::now()));
        }
    }

    fn start_caller<T: Send + 'static>(
        self: &Arc<Self>,
        line: &Arc<Line<T>>,
        number: u32,
        name: String,
    ) -> std::io::Result<()> {
        let (me, line) = (Arc::clone(self), Arc::clone(line));
        let work = move || {
            thread_id::set(number);
            me.pool.enter();
            line.work(number);
            me.pool.left(number);
        };
        std::thread::Builder::new().name(name).stack_size(STACK_BYTES).spawn(work).map(drop)
    }

    /// Makes one call.
    pub fn call_guarded<T: Send + 'static>(
        self: &Arc<Self>,
        limit: Limit,
        runtime: &Arc<NodeRuntime>,
        kind: CallKind,
        run: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, CallError> {
        let mut answer = None;
        let call = Call { runtime: Arc::clone(runtime), kind, run: Box::new(run) };
        self.guarded(
            limit,
            |_| true,
            [call],
            |_, result| {
                answer = Some(result);
                ControlFlow::Break(())
            },
        );
        answer.unwrap_or_else(|| Err(CallError::Panic { words: "the call was not made".to_owned() }))
    }

    /// A call that opens an instance with the given values.
    pub fn opening(
        self: &Arc<Self>,
        runtime: &Arc<NodeRuntime>,
        snapshot: &Arc<Snapshot>,
    ) -> Call<Result<Instance, NotOpened>> {
        let (me, mine, values) = (Arc::clone(self), Arc::clone(runtime), Arc::clone(snapshot));
        let run = move || mine.open(&me.context, &values);
        Call { runtime: Arc::clone(runtime), kind: CallKind::Open, run: Box::new(run) }
    }

    /// Opens an instance with the given values.
    ///
    /// # Errors
    /// The node's message, or that it did not return.
    pub fn open_guarded(
        self: &Arc<Self>,
        runtime: &Arc<NodeRuntime>,
        snapshot: &Arc<Snapshot>,
    ) -> Result<Instance, OpenError> {
        let call = self.opening(runtime, snapshot);
        match self.call_guarded(Limit::until_stop(self.context.open_limit), runtime, CallKind::Open, call.run) {
            Ok(opened) => opened.map_err(OpenError::Node),
            Err(error) => Err(OpenError::Call(error)),
        }
    }

    /// Reopens a failed node; a source continues where it was.
    ///
    /// # Errors
    /// The node's message, or that it did not return.
    pub fn open_again(
        self: &Arc<Self>,
        runtime: &Arc<NodeRuntime>,
        snapshot: &Arc<Snapshot>,
    ) -> Result<Instance, OpenError> {
        let instance = self.open_guarded(runtime, snapshot)?;
        let Some(state) = runtime.take_position(&instance) else { return Ok(instance) };
        match self.load_guarded(runtime, instance, state.clone()) {
            Ok((instance, understood)) => {
                runtime.position_taken(&self.context, state, understood);
                Ok(instance)
            }
            Err(error) => {
                runtime.position_lost(&self.context);
                Err(OpenError::Call(error))
            }
        }
    }

    /// Loads a state into an instance. Returns whether the instance understood it.
    ///
    /// # Errors
    /// The node did not return: the instance is lost.
    pub fn load_guarded(
        self: &Arc<Self>,
        runtime: &Arc<NodeRuntime>,
        mut instance: Instance,
        state: Vec<u8>,
    ) -> Result<(Instance, bool), CallError> {
        let load = move || {
            let understood = instance.load_state(&state);
            (instance, understood)
        };
        self.call_guarded(Limit::until_stop(self.context.close_limit), runtime, CallKind::LoadState, load)
    }

    /// Closes instances of a node; one that does not return is reported and abandoned.
    pub fn close_guarded(self: &Arc<Self>, runtime: &Arc<NodeRuntime>, instances: Vec<Instance>) {
        let open = instances.into_iter().filter(Instance::is_open);
        let calls = open.map(|instance| {
            let (me, mine) = (Arc::clone(self), Arc::clone(runtime));
            let run = Box::new(move || mine.end(&me.context, instance));
            Call { runtime: Arc::clone(runtime), kind: CallKind::Close, run }
        });
        self.guarded(
            Limit::always(self.context.close_limit),
            |()| true,
            calls,
            |runtime, result| {
                if let Err(error) = result {
                    self.report_no_return(runtime, &error);
                }
                ControlFlow::Continue(())
            },
        );
    }

    /// Closes all instances of nodes one after the other; while one takes long, the next ones close in parallel. The
    /// log names those that are not closed at the deadline.
    pub fn close_all(self: &Arc<Self>, runtimes: Vec<Arc<NodeRuntime>>, until: Instant) {
        let mut open = Vec::new();
        let mut calls = Vec::new();
        for runtime in runtimes {
            // Outdates any restart of the node.
            runtime.recovery.begin_restart();
            let (instances, all) = runtime.take_instances();
            let closed = Arc::new(AtomicBool::new(!all));
            open.push((Arc::clone(&runtime), Arc::clone(&closed), all));
            let (me, mine) = (Arc::clone(self), Arc::clone(&runtime));
            // Also when the call is never made, because no thread can be started for it: then dropping it closes its instances.
            let over = OnDrop(move || closed.store(true, Ordering::Release));
            let run = Box::new(move || {
                instances.into_iter().for_each(|instance| mine.end(&me.context, instance));
                drop(over);
            });
            calls.push(Call { runtime, kind: CallKind::Close, run });
        }
        let turn = until.saturating_duration_since(Instant::now()).min(MAX_TURN);
        self.guarded(Limit::always(turn), |()| true, calls, |_, _| ControlFlow::Continue(()));
        for (runtime, closed, all) in open {
            while !closed.load(Ordering::Acquire) && Instant::now() < until {
                std::thread::sleep(Duration::from_millis(1));
            }
            if !all || !closed.load(Ordering::Acquire) || runtime.recovery.stuck() > 0 {
                let words = "it does not return and is left behind; its files may be incomplete";
                self.context.log.write(Level::Error, &runtime.id, words);
                runtime.record_bypassed(&self.context, words);
            }
        }
    }
}

/// Calls a function when it is dropped.
struct OnDrop<F: Fn()>(F);

impl<F: Fn()> Drop for OnDrop<F> {
    fn drop(&mut self) {
        (self.0)();
    }
}

/// An instance that could not be opened.
#[derive(Debug, thiserror::Error)]
pub(crate) enum OpenError {
    /// The node refused.
    #[error(transparent)]
    Node(NotOpened),
    /// The call did not return.
    #[error(transparent)]
    Call(CallError),
}
