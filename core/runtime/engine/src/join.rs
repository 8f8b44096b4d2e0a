//! The inputs of a node: the packets that wait, and when the node may fire.

mod slot;

use std::collections::VecDeque;
use std::sync::Mutex;

use panoscope_abi::Tick;

use crate::decide::Wanted;
use crate::light::{Lights, inherited};
use crate::memory::FrameRef;
use crate::region::Region;
use crate::sync::lock;

pub(crate) use self::slot::{Rule, Slot};

/// Maximum number of packets beyond its capacity that a slot queues while its region is paused.
const MAX_PAUSED: usize = 1 << 10;

/// Result of an attempt to fire.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Take {
    /// An input is missing.
    Wait,
    /// Inputs are staged for this tick; `complete` is false if a required one is empty.
    Fire { tick: Tick, complete: bool },
    /// No packet will follow.
    Finished,
}

/// Whether a thread runs the node, and whether it will be fired again.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Turn {
    /// May be fired.
    #[default]
    Idle,
    /// A thread runs it.
    Running,
    /// A thread runs it for the last time: it was removed from the graph meanwhile.
    Finishing,
    /// It is not fired again.
    Finished,
}

/// All connections into a node.
#[derive(Default)]
pub(crate) struct Join {
    pub slots: Vec<Slot>,
    turn: Turn,
    /// Inputs of the tick that is to run, one per slot.
    pub staged: Vec<FrameRef>,
    pub staged_take: Option<(Tick, bool)>,
    exact: bool,
    /// Whether a slot is not exact.
    timed: bool,
    batch: bool,
    /// The tick before, of a node with slots that are not exact.
    previous: Option<Tick>,
    /// A slot whose packet was too old for the tick that was taken last.
    pub too_old_on: Option<usize>,
    /// Whether the inputs of a source were staged for a tick that it has not made: no producer makes a value for it.
    is_unmade: bool,
    /// Whether a slot may queue more than its capacity, during a pause and until what came then is used.
    has_spare: bool,
    /// The slots were handed over to the node's successor, see [`Self::hand_over`].
    is_handed_over: bool,
    /// Time in ns of the host's clock after which the node stops waiting for a `nearest` slot; 0 when it does not wait.
    pub nearest_deadline_ns: u64,
}

impl Join {
    pub fn new(slots: Vec<Slot>, batch: bool) -> Self {
        let exact = slots.iter().any(|s| s.rule == Rule::Exact);
        let timed = slots.iter().any(|s| s.rule != Rule::Exact);
        let staged = Vec::with_capacity(slots.len());
        Self { slots, exact, timed, batch, staged, ..Self::default() }
    }

    /// Whether the node may be fired: no thread runs it, and it is not finished.
    #[inline]
    pub fn is_idle(&self) -> bool {
        self.turn == Turn::Idle
    }

    /// Whether a thread runs the node.
    #[inline]
    pub fn is_running(&self) -> bool {
        matches!(self.turn, Turn::Running | Turn::Finishing)
    }

    /// Whether the node is not fired again.
    #[inline]
    pub fn is_finished(&self) -> bool {
        matches!(self.turn, Turn::Finishing | Turn::Finished)
    }

    /// Sets whether a thread runs the node.
    #[inline]
    pub fn set_running(&mut self, running: bool) {
        self.turn = match (running, self.is_finished()) {
            (true, false) => Turn::Running,
            (true, true) => Turn::Finishing,
            (false, false) => Turn::Idle,
            (false, true) => Turn::Finished,
        };
    }

    /// The node is not fired again. Returns whether that is new.
    pub fn finish(&mut self) -> bool {
        let is_new = !self.is_finished();
        self.turn = if self.is_running() { Turn::Finishing } else { Turn::Finished };
        is_new
    }

    /// The node may be fired again: a change gave it new inputs. Returns whether it was finished.
    pub fn unfinish(&mut self) -> bool {
        let was_finished = self.is_finished();
        self.turn = if self.is_running() { Turn::Running } else { Turn::Idle };
        was_finished
    }

    /// Whether the node fires on arrivals because nothing gives it a tick.
    pub fn heads_region(&self) -> bool {
        !self.exact && self.slots.iter().any(|s| matches!(s.rule, Rule::Latest { .. } | Rule::Nearest { .. }))
    }

