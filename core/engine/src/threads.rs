//! Threads that belong to one node: sources and nodes that may wait.

use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use panoscope_abi::{Frame, Tick};
use panoscope_graph::{NodeKind, OnFault};

use crate::clock;
use crate::fault::{Action, Cause};
use crate::ingest::INGEST_RING;
use crate::memory::FrameRef;
use crate::node::{CallOutcome, NodeRuntime, Ports};
use crate::observe::Event;
use crate::own_thread::OwnThread;
use crate::schedule::{Ready, Shared};
use crate::scratch::Scratch;
use crate::stats::bump;
use crate::sync::lock;
use crate::thread_id;

/// Ticks a batch reader of another region may lag behind before the producer's source waits.
const MOST_BEHIND: usize = 64;

/// Capture time between ticks of a source that states none.
const DEFAULT_FRAME_NS: i64 = 33_333_333;

/// A step back in capture time of at least this length is a recording that starts again, not a fault.
const REWIND_NS: i64 = 1_000_000_000;

/// Capture times that are let in: 146 years to either side. The difference of any two of them is a number of nanoseconds, too.
const CAPTURE_NS: Range<i64> = -(1 << 62)..1 << 62;

/// Longest that a source's thread works for others between two of its ticks, and the share of the time between them.
const LONGEST_WALK_NS: u64 = 1_000_000;
const WALK_SHARE: u64 = 8;
/// The same for the thread of a node that may wait: about what it takes to wake another one.
const SHORT_WALK_NS: u64 = 100_000;

/// What a source's thread knows between two ticks.
#[derive(Default)]
struct Pace {
    /// Capture and wall time of the first tick.
    first: Option<(i64, u64)>,
    last_capture_ns: Option<i64>,
    /// The last staging of inputs led to no tick.
    again: bool,
}

impl Shared {
    /// Starts the thread of a node.
    pub fn start_thread(self: &Arc<Self>, node: usize, cell: &Arc<NodeRuntime>) -> std::io::Result<()> {
        let number = thread_id::next();
        let (shared, owner) = (Arc::clone(self), Arc::clone(cell));
        let cell = Arc::clone(cell);
        cell.runner.has_thread.store(true, Ordering::Release);
        let mut threads = lock(&self.own_threads);
        let builder = std::thread::Builder::new().name(cell.id.chars().take(15).collect());
        let name = cell.id.clone();
        let work = Arc::clone(&shared).watched(name, move || {
            *lock(&cell.runner.thread) = Some(std::thread::current());
            thread_id::set(number);
            shared.pool.enter();
            place_thread(cell.cpu, cell.kind == NodeKind::Realtime);
            let given_up =
                if cell.source { shared.source_thread(node, &cell) } else { shared.blocking_thread(node, &cell) };
            if given_up {
                shared.pool.left(number);
                return;
            }
            if cell.runner.retired.load(Ordering::Acquire) {
                for instance in cell.take_instances().0 {
                    cell.end(&shared.around, instance);
                }
            }
            cell.runner.has_thread.store(false, Ordering::Release);
        });
        let handle = builder.spawn(work)?;
        threads.insert(number, OwnThread { node, cell: owner, handle });
        Ok(())
    }

    /// Waits on the node's own thread until it is woken or the time is over.
    pub(crate) fn park(&self, cell: &NodeRuntime, most: Option<Duration>) {
        if cell.runner.wake.swap(false, Ordering::Acquire) {
            return;
        }
        match most {
            Some(most) => std::thread::park_timeout(most),
            None => std::thread::park(),
        }
        cell.runner.wake.store(false, Ordering::Release);
    }

    /// Answers whether the watchdog gave this thread up.
    fn blocking_thread(&self, node: usize, cell: &NodeRuntime) -> bool {
        let mut walk = Scratch::default();
        // Real-time priority is for the node alone.
        let allowance_ns = if cell.kind == NodeKind::Realtime { 0 } else { SHORT_WALK_NS };
        loop {
            while !cell.runner.wake.swap(false, Ordering::Acquire) {
                std::thread::park();
            }
            let (running, finished) = {
                let join = lock(&cell.join);
                (join.running, join.finished)
            };
            if finished || cell.runner.leave.accept() {
                return false;
            }
            if running && !self.run(node, &mut walk, allowance_ns) {
                return true;
            }
        }
    }

