//! Threads that belong to one node: sources, and nodes that may block.

use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use panoscope_abi::{Frame, Tick};
use panoscope_graph::{NodeKind, OnFault};

use crate::call::{CallOutcome, Called, NoOutcome, Ports};
use crate::clock;
use crate::fault::{Action, Cause};
use crate::memory::FrameRef;
use crate::node::NodeRuntime;
use crate::observe::Event;
use crate::own_thread::OwnThread;
use crate::plan::{Link, Plan};
use crate::pool::{self, Urgency};
use crate::region::Region;
use crate::schedule::{Ready, Shared};
use crate::scratch::Scratch;
use crate::stats::bump;
use crate::sync::lock;
use crate::thread_id;

/// Packets that may wait at a reader of another region in batch before the producer's source waits.
const MAX_BEHIND: usize = 64;

/// Capture time between ticks of a source that sets none.
const DEFAULT_FRAME_NS: i64 = 33_333_333;

/// A step back in capture time of at least this length counts as a recording that restarts, not as a fault.
const REWIND_NS: i64 = 1_000_000_000;

/// Accepted capture times: 146 years to either side, so that the difference of any two fits an `i64`.
const CAPTURE_NS: Range<i64> = -(1 << 62)..1 << 62;

/// Maximum time that a source's thread runs other nodes between two of its ticks.
const MAX_WALK_NS: u64 = 1_000_000;
const WALK_SHARE: u64 = 8;
/// As [`MAX_WALK_NS`], for the thread of a node that may block: about the time to wake another thread.
const SHORT_WALK_NS: u64 = 100_000;
/// Time that two busy threads spend to hand a tick over. Working at the same time pays only if both have more to do.
const HAND_OVER_NS: u64 = 1_000;
/// Maximum time of a chain that a source runs to save the hand-over: a longer one gains more from a thread of its own.
const SHORT_CHAIN_NS: u64 = 3_000;
/// Ticks for which a source that does not wait for capture times hands over what it makes, once that pays.
const HANDED_OVER: u32 = 32;

/// State of a source's thread between two ticks.
struct Pace {
    /// Capture and wall time of the first tick.
    first: Option<(i64, u64)>,
    last_capture_ns: Option<i64>,
    region: Arc<Region>,
    /// Recent maximum time of the chain that is the region; `u64::MAX` where it is unknown or must not run here.
    chain_ns: u64,
    /// Ticks to hand over before the chain runs on this thread, for a source that does not wait for capture times.
    to_hand_over: u32,
    /// End of the last call of a chain on this thread, if nothing else was done since.
    end_ns: Option<u64>,
}

impl Shared {
    /// Starts the thread of a node.
    pub fn start_thread(self: &Arc<Self>, node: usize, runtime: &Arc<NodeRuntime>) -> std::io::Result<()> {
        let number = thread_id::next();
        let (shared, owner) = (Arc::clone(self), Arc::clone(runtime));
        let runtime = Arc::clone(runtime);
        runtime.runner.thread_starts();
        let mut threads = lock(&self.own_threads);
        let builder = std::thread::Builder::new().name(runtime.id.chars().take(15).collect());
        let name = runtime.id.clone();
        let work = Arc::clone(&shared).watched(name, move || {
            runtime.runner.register_thread();
            thread_id::set(number);
            shared.pool.enter();
            place_thread(runtime.cpu, runtime.kind == NodeKind::Realtime);
            let given_up = if runtime.source {
                shared.source_thread(node, &runtime)
            } else {
                shared.blocking_thread(node, &runtime)
            };
            if given_up {
                shared.pool.left(number);
                return;
            }
            if runtime.runner.is_retired() {
                for instance in runtime.take_instances().0 {
                    runtime.end(&shared.context, instance);
                }
            }
            runtime.runner.thread_ended();
        });
        let handle = builder.spawn(work)?;
        threads.insert(number, OwnThread { node, runtime: owner, handle });
        Ok(())
    }

    /// Forgets threads that have ended. Their stacks and nodes stay in memory until then.
    pub fn forget_ended_threads(&self) {
        lock(&self.own_threads).retain(|_, thread| !thread.handle.is_finished());
    }

