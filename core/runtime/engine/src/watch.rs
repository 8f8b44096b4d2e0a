//! The watchdog: detects calls that do not return, abandons them with their thread, and starts restarts of failed
//! nodes. It calls no plugin itself.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use panoscope_graph::OnFault;

use crate::busy::{ABANDONED, CallKind};
use crate::call::failures::backoff_ms;
use crate::clock;
use crate::fault::{Action, Cause};
use crate::guard::{CallError, OpenError};
use crate::log::Level;
use crate::memory::lost_on_device;
use crate::node::NodeRuntime;
use crate::outbox::panic_words;
use crate::plan::Plan;
use crate::retained;
use crate::schedule::{Ready, Shared};
use crate::sleeps::Sleeps;
use crate::stats::bump;
use crate::sync::lock;

/// Stuck calls of one node at a time; with more the node is bypassed.
const MAX_STUCK: u32 = 3;
/// Grace time after a node's budget until it counts as hung: two frames, within these limits.
const MIN_GRACE_NS: u64 = 20_000_000;
const MAX_GRACE_NS: u64 = 66_000_000;
/// Minimum sleep of the process that is logged; shorter ones happen on any busy machine.
const MIN_LOGGED_SLEEP_NS: u64 = 1_000_000_000;
/// Budgets after which a call counts as hung in a replay: the machine may be slower than that of the recording, and the
/// effects of recorded hangs are in the recording.
const REPLAY_BUDGETS: u64 = 20;

impl Shared {
    /// Checks the running calls until `stop` is set.
    pub fn watch(&self, stop: &AtomicBool) {
        let mut next_look_ns = 0;
        let mut sleeps = Sleeps::default();
        let mut refused = retained::refused_outside();
        let mut lost = lost_on_device().0;
        while !stop.load(Ordering::Relaxed) {
            let (nearest, budgets) = {
                let plan = self.plan.load();
                (plan.nearest, plan.live().any(|(_, c)| c.budget_ns() != 0))
            };
            let look_ms = if budgets && !self.context.batch { 4 } else { 20 };
            let wait_ms = if nearest { 1 } else { look_ms };
            sleeps.begin_wait(clock::now_ns());
            std::thread::park_timeout(Duration::from_millis(wait_ms));
            // First, because after a sleep the clock may have a step to make.
            clock::keep();
            let slept_ns = sleeps.end_wait(clock::now_ns(), wait_ms * 1_000_000);
            if slept_ns >= MIN_LOGGED_SLEEP_NS {
                let words = format!(
                    "the machine or this process slept for {:.1} s; running calls get this time back",
                    slept_ns as f64 / 1e9
                );
                self.context.log.write(Level::Warn, "engine", &words);
            }
            self.try_fire_nearest();
            let now_ns = clock::now_ns();
            if now_ns >= next_look_ns {
                next_look_ns = now_ns + look_ms * 1_000_000;
                self.look_for_hangs(now_ns, &sleeps);
                if !self.context.ignores_wall_clock()
                    && let Err(cause) = self.pool.relieve(now_ns)
                {
                    self.fail(format!("no thread could be started to replace those that hang: {cause}"));
                }
                let before = std::mem::replace(&mut refused, retained::refused_outside());
                if refused != before {
                    let words = "a plugin's thread released or retained a frame that the plugin does not hold; the host refused this";
                    self.context.log.write(Level::Error, "engine", words);
                }
                let (now_lost, reason) = lost_on_device();
                if std::mem::replace(&mut lost, now_lost) != now_lost {
                    let words = format!("frames were lost on the GPU and are black or unknown: {reason}");
                    self.context.log.write(Level::Error, "engine", &words);
                }
            }
        }
    }

    /// Fires nodes whose deadline for a `nearest` input has passed.
    fn try_fire_nearest(&self) {
        if self.waiting_nearest.swap(0, Ordering::Relaxed) == 0 {
            return;
        }
        let now_ns = clock::now_ns();
        let plan = self.plan.load();
        let mut ready = Ready::default();
        for (node, runtime) in plan.live() {
            let deadline = lock(&runtime.join).nearest_deadline_ns;
            if deadline == 0 {
                continue;
            }
            if now_ns >= deadline {
                self.try_fire(&plan, node, &mut ready);
            } else {
                self.waiting_nearest.store(1, Ordering::Relaxed);
            }
        }
        ready.dispatch_ready(self, &plan, 0);
    }

    /// Time from the start of a call to the end of its budget, and from there until it counts as hung.
    fn time_limits(&self, runtime: &NodeRuntime) -> (u64, u64) {
        match runtime.busy.kind() {
            CallKind::Process => {}
            CallKind::Check | CallKind::Open => return (nanoseconds(self.context.open_limit), 0),
            CallKind::Finish | CallKind::Close | CallKind::SaveState | CallKind::LoadState => {
                return (nanoseconds(self.context.close_limit), 0);
            }
        }
        let budget_ns = runtime.budget_ns();
        match (budget_ns, self.context.decider.is_some()) {
            (0, _) => (self.hang_ns, 0),
            (budget, true) => (self.hang_ns.max(budget.saturating_mul(REPLAY_BUDGETS)), 0),
            (budget, false) => {
                let frame_ns = self.frame_ns.load(Ordering::Relaxed);
                (budget, frame_ns.saturating_mul(2).clamp(MIN_GRACE_NS, MAX_GRACE_NS))
            }
        }
    }