    /// Queues a packet. Returns how many were dropped to make room.
    pub fn push(&mut self, slot: usize, frame: FrameRef) -> u64 {
        let (batch, heads) = (self.batch, !self.exact);
        let slot = &mut self.slots[slot];
        let mut dropped = 0;
        match slot.rule {
            Rule::Latest { trigger } if !batch => {
                if frame.is_empty() {
                    return 0; // An empty packet keeps the newest value.
                }
                while slot.queue.len() >= slot.room() {
                    slot.queue.pop_front();
                    // Replacing a value that would not fire loses nothing, so only triggers count.
                    dropped += u64::from(trigger && heads);
                }
                slot.dropped += dropped;
            }
            Rule::Nearest { .. } | Rule::Delay if !batch => {
                while slot.queue.len() >= slot.room() {
                    slot.queue.pop_front();
                    dropped += 1;
                }
                slot.dropped += dropped;
            }
            _ => {}
        }
        slot.put(frame);
        dropped
    }

    /// Queues everything that arrives during a pause, up to [`MAX_PAUSED`] packets beyond each capacity.
    pub fn pause(&mut self) {
        let fires = !self.exact;
        self.slots.iter_mut().for_each(|s| s.pause(fires));
        self.has_spare = true;
    }

    /// Ends the pause: the queues drain, then capacities hold again.
    pub fn resume(&mut self) {
        self.slots.iter_mut().for_each(|s| s.spare = s.spare.min(s.queue.len()));
        self.has_spare = self.slots.iter().any(|s| s.spare > 0);
    }

    /// Takes back what a pause granted, as the queues drain.
    #[cold]
    fn shrink_spare(&mut self) {
        let draining = |s: &&mut Slot| s.spare > 0 && s.spare < MAX_PAUSED;
        self.slots.iter_mut().filter(draining).for_each(|s| s.spare = s.spare.min(s.queue.len()));
        self.has_spare = self.slots.iter().any(|s| s.spare > 0);
    }

    /// Sets per slot how many packets may wait, and whether they come from a loop.
    pub fn set_wires(&mut self, wires: impl Iterator<Item = (usize, bool)>) {
        for (slot, (capacity, is_state)) in self.slots.iter_mut().zip(wires) {
            slot.capacity = capacity.max(1);
            slot.is_state = is_state;
        }
    }

    /// Becomes `new` and takes over the queues of slots that stay: `from[i]` is the old index of new slot `i`.
    pub fn rewire(&mut self, mut new: Join, from: &[Option<usize>]) {
        for (slot, from) in new.slots.iter_mut().zip(from) {
            if let Some(old) = from.and_then(|i| self.slots.get_mut(i)) {
                slot.inherit(old);
            }
        }
        let (turn, has_spare, previous) = (self.turn, self.has_spare, self.previous);
        *self = Join { turn, has_spare, previous, ..new };
    }

    /// Hands all slots over to the node's successor. From here on packets that a call of a producer still delivers here
    /// belong to the successor.
    pub fn hand_over(&mut self) -> Join {
        std::mem::replace(self, Join { turn: Turn::Finished, is_handed_over: true, ..Join::default() })
    }

    /// Whether a successor has the slots.
    #[inline]
    pub fn is_handed_over(&self) -> bool {
        self.is_handed_over
    }

    /// No further packet will come on this slot.
    pub fn end(&mut self, slot: usize) {
        self.slots[slot].ended = true;
    }

    /// Fires if all inputs are there. `region` must admit the tick for a node that heads one.
    pub fn try_take(&mut self, region: Option<&Region>, lights: &Lights<'_>) -> Take {
        if self.is_finished() {
            return Take::Finished;
        }
        if self.exact { self.take_exact(lights) } else { self.take_arrival(region, lights) }
    }

    /// Whether the packets taken may depend on timing.
    pub fn is_timed(&self) -> bool {
        self.timed
    }

    /// The ticks of the staged packets; `None` for an empty input.
    pub fn staged_ticks(&self) -> Vec<Option<(u32, u64)>> {
        let staged = self.slots.iter().zip(&self.staged);
        let known = |(slot, frame): (&Slot, &FrameRef)| {
            (slot.rule == Rule::Exact || !frame.is_empty()).then(|| (frame.tick().source, frame.tick().seq))
        };
        staged.map(known).collect()
    }

    /// Queues a packet for [`Self::take_wanted`].
    pub fn push_for_decider(&mut self, slot: usize, frame: FrameRef) -> u64 {
        let slot = &mut self.slots[slot];
        if slot.rule == Rule::Exact || !frame.is_empty() {
            slot.put(frame);
        }
        0
    }

