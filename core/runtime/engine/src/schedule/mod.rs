//! Runs ticks through the plan.
//!
//! The thread that runs a node has its join marked as running and owns its `Exec`. The plan is loaded for every node
//! that starts: a node only starts after its region admitted a tick, and a region with a tick inside is never changed.

mod take;

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Condvar, Mutex, Weak};

use arc_swap::ArcSwap;
use panoscope_abi::{Frame, Tick};
use panoscope_base::format;

use crate::call::{CallOutcome, NoOutcome, Ports};
use crate::clock;
use crate::convert;
use crate::exec::{Exec, prefetch};
use crate::fault::{Action, Cause};
use crate::light::{Lag, Sources};
use crate::log::Level;
use crate::memory::FrameRef;
use crate::node::{NodeRuntime, SizeChange};
use crate::own_thread::OwnThread;
use crate::plan::{Link, Plan, Reader};
use crate::pool::{self, Pool, Urgency};
use crate::region::Freed;
use crate::run_context::RunContext;
use crate::scratch::{Scratch, clear};
use crate::stats::bump;
use crate::sync::lock;

/// State shared by the threads of an engine.
pub(crate) struct Shared {
    pub me: Weak<Shared>,
    pub plan: ArcSwap<Plan>,
    pub pool: Pool,
    pub context: RunContext,
    /// Whether sources wait until the capture time of each tick.
    pub paced: bool,
    /// Ticks each source makes; `None` for no end.
    pub frames: Option<u64>,
    pub stopping: AtomicBool,
    pub failed: Mutex<Option<String>>,
    /// Whether a thread of the host panicked or could not be started, so that nodes may never finish.
    pub broken: AtomicBool,
    /// Nodes that are not finished.
    pub unfinished: AtomicUsize,
    pub finished: Condvar,
    pub finished_lock: Mutex<()>,
    /// Held while nodes finish and while the plan changes.
    pub finishing: Mutex<()>,
    pub start_ns: u64,
    pub end_ns: AtomicU64,
    pub allocations: AllocationMeter,
    /// Nodes that wait for a `nearest` input with a deadline.
    pub waiting_nearest: AtomicI64,
    /// Threads that belong to one node, by thread number.
    pub own_threads: Mutex<HashMap<u32, OwnThread>>,
    /// A call without a budget that takes longer counts as hung.
    pub hang_ns: u64,
    /// When the run was asked to end, 0 before. From then on a call that takes longer than `stop_limit_ns` counts as
    /// hung.
    pub stop_ns: AtomicU64,
    pub stop_limit_ns: u64,
    /// Media time between two ticks of the fastest source.
    pub frame_ns: AtomicU64,
}

/// Counts heap allocations of the whole process in steady state.
#[derive(Default)]
pub(crate) struct AllocationMeter {
    pub count: Option<fn() -> u64>,
    /// Count and tick number after warm-up.
    pub from: Mutex<Option<(u64, u64)>>,
    /// Count and tick number at the end of the source.
    pub to: Mutex<Option<(u64, u64)>>,
    pub warm_up_ticks: u64,
}

/// Nodes that are ready to run.
#[derive(Default)]
pub(crate) struct Ready {
    nodes: [u32; 16],
    len: usize,
}

impl Ready {
    fn push(&mut self, shared: &Shared, plan: &Plan, node: usize) {
        if self.len == self.nodes.len() {
            shared.dispatch(plan, node);
            return;
        }
        self.nodes[self.len] = node as u32;
        self.len += 1;
    }

    /// Sends all nodes to their threads except one whose chain takes at most `allowance_ns`, which the caller runs
    /// itself: an urgent one, if there is one, a patient one only if no urgent task waits.
    pub fn dispatch_ready(&mut self, shared: &Shared, plan: &Plan, allowance_ns: u64) -> Option<usize> {
        let nodes = &self.nodes[..self.len];
        let fits = |node: &usize| {
            let runtime = &plan.runtimes[*node];
            allowance_ns > 0 && !runtime.owns_thread() && runtime.runner.chain_ns() <= allowance_ns
        };
        let urgent = |node: &usize| plan.wiring[*node].urgency == Urgency::Urgent;
        let all = || nodes.iter().map(|node| *node as usize);
        let next = all().find(|node| urgent(node) && fits(node));
        let next = next.or_else(|| all().find(|node| fits(node) && !shared.pool.is_pressed()));
        for node in all().filter(|node| Some(*node) != next) {
            shared.dispatch(plan, node);
        }
        self.len = 0;
        next
    }
}

