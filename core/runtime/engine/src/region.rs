//! Regions: nodes joined by `exact` edges, entered by whole ticks through one head.
//!
//! A tick is in flight from its admission until every leaf of the region is done with it. In live mode ticks are
//! dropped only here, where they enter; inside, queues never drop. A paused region admits nothing and retains what
//! comes, so that the graph can be changed when the ticks inside have finished.

use std::collections::VecDeque;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU32, Ordering};

use crate::memory::FrameRef;
use crate::sync::lock;

const RING: usize = 256;
/// Ticks retained during a pause; beyond that the oldest are dropped. A graph that is slower than its source works on
/// all of them before newer ones, so a longer queue would only delay it more.
const MAX_PAUSED: usize = 256;

struct State {
    in_flight: u32,
    paused: bool,
    /// Whether a thread delivers ticks that waited; newer ticks wait until it is done.
    handing: bool,
    /// The tick of its source before which the region pauses.
    pause_before: u64,
    /// Number of the tick after the last one that arrived.
    next_seq: Option<u64>,
    /// The head waits until at most so many ticks are inside.
    awaited: Option<u32>,
    /// Ticks of a live source that wait to enter: those of a pause, then the newest.
    pending: VecDeque<Vec<FrameRef>>,
    /// Number of them that came during a pause and must not be replaced.
    protected: usize,
    /// Empty lists for reuse.
    spare: Vec<Vec<FrameRef>>,
}

/// A region. It belongs to its head node.
pub(crate) struct Region {
    /// Node that admits ticks.
    pub head: usize,
    /// Nodes without an exact reader inside the region.
    leaves: AtomicU32,
    limit: AtomicU32,
    remaining: Box<[AtomicU32]>,
    state: Mutex<State>,
}

/// Ticks that may enter after a tick has finished.
pub(crate) enum Freed {
    /// Nothing waits.
    Nothing,
    /// The head may continue.
    Head,
    /// These outputs of the head are admitted now.
    Pending(Vec<FrameRef>),
}

fn first_seq(outputs: &[FrameRef]) -> u64 {
    outputs.first().map_or(0, |f| f.tick().seq)
}

impl Region {
    pub fn new(head: usize, leaves: u32, limit: u32) -> Self {
        let leaves = leaves.max(1);
        let state = State {
            in_flight: 0,
            paused: false,
            handing: false,
            pause_before: u64::MAX,
            next_seq: None,
            awaited: None,
            pending: VecDeque::with_capacity(4),
            protected: 0,
            spare: Vec::with_capacity(4),
        };
        Self {
            head,
            leaves: AtomicU32::new(leaves),
            limit: AtomicU32::new(limit.clamp(1, RING as u32 - 1)),
            remaining: (0..RING).map(|_| AtomicU32::new(leaves)).collect(),
            state: Mutex::new(state),
        }
    }