    /// Runs until the node finishes or is removed. Returns whether the watchdog abandoned this thread.
    fn blocking_thread(&self, node: usize, runtime: &NodeRuntime) -> bool {
        let mut scratch = Scratch::default();
        // Real-time priority is only for this node.
        let allowance_ns = if runtime.kind == NodeKind::Realtime { 0 } else { SHORT_WALK_NS };
        loop {
            runtime.runner.park();
            let (running, finished) = {
                let join = lock(&runtime.join);
                (join.is_running(), join.is_finished())
            };
            if finished || runtime.runner.leave.accept() {
                return false;
            }
            if running && !self.run(node, &mut scratch, allowance_ns) {
                return true;
            }
        }
    }

    /// Runs until the node finishes or is removed. Returns whether the watchdog abandoned this thread.
    fn source_thread(&self, node: usize, runtime: &Arc<NodeRuntime>) -> bool {
        let mut scratch = Scratch::default();
        let mut pace = Pace {
            first: None,
            last_capture_ns: runtime.ticks.last_capture_ns(),
            region: Arc::clone(self.plan.load().region_of(node)),
            chain_ns: u64::MAX,
            to_hand_over: HANDED_OVER,
            end_ns: None,
        };
        let leaves = || runtime.runner.leave.accept();
        if let Some(decider) = self.context.decider.clone() {
            if self.play(&*decider, node, runtime) {
                return false;
            }
            return self.source_over(node, runtime);
        }
        while !self.is_stopping() {
            if leaves() {
                return false;
            }
            let seq = runtime.ticks.made();
            if self.frames.is_some_and(|most| seq >= most) {
                break;
            }
            match self.source_tick(node, runtime, seq, &mut pace, &mut scratch) {
                Step::Next => {}
                Step::End => break,
                Step::GivenUp => return true,
            }
        }
        self.source_over(node, runtime)
    }

    /// Finishes a source that has made its last tick. Always returns `false`: the thread was not abandoned.
    fn source_over(&self, node: usize, runtime: &NodeRuntime) -> bool {
        self.meter_allocations(runtime.ticks.made(), true);
        let region = Arc::clone(self.plan.load().region_of(node));
        while region.has_pending() {
            runtime.runner.park_at_most(Some(Duration::from_millis(1)));
            if runtime.runner.leave.accept() {
                return false;
            }
        }
        let mut ready = Ready::default();
        if lock(&runtime.join).finish() {
            self.finish(node, &mut ready);
        }
        ready.dispatch_ready(self, &self.plan.load(), 0);
        false
    }

    /// Whether sources wait until the capture time of each tick.
    fn waits_for_capture(&self) -> bool {
        self.paced && !self.context.batch
    }

    /// In batch and unpaced runs: waits for room in the source's region and for slow readers, at most 100 ms. Returns
    /// whether it waited.
    fn wait_for_room(&self, node: usize, runtime: &NodeRuntime, pace: &mut Pace) -> bool {
        if self.waits_for_capture() {
            return false;
        }
        let has_room = match pace.to_hand_over {
            // This thread just left the region empty, and no other region reads it.
            0 if pace.end_ns.is_some() => return false,
            0 => pace.region.is_free(),
            _ => pace.region.has_room(),
        };
        let waits = !has_room || self.readers_lag(node);
        if waits {
            pace.end_ns = None;
            // A reader of another region does not wake this thread when it catches up.
            runtime.runner.park_at_most(Some(Duration::from_millis(if has_room { 1 } else { 100 })));
        }
        waits
    }

    /// Prepares the decision whether the source's thread runs the chain that is its region. A source that waits for
    /// capture times has time for a chain that fits into its allowance. Another one saves the hand-over of ticks, unless
    /// both it and its chain have so much to do that they should work at the same time.
    fn look_ahead(&self, plan: &Plan, node: usize, runtime: &NodeRuntime, pace: &mut Pace) {
        let is_next =
            |first: &&Link| plan.wiring[first.node as usize].urgency == Urgency::Urgent || !self.pool.is_pressed();
        // In a loop through a source results may depend on the ticks in flight; a real-time source runs nothing else.
        let is_plain = runtime.kind != NodeKind::Realtime && runtime.declared.inputs_len == 0;
        let first = plan.sole_chain(node).filter(|first| is_plain && is_next(first));
        pace.chain_ns = first.map_or(u64::MAX, |first| first.runtime.runner.chain_ns());
        let hands_over = pace.chain_ns > SHORT_CHAIN_NS || pace.chain_ns.min(runtime.runner.chain_ns()) > HAND_OVER_NS;
        pace.to_hand_over = if hands_over { HANDED_OVER } else { pace.to_hand_over.saturating_sub(1) };
        if !Arc::ptr_eq(&pace.region, plan.region_of(node)) {
            pace.region = Arc::clone(plan.region_of(node));
        }
    }

