//! The walk of ticks through the plan.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Condvar, Mutex};
use std::time::Duration;

use panoscope_abi::{Frame, Tick};

use crate::cell::{Cell, Exec, Ran, Surroundings, clear, lock};
use crate::clock;
use crate::convert;
use crate::join::Take;
use crate::log::Level;
use crate::memory::FrameRef;
use crate::plan::{InlineReader, Plan};
use crate::pool::Pool;
use crate::region::Freed;
use crate::stats::bump;

/// Ticks whose ingest time is remembered per source.
const INGEST_RING: usize = 4096;

/// Ticks a batch reader of another region may lag behind before the producer's source waits.
const MOST_BEHIND: usize = 64;

/// What the threads of an engine share.
pub(crate) struct Shared {
    pub plan: Plan,
    pub pool: Pool,
    pub around: Surroundings,
    /// Wait between ticks of a source until their capture time has come.
    pub paced: bool,
    /// Ticks each source makes; `None` for no end.
    pub frames: Option<u64>,
    pub stopping: AtomicBool,
    pub failed: Mutex<Option<String>>,
    /// Nodes that are not finished.
    pub unfinished: AtomicUsize,
    pub finished: Condvar,
    pub finished_lock: Mutex<()>,
    /// Ingest time of the newest ticks, per source node.
    pub ingest_ns: Vec<Box<[AtomicU64]>>,
    /// Ticks each source node has made.
    pub made: Vec<AtomicU64>,
    pub start_ns: u64,
    pub end_ns: AtomicU64,
    pub allocations: AllocationMeter,
    /// Nodes that wait for a `nearest` input with a deadline.
    pub waiting_nearest: AtomicI64,
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

/// Nodes that may run now.
#[derive(Default)]
pub(crate) struct Ready {
    nodes: [u32; 16],
    len: usize,
}

impl Ready {
    fn push(&mut self, shared: &Shared, node: usize) {
        if self.len == self.nodes.len() {
            shared.dispatch(node);
            return;
        }
        self.nodes[self.len] = node as u32;
        self.len += 1;
    }

    /// Hands all to their threads but one that may run inline.
    fn settle(&mut self, shared: &Shared, inline: bool) -> Option<usize> {
        let mut next = None;
        for &node in &self.nodes[..self.len] {
            let node = node as usize;
            if inline && next.is_none() && !shared.plan.cells[node].owns_thread() {
                next = Some(node);
            } else {
                shared.dispatch(node);
            }
        }
        self.len = 0;
        next
    }
}

impl Shared {
    /// Sends a node that was taken (`running`) to where it runs.
    pub fn dispatch(&self, node: usize) {
        let cell = &self.plan.cells[node];
        if cell.owns_thread() {
            self.wake(cell);
        } else {
            self.pool.push(node as u32);
        }
    }

    fn wake(&self, cell: &Cell) {
        cell.wake.store(true, Ordering::Release);
        if let Some(thread) = cell.thread.get() {
            thread.unpark();
        }
    }

    /// Runs a node and whatever may follow it on this thread.
    pub fn run(&self, node: usize) {
        let mut current = node;
        loop {
            let inline = !self.plan.cells[current].owns_thread();
            let mut ready = Ready::default();
            let again = self.run_tick(current, &mut ready);
            if !inline {
                ready.settle(self, false);
                if again {
                    continue;
                }
                return;
            }
            let next = ready.settle(self, true);
            match (next, again) {
                (Some(next), true) => {
                    self.pool.push(current as u32);
                    current = next;
                }
                (Some(next), false) => current = next,
                (None, true) => {}
                (None, false) => return,
            }
        }
    }