    fn state(&self) -> std::sync::MutexGuard<'_, State> {
        lock(&self.state)
    }

    fn open(&self, state: &State) -> bool {
        !state.paused && state.in_flight < self.limit.load(Ordering::Relaxed)
    }

    fn admit(&self, state: &mut State) {
        state.in_flight += 1;
    }

    /// Has the head woken when the region is half empty, not for every tick, because waking a thread costs more than
    /// many nodes do.
    fn await_half(&self, state: &mut State) {
        state.awaited = Some(self.limit.load(Ordering::Relaxed) / 2);
    }

    /// Admits a tick if there is room.
    pub fn try_admit(&self) -> bool {
        let mut state = self.state();
        let open = self.open(&state);
        if open {
            self.admit(&mut state);
        } else {
            self.await_half(&mut state);
        }
        open
    }

    /// Whether a tick could be admitted. If not, the head is woken once the region is half empty.
    pub fn has_room(&self) -> bool {
        let mut state = self.state();
        let room = self.open(&state) && state.pending.is_empty();
        if !room {
            self.await_half(&mut state);
        }
        room
    }

    /// Whether a tick could be admitted and be the only one. If not, the head is woken once the region is empty.
    pub fn is_free(&self) -> bool {
        let mut state = self.state();
        let free = self.would_be_alone(&state);
        if !free {
            state.awaited = Some(0);
        }
        free
    }

    fn would_be_alone(&self, state: &State) -> bool {
        state.in_flight == 0 && self.open(state) && state.pending.is_empty() && !state.handing
    }

    /// Admits a source's tick `seq` if no other is inside or waits: until it is done, no other thread runs a node of
    /// the region.
    pub fn admit_alone(&self, seq: u64) -> bool {
        let mut state = self.state();
        let alone = self.would_be_alone(&state) && seq < state.pause_before;
        if alone {
            state.next_seq = Some(seq.saturating_add(1));
            self.admit(&mut state);
        }
        alone
    }

    /// Admits a live source's tick, or queues it in place of an older one. Returns the outputs to deliver now, and
    /// those of an older tick that was dropped.
    pub fn admit_or_keep(&self, outputs: Vec<FrameRef>) -> (Option<Vec<FrameRef>>, Option<Vec<FrameRef>>) {
        let mut state = self.state();
        state.next_seq = Some(first_seq(&outputs).saturating_add(1));
        let is_after = state.pause_before != u64::MAX && state.pause_before <= first_seq(&outputs);
        // Ticks that wait and come before the pause enter first: the pause begins when they have.
        if is_after && state.pending.is_empty() {
            state.paused = true;
        }
        if self.open(&state) && state.pending.is_empty() && !state.handing {
            self.admit(&mut state);
            return (Some(outputs), None);
        }
        let mut dropped = None;
        if state.paused || is_after {
            if state.pending.len() >= MAX_PAUSED {
                dropped = state.pending.pop_front();
            }
            state.pending.push_back(outputs);
            state.protected = state.pending.len();
        } else {
            if state.pending.len() > state.protected {
                dropped = state.pending.pop_back();
            }
            state.pending.push_back(outputs);
        }
        (None, dropped)
    }

    /// An empty list for the head's outputs.
    pub fn spare(&self) -> Vec<FrameRef> {
        self.state().spare.pop().unwrap_or_default()
    }

    /// Takes a list for reuse.
    pub fn recycle(&self, mut list: Vec<FrameRef>) {
        list.clear();
        let mut state = self.state();
        if state.spare.len() < 4 {
            state.spare.push(list);
        }
    }

    /// Whether a tick waits to enter, or was admitted and is being delivered by another thread.
    pub fn has_pending(&self) -> bool {
        let state = self.state();
        !state.pending.is_empty() || state.handing
    }

    /// Ticks inside now.
    pub fn in_flight(&self) -> u32 {
        self.state().in_flight
    }

    fn next_pending(&self, state: &mut State) -> Option<Vec<FrameRef>> {
        if state.pause_before != u64::MAX && state.pending.front().is_some_and(|p| state.pause_before <= first_seq(p)) {
            state.paused = true;
        }
        if !self.open(state) {
            return None;
        }
        let outputs = state.pending.pop_front()?;
        state.protected = state.protected.saturating_sub(1);
        self.admit(state);
        Some(outputs)
    }

    /// Counts a tick that a leaf finished, its `nth` from 0, and says what may enter.
    pub fn leaf_done(&self, nth: u64) -> Freed {
        let leaves = self.leaves.load(Ordering::Relaxed);
        if leaves > 1 {
            let slot = &self.remaining[nth as usize % RING];
            if slot.fetch_sub(1, Ordering::AcqRel) != 1 {
                return Freed::Nothing;
            }
            slot.store(leaves, Ordering::Release);
        }
        let mut state = self.state();
        state.in_flight = state.in_flight.saturating_sub(1);
        if state.handing {
            return Freed::Nothing;
        }
        if let Some(outputs) = self.next_pending(&mut state) {
            state.handing = true;
            return Freed::Pending(outputs);
        }
        match state.awaited {
            Some(most) if state.in_flight <= most => {
                state.awaited = None;
                Freed::Head
            }
            _ => Freed::Nothing,
        }
    }

    /// Marks the ticks that waited as delivered. Returns the next one that arrived meanwhile, if any.
    pub fn handed_over(&self) -> Option<Vec<FrameRef>> {
        let mut state = self.state();
        let next = self.next_pending(&mut state);
        state.handing = next.is_some();
        next
    }

    /// Admits nothing until [`Self::resume`].
    pub fn pause(&self) {
        self.state().paused = true;
    }

    /// Admits nothing from tick `seq` of its source on. `made` is the source's next tick. If `seq` has passed, returns
    /// the first tick that could still be held back.
    pub fn pause_before(&self, seq: u64, made: u64) -> Result<(), u64> {
        let mut state = self.state();
        let next = state.pending.front().map_or(made, |p| first_seq(p));
        if seq < next {
            return Err(next);
        }
        state.pause_before = seq;
        Ok(())
    }

    /// Cancels [`Self::pause_before`]. Returns whether the region is paused.
    pub fn stop_waiting(&self) -> bool {
        let mut state = self.state();
        state.pause_before = u64::MAX;
        state.paused
    }

    /// Whether the region is paused.
    pub fn is_paused(&self) -> bool {
        self.state().paused
    }

    /// The first tick of a live source that may still enter: the first that waits, or the one after the last that
    /// arrived. A tick that was made may be on its way to the region. `None` before the first tick came, and of a
    /// source that makes a tick only where there is room.
    pub fn next_seq(&self) -> Option<u64> {
        let state = self.state();
        state.pending.front().map(|p| first_seq(p)).or(state.next_seq)
    }

    /// Removes the ticks that wait.
    pub fn take_pending(&self) -> Vec<Vec<FrameRef>> {
        let mut state = self.state();
        state.protected = 0;
        state.pending.drain(..).collect()
    }

    /// Admits ticks again. The caller delivers the returned outputs of retained ticks in this order.
    pub fn resume(&self) -> Vec<Vec<FrameRef>> {
        let mut state = self.state();
        state.paused = false;
        state.pause_before = u64::MAX;
        state.awaited = None;
        if state.handing {
            // The thread that delivers now continues with them.
            return Vec::new();
        }
        let waited: Vec<_> = std::iter::from_fn(|| self.next_pending(&mut state)).collect();
        state.handing = !waited.is_empty();
        waited
    }

    /// Sets leaves and limit of a region without a tick inside; its leaves count from 0 again.
    pub fn reset(&self, leaves: u32, limit: u32) {
        let leaves = leaves.max(1);
        self.leaves.store(leaves, Ordering::Relaxed);
        self.limit.store(limit.clamp(1, RING as u32 - 1), Ordering::Relaxed);
        for slot in &self.remaining {
            slot.store(leaves, Ordering::Release);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_abi::Tick;

    fn tick(seq: u64) -> Vec<FrameRef> {
        vec![FrameRef::empty(Tick { seq, ..Tick::default() })]
    }

    fn seq(list: &[FrameRef]) -> u64 {
        list[0].tick().seq
    }

    #[test]
    fn the_newest_tick_wins() {
        let region = Region::new(0, 1, 1);
        assert!(region.admit_or_keep(tick(0)).0.is_some());
        assert!(region.admit_or_keep(tick(1)).1.is_none());
        assert_eq!(region.admit_or_keep(tick(2)).1.as_deref().map(seq), Some(1), "the older one is dropped");
        assert!(matches!(region.leaf_done(0), Freed::Pending(list) if seq(&list) == 2));
    }

    #[test]
    fn a_pause_keeps_every_tick_in_order() {
        let region = Region::new(0, 1, 1);
        assert!(region.admit_or_keep(tick(0)).0.is_some());
        region.pause();
        for n in 1..=3 {
            let (now, dropped) = region.admit_or_keep(tick(n));
            assert!(now.is_none() && dropped.is_none());
        }
        assert!(matches!(region.leaf_done(0), Freed::Nothing), "nothing enters");
        assert_eq!(region.in_flight(), 0);
        region.reset(1, 2);
        assert_eq!(region.resume().iter().map(|l| seq(l)).collect::<Vec<_>>(), [1, 2]);
        assert!(region.handed_over().is_none(), "the region is full");
        // A later tick may replace only ticks that came after the pause.
        assert!(region.admit_or_keep(tick(4)).1.is_none());
        assert_eq!(region.admit_or_keep(tick(5)).1.as_deref().map(seq), Some(4));
        assert!(matches!(region.leaf_done(0), Freed::Pending(list) if seq(&list) == 3));
        assert!(region.handed_over().is_none());
        assert!(matches!(region.leaf_done(1), Freed::Pending(list) if seq(&list) == 5));
    }

    #[test]
    fn a_tick_that_is_being_delivered_counts_as_waiting() {
        let region = Region::new(0, 1, 1);
        assert!(region.admit_or_keep(tick(0)).0.is_some());
        assert!(region.admit_or_keep(tick(1)).0.is_none());
        assert!(matches!(region.leaf_done(0), Freed::Pending(list) if seq(&list) == 1));
        assert!(region.has_pending(), "its readers have not got it yet");
        assert!(region.handed_over().is_none());
        assert!(!region.has_pending());
    }

    /// The thread that admitted a tick alone runs the nodes of the region itself.
    #[test]
    fn a_tick_is_admitted_alone_only_into_an_empty_open_region() {
        let region = Region::new(0, 1, 4);
        assert!(region.is_free() && region.admit_alone(0));
        assert_eq!((region.next_seq(), region.in_flight()), (Some(1), 1));
        assert!(!region.admit_alone(1) && !region.is_free(), "another tick is inside");
        assert!(matches!(region.leaf_done(0), Freed::Head), "the source waited for the empty region");
        assert!(matches!(region.admit_or_keep(tick(1)), (Some(_), None)));
        assert!(region.has_room() && matches!(region.leaf_done(1), Freed::Nothing), "nobody waits");
        region.pause();
        assert!(!region.admit_alone(2), "the region pauses");
        assert!(region.admit_or_keep(tick(2)).0.is_none());
        assert_eq!(region.resume().iter().map(|l| seq(l)).collect::<Vec<_>>(), [2]);
        assert!(matches!(region.leaf_done(2), Freed::Nothing));
        assert!(!region.admit_alone(3), "another thread still delivers what waited");
        assert!(region.handed_over().is_none() && region.admit_alone(3));
        assert!(matches!(region.leaf_done(3), Freed::Nothing));
        assert_eq!(region.pause_before(4, 4), Ok(()));
        assert!(!region.admit_alone(4), "the pause begins at this tick");
    }

    /// A change names the first tick that meets it, also while that tick is on its way from its source.
    #[test]
    fn the_next_tick_is_the_one_after_the_last_that_came() {
        let region = Region::new(0, 1, 1);
        assert_eq!(region.next_seq(), None);
        assert!(region.admit_or_keep(tick(5)).0.is_some());
        region.pause();
        assert_eq!(region.next_seq(), Some(6));
        assert!(region.admit_or_keep(tick(6)).0.is_none());
        assert!(region.admit_or_keep(tick(7)).0.is_none());
        assert_eq!(region.next_seq(), Some(6));
    }

    /// A change that is to be made before a tick is made before no earlier one.
    #[test]
    fn ticks_before_a_named_one_enter_before_the_pause() {
        let region = Region::new(0, 1, 1);
        assert!(region.admit_or_keep(tick(0)).0.is_some());
        assert_eq!(region.pause_before(2, 1), Ok(()));
        assert!(region.admit_or_keep(tick(1)).0.is_none(), "the region is full");
        let (now, dropped) = region.admit_or_keep(tick(2));
        assert!(now.is_none() && dropped.is_none(), "both wait");
        assert!(!region.is_paused(), "tick 1 comes first");
        assert!(matches!(region.leaf_done(0), Freed::Pending(list) if seq(&list) == 1));
        assert!(region.handed_over().is_none());
        assert!(matches!(region.leaf_done(1), Freed::Nothing));
        assert!(region.is_paused() && region.next_seq() == Some(2));
    }
}