/// Next step of a node after an attempt to take its next tick.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Next {
    Run,
    Idle,
    Finish,
}

impl Sources for Shared {
    fn arrived_ns(&self, tick: &Tick) -> Option<i64> {
        self.plan.load().arrived_ns(tick)
    }

    fn is_constant(&self, tick: &Tick) -> bool {
        self.plan.load().is_constant(tick)
    }

    fn is_forgotten(&self, tick: &Tick) -> bool {
        self.plan.load().is_forgotten(tick)
    }
}

impl Shared {
    /// Sends a node that took its tick to its own thread or to the pool.
    pub fn dispatch(&self, plan: &Plan, node: usize) {
        let runtime = &plan.runtimes[node];
        if runtime.owns_thread() {
            runtime.runner.wake();
        } else {
            self.pool.push(node as u32, plan.wiring[node].urgency);
        }
    }

    /// Runs a node and its successors on this thread; `false` if the watchdog abandoned the thread. A worker has no
    /// time limit (`u64::MAX`); a node's own thread runs other chains only as long as they are known to fit into its
    /// allowance.
    pub fn run(&self, node: usize, scratch: &mut Scratch, mut allowance_ns: u64) -> bool {
        let is_worker = allowance_ns == u64::MAX;
        let mut current = node;
        loop {
            let plan = self.plan.load();
            let mut ready = Ready::default();
            pool::set_urgency(plan.wiring[current].urgency);
            let Some(again) = self.run_tick(&plan, current, scratch, &mut ready) else { return false };
            let is_owner = plan.runtimes[current].owns_thread();
            // A thread's own node comes first.
            match (ready.dispatch_ready(self, &plan, if is_owner && again { 0 } else { allowance_ns }), again) {
                (next, true) if !is_owner && (next.is_some() || !is_worker) => {
                    self.pool.push(current as u32, plan.wiring[current].urgency);
                    let Some(next) = next else { return true };
                    current = next;
                }
                (_, true) => continue,
                (Some(next), false) => current = next,
                (None, false) => return true,
            }
            if !is_worker {
                allowance_ns = allowance_ns.saturating_sub(plan.runtimes[current].runner.chain_ns());
            }
        }
    }

    /// Runs one staged tick of a node and its inline chain. Returns whether the next tick is staged, `None` if a call
    /// was abandoned.
    fn run_tick(&self, plan: &Plan, node: usize, scratch: &mut Scratch, ready: &mut Ready) -> Option<bool> {
        let runtime = &plan.runtimes[node];
        let staged = {
            let mut join = lock(&runtime.join);
            scratch.inputs.append(&mut join.staged);
            join.staged_take.take()
        };
        if let Some((mut tick, complete)) = staged {
            prefetch_next(plan.following(node), 0);
            let start_ns = clock::now_ns();
            let (inputs, made) = (&mut scratch.inputs, &mut scratch.made[0]);
            let mut ports = Ports { inputs, lone: false, made, sources: plan };
            let called = match runtime.call_node(&self.context, &mut tick, complete, start_ns, &mut ports) {
                Ok(called) => called,
                Err(NoOutcome::Closed) => {
                    scratch.inputs.clear();
                    lock(&runtime.join).set_running(false);
                    return Some(false);
                }
                Err(NoOutcome::Abandoned) => {
                    runtime.abandoned_call_returned(scratch);
                    return None;
                }
            };
            scratch.inputs.clear();
            self.after(plan, node, plan.wiring[node].sink, called.outcome, &tick, called.end_ns);
            self.show(runtime, &scratch.made[0].outputs);
            let end_ns = self.chain(plan, node, tick, called.end_ns, scratch, ready)?;
            runtime.runner.record_chain_time(end_ns.saturating_sub(start_ns));
        }
        Some(self.take_next(plan, node, ready))
    }