    /// One staged tick of a node and its inline chain; `true` when the next tick is staged already.
    fn run_tick(&self, node: usize, ready: &mut Ready) -> bool {
        let plan = &self.plan;
        let cell = &plan.cells[node];
        let mut exec = lock(&cell.exec);
        let staged = {
            let mut join = lock(&cell.join);
            std::mem::swap(&mut exec.inputs, &mut join.staged);
            join.staged_take.take()
        };
        if let Some((mut tick, complete)) = staged {
            let start_ns = clock::now_ns();
            let (ran, now_ns) = cell.run(&mut exec, &self.around, &mut tick, complete, start_ns);
            self.after(cell, node, ran, &tick, now_ns);
            self.chain(node, exec, tick, now_ns, ready);
        } else {
            drop(exec);
        }
        let mut join = lock(&cell.join);
        let region = self.plan.regions.get(plan.wiring[node].region).filter(|_| join.heads_region());
        let take = join.try_take(region.map(|r| &**r), clock::now_ns());
        self.settle_take(node, &mut join, take, ready)
    }

    fn after(&self, cell: &Cell, node: usize, ran: Ran, tick: &Tick, now_ns: u64) {
        if ran == Ran::Stop {
            self.fail(format!("node `{}` failed and the graph says on_fault = \"stop\"", cell.id));
        }
        if self.plan.wiring[node].sink && ran == Ran::Ok {
            if let Some(ingest) = self.ingest(tick) {
                cell.stats.age.record(now_ns.saturating_sub(ingest));
            }
        }
    }

    /// When a tick came into the graph, in ns of the host's clock.
    pub fn ingest(&self, tick: &Tick) -> Option<u64> {
        let ring = self.ingest_ns.get(tick.source as usize)?;
        let slot = ring.get(tick.seq as usize % INGEST_RING)?;
        Some(slot.load(Ordering::Relaxed)).filter(|&ns| ns > 0)
    }

    /// Walks the inline readers, delivers what the last one made and tells the region.
    fn chain<'a>(
        &'a self,
        node: usize,
        mut exec: std::sync::MutexGuard<'a, Exec>,
        tick: Tick,
        mut now_ns: u64,
        ready: &mut Ready,
    ) {
        let plan = &self.plan;
        let mut last = node;
        let mut tick = tick;
        while let Some(InlineReader { port, node: next, optional }) = plan.wiring[last].inline_reader {
            plan.cells[last].taps.show(&exec.outputs);
            let frame = std::mem::replace(&mut exec.outputs[port], Frame::EMPTY);
            clear(&mut exec.outputs);
            let cell = &plan.cells[next];
            let mut following = lock(&cell.exec);
            let complete = optional || !frame.is_empty();
            following.inputs.push(FrameRef::adopt(Frame { tick, ..frame }));
            let (ran, end_ns) = cell.run(&mut following, &self.around, &mut tick, complete, now_ns);
            self.after(cell, next, ran, &tick, end_ns);
            now_ns = end_ns;
            exec = following;
            last = next;
        }
        plan.cells[last].taps.show(&exec.outputs);
        self.deliver(last, &mut exec.outputs, tick, ready);
        drop(exec);
        self.leave(last, ready);
    }

    /// A node is done with a tick: if it is a leaf, its region may be.
    fn leave(&self, node: usize, ready: &mut Ready) {
        let wiring = &self.plan.wiring[node];
        if !wiring.leaf {
            return;
        }
        let nth = self.plan.cells[node].done_ticks.fetch_add(1, Ordering::Relaxed);
        let region = &self.plan.regions[wiring.region];
        match region.leaf_done(nth) {
            Freed::Nothing => {}
            Freed::Head => self.poke_head(region.head, ready),
            Freed::Pending(outputs) => {
                self.deliver_list(region.head, outputs, ready);
                self.poke_head(region.head, ready);
            }
        }
    }

    /// The head of a region may admit another tick.
    fn poke_head(&self, head: usize, ready: &mut Ready) {
        let cell = &self.plan.cells[head];
        if cell.source {
            self.wake(cell);
        } else {
            self.poke(head, ready);
        }
    }

