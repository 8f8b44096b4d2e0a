//! One connection into a node: the packets that wait on it, and how they are matched.

use std::collections::VecDeque;

use panoscope_abi::Tick;

use super::MAX_PAUSED;
use crate::light::Lights;
use crate::memory::FrameRef;

/// Default queue length of `nearest` slots in live mode: about one second of a camera.
const MAX_NEAREST: usize = 32;
/// Default queue length of `delay` slots in live mode for packets of another region.
const MAX_DELAYED: usize = 8;
/// Largest queue capacity that is allocated at the start.
const MAX_RESERVED: usize = 256;

/// Matching of a slot with the node's other slots.
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
    /// Queue length in live mode; older packets are dropped. Not used for `exact` slots, whose queues are limited by
    /// the ticks in the region.
    pub capacity: usize,
    pub(super) queue: VecDeque<FrameRef>,
    /// Newest non-empty value that was used (`latest`, `delay`).
    pub(super) held: Option<FrameRef>,
    pub(super) ended: bool,
    /// Maximum queue length since [`Slot::fill`] was called last.
    pub(super) most: usize,
    /// Packets dropped because the queue was full.
    pub(super) dropped: u64,
    /// For a `delay` slot: a packet of the producer is expected.
    pub(super) expects: bool,
    /// Packets beyond the capacity that may wait, because they came during a pause.
    pub(super) spare: usize,
    /// Whether its packets count for the age of the outputs, see [`crate::light`].
    pub shows_light: bool,
    /// Whether it is a `delay` slot on a loop.
    pub is_state: bool,
    /// Age beyond which a packet counts as absent.
    pub max_age_ns: Option<i64>,
    /// Ticks at which a packet was too old.
    pub too_old: u64,
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
            shows_light: true,
            is_state: false,
            max_age_ns: None,
            too_old: 0,
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

    pub(super) fn waits_for_delayed(&self) -> bool {
        self.rule == Rule::Delay && self.expects && self.queue.is_empty() && !self.ended
    }

    pub(super) fn put(&mut self, frame: FrameRef) {
        self.queue.push_back(frame);
        self.most = self.most.max(self.queue.len());
    }

    /// Queue length now, and the maximum since the last call.
    pub fn fill(&mut self) -> (usize, usize) {
        let waiting = self.queue.len();
        (waiting, std::mem::replace(&mut self.most, waiting))
    }

    /// Takes over the queue of the slot that this one replaces.
    pub(super) fn inherit(&mut self, old: &mut Self) {
        std::mem::swap(&mut self.queue, &mut old.queue);
        self.held = old.held.take();
        self.ended = old.ended;
        self.expects = old.expects;
        self.dropped = old.dropped;
        self.spare = old.spare;
        self.too_old = old.too_old;
    }

    /// Retains packets during a pause that would otherwise be dropped, except values that fire nothing, of which only
    /// the newest matters. `fires` says whether arrivals fire the node.
    pub(super) fn pause(&mut self, fires: bool) {
        let retains = match self.rule {
            Rule::Exact => false,
            Rule::Latest { trigger } => trigger && fires,
            Rule::Nearest { .. } | Rule::Delay => true,
        };
        if retains {
            self.spare = MAX_PAUSED;
        }
    }

    /// Whether a packet that is taken for `tick` counts as absent; counts it.
    #[cold]
    pub(super) fn is_too_old(&mut self, frame: &FrameRef, tick: &Tick, lights: &Lights<'_>) -> bool {
        let packet = Some(frame).filter(|frame| !frame.is_empty());
        let age_ns = packet.and_then(|frame| lights.age_ns(tick, &frame.tick()));
        let is_too_old = age_ns.zip(self.max_age_ns).is_some_and(|(age_ns, max_ns)| age_ns > max_ns);
        self.too_old += u64::from(is_too_old);
        is_too_old
    }

    /// Maximum number of packets that may wait now.
    pub(super) fn room(&self) -> usize {
        self.capacity.saturating_add(self.spare)
    }
}