    /// Passes a node's outputs to its subscribers and to the observer.
    #[inline]
    fn show(&self, runtime: &NodeRuntime, outputs: &[Frame]) {
        runtime.subscribers.show(outputs);
        if let Some(observer) = &self.context.observer {
            observer.outputs(&runtime.id, &runtime.output_names, outputs);
        }
    }

    /// Handles the outcome of a call.
    #[inline]
    pub fn after(&self, plan: &Plan, node: usize, sink: bool, outcome: CallOutcome, tick: &Tick, now_ns: u64) {
        if outcome == CallOutcome::Ok {
            if sink && let Some(arrived_ns) = plan.arrived_ns(tick) {
                let (age_ns, lag) = (now_ns.saturating_add_signed(arrived_ns.saturating_neg()), Lag::carried(tick));
                let stats = &plan.runtimes[node].stats;
                stats.age.record(age_ns.saturating_add_signed(lag.oldest_ns));
                stats.newest_age.record(age_ns.saturating_add_signed(lag.newest_ns));
            }
        } else if outcome != CallOutcome::Skipped {
            self.after_failure(plan, node, outcome, tick);
        }
    }

    #[cold]
    fn after_failure(&self, plan: &Plan, node: usize, outcome: CallOutcome, tick: &Tick) {
        let runtime = &plan.runtimes[node];
        self.report_size_change(plan, node, tick);
        if outcome == CallOutcome::Stop {
            self.fail(format!("node `{}` failed and the graph says on_fault = \"stop\"", runtime.id));
        }
        if runtime.recovery.take_restart_request() {
            self.start_restart(runtime);
        }
    }

    /// After a failure: reports a producer that changed the size of its output at this tick.
    fn report_size_change(&self, plan: &Plan, node: usize, tick: &Tick) {
        for (from, producer) in plan.live() {
            let readers = &plan.wiring[from].readers;
            let fed = |r: &&SizeChange| readers.get(r.output).is_some_and(|r| r.iter().any(|r| r.node == node));
            let at_tick = |r: &&SizeChange| (r.tick.source, r.tick.seq) == (tick.source, tick.seq);
            let Some(resized) = producer.progress.find_size_change(|change| fed(&change) && at_tick(&change)) else {
                continue;
            };
            let name = producer.rules.get(resized.output).map_or("?", |r| &r.name);
            let ((w0, h0), (w1, h1), reader) = (resized.from, resized.to, &plan.runtimes[node].id);
            let words = format!("output `{name}` is {w1}x{h1} after {w0}x{h0}, node `{reader}` failed on it");
            self.context.log.write(Level::Error, &producer.id, &words);
            producer.report_fault(&self.context, Cause::Size, Action::Note, Some(tick.seq), None, words);
        }
    }