    /// Tries to fire a node that nobody runs.
    fn poke(&self, node: usize, ready: &mut Ready) {
        let cell = &self.plan.cells[node];
        let mut join = lock(&cell.join);
        if join.running || join.finished {
            return;
        }
        let region = self.plan.regions.get(self.plan.wiring[node].region).filter(|_| join.heads_region());
        let take = join.try_take(region.map(|r| &**r), clock::now_ns());
        if self.settle_take(node, &mut join, take, ready) {
            ready.push(self, node);
        }
    }

    /// Writes down what `try_take` said; `true` when the node is to run.
    fn settle_take(&self, node: usize, join: &mut crate::join::Join, take: Take, ready: &mut Ready) -> bool {
        match take {
            Take::Fire { .. } => {
                join.running = true;
                true
            }
            Take::Wait => {
                join.running = false;
                false
            }
            Take::Finished => {
                join.running = false;
                if !std::mem::replace(&mut join.finished, true) {
                    self.finish(node, ready);
                }
                false
            }
        }
    }

    /// Passes the outputs of a node to their readers and leaves them empty.
    fn deliver(&self, node: usize, outputs: &mut [Frame], tick: Tick, ready: &mut Ready) {
        for (port, output) in outputs.iter_mut().enumerate() {
            let raw = std::mem::replace(output, Frame::EMPTY);
            self.deliver_port(node, port, FrameRef::adopt(Frame { tick, ..raw }), ready);
        }
    }

    fn deliver_list(&self, node: usize, mut outputs: Vec<FrameRef>, ready: &mut Ready) {
        for (port, frame) in outputs.drain(..).enumerate() {
            self.deliver_port(node, port, frame, ready);
        }
        self.plan.regions[self.plan.wiring[node].region].recycle(outputs);
    }

    fn deliver_port(&self, node: usize, port: usize, frame: FrameRef, ready: &mut Ready) {
        let readers = &self.plan.wiring[node].readers[port];
        let mut gray: Option<FrameRef> = None;
        for (index, reader) in readers.iter().enumerate() {
            let packet = if reader.convert && convert::wants(frame.frame()) {
                let made = gray.get_or_insert_with(|| {
                    bump(&self.plan.cells[node].stats.conversions);
                    convert::to_gray8(&frame).unwrap_or_else(|| {
                        self.around.log.say(
                            Level::Warn,
                            &self.plan.cells[node].id,
                            "a gray copy was left out: frame memory is used up",
                        );
                        FrameRef::empty(frame.tick())
                    })
                });
                made.clone()
            } else if index + 1 == readers.len() {
                return self.arrive(reader.node, reader.slot, frame, ready);
            } else {
                frame.clone()
            };
            self.arrive(reader.node, reader.slot, packet, ready);
        }
    }

    fn arrive(&self, node: usize, slot: usize, frame: FrameRef, ready: &mut Ready) {
        let cell = &self.plan.cells[node];
        let mut join = lock(&cell.join);
        let dropped = join.push(slot, frame);
        if dropped > 0 {
            cell.stats.dropped.fetch_add(dropped, Ordering::Relaxed);
        }
        if join.running || join.finished {
            return;
        }
        if cell.source {
            drop(join);
            return self.wake(cell);
        }
        let region = self.plan.regions.get(self.plan.wiring[node].region).filter(|_| join.heads_region());
        let take = join.try_take(region.map(|r| &**r), clock::now_ns());
        if take == Take::Wait && join.nearest_deadline_ns != 0 {
            self.waiting_nearest.store(1, Ordering::Relaxed);
        }
        if self.settle_take(node, &mut join, take, ready) {
            ready.push(self, node);
        }
    }