    /// Answers whether the watchdog gave this thread up.
    fn source_thread(&self, node: usize, cell: &Arc<NodeRuntime>) -> bool {
        let last_ns = cell.ticks.last_capture_ns.load(Ordering::Relaxed);
        let mut walk = Scratch::default();
        let mut pace = Pace { last_capture_ns: (last_ns != i64::MIN).then_some(last_ns), ..Pace::default() };
        let leaves = || cell.runner.leave.accept();
        if let Some(decider) = self.around.decider.clone() {
            if self.play(&*decider, node, cell) {
                return false;
            }
            return self.source_over(node, cell);
        }
        while !self.is_stopping() {
            if leaves() {
                return false;
            }
            let seq = cell.ticks.made.load(Ordering::Relaxed);
            if self.frames.is_some_and(|most| seq >= most) {
                break;
            }
            match self.source_tick(node, cell, seq, &mut pace, &mut walk) {
                Step::Next => {}
                Step::End => break,
                Step::GivenUp => return true,
            }
        }
        self.source_over(node, cell)
    }

    /// A source has made its last tick: answers `false` when all is said.
    fn source_over(&self, node: usize, cell: &NodeRuntime) -> bool {
        let region = Arc::clone(self.plan.load().region_of(node));
        while region.has_pending() {
            self.park(cell, Some(Duration::from_millis(1)));
            if cell.runner.leave.accept() {
                return false;
            }
        }
        let mut ready = Ready::default();
        if !std::mem::replace(&mut lock(&cell.join).finished, true) {
            self.finish(node, &mut ready);
        }
        ready.dispatch_ready(self, &self.plan.load(), 0);
        false
    }

    fn source_tick(&self, node: usize, cell: &Arc<NodeRuntime>, seq: u64, pace: &mut Pace, walk: &mut Scratch) -> Step {
        if self.around.batch || !self.paced {
            let has_room = self.plan.load().region_of(node).has_room();
            if !has_room || self.readers_lag(node) {
                // A reader of another region does not wake this thread when it catches up.
                self.park(cell, Some(Duration::from_millis(if has_room { 1 } else { 100 })));
                return Step::Next;
            }
        }
        let capture_ns = pace.last_capture_ns.map_or(0, |last| last.saturating_add(DEFAULT_FRAME_NS));
        let mut tick = Tick { source: node as u32, flags: 0, seq, capture_ns };
        if !lock(&cell.join).take_source(tick, pace.again) {
            pace.again = false;
            self.park(cell, Some(Duration::from_millis(100)));
            return Step::Next;
        }
        pace.again = true;
        let Some(mut exec) = cell.exec.take() else { return Step::End };
        walk.inputs.append(&mut lock(&cell.join).staged);
        let start_ns = clock::now_ns();
        let mut ports = Ports { inputs: &mut walk.inputs, lone: false, made: &mut walk.made[0] };
        let (ran, mut now_ns) = cell.run(&mut exec, &self.around, &mut tick, true, start_ns, &mut ports);
        if ran == CallOutcome::Abandoned {
            Self::left_behind(cell, exec, walk);
            return Step::GivenUp;
        }
        walk.inputs.clear();
        let bypassed = exec.bypassed;
        cell.exec.put(exec);
        let made = &mut walk.made[0];
        if ran != CallOutcome::Ok {
            if ran == CallOutcome::End {
                return Step::End;
            }
            self.after(&self.plan.load(), node, false, ran, &tick, now_ns);
            if ran == CallOutcome::Stop || bypassed || cell.on_fault() == OnFault::Bypass {
                return Step::End;
            }
            if ran == CallOutcome::Fault {
                // The call was made: the next one is another tick.
                cell.ticks.made.store(seq + 1, Ordering::Relaxed);
            } else if !self.around.batch {
                // It is being restarted; whoever does that wakes this thread.
                self.park(cell, Some(Duration::from_millis(100)));
            }
            return Step::Next;
        }
        if !capture_fits(tick.capture_ns, pace.last_capture_ns) {
            made.clear();
            self.capture_fault(cell, &tick, pace.last_capture_ns);
            cell.ticks.made.store(seq + 1, Ordering::Relaxed);
            return Step::Next;
        }
        pace.again = false;
        let mut allowance_ns = 0;
        if let Some(last) = pace.last_capture_ns.replace(tick.capture_ns).filter(|&last| tick.capture_ns > last) {
            let period_ns = tick.capture_ns.abs_diff(last);
            self.frame_ns.store(period_ns, Ordering::Relaxed);
            // Where nobody waits for the time of a tick, the next one is made meanwhile.
            if self.paced && !self.around.batch {
                allowance_ns = LONGEST_WALK_NS.min(period_ns / WALK_SHARE);
            }
        }
        cell.ticks.last_capture_ns.store(tick.capture_ns, Ordering::Relaxed);
        cell.subscribers.show(&made.outputs);
        if let Some(observer) = &self.around.observer {
            observer.source_tick(&cell.id, &cell.output_names, &tick, &made.outputs);
        }
        let region = Arc::clone(self.plan.load().region_of(node));
        let mut outputs = region.spare();
        for output in &mut made.outputs {
            let raw = std::mem::replace(output, Frame::EMPTY);
            // SAFETY: outputs of a call that has ended are empty or hold a reference, which the list has just forgotten.
            outputs.push(unsafe { FrameRef::adopt(Frame { tick, ..raw }) });
        }
        if self.paced && !self.around.batch {
            now_ns = self.wait_until_due(cell, tick.capture_ns, now_ns, &mut pace.first);
        }
        cell.ticks.ingest_ns[seq as usize % INGEST_RING].store(now_ns.max(1), Ordering::Relaxed);
        cell.ticks.made.store(seq + 1, Ordering::Relaxed);
        self.meter_allocations(seq + 1);
        let (enter, dropped) = region.admit_or_keep(outputs);
        if let Some(old) = dropped {
            bump(&cell.stats.dropped);
            if let Some(seq) = old.first().map(|f| f.tick().seq) {
                cell.write_down(&self.around, |node| Event::Dropped { node, seq });
            }
            region.recycle(old);
        }
        if let Some(outputs) = enter {
            // Admitted, so the region keeps its wiring: this is the plan to deliver by.
            let plan = self.plan.load();
            let mut ready = Ready::default();
            self.enter(&plan, node, outputs, &mut ready);
            if let Some(next) = ready.dispatch_ready(self, &plan, allowance_ns)
                && !self.run(next, walk, allowance_ns)
            {
                return Step::GivenUp;
            }
        }
        Step::Next
    }