    /// Runs the inline readers of the outputs in `scratch.made[0]`, which were shown, delivers the outputs of the last
    /// one and notifies the region. Returns when the last call ended, `None` if one was abandoned.
    pub fn chain(
        &self,
        plan: &Plan,
        node: usize,
        mut tick: Tick,
        mut now_ns: u64,
        scratch: &mut Scratch,
        ready: &mut Ready,
    ) -> Option<u64> {
        let mut last = node;
        let [made, next] = &mut scratch.made;
        let (mut made, mut next) = (made, next);
        let links = plan.following(node);
        for (at, link) in links.iter().enumerate() {
            prefetch_next(links, at + 1);
            let frame = &mut made.outputs[link.port as usize];
            if !takes(link.accepts, frame) {
                self.refused(plan, last, link.port as usize, link.node as usize, link.accepts, frame);
                // SAFETY: an output of a call that has ended holds its reference.
                unsafe { clear(std::slice::from_mut(frame)) };
            }
            let runtime = &*link.runtime;
            let complete = link.optional || !frame.is_empty();
            // Outputs of a call carry the tick already; writing it again would delay the next reader.
            if frame.is_empty() {
                frame.tick = tick;
            }
            tick.flags = frame.tick.flags;
            // SAFETY: an output of a call that has ended is empty or holds its reference, and `made` keeps holding it.
            let inputs = std::slice::from_mut(unsafe { FrameRef::adopt_in_place(frame) });
            let mut ports = Ports { inputs, lone: link.lone, made: next, sources: plan };
            let called = match runtime.call_node(&self.context, &mut tick, complete, now_ns, &mut ports) {
                Ok(called) => called,
                Err(NoOutcome::Closed) => {
                    // At the end of a run, after the time limit.
                    made.clear();
                    self.skip_from(plan, link.node as usize, tick, ready);
                    return Some(now_ns);
                }
                Err(NoOutcome::Abandoned) => {
                    runtime.abandoned_call_returned(scratch);
                    return None;
                }
            };
            made.clear();
            if link.sink || called.outcome != CallOutcome::Ok {
                self.after(plan, link.node as usize, link.sink, called.outcome, &tick, called.end_ns);
            }
            now_ns = called.end_ns;
            last = link.node as usize;
            std::mem::swap(&mut made, &mut next);
            self.show(runtime, &made.outputs);
        }
        for (port, output) in made.outputs.iter_mut().enumerate() {
            let raw = std::mem::replace(output, Frame::EMPTY);
            let tick = if raw.is_empty() { tick } else { raw.tick };
            // SAFETY: an output of a call that has ended is empty or holds its reference, which `made` no longer has after the `replace`.
            let frame = unsafe { FrameRef::adopt(Frame { tick, ..raw }) };
            self.deliver_port(plan, last, port, frame, ready);
        }
        self.leave(plan, last, ready);
        Some(now_ns)
    }

    /// Finishes a tick from a node on whose call was abandoned: its outputs are empty, and the rest of its chain is
    /// skipped.
    pub fn skip_from(&self, plan: &Plan, node: usize, tick: Tick, ready: &mut Ready) {
        let mut last = node;
        while let Some(inline) = plan.wiring[last].inline {
            last = inline.node;
            bump(&plan.runtimes[last].stats.skipped);
            plan.runtimes[last].skipped_tick(&self.context, &tick, false);
        }
        for port in 0..plan.wiring[last].readers.len() {
            self.deliver_port(plan, last, port, FrameRef::empty(tick), ready);
        }
        self.leave(plan, last, ready);
    }

    /// A node is done with a tick. If it is a leaf, its region may admit another one.
    fn leave(&self, plan: &Plan, node: usize, ready: &mut Ready) {
        let wiring = &plan.wiring[node];
        if !wiring.leaf {
            return;
        }
        let nth = plan.runtimes[node].count_done_tick();
        let region = &plan.regions[wiring.region];
        match region.leaf_done(nth) {
            Freed::Nothing => {}
            Freed::Head => self.try_fire_head(plan, region.head, ready),
            Freed::Pending(outputs) => {
                self.enter(plan, region.head, outputs, ready);
                while let Some(outputs) = region.handed_over() {
                    self.enter(plan, region.head, outputs, ready);
                }
                self.try_fire_head(plan, region.head, ready);
            }
        }
    }

    /// Delivers a tick of a source that was admitted.
    pub fn enter(&self, plan: &Plan, source: usize, mut outputs: Vec<FrameRef>, ready: &mut Ready) {
        if let Some(observer) = &self.context.observer {
            observer.admitted(&plan.runtimes[source].id);
        }
        for (port, frame) in outputs.drain(..).enumerate() {
            self.deliver_port(plan, source, port, frame, ready);
        }
        plan.regions[plan.wiring[source].region].recycle(outputs);
        self.leave(plan, source, ready);
    }

    /// The head of a region may admit another tick.
    pub fn try_fire_head(&self, plan: &Plan, head: usize, ready: &mut Ready) {
        let runtime = &plan.runtimes[head];
        if runtime.source {
            runtime.runner.wake();
        } else {
            self.try_fire(plan, head, ready);
        }
    }