    /// No tick will come out of this node again.
    fn finish(&self, node: usize, ready: &mut Ready) {
        let mut list = vec![node];
        while let Some(node) = list.pop() {
            // Closing finishes files; nobody runs the node any more.
            if self.unfinished.fetch_sub(1, Ordering::AcqRel) == 1 {
                self.end_ns.store(clock::now_ns(), Ordering::Relaxed);
                let _guard = lock(&self.finished_lock);
                self.finished.notify_all();
            }
            self.wake(&self.plan.cells[node]);
            for reader in self.plan.wiring[node].readers.iter().flatten() {
                let mut join = lock(&self.plan.cells[reader.node].join);
                join.end(reader.slot);
                if join.running || join.finished || self.plan.cells[reader.node].source {
                    continue;
                }
                let region =
                    self.plan.regions.get(self.plan.wiring[reader.node].region).filter(|_| join.heads_region());
                match join.try_take(region.map(|r| &**r), clock::now_ns()) {
                    Take::Fire { .. } => {
                        join.running = true;
                        ready.push(self, reader.node);
                    }
                    Take::Wait => {}
                    Take::Finished => {
                        join.finished = true;
                        list.push(reader.node);
                    }
                }
            }
        }
    }

    /// Ends the run with a reason.
    pub fn fail(&self, reason: String) {
        lock(&self.failed).get_or_insert(reason);
        self.stop();
    }

    /// Asks the sources to end.
    pub fn stop(&self) {
        self.stopping.store(true, Ordering::Release);
        for cell in self.plan.cells.iter().filter(|c| c.source) {
            self.wake(cell);
        }
    }

    fn is_stopping(&self) -> bool {
        self.stopping.load(Ordering::Acquire)
    }

    /// Waits on the node's own thread until it is woken or the time is over.
    fn park(&self, cell: &Cell, most: Option<Duration>) {
        if cell.wake.swap(false, Ordering::Acquire) {
            return;
        }
        match most {
            Some(most) => std::thread::park_timeout(most),
            None => std::thread::park(),
        }
        cell.wake.store(false, Ordering::Release);
    }

    /// The thread of a node that may wait.
    pub fn blocking_thread(&self, node: usize) {
        let cell = Arc::clone(&self.plan.cells[node]);
        loop {
            while !cell.wake.swap(false, Ordering::Acquire) {
                std::thread::park();
            }
            let (running, finished) = {
                let join = lock(&cell.join);
                (join.running, join.finished)
            };
            if finished {
                return;
            }
            if running {
                self.run(node);
            }
        }
    }

    /// The thread of a source.
    pub fn source_thread(&self, node: usize) {
        let cell = Arc::clone(&self.plan.cells[node]);
        let region = Arc::clone(&self.plan.regions[self.plan.wiring[node].region]);
        let mut seq = 0u64;
        let mut first_due: Option<(i64, u64)> = None;
        while !self.is_stopping() && self.frames.is_none_or(|most| seq < most) {
            let waits = self.around.batch || !self.paced;
            if waits && (!region.has_room() || self.readers_lag(node)) {
                // A reader of another region does not wake this thread when it catches up.
                self.park(&cell, Some(Duration::from_millis(if region.has_room() { 1 } else { 100 })));
                continue;
            }
            let mut tick = Tick { source: node as u32, flags: 0, seq, capture_ns: 0 };
            if !lock(&cell.join).take_source(tick) {
                self.park(&cell, Some(Duration::from_millis(100)));
                continue;
            }
            let mut exec = lock(&cell.exec);
            std::mem::swap(&mut exec.inputs, &mut lock(&cell.join).staged);
            let start_ns = clock::now_ns();
            let (ran, mut now_ns) = cell.run(&mut exec, &self.around, &mut tick, true, start_ns);
            match ran {
                Ran::End => break,
                Ran::Stop => {
                    self.after(&cell, node, ran, &tick, now_ns);
                    break;
                }
                // A source that is down makes no ticks; do not ask again at once.
                Ran::Skipped | Ran::Fault => {
                    drop(exec);
                    if cell.on_fault == panoscope_graph::OnFault::Bypass {
                        break;
                    }
                    std::thread::sleep(Duration::from_millis(5));
                    continue;
                }
                Ran::Ok => {}
            }
            if self.paced && !self.around.batch {
                now_ns = self.wait_until_due(&cell, tick.capture_ns, now_ns, &mut first_due);
            }
            self.ingest_ns[node][seq as usize % INGEST_RING].store(now_ns.max(1), Ordering::Relaxed);
            cell.taps.show(&exec.outputs);
            let mut outputs = region.spare();
            for output in &mut exec.outputs {
                let raw = std::mem::replace(output, Frame::EMPTY);
                outputs.push(FrameRef::adopt(Frame { tick, ..raw }));
            }
            drop(exec);
            seq += 1;
            self.made[node].store(seq, Ordering::Relaxed);
            self.meter_allocations(seq);
            let mut ready = Ready::default();
            let (enter, dropped) = region.admit_or_keep(outputs);
            if let Some(old) = dropped {
                bump(&cell.stats.dropped);
                region.recycle(old);
            }
            if let Some(outputs) = enter {
                self.deliver_list(node, outputs, &mut ready);
                self.leave(node, &mut ready);
            }
            ready.settle(self, false);
        }
        while region.has_pending() {
            self.park(&cell, Some(Duration::from_millis(1)));
        }
        let mut ready = Ready::default();
        lock(&cell.join).finished = true;
        self.finish(node, &mut ready);
        ready.settle(self, false);
    }