    /// Fires with the packets that the earlier run took, once they are there. Skips the packets before them.
    pub fn take_wanted(
        &mut self,
        region: Option<&Region>,
        script: Option<&Mutex<VecDeque<Wanted>>>,
        may_enter: bool,
        lights: &Lights<'_>,
    ) -> Take {
        if self.is_finished() {
            return Take::Finished;
        }
        let mut script = script.map(|s| lock(s));
        let Some(wanted) = script.as_mut().and_then(|s| s.front()) else {
            self.slots.iter_mut().filter(|s| s.rule != Rule::Exact).for_each(|s| s.queue.clear());
            let fires = |s: &&Slot| match s.rule {
                Rule::Exact => true,
                Rule::Latest { trigger } => trigger && !self.exact,
                Rule::Nearest { .. } | Rule::Delay => false,
            };
            return if self.slots.iter().filter(fires).all(|s| s.ended) { Take::Finished } else { Take::Wait };
        };
        let is = |frame: &FrameRef, tick: (u32, u64)| (frame.tick().source, frame.tick().seq) == tick;
        let mut there = true;
        for (slot, wanted) in self.slots.iter_mut().zip(&wanted.inputs) {
            let Some(tick) = *wanted else { continue };
            if slot.held.as_ref().is_some_and(|held| is(held, tick)) {
                continue;
            }
            while slot.queue.front().is_some_and(|front| !is(front, tick)) {
                slot.queue.pop_front();
            }
            match slot.queue.pop_front() {
                Some(frame) => slot.held = Some(frame),
                // After a gap in the recording it never comes.
                None if slot.ended => slot.held = None,
                None => there = false,
            }
        }
        if !there || !may_enter || region.is_some_and(|r| !r.try_admit()) {
            return Take::Wait;
        }
        let mut tick = wanted.tick;
        let mut complete = true;
        self.staged.clear();
        for (slot, wanted) in self.slots.iter_mut().zip(wanted.inputs.iter().copied().chain(std::iter::repeat(None))) {
            let frame = wanted.and_then(|_| slot.held.clone()).unwrap_or_else(|| FrameRef::empty(tick));
            if slot.rule == Rule::Exact {
                slot.held = None;
            }
            complete &= slot.optional || !frame.is_empty();
            self.staged.push(frame);
        }
        if let Some(script) = &mut script {
            script.pop_front();
        }
        tick.flags = self.inherit(&tick, lights);
        self.previous = Some(tick);
        self.staged_take = Some((tick, complete));
        Take::Fire { tick, complete }
    }

    /// Packets that wait on a slot; none where a successor has it.
    pub fn waiting(&self, slot: usize) -> usize {
        self.slots.get(slot).map_or(0, |slot| slot.queue.len())
    }

    /// Stages the delay and latest inputs of a source; `false` while the previous tick's value is still being made.
    pub fn take_source(&mut self, tick: Tick, lights: &Lights<'_>) -> bool {
        if self.is_unmade {
            self.slots.iter_mut().for_each(|s| s.expects = false);
        }
        if self.slots.iter().any(Slot::waits_for_delayed) {
            return false;
        }
        self.stage(tick, None, lights);
        self.staged_take = None;
        self.is_unmade = true;
        true
    }

    /// A source has made the tick that its inputs were staged for.
    pub fn made_tick(&mut self) {
        self.is_unmade = false;
    }

    fn take_exact(&mut self, lights: &Lights<'_>) -> Take {
        let mut tick = None;
        for slot in self.slots.iter().filter(|s| s.rule == Rule::Exact) {
            match slot.queue.front() {
                Some(front) => tick = tick.or(Some(front.tick())),
                None if slot.ended => return Take::Finished,
                None => return Take::Wait,
            }
        }
        let Some(tick) = tick else { return Take::Wait };
        if self.timed && !self.others_ready(tick, lights.now_ns) {
            return Take::Wait;
        }
        self.stage(tick, None, lights)
    }

    /// Delay, latest and nearest slots of a node that has its tick.
    fn others_ready(&mut self, tick: Tick, now_ns: u64) -> bool {
        for slot in &self.slots {
            let newest = slot.queue.back().map(|f| f.tick().capture_ns);
            let ready = match slot.rule {
                Rule::Exact => true,
                Rule::Delay => !slot.waits_for_delayed(),
                Rule::Latest { .. } if self.batch => slot.ended || newest.is_some_and(|t| t >= tick.capture_ns),
                Rule::Latest { .. } => true,
                Rule::Nearest { tolerance_ns } => {
                    let arrived = slot.ended || newest.is_some_and(|t| t >= tick.capture_ns);
                    if !arrived && !self.batch && self.nearest_deadline_ns == 0 {
                        self.nearest_deadline_ns = now_ns.saturating_add(tolerance_ns.max(1) as u64);
                    }
                    arrived || (!self.batch && now_ns >= self.nearest_deadline_ns)
                }
            };
            if !ready {
                return false;
            }
        }
        true
    }