    fn deliver_port(&self, plan: &Plan, node: usize, port: usize, frame: FrameRef, ready: &mut Ready) {
        let Some(readers) = plan.wiring[node].readers.get(port) else { return };
        let mut gray: Option<FrameRef> = None;
        for (index, reader) in readers.iter().enumerate() {
            let converted = reader.convert && convert::wants(frame.frame());
            if !converted && !takes(reader.accepts, frame.frame()) {
                self.refused(plan, node, port, reader.node, reader.accepts, frame.frame());
                self.arrive(plan, reader, FrameRef::empty(frame.tick()), ready);
                continue;
            }
            let packet = if converted {
                gray.get_or_insert_with(|| self.to_gray(&plan.runtimes[node], &frame)).clone()
            } else if index + 1 == readers.len() {
                return self.arrive(plan, reader, frame, ready);
            } else {
                frame.clone()
            };
            self.arrive(plan, reader, packet, ready);
        }
    }

    fn to_gray(&self, runtime: &NodeRuntime, frame: &FrameRef) -> FrameRef {
        bump(&runtime.stats.conversions);
        convert::to_gray8(frame).unwrap_or_else(|| {
            let words = "a gray copy was skipped: frame memory is used up";
            self.context.log.write(Level::Warn, &runtime.id, words);
            runtime.report_repeated_fault(
                &self.context,
                Cause::Exhausted,
                Action::Withhold,
                Some(frame.tick().seq),
                || words.to_owned(),
            );
            FrameRef::empty(frame.tick())
        })
    }

    /// Reports an output of a format that its reader does not accept.
    #[cold]
    fn refused(&self, plan: &Plan, node: usize, port: usize, reader: usize, accepts: u32, frame: &Frame) {
        let runtime = &plan.runtimes[node];
        bump(&runtime.stats.faults);
        runtime.report_repeated_fault(&self.context, Cause::Format, Action::Withhold, Some(frame.tick.seq), || {
            let words = format!(
                "output `{}` is {}, node `{}` takes {}",
                runtime.rules.get(port).map_or("?", |r| &r.name),
                format::name(frame.format),
                plan.runtimes[reader].id,
                format::names(accepts)
            );
            self.context.log.write(Level::Error, &runtime.id, &words);
            words
        });
    }

    fn arrive(&self, plan: &Plan, reader: &Reader, frame: FrameRef, ready: &mut Ready) {
        let node = reader.node;
        let runtime = &plan.runtimes[node];
        let mut join = lock(&runtime.join);
        if join.is_handed_over() {
            drop(join);
            return self.arrive_at_successor(reader, frame);
        }
        let dropped = if self.context.decider.is_none() {
            join.push(reader.slot, frame)
        } else if runtime.source {
            // Its ticks come from a recording, so it needs no inputs.
            return;
        } else {
            join.push_for_decider(reader.slot, frame)
        };
        if dropped > 0 {
            runtime.stats.dropped.fetch_add(dropped, Ordering::Relaxed);
            let slot = &join.slots[reader.slot];
            if slot.is_timed() {
                self.report_drops(runtime, reader.slot, slot.dropped(), dropped, slot.capacity);
            }
        }
        if !join.is_idle() {
            return;
        }
        if runtime.source {
            drop(join);
            return runtime.runner.wake();
        }
        let next = self.decide(plan, node, &mut join);
        drop(join);
        self.go_on(plan, node, next, ready);
    }

    /// Delivers to the successor of a node that a change replaced while its producer, in a region that the change does
    /// not hold, was in a call under the plan before. The producer's readers are the same in both plans: otherwise the
    /// change would hold its region.
    #[cold]
    fn arrive_at_successor(&self, reader: &Reader, frame: FrameRef) {
        // The change holds this lock until its plan is stored.
        drop(lock(&self.finishing));
        let plan = self.plan.load_full();
        let mut ready = Ready::default();
        self.arrive(&plan, reader, frame, &mut ready);
        ready.dispatch_ready(self, &plan, 0);
    }