    /// Whether a batch reader of another region has much to catch up with.
    fn readers_lag(&self, node: usize) -> bool {
        if !self.around.batch {
            return false;
        }
        let home = self.plan.wiring[node].region;
        self.plan.wiring.iter().enumerate().filter(|(_, w)| w.region == home).any(|(_, wiring)| {
            wiring.readers.iter().flatten().any(|r| {
                self.plan.wiring[r.node].region != home
                    && lock(&self.plan.cells[r.node].join).waiting(r.slot) > MOST_BEHIND
            })
        })
    }

    fn wait_until_due(&self, cell: &Cell, capture_ns: i64, now_ns: u64, first: &mut Option<(i64, u64)>) -> u64 {
        let &mut (first_capture, first_ns) = first.get_or_insert((capture_ns, now_ns));
        let due = first_ns.saturating_add_signed(capture_ns - first_capture);
        // A jump in media time is not waited for.
        if due > now_ns + 2_000_000_000 || due + 1_000_000_000 < now_ns {
            *first = Some((capture_ns, now_ns));
            return now_ns;
        }
        let mut now = now_ns;
        while now < due && !self.is_stopping() {
            self.park(cell, Some(Duration::from_nanos(due - now)));
            now = clock::now_ns();
        }
        now
    }

    fn meter_allocations(&self, seq: u64) {
        let Some(count) = self.allocations.count else { return };
        if seq == self.allocations.warm_up_ticks {
            lock(&self.allocations.from).get_or_insert((count(), seq));
        } else if seq > self.allocations.warm_up_ticks {
            *lock(&self.allocations.to) = Some((count(), seq));
        }
    }

    /// Wakes nodes whose wait for a `nearest` input is over; answers whether any still waits.
    pub fn poke_nearest(&self) {
        if self.waiting_nearest.swap(0, Ordering::Relaxed) == 0 {
            return;
        }
        let now_ns = clock::now_ns();
        let mut ready = Ready::default();
        for (node, cell) in self.plan.cells.iter().enumerate() {
            let deadline = lock(&cell.join).nearest_deadline_ns;
            if deadline == 0 {
                continue;
            }
            if now_ns >= deadline {
                self.poke(node, &mut ready);
            } else {
                self.waiting_nearest.store(1, Ordering::Relaxed);
            }
        }
        ready.settle(self, false);
    }
}

/// Memory for the ingest times of one source.
pub(crate) fn ingest_ring(source: bool) -> Box<[AtomicU64]> {
    (0..if source { INGEST_RING } else { 0 }).map(|_| AtomicU64::new(0)).collect()
}
