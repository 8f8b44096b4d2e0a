//! The inputs of a node: the packets that wait, and when the node may fire.

use std::collections::VecDeque;
use std::sync::Mutex;

use panoscope_abi::Tick;

use crate::decide::Wanted;
use crate::memory::FrameRef;
use crate::region::Region;
use crate::sync::lock;

/// Most packets beyond its capacity that a slot queues while its region is paused.
const MAX_PAUSED: usize = 1 << 10;
/// Default queue length of `nearest` slots in live mode: about one second of a camera.
const MAX_NEAREST: usize = 32;
/// Default queue length of `delay` slots in live mode for packets of another region.
const MAX_DELAYED: usize = 8;
/// Largest queue capacity that is allocated at the start.
const MAX_RESERVED: usize = 256;

/// How a slot is matched with the node's other slots.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Rule {
    /// The same tick on all exact slots.
    Exact,
    /// The newest value; fires the node when it has no exact slot and this is a trigger.
    Latest { trigger: bool },
    /// The closest capture time within `tolerance_ns`.
    Nearest { tolerance_ns: i64 },
    /// The producer's value of this node's previous tick.
    Delay,
}

/// One connection into a node.
pub(crate) struct Slot {
    pub rule: Rule,
    /// The input may be empty or unconnected.
    pub optional: bool,
    /// Queue length in live mode; older packets are dropped. Not used for `exact` slots, whose queues are limited by the ticks in
    /// the region.
    pub capacity: usize,
    queue: VecDeque<FrameRef>,
    /// Newest non-empty value that was used (`latest`, `delay`).
    held: Option<FrameRef>,
    ended: bool,
    /// Longest queue since [`Slot::fill`] was called last.
    most: usize,
    /// Packets dropped because the queue was full.
    dropped: u64,
    /// For a `delay` slot: a packet of the producer is expected.
    expects: bool,
    /// Packets beyond the capacity that may wait, because they came during a pause.
    spare: usize,
}

impl Slot {
    pub fn new(rule: Rule, optional: bool, capacity: usize) -> Self {
        let queue = VecDeque::with_capacity(capacity.clamp(8, MAX_RESERVED));
        let capacity = capacity.max(1);
        Self {
            rule,
            optional,
            capacity,
            queue,
            held: None,
            ended: false,
            most: 0,
            dropped: 0,
            expects: false,
            spare: 0,
        }
    }

    /// Default queue length.
    pub fn usual_capacity(rule: Rule) -> usize {
        match rule {
            Rule::Exact | Rule::Latest { .. } => 1,
            Rule::Nearest { .. } => MAX_NEAREST,
            Rule::Delay => MAX_DELAYED,
        }
    }

    /// Whether packets are matched by time or by turn.
    pub fn is_timed(&self) -> bool {
        matches!(self.rule, Rule::Nearest { .. } | Rule::Delay)
    }

    /// Packets dropped so far because the queue was full.
    pub fn dropped(&self) -> u64 {
        self.dropped
    }

    fn waits_for_delayed(&self) -> bool {
        self.rule == Rule::Delay && self.expects && self.queue.is_empty() && !self.ended
    }

    fn put(&mut self, frame: FrameRef) {
        self.queue.push_back(frame);
        self.most = self.most.max(self.queue.len());
    }

    /// Queue length now, and the longest since the last call.
    pub fn fill(&mut self) -> (usize, usize) {
        let waiting = self.queue.len();
        (waiting, std::mem::replace(&mut self.most, waiting))
    }

    /// Takes over the queue of the slot that this one replaces.
    fn inherit(&mut self, old: &mut Self) {
        std::mem::swap(&mut self.queue, &mut old.queue);
        self.held = old.held.take();
        self.ended = old.ended;
        self.expects = old.expects;
        self.dropped = old.dropped;
        self.spare = old.spare;
    }

    /// Retains during a pause what would otherwise be dropped, except values that fire nothing, of which only the newest counts. `fires` says
    /// whether arrivals fire the node.
    fn pause(&mut self, fires: bool) {
        let retains = match self.rule {
            Rule::Exact => false,
            Rule::Latest { trigger } => trigger && fires,
            Rule::Nearest { .. } | Rule::Delay => true,
        };
        if retains {
            self.spare = MAX_PAUSED;
        }
    }