    /// Reports a full queue of packets that are matched by time.
    #[cold]
    fn report_drops(&self, runtime: &NodeRuntime, slot: usize, all: u64, new: u64, capacity: usize) {
        // Only when the count passes a power of two.
        if all.ilog2() == (all - new).checked_ilog2().unwrap_or(u32::MAX) {
            return;
        }
        let port = runtime.port_of_slot(slot);
        let name = port.map_or("?", |port| runtime.input_name(port));
        let words = format!(
            "input `{name}`: {all} packets were dropped, because {capacity} wait already; what they are matched with comes too seldom \
             (`queue` says how many may wait)"
        );
        self.context.log.write(Level::Warn, &runtime.id, &words);
    }

    /// Marks a node as finished: no tick will come out of it again. Its readers may finish, too.
    pub fn finish(&self, node: usize, ready: &mut Ready) {
        let _order = lock(&self.finishing);
        let plan = self.plan.load();
        let mut list = vec![node];
        while let Some(node) = list.pop() {
            // No thread runs the node any more; closing it will finish its files.
            self.one_finished();
            plan.runtimes[node].runner.wake();
            for reader in plan.wiring[node].readers.iter().flatten() {
                let mut join = lock(&plan.runtimes[reader.node].join);
                join.end(reader.slot);
                if !join.is_idle() || plan.runtimes[reader.node].source {
                    continue;
                }
                match self.decide(&plan, reader.node, &mut join) {
                    Next::Run => ready.push(self, &plan, reader.node),
                    Next::Idle => {}
                    Next::Finish => list.push(reader.node),
                }
            }
        }
    }

    /// Counts a finished or removed node.
    pub fn one_finished(&self) {
        if self.unfinished.fetch_sub(1, Ordering::AcqRel) == 1 {
            self.end_ns.store(clock::now_ns(), Ordering::Relaxed);
            let _guard = lock(&self.finished_lock);
            self.finished.notify_all();
        }
    }

    /// Ends the run with a reason.
    pub fn fail(&self, reason: String) {
        lock(&self.failed).get_or_insert(reason);
        self.stop();
    }

    /// Ends the run with a reason, without waiting for nodes that can no longer finish.
    #[cold]
    pub fn fail_for_good(&self, reason: String) {
        self.fail(reason);
        self.broken.store(true, Ordering::Release);
        let _guard = lock(&self.finished_lock);
        self.finished.notify_all();
    }

    /// Ends the sources.
    pub fn stop(&self) {
        let _ = self.stop_ns.compare_exchange(0, clock::now_ns().max(1), Ordering::Relaxed, Ordering::Relaxed);
        self.stopping.store(true, Ordering::Release);
        for (_, runtime) in self.plan.load().live().filter(|(_, c)| c.source) {
            runtime.runner.wake();
        }
    }

    pub fn is_stopping(&self) -> bool {
        self.stopping.load(Ordering::Acquire)
    }

    /// Counts the heap allocations up to a source's tick `seq`: after the warm-up, every 16 ticks, and at its end.
    pub fn meter_allocations(&self, seq: u64, is_last: bool) {
        let Some(count) = self.allocations.count else { return };
        if seq == self.allocations.warm_up_ticks {
            lock(&self.allocations.from).get_or_insert((count(), seq));
        } else if seq > self.allocations.warm_up_ticks && (is_last || seq.is_multiple_of(16)) {
            *lock(&self.allocations.to) = Some((count(), seq));
        }
    }
}

/// Prefetches what the next nodes of a chain will touch, each step as early as its address is known: after a pause, or
/// in a long chain, it is in no fast cache.
#[inline]
fn prefetch_next(links: &[Link], at: usize) {
    if let Some(link) = links.get(at + 1) {
        prefetch((&raw const *link.runtime).cast());
    }
    if let Some(link) = links.get(at) {
        Exec::prefetch(link.runtime.exec.address());
    }
}

/// Whether a reader accepts the format of a frame.
#[inline]
fn takes(accepts: u32, frame: &Frame) -> bool {
    accepts == 0 || frame.is_empty() || (frame.format < 32 && accepts >> frame.format & 1 == 1)
}