    /// Makes the next tick of a source and delivers it.
    fn source_tick(
        &self,
        node: usize,
        runtime: &Arc<NodeRuntime>,
        seq: u64,
        pace: &mut Pace,
        scratch: &mut Scratch,
    ) -> Step {
        if self.wait_for_room(node, runtime, pace) {
            return Step::Next;
        }
        let capture_ns = pace.last_capture_ns.map_or(0, |last| last.saturating_add(DEFAULT_FRAME_NS));
        let mut tick = Tick { source: node as u32, flags: 0, seq, capture_ns };
        let has_inputs = runtime.declared.inputs_len != 0;
        if has_inputs && !self.take_source(runtime, tick, &mut scratch.inputs) {
            runtime.runner.park_at_most(Some(Duration::from_millis(100)));
            return Step::Next;
        }
        let start_ns = pace.end_ns.take().unwrap_or_else(clock::now_ns);
        let (inputs, made) = (&mut scratch.inputs, &mut scratch.made[0]);
        let mut ports = Ports { inputs, lone: false, made, sources: self };
        let called = match runtime.call_node(&self.context, &mut tick, true, start_ns, &mut ports) {
            Ok(called) => called,
            Err(NoOutcome::Closed) => return Step::End,
            Err(NoOutcome::Abandoned) => {
                runtime.abandoned_call_returned(scratch);
                return Step::GivenUp;
            }
        };
        scratch.inputs.clear();
        if called.outcome != CallOutcome::Ok {
            return self.after_no_tick(node, runtime, &called, &tick, start_ns);
        }
        let Called { end_ns: mut now_ns, arrived_ns: declared_ns, .. } = called;
        runtime.runner.record_chain_time(now_ns.saturating_sub(start_ns));
        let made = &mut scratch.made[0];
        if !capture_fits(tick.capture_ns, pace.last_capture_ns) {
            made.clear();
            self.capture_fault(runtime, &tick, pace.last_capture_ns);
            runtime.ticks.set_made(seq + 1);
            self.wait_for_next_frame(runtime, start_ns);
            return Step::Next;
        }
        if has_inputs {
            lock(&runtime.join).made_tick();
        }
        let mut allowance_ns = 0;
        if let Some(last) = pace.last_capture_ns.replace(tick.capture_ns).filter(|&last| tick.capture_ns > last) {
            let period_ns = tick.capture_ns.abs_diff(last);
            self.frame_ns.store(period_ns, Ordering::Relaxed);
            // In batch the source makes its next tick at once instead.
            if self.waits_for_capture() {
                allowance_ns = MAX_WALK_NS.min(period_ns / WALK_SHARE);
            }
        }
        if made.outputs.iter().all(Frame::is_empty) && runtime.is_read() {
            runtime.ticks.count_empty();
        }
        runtime.ticks.set_last_capture_ns(tick.capture_ns);
        runtime.ticks.arrive(seq, declared_ns.unwrap_or(now_ns as i64));
        runtime.subscribers.show(&made.outputs);
        if let Some(observer) = &self.context.observer {
            observer.source_tick(&runtime.id, &runtime.output_names, &tick, &made.outputs);
        }
        if self.waits_for_capture() {
            now_ns = self.wait_until_due(runtime, tick.capture_ns, now_ns, &mut pace.first);
        }
        if declared_ns.is_none() {
            runtime.ticks.arrive(seq, now_ns as i64);
        }
        runtime.ticks.enter(seq);
        self.meter_allocations(seq + 1, false);
        self.pass_on(node, runtime, (tick, now_ns), allowance_ns, pace, scratch)
    }