    fn take_arrival(&mut self, region: Option<&Region>, lights: &Lights<'_>) -> Take {
        let fires = |s: &Slot| matches!(s.rule, Rule::Latest { trigger: true });
        // In batch the merged order must not depend on timing: wait until every firing slot has its next packet.
        if self.batch && self.slots.iter().any(|s| fires(s) && s.queue.is_empty() && !s.ended) {
            return Take::Wait;
        }
        let next = self
            .slots
            .iter()
            .enumerate()
            .filter(|(_, s)| fires(s))
            .filter_map(|(i, s)| s.queue.front().map(|f| (f.tick().capture_ns, i)))
            .min();
        let Some((_, index)) = next else {
            let over = self.slots.iter().filter(|s| fires(s)).all(|s| s.ended);
            return if over { Take::Finished } else { Take::Wait };
        };
        let tick = self.slots[index].queue[0].tick();
        if self.batch {
            let behind = |s: &Slot| {
                !fires(s) && !s.ended && s.queue.back().is_none_or(|f| f.tick().capture_ns < tick.capture_ns)
            };
            if self.slots.iter().any(|s| s.rule != Rule::Delay && behind(s)) {
                return Take::Wait;
            }
        } else {
            // A required value never came: the node does not fire.
            let missing = |(i, s): (usize, &Slot)| i != index && !s.optional && s.queue.is_empty() && s.held.is_none();
            if self.slots.iter().enumerate().any(missing) {
                return Take::Wait;
            }
        }
        if self.slots.iter().any(Slot::waits_for_delayed) {
            return Take::Wait;
        }
        if region.is_some_and(|r| !r.try_admit()) {
            return Take::Wait;
        }
        self.stage(tick, Some(index), lights)
    }

    fn stage(&mut self, mut tick: Tick, fired_by: Option<usize>, lights: &Lights<'_>) -> Take {
        let (mut complete, mut has_lag) = (true, self.timed);
        self.nearest_deadline_ns = 0;
        self.staged.clear();
        for (index, slot) in self.slots.iter_mut().enumerate() {
            let frame = match slot.rule {
                Rule::Exact => slot.queue.pop_front(),
                Rule::Delay => {
                    // The producer's packet of the previous tick; an empty one keeps the last value.
                    if std::mem::replace(&mut slot.expects, true)
                        && let Some(frame) = slot.queue.pop_front()
                        && !frame.is_empty()
                    {
                        slot.held = Some(frame);
                    }
                    slot.held.clone()
                }
                Rule::Latest { .. } => {
                    if fired_by == Some(index) {
                        slot.held = slot.queue.pop_front();
                    } else {
                        while let Some(front) = slot.queue.front()
                            && (!self.batch || front.tick().capture_ns <= tick.capture_ns)
                        {
                            let frame = slot.queue.pop_front();
                            if frame.as_ref().is_some_and(|f| !f.is_empty()) {
                                slot.held = frame;
                            }
                        }
                    }
                    slot.held.clone()
                }
                Rule::Nearest { tolerance_ns } => {
                    let distance = |f: &FrameRef| f.tick().capture_ns.abs_diff(tick.capture_ns);
                    while slot.queue.len() > 1 && distance(&slot.queue[1]) <= distance(&slot.queue[0]) {
                        slot.queue.pop_front();
                    }
                    slot.queue.front().filter(|f| distance(f) <= tolerance_ns.max(0) as u64).cloned()
                }
            };
            let mut frame = frame.unwrap_or_else(|| FrameRef::empty(tick));
            if slot.max_age_ns.is_some() && slot.is_too_old(&frame, &tick, lights) {
                (frame, self.too_old_on) = (FrameRef::empty(tick), Some(index));
            }
            complete &= slot.optional || !frame.is_empty();
            has_lag |= frame.tick().flags != 0;
            self.staged.push(frame);
        }
        if has_lag {
            tick.flags = self.inherit(&tick, lights);
            self.previous = Some(tick);
        }
        if self.has_spare {
            self.shrink_spare();
        }
        self.staged_take = Some((tick, complete));
        Take::Fire { tick, complete }
    }

    /// Lag of what is made of the staged packets, as [`Tick::flags`].
    fn inherit(&self, tick: &Tick, lights: &Lights<'_>) -> u32 {
        let lags = self.slots.iter().zip(&self.staged).filter(|(slot, frame)| slot.shows_light && !frame.is_empty());
        inherited(lags.filter_map(|(slot, frame)| match slot.is_state {
            true => lights.lag_of_state(tick, &frame.tick(), self.previous),
            false => lights.lag(tick, &frame.tick()),
        }))
    }
}

#[cfg(test)]
mod tests;