    #[cold]
    fn capture_fault(&self, cell: &NodeRuntime, tick: &Tick, last_ns: Option<i64>) {
        bump(&cell.stats.faults);
        bump(&cell.stats.dropped);
        cell.note(&self.around, Cause::CaptureTime, Action::Withhold, Some(tick.seq), || {
            let words = capture_words(tick.capture_ns, last_ns);
            self.around.log.write(crate::log::Level::Error, &cell.id, &words);
            words
        });
    }

    /// Whether a batch reader of another region has much to catch up with.
    pub(crate) fn readers_lag(&self, node: usize) -> bool {
        if !self.around.unhurried() {
            return false;
        }
        let plan = self.plan.load();
        let outsiders = &plan.outsiders[plan.wiring[node].region];
        outsiders.iter().any(|&(reader, slot)| lock(&plan.cells[reader].join).waiting(slot) > MOST_BEHIND)
    }

    fn wait_until_due(&self, cell: &NodeRuntime, capture_ns: i64, now_ns: u64, first: &mut Option<(i64, u64)>) -> u64 {
        let &mut (first_capture, first_ns) = first.get_or_insert((capture_ns, now_ns));
        let due = first_ns.saturating_add_signed(capture_ns.saturating_sub(first_capture));
        // A jump in media time is not waited for.
        if due > now_ns.saturating_add(2_000_000_000) || due.saturating_add(1_000_000_000) < now_ns {
            *first = Some((capture_ns, now_ns));
            return now_ns;
        }
        let mut now = now_ns;
        while now < due && !self.is_stopping() && !cell.runner.leave.is_requested() {
            self.park(cell, Some(Duration::from_nanos(due - now)));
            now = clock::now_ns();
        }
        now
    }
}

/// Whether a tick of this capture time is let in after one of another.
#[inline]
pub(crate) fn capture_fits(capture_ns: i64, last_ns: Option<i64>) -> bool {
    let back = |last: i64| capture_ns <= last && last.saturating_sub(capture_ns) < REWIND_NS;
    CAPTURE_NS.contains(&capture_ns) && !last_ns.is_some_and(back)
}

/// Why it is not.
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
    /// Somebody else goes on in place of this thread.
    GivenUp,
}

/// Pins the calling thread and asks for real-time priority; a system may refuse both.
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