    /// Passes the tick of a source in `scratch` on: to the chain that is its region, on this thread, or to its region.
    fn pass_on(
        &self,
        node: usize,
        runtime: &NodeRuntime,
        (tick, now_ns): (Tick, u64),
        allowance_ns: u64,
        pace: &mut Pace,
        scratch: &mut Scratch,
    ) -> Step {
        let runs_chain = if self.waits_for_capture() { pace.chain_ns < allowance_ns } else { pace.to_hand_over == 0 };
        let alone = runs_chain && pace.region.admit_alone(tick.seq);
        // The wiring of a region that admitted a tick does not change: deliver by this plan.
        let plan = self.plan.load();
        if alone && let Some(first) = plan.sole_chain(node) {
            let end_ns = self.run_sole_chain(&plan, node, first, (tick, now_ns), allowance_ns, scratch);
            // Beyond a sink nothing was delivered, which may take longer than a call.
            pace.end_ns = end_ns.filter(|_| plan.following(node).last().is_some_and(|link| link.sink));
            self.look_ahead(&plan, node, runtime, pace);
            return if end_ns.is_some() { Step::Next } else { Step::GivenUp };
        }
        drop(plan);
        let step = self.admit(node, runtime, (tick, alone), &pace.region, allowance_ns, scratch);
        self.look_ahead(&self.plan.load(), node, runtime, pace);
        step
    }

    /// Runs the chain that is a source's region, into which the tick in `scratch` was admitted as the only one. Returns
    /// when the last call ended, `None` if the watchdog abandoned this thread.
    fn run_sole_chain(
        &self,
        plan: &Plan,
        node: usize,
        first: &Link,
        (tick, now_ns): (Tick, u64),
        allowance_ns: u64,
        scratch: &mut Scratch,
    ) -> Option<u64> {
        if let Some(observer) = &self.context.observer {
            observer.admitted(&plan.runtimes[node].id);
        }
        pool::set_urgency(plan.wiring[first.node as usize].urgency);
        let mut ready = Ready::default();
        let end_ns = self.chain(plan, node, tick, now_ns, scratch, &mut ready)?;
        first.runtime.runner.record_chain_time(end_ns.saturating_sub(now_ns));
        match ready.dispatch_ready(self, plan, allowance_ns) {
            Some(next) => self.run(next, scratch, allowance_ns).then(clock::now_ns),
            None => Some(end_ns),
        }
    }

    /// Handles a call of a source that made no tick because it ended, failed or was skipped.
    #[cold]
    fn after_no_tick(
        &self,
        node: usize,
        runtime: &NodeRuntime,
        &Called { outcome, end_ns, bypassed, .. }: &Called,
        tick: &Tick,
        start_ns: u64,
    ) -> Step {
        if outcome == CallOutcome::End {
            runtime.ticks.end();
            return Step::End;
        }
        self.after(&self.plan.load(), node, false, outcome, tick, end_ns);
        if outcome == CallOutcome::Stop || bypassed || runtime.on_fault() == OnFault::Bypass {
            return Step::End;
        }
        if outcome == CallOutcome::Fault {
            // The call was made, so the next one is another tick.
            runtime.ticks.set_made(tick.seq + 1);
            self.wait_for_next_frame(runtime, start_ns);
        } else if !self.context.batch {
            // The restart thread wakes this thread.
            runtime.runner.park_at_most(Some(Duration::from_millis(100)));
        }
        Step::Next
    }