    fn look_for_hangs(&self, now_ns: u64, sleeps: &Sleeps) {
        let plan = self.plan.load();
        let stop_ns = self.stop_ns.load(Ordering::Relaxed);
        for (node, runtime) in plan.live() {
            let since_ns = runtime.busy.since_ns.load(Ordering::Acquire);
            if since_ns == 0 || since_ns == ABANDONED {
                continue;
            }
            let (budget_ns, grace_ns) = self.time_limits(runtime);
            let spent_ns = sleeps.awake_ns(since_ns, now_ns);
            let is_late = spent_ns > budget_ns.saturating_add(grace_ns);
            // A run that is to end does not wait for a long budget.
            let is_late_at_stop = || {
                stop_ns != 0
                    && runtime.busy.kind() == CallKind::Process
                    && sleeps.awake_ns(since_ns.max(stop_ns), now_ns) > self.stop_limit_ns
            };
            if is_late || is_late_at_stop() {
                self.abandon(&plan, node, runtime, since_ns, [spent_ns, budget_ns]);
            }
        }
    }

    /// Abandons a call that does not return: its tick continues with empty outputs, and instance and thread are
    /// replaced.
    #[cold]
    fn abandon(
        &self,
        plan: &Plan,
        node: usize,
        runtime: &Arc<NodeRuntime>,
        since_ns: u64,
        [spent_ns, budget_ns]: [u64; 2],
    ) {
        let busy = &runtime.busy;
        let (tick, thread, kind) = (busy.tick(), busy.thread.load(Ordering::Relaxed), busy.kind());
        // Before the call is let go: from then on its thread may count it as returned.
        let stuck = runtime.recovery.add_stuck();
        if !busy.abandon(since_ns) {
            runtime.recovery.remove_stuck();
            return;
        }
        let now_ns = clock::now_ns();
        let failures = runtime.recovery.add_failure();
        bump(&runtime.stats.faults);
        let mut exec = runtime.fresh_exec();
        exec.failed_at_ns = now_ns;
        exec.failures_in_a_row = failures;
        let done = match runtime.on_fault() {
            OnFault::Stop => Action::Stop,
            // A run that ends makes no further call that may hang.
            OnFault::Restart if stuck <= MAX_STUCK && !self.is_stopping() => Action::Abandon,
            _ => Action::Bypass,
        };
        exec.bypassed = done == Action::Bypass;
        if exec.bypassed {
            runtime.record_bypassed(&self.context, &format!("{stuck} of its calls did not return"));
        }
        busy.clear();
        runtime.exec.put(exec);
        if let Some(group) = &runtime.group {
            runtime.recovery.save_kept_position();
            // The call returns now and is no longer counted as stuck.
            group.kill(&format!("node `{}` did not return{}", runtime.id, kind.return_words()));
        }

        let (late_ms, spent_ms) = (spent_ns.saturating_sub(budget_ns) as f64 / 1e6, spent_ns as f64 / 1e6);
        let done_about = match &runtime.group {
            Some(_) => "its process was ended",
            None => "was left behind with its thread",
        };
        let words = format!("it did not return{} for {spent_ms:.0} ms and {done_about}", kind.return_words());
        self.context.log.write(Level::Error, &runtime.id, &words);
        runtime.report_fault(&self.context, Cause::Hang, done, Some(tick.seq), Some(late_ms), words);
        // Finish the tick first, so that no thread runs the node before that.
        let mut ready = Ready::default();
        let head = plan.wiring[node].chain_head;
        let mut again = false;
        if runtime.source {
            runtime.ticks.set_made(tick.seq + 1);
        } else {
            runtime.skipped_tick(&self.context, &tick, true);
            self.skip_from(plan, node, tick, &mut ready);
            again = self.take_next(plan, head, &mut ready);
        }
        self.replace_thread(thread);
        if again {
            self.dispatch(plan, head);
        }
        ready.dispatch_ready(self, plan, 0);
        match done {
            Action::Stop => {
                self.fail(format!("node `{}` did not return and the graph says on_fault = \"stop\"", runtime.id));
            }
            Action::Abandon => self.start_restart(runtime),
            _ => {}
        }
    }

    /// Starts a thread in place of one that hangs.
    fn replace_thread(&self, thread: u32) {
        // Drops only the handle, because the thread may never end. It may belong to another node.
        let own = lock(&self.own_threads).remove(&thread);
        let mut replaced = self.pool.give_up(thread);
        if let Some(me) = self.me.upgrade()
            && let Some(own) = own
        {
            replaced = replaced.and(me.start_thread(own.node, &own.runtime));
        }
        if let Err(cause) = replaced {
            self.fail_for_good(format!("no thread could be started to replace one that hangs: {cause}"));
        }
    }

