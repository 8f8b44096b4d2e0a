//! The watchdog: sees calls that do not return, leaves them behind with their thread and has failed nodes opened again. It calls no
//! plugin itself.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use panoscope_graph::OnFault;

use crate::busy::{ABANDONED, CallKind};
use crate::clock;
use crate::failures::backoff_ms;
use crate::fault::{Action, Cause};
use crate::guard::{CallError, OpenError};
use crate::log::Level;
use crate::node::NodeRuntime;
use crate::outbox::panic_words;
use crate::plan::Plan;
use crate::retained;
use crate::schedule::{Ready, Shared};
use crate::stats::bump;
use crate::sync::lock;

/// Calls of one node that may be stuck at a time; with one more the node is left out.
const MOST_STUCK: u32 = 3;
/// Between a node's budget and the moment it is called hung: two frames, within these limits.
const SHORTEST_GRACE_NS: u64 = 20_000_000;
const LONGEST_GRACE_NS: u64 = 66_000_000;
/// In batch time is no measure of a node: only what takes this many times its budget hangs.
const BATCH_BUDGETS: u64 = 20;

impl Shared {
    /// Looks at the running calls until `stop` is set.
    pub fn watch(&self, stop: &AtomicBool) {
        let mut next_look_ns = 0;
        let mut refused = retained::refused_outside();
        while !stop.load(Ordering::Relaxed) {
            let (nearest, budgets) = {
                let plan = self.plan.load();
                (plan.nearest, plan.live().any(|(_, c)| c.budget_ns.load(Ordering::Relaxed) != 0))
            };
            let look_ms = if budgets && !self.around.batch { 4 } else { 20 };
            std::thread::park_timeout(Duration::from_millis(if nearest { 1 } else { look_ms }));
            self.try_fire_nearest();
            let now_ns = clock::now_ns();
            if now_ns >= next_look_ns {
                next_look_ns = now_ns + look_ms * 1_000_000;
                self.look_for_hangs(now_ns);
                clock::keep();
                if !self.around.unhurried()
                    && let Err(cause) = self.pool.relieve(now_ns)
                {
                    self.fail(format!("no thread could be started beside those that hang: {cause}"));
                }
                let before = std::mem::replace(&mut refused, retained::refused_outside());
                if refused != before {
                    let words =
                        "a plugin's thread gave back or kept a frame that the plugin does not hold; this was refused";
                    self.around.log.write(Level::Error, "engine", words);
                }
            }
        }
    }