    /// Admits the tick of a source in `scratch` to its region, if it `is_admitted` not already, now or when there is
    /// room, and runs what follows for at most `allowance_ns`.
    fn admit(
        &self,
        node: usize,
        runtime: &NodeRuntime,
        (tick, is_admitted): (Tick, bool),
        region: &Region,
        allowance_ns: u64,
        scratch: &mut Scratch,
    ) -> Step {
        let mut outputs = region.spare();
        for output in &mut scratch.made[0].outputs {
            let raw = std::mem::replace(output, Frame::EMPTY);
            // SAFETY: outputs of a call that has ended are empty or hold a reference, which the list no longer has after the `replace`.
            outputs.push(unsafe { FrameRef::adopt(Frame { tick, ..raw }) });
        }
        let (enter, dropped) = if is_admitted { (Some(outputs), None) } else { region.admit_or_keep(outputs) };
        if let Some(old) = dropped {
            if let Some(seq) = old.first().map(|f| f.tick().seq) {
                self.count_lacking(node, seq);
            }
            self.drop_tick(runtime, region, old);
        }
        if let Some(outputs) = enter {
            // The tick is admitted, so the wiring of its region does not change: deliver by this plan.
            let plan = self.plan.load();
            let mut ready = Ready::default();
            self.enter(&plan, node, outputs, &mut ready);
            if let Some(next) = ready.dispatch_ready(self, &plan, allowance_ns)
                && !self.run(next, scratch, allowance_ns)
            {
                return Step::GivenUp;
            }
        }
        Step::Next
    }

    /// Counts a dropped tick of a source at the nodes of its region that write files.
    #[cold]
    fn count_lacking(&self, source: usize, seq: u64) {
        let plan = self.plan.load();
        let members = || plan.extents[plan.wiring[source].region].members.iter().map(|&member| &plan.runtimes[member]);
        for recorder in members().filter(|runtime| !runtime.source && runtime.writes_files()) {
            let lacking = recorder.stats.lacking.fetch_add(1, Ordering::Relaxed) + 1;
            recorder.report_repeated_fault(&self.context, Cause::Incomplete, Action::Note, Some(seq), || {
                let (source, recorder) = (&plan.runtimes[source].id, &recorder.id);
                let typical_ns = |runtime: &Arc<NodeRuntime>| runtime.stats.time.quantile_ns(0.5);
                let slowest = members().filter(|runtime| !runtime.source).max_by_key(|runtime| typical_ns(runtime));
                // Others are quick, but wait for another region.
                let period_ns = self.frame_ns.load(Ordering::Relaxed);
                let slowest = slowest.filter(|slow| typical_ns(slow) > period_ns / 2);
                let slow = slowest.map_or_else(String::new, |slow| {
                    let (id, ms) = (&slow.id, typical_ns(slow) as f64 / 1e6);
                    let remedy = if id == recorder {
                        "make its work smaller or the source slower".to_owned()
                    } else {
                        format!("let `{id}` read with align = \"latest\", or limit it with `max_rate_hz`")
                    };
                    format!(": `{id}` takes {ms:.1} ms; {remedy}")
                });
                let words = format!("it lacks {lacking} frames of `{source}` so far{slow}");
                self.context.log.write(crate::log::Level::Warn, recorder, &words);
                words
            });
        }
    }

    /// Counts and reports a tick of a source that does not enter the graph.
    pub(crate) fn drop_tick(&self, runtime: &NodeRuntime, region: &Region, outputs: Vec<FrameRef>) {
        bump(&runtime.stats.dropped);
        if let Some(seq) = outputs.first().map(|f| f.tick().seq) {
            runtime.record_event(&self.context, |node| Event::Dropped { node, seq });
            if let Some(tracer) = &self.context.tracer {
                tracer.dropped(&runtime.id, seq, clock::now_ns());
            }
        }
        region.recycle(outputs);
    }

    #[cold]
    fn capture_fault(&self, runtime: &NodeRuntime, tick: &Tick, last_ns: Option<i64>) {
        bump(&runtime.stats.faults);
        bump(&runtime.stats.dropped);
        runtime.report_repeated_fault(&self.context, Cause::CaptureTime, Action::Withhold, Some(tick.seq), || {
            let words = capture_words(tick.capture_ns, last_ns);
            self.context.log.write(crate::log::Level::Error, &runtime.id, &words);
            words
        });
    }

    /// Whether a reader of another region is too far behind in batch.
    pub(crate) fn readers_lag(&self, node: usize) -> bool {
        if !self.context.ignores_wall_clock() {
            return false;
        }
        let plan = self.plan.load();
        let outsiders = &plan.outsiders[plan.wiring[node].region];
        outsiders.iter().any(|&(reader, slot)| lock(&plan.runtimes[reader].join).waiting(slot) > MAX_BEHIND)
    }