    /// Reports that a call off the hot path did not return. Returns the engine's response.
    #[cold]
    pub fn report_no_return(&self, runtime: &NodeRuntime, error: &CallError) -> Action {
        let stuck = runtime.recovery.stuck();
        let done = if stuck <= MAX_STUCK { Action::Abandon } else { Action::Bypass };
        bump(&runtime.stats.faults);
        let words = error.to_string();
        if done == Action::Bypass {
            runtime.record_bypassed(&self.context, &words);
        }
        self.context.log.write(Level::Error, &runtime.id, &words);
        runtime.report_fault(&self.context, Cause::Hang, done, None, None, words);
        done
    }

    /// Starts a thread of the host.
    ///
    /// # Errors
    /// The system gives no thread.
    pub fn start_host_thread(
        self: &Arc<Self>,
        name: &str,
        work: impl FnOnce() + Send + 'static,
    ) -> std::io::Result<JoinHandle<()>> {
        let work = Arc::clone(self).watched(name.to_owned(), work);
        std::thread::Builder::new().name(name.chars().take(15).collect()).spawn(work)
    }

    /// Wraps the work of a thread of the host. A panic there is a bug in the host: it is reported with the thread's
    /// name and ends the run.
    pub fn watched(self: Arc<Self>, name: String, work: impl FnOnce() + Send + 'static) -> impl FnOnce() + Send {
        move || {
            if let Err(payload) = catch_unwind(AssertUnwindSafe(work)) {
                self.thread_panicked(&name, panic_words(&*payload));
            }
        }
    }

    /// Handles a panic of a thread of the host. The run ends without waiting for work that this thread may have left
    /// undone.
    #[cold]
    pub fn thread_panicked(&self, name: &str, words: &str) {
        let words = format!("thread `{name}` of the engine panicked: {words}");
        self.context.log.write(Level::Error, "engine", &words);
        self.fail_for_good(words);
    }

    /// Closes failed instances and, if the graph says so, restarts the node, on a separate thread.
    pub fn start_restart(&self, runtime: &Arc<NodeRuntime>) {
        if self.context.ignores_wall_clock() && runtime.on_fault() == OnFault::Restart && !runtime.has_given_up() {
            // In batch and replay the node itself reopens before a tick that does not depend on the clock.
            return;
        }
        let Some(me) = self.me.upgrade() else { return };
        let mine = runtime.recovery.begin_restart();
        let runtime = Arc::clone(runtime);
        let name = format!("restart {}", runtime.id);
        let restarter = Arc::clone(&me);
        if let Err(cause) = me.start_host_thread(&name, move || restarter.restart(&runtime, mine)) {
            self.fail(format!("no thread could be started to open a node again: {cause}"));
        }
    }

    fn restart(self: &Arc<Self>, runtime: &Arc<NodeRuntime>, mine: u64) {
        let outdated = || runtime.recovery.is_outdated(mine) || runtime.runner.is_retired();
        let broken = runtime.recovery.take_broken();
        self.close_guarded(runtime, broken);
        if runtime.on_fault() != OnFault::Restart || runtime.has_given_up() {
            return;
        }
        loop {
            let max_ms = runtime.group.as_ref().map_or(u64::MAX, |group| group.max_pause_ms());
            let mut rest_ms = backoff_ms(runtime.recovery.failures()).min(max_ms);
            while rest_ms > 0 && !outdated() && !self.is_stopping() {
                let step = rest_ms.min(20);
                std::thread::sleep(Duration::from_millis(step));
                rest_ms -= step;
            }
            if outdated() || self.is_stopping() {
                return;
            }
            let opened = self.open_again(runtime, &runtime.snapshot());
            if outdated() {
                // A change reopened or removed the node meanwhile.
                if let Ok(instance) = opened {
                    self.close_guarded(runtime, vec![instance]);
                }
                return;
            }
            match opened {
                Ok(instance) => {
                    bump(&runtime.stats.restarts);
                    self.context.log.write(Level::Info, &runtime.id, "opened again");
                    let unused = runtime.install_restarted(instance, mine);
                    self.close_guarded(runtime, unused.into_iter().collect());
                    if runtime.source {
                        runtime.runner.wake();
                    }
                    return;
                }
                Err(OpenError::Node(refusal)) => {
                    runtime.recovery.add_failure();
                    runtime.open_failed(&self.context, &refusal.message, None);
                    if runtime.has_given_up() {
                        return;
                    }
                }
                Err(OpenError::Call(error)) => {
                    runtime.recovery.add_failure();
                    if self.report_no_return(runtime, &error) == Action::Bypass {
                        return;
                    }
                }
            }
        }
    }
}

fn nanoseconds(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}