    /// Most packets that may wait now.
    fn room(&self) -> usize {
        self.capacity.saturating_add(self.spare)
    }
}

/// Result of an attempt to fire.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Take {
    /// An input is missing.
    Wait,
    /// Inputs are staged for this tick; `complete` is false if a required one is empty.
    Fire { tick: Tick, complete: bool },
    /// No packet will come again.
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
    /// A thread runs it for the last time: it was taken out of the graph meanwhile.
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
    batch: bool,
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
        let staged = Vec::with_capacity(slots.len());
        Self { slots, exact, batch, staged, ..Self::default() }
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

    /// Sets how many packets wait at most, slot by slot.
    pub fn set_capacities(&mut self, capacities: impl Iterator<Item = usize>) {
        for (slot, capacity) in self.slots.iter_mut().zip(capacities) {
            slot.capacity = capacity.max(1);
        }
    }

    /// Becomes `new` and takes over the queues of slots that stay: `from[i]` is the old index of new slot `i`.
    pub fn rewire(&mut self, mut new: Join, from: &[Option<usize>]) {
        for (slot, from) in new.slots.iter_mut().zip(from) {
            if let Some(old) = from.and_then(|i| self.slots.get_mut(i)) {
                slot.inherit(old);
            }
        }
        let (turn, has_spare) = (self.turn, self.has_spare);
        *self = Join { turn, has_spare, ..new };
    }

    /// Hands all slots over to the node's successor. From here on packets that a call of a producer still delivers here belong to the successor.
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
    pub fn try_take(&mut self, region: Option<&Region>, now_ns: u64) -> Take {
        if self.is_finished() {
            return Take::Finished;
        }
        if self.exact { self.take_exact(now_ns) } else { self.take_arrival(region) }
    }

    /// Whether the packets taken may depend on timing.
    pub fn is_timed(&self) -> bool {
        self.slots.iter().any(|s| s.rule != Rule::Exact)
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
        let tick = wanted.tick;
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
        self.staged_take = Some((tick, complete));
        Take::Fire { tick, complete }
    }

    /// Packets that wait on a slot; none where a successor has it.
    pub fn waiting(&self, slot: usize) -> usize {
        self.slots.get(slot).map_or(0, |slot| slot.queue.len())
    }

    /// Stages the delay and latest inputs of a source; `false` while the previous tick's value is still being made.
    pub fn take_source(&mut self, tick: Tick) -> bool {
        if self.is_unmade {
            self.slots.iter_mut().for_each(|s| s.expects = false);
        }
        if self.slots.iter().any(Slot::waits_for_delayed) {
            return false;
        }
        self.stage(tick, None);
        self.staged_take = None;
        self.is_unmade = true;
        true
    }

    /// A source has made the tick that its inputs were staged for.
    pub fn made_tick(&mut self) {
        self.is_unmade = false;
    }

    fn take_exact(&mut self, now_ns: u64) -> Take {
        let mut tick = None;
        for slot in self.slots.iter().filter(|s| s.rule == Rule::Exact) {
            match slot.queue.front() {
                Some(front) => tick = tick.or(Some(front.tick())),
                None if slot.ended => return Take::Finished,
                None => return Take::Wait,
            }
        }
        let Some(tick) = tick else { return Take::Wait };
        if !self.others_ready(tick, now_ns) {
            return Take::Wait;
        }
        self.stage(tick, None)
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

    fn take_arrival(&mut self, region: Option<&Region>) -> Take {
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
        self.stage(tick, Some(index))
    }

    fn stage(&mut self, tick: Tick, fired_by: Option<usize>) -> Take {
        let mut complete = true;
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
            let frame = frame.unwrap_or_else(|| FrameRef::empty(tick));
            complete &= slot.optional || !frame.is_empty();
            self.staged.push(frame);
        }
        if self.has_spare {
            self.shrink_spare();
        }
        self.staged_take = Some((tick, complete));
        Take::Fire { tick, complete }
    }
}

#[cfg(test)]
mod tests;