    fn wait_until_due(
        &self,
        runtime: &NodeRuntime,
        capture_ns: i64,
        now_ns: u64,
        first: &mut Option<(i64, u64)>,
    ) -> u64 {
        let &mut (first_capture, first_ns) = first.get_or_insert((capture_ns, now_ns));
        let due = first_ns.saturating_add_signed(capture_ns.saturating_sub(first_capture));
        // Do not wait for a jump in media time.
        if due > now_ns.saturating_add(2_000_000_000) || due.saturating_add(1_000_000_000) < now_ns {
            *first = Some((capture_ns, now_ns));
            return now_ns;
        }
        self.wait_until(runtime, due, now_ns)
    }

    /// After a live source's call at `start_ns` that led to no tick: waits until its next frame is due. Without frame
    /// memory, for instance, a source would otherwise be called in a busy loop.
    fn wait_for_next_frame(&self, runtime: &NodeRuntime, start_ns: u64) {
        if self.paced && !self.context.batch {
            let frame_ns = self.frame_ns.load(Ordering::Relaxed).min(DEFAULT_FRAME_NS as u64);
            self.wait_until(runtime, start_ns.saturating_add(frame_ns), clock::now_ns());
        }
    }

    /// Waits until `due_ns`, or until the source has to end or is removed. Returns the time.
    fn wait_until(&self, runtime: &NodeRuntime, due_ns: u64, mut now_ns: u64) -> u64 {
        while now_ns < due_ns && !self.is_stopping() && !runtime.runner.leave.is_requested() {
            runtime.runner.park_at_most(Some(Duration::from_nanos(due_ns - now_ns)));
            now_ns = clock::now_ns();
        }
        now_ns
    }
}

/// Whether to admit a tick of this capture time after one of `last_ns`.
#[inline]
pub(crate) fn capture_fits(capture_ns: i64, last_ns: Option<i64>) -> bool {
    let back = |last: i64| capture_ns <= last && last.saturating_sub(capture_ns) < REWIND_NS;
    CAPTURE_NS.contains(&capture_ns) && !last_ns.is_some_and(back)
}

/// The reason why [`capture_fits`] is false.
#[cold]
pub(crate) fn capture_words(capture_ns: i64, last_ns: Option<i64>) -> String {
    let (range, ms) = (CAPTURE_NS, |ns: i64| ns as f64 / 1e6);
    match last_ns.filter(|_| range.contains(&capture_ns)) {
        Some(last) => {
            format!("capture time {:.3} ms after {:.3} ms: the tick was dropped", ms(capture_ns), ms(last))
        }
        None => format!("capture time {capture_ns} ns lies outside {range:?}: the tick was dropped"),
    }
}

enum Step {
    Next,
    End,
    /// The watchdog abandoned this thread; another one continues.
    GivenUp,
}

/// Pins the calling thread and requests real-time priority; the system may refuse both.
fn place_thread(cpu: Option<u32>, realtime: bool) {
    if let Some(cpu) = cpu.filter(|&c| (c as usize) < libc::CPU_SETSIZE as usize) {
        // SAFETY: plain system calls on a local set.
        unsafe {
            let mut set: libc::cpu_set_t = std::mem::zeroed();
            libc::CPU_SET(cpu as usize, &mut set);
            libc::sched_setaffinity(0, size_of::<libc::cpu_set_t>(), &raw const set);
        }
    }
    if realtime {
        let priority = libc::sched_param { sched_priority: 20 };
        // SAFETY: a plain system call.
        unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const priority) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn capture_times_outside_their_range_or_backwards_are_not_let_in() {
        let refused = |ns, last| !capture_fits(ns, last);
        for ns in [i64::MIN, i64::MAX, 1 << 62, -(1 << 62) - 1] {
            assert!(refused(ns, None) && refused(ns, Some(0)), "{ns}");
        }
        let (least, most) = (CAPTURE_NS.start, CAPTURE_NS.end - 1);
        assert!(!refused(least, None) && !refused(most, Some(least)));
        assert!(most.checked_sub(least).is_some() && least.checked_sub(most).is_some());
        assert!(refused(5, Some(5)) && refused(4, Some(5)) && !refused(6, Some(5)));
        assert!(!refused(least, Some(most)), "a recording that starts again");
    }
}