    /// Wakes nodes whose wait for a `nearest` input is over.
    fn try_fire_nearest(&self) {
        if self.waiting_nearest.swap(0, Ordering::Relaxed) == 0 {
            return;
        }
        let now_ns = clock::now_ns();
        let plan = self.plan.load();
        let mut ready = Ready::default();
        for (node, cell) in plan.live() {
            let deadline = lock(&cell.join).nearest_deadline_ns;
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

    /// Time from the start of a call to the end of its budget, and from there until it is called hung.
    fn patience(&self, cell: &NodeRuntime) -> (u64, u64) {
        match cell.busy.kind() {
            CallKind::Process => {}
            CallKind::Check | CallKind::Open => return (nanoseconds(self.around.open_limit), 0),
            CallKind::Finish | CallKind::Close | CallKind::SaveState | CallKind::LoadState => {
                return (nanoseconds(self.around.close_limit), 0);
            }
        }
        let budget_ns = cell.budget_ns.load(Ordering::Relaxed);
        match (budget_ns, self.around.unhurried()) {
            (0, _) => (self.hang_ns, 0),
            (budget, true) => (self.hang_ns.max(budget.saturating_mul(BATCH_BUDGETS)), 0),
            (budget, false) => {
                let frame_ns = self.frame_ns.load(Ordering::Relaxed);
                (budget, frame_ns.saturating_mul(2).clamp(SHORTEST_GRACE_NS, LONGEST_GRACE_NS))
            }
        }
    }

    fn look_for_hangs(&self, now_ns: u64) {
        let plan = self.plan.load();
        for (node, cell) in plan.live() {
            let since_ns = cell.busy.since_ns.load(Ordering::Acquire);
            let (budget_ns, grace_ns) = self.patience(cell);
            let running = since_ns != 0 && since_ns != ABANDONED;
            if running && now_ns.saturating_sub(since_ns) > budget_ns.saturating_add(grace_ns) {
                self.abandon(&plan, node, cell, since_ns, budget_ns);
            }
        }
    }

    /// Takes everything over from a call that does not return: its tick goes on with empty outputs, node and thread are replaced.
    #[cold]
    fn abandon(&self, plan: &Plan, node: usize, cell: &Arc<NodeRuntime>, since_ns: u64, budget_ns: u64) {
        let busy = &cell.busy;
        let (tick, thread, kind) = (busy.tick(), busy.thread.load(Ordering::Relaxed), busy.kind());
        if !busy.abandon(since_ns) {
            return;
        }
        let now_ns = clock::now_ns();
        let stuck = cell.recovery.stuck.fetch_add(1, Ordering::Relaxed) + 1;
        let failures = cell.recovery.failures.fetch_add(1, Ordering::Relaxed) + 1;
        bump(&cell.stats.faults);
        let mut exec = cell.fresh_exec();
        exec.failed_at_ns = now_ns;
        exec.failures_in_a_row = failures;
        let done = match cell.on_fault() {
            OnFault::Stop => Action::Stop,
            OnFault::Restart if stuck <= MOST_STUCK => Action::Abandon,
            _ => Action::Bypass,
        };
        exec.bypassed = done == Action::Bypass;
        if exec.bypassed {
            cell.ceased(&self.around, &format!("{stuck} of its calls did not return"));
        }
        busy.clear();
        cell.exec.put(exec);

        let late_ms = now_ns.saturating_sub(since_ns.saturating_add(budget_ns)) as f64 / 1e6;
        let spent_ms = now_ns.saturating_sub(since_ns) as f64 / 1e6;
        let words = format!(
            "it did not return{} for {spent_ms:.0} ms and was left behind with its thread",
            kind.return_words()
        );
        self.around.log.write(Level::Error, &cell.id, &words);
        cell.tell(&self.around, Cause::Hang, done, Some(tick.seq), Some(late_ms), words);
        // The rest of the tick first, so that nobody runs the node before.
        let mut ready = Ready::default();
        let head = plan.wiring[node].chain_head;
        let mut again = false;
        if cell.source {
            cell.ticks.made.store(tick.seq + 1, Ordering::Relaxed);
        } else {
            cell.skipped_tick(&self.around, &tick, true);
            self.skip_from(plan, node, tick, &mut ready);
            again = self.take_next(plan, head, &mut ready);
        }
        // Only the handle goes: the thread may never end. It need not be this node's own.
        let own = lock(&self.own_threads).remove(&thread);
        let mut replaced = self.pool.give_up(thread);
        if let Some(me) = self.me.upgrade()
            && let Some(own) = own
        {
            replaced = replaced.and(me.start_thread(own.node, &own.cell));
        }
        if let Err(cause) = replaced {
            self.fail(format!("no thread could be started in place of one that hangs: {cause}"));
        }
        if again {
            self.dispatch(plan, head);
        }
        ready.dispatch_ready(self, plan, 0);
        match done {
            Action::Stop => {
                self.fail(format!("node `{}` did not return and the graph says on_fault = \"stop\"", cell.id));
            }
            Action::Abandon => self.start_mending(cell),
            _ => {}
        }
    }

    /// Writes down that a call off the hot path has no answer; answers what is done about it.
    #[cold]
    pub fn tell_no_return(&self, cell: &NodeRuntime, error: &CallError) -> Action {
        let stuck = cell.recovery.stuck.load(Ordering::Relaxed);
        let done = if stuck <= MOST_STUCK { Action::Abandon } else { Action::Bypass };
        bump(&cell.stats.faults);
        let words = error.to_string();
        if done == Action::Bypass {
            cell.ceased(&self.around, &words);
        }
        self.around.log.write(Level::Error, &cell.id, &words);
        cell.tell(&self.around, Cause::Hang, done, None, None, words);
        done
    }

    /// Starts a thread of the host.
    ///
    /// # Errors
    /// The system gives none.
    pub fn start_host_thread(
        self: &Arc<Self>,
        name: &str,
        work: impl FnOnce() + Send + 'static,
    ) -> std::io::Result<JoinHandle<()>> {
        let work = Arc::clone(self).watched(name.to_owned(), work);
        std::thread::Builder::new().name(name.chars().take(15).collect()).spawn(work)
    }

    /// Work of a thread of the host. A panic there is a mistake of the host: it is told with the thread's name and ends the run.
    pub fn watched(self: Arc<Self>, name: String, work: impl FnOnce() + Send + 'static) -> impl FnOnce() + Send {
        move || {
            if let Err(payload) = catch_unwind(AssertUnwindSafe(work)) {
                self.thread_panicked(&name, panic_words(&*payload));
            }
        }
    }

    /// A thread of the host panicked: what it was to do may never be done, so the run does not wait for it.
    #[cold]
    pub fn thread_panicked(&self, name: &str, words: &str) {
        let words = format!("thread `{name}` of the engine panicked: {words}");
        self.around.log.write(Level::Error, "engine", &words);
        self.fail(words);
        self.broken.store(true, Ordering::Release);
        let _guard = lock(&self.finished_lock);
        self.finished.notify_all();
    }

    /// Closes what failed and, if the graph wants that, opens the node again. This happens on a thread of its own.
    pub fn start_mending(&self, cell: &Arc<NodeRuntime>) {
        if self.around.unhurried() && cell.on_fault() == OnFault::Restart && !cell.has_given_up() {
            // Closed and opened again before a tick that does not depend on the clock.
            return;
        }
        let Some(me) = self.me.upgrade() else { return };
        let mine = cell.recovery.restarting.fetch_add(1, Ordering::AcqRel) + 1;
        let cell = Arc::clone(cell);
        let name = format!("restart {}", cell.id);
        let restarter = Arc::clone(&me);
        if let Err(cause) = me.start_host_thread(&name, move || restarter.restart(&cell, mine)) {
            self.fail(format!("no thread could be started to open a node again: {cause}"));
        }
    }

    fn restart(self: &Arc<Self>, cell: &Arc<NodeRuntime>, mine: u64) {
        let outdated =
            || cell.recovery.restarting.load(Ordering::Acquire) != mine || cell.runner.retired.load(Ordering::Relaxed);
        let broken = std::mem::take(&mut *lock(&cell.recovery.broken));
        self.close_guarded(cell, broken);
        if cell.on_fault() != OnFault::Restart || cell.has_given_up() {
            return;
        }
        loop {
            let mut rest_ms = backoff_ms(cell.recovery.failures.load(Ordering::Relaxed));
            while rest_ms > 0 && !outdated() && !self.is_stopping() {
                let step = rest_ms.min(20);
                std::thread::sleep(Duration::from_millis(step));
                rest_ms -= step;
            }
            if outdated() || self.is_stopping() {
                return;
            }
            let opened = self.open_again(cell, &cell.snapshot());
            if outdated() {
                // Somebody opened the node otherwise, or it is gone.
                if let Ok(instance) = opened {
                    self.close_guarded(cell, vec![instance]);
                }
                return;
            }
            match opened {
                Ok(instance) => {
                    bump(&cell.stats.restarts);
                    self.around.log.write(Level::Info, &cell.id, "opened again");
                    let unused = cell.replace_instance(instance, None);
                    self.close_guarded(cell, unused.into_iter().collect());
                    if cell.source {
                        self.wake(cell);
                    }
                    return;
                }
                Err(OpenError::Refused(words)) => {
                    cell.recovery.failures.fetch_add(1, Ordering::Relaxed);
                    cell.open_failed(&self.around, &words, None);
                    if cell.has_given_up() {
                        return;
                    }
                }
                Err(OpenError::Call(error)) => {
                    cell.recovery.failures.fetch_add(1, Ordering::Relaxed);
                    if self.tell_no_return(cell, &error) == Action::Bypass {
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
