//! Regions: nodes joined by `exact` edges, entered by whole ticks through one head.
//!
//! A tick is in flight from its admission until every leaf of the region is done with it. In live mode ticks are
//! dropped only here, where they enter; inside, queues never drop.

use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

use crate::memory::FrameRef;

const RING: usize = 256;

struct State {
    in_flight: u32,
    /// A live source's newest tick that waits to enter.
    pending: Option<Vec<FrameRef>>,
    /// Emptied lists, used again.
    spare: Vec<Vec<FrameRef>>,
}

/// One region.
pub(crate) struct Region {
    /// Node that admits ticks.
    pub head: usize,
    /// Nodes without an exact reader inside the region.
    pub leaves: u32,
    limit: u32,
    remaining: Box<[AtomicU32]>,
    state: Mutex<State>,
    full: AtomicBool,
    admitted: AtomicU64,
}

/// What a finished tick makes possible.
pub(crate) enum Freed {
    /// Nothing waits.
    Nothing,
    /// The head may go on.
    Head,
    /// These outputs of the head are admitted now.
    Pending(Vec<FrameRef>),
}

impl Region {
    pub fn new(head: usize, leaves: u32, limit: u32) -> Self {
        let leaves = leaves.max(1);
        Self {
            head,
            leaves,
            limit: limit.clamp(1, RING as u32 - 1),
            remaining: (0..RING).map(|_| AtomicU32::new(leaves)).collect(),
            state: Mutex::new(State { in_flight: 0, pending: None, spare: Vec::with_capacity(4) }),
            full: AtomicBool::new(false),
            admitted: AtomicU64::new(0),
        }
    }

    fn state(&self) -> std::sync::MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Lets one tick in if there is room.
    pub fn try_admit(&self) -> bool {
        let mut state = self.state();
        if state.in_flight >= self.limit {
            self.full.store(true, Ordering::Relaxed);
            return false;
        }
        state.in_flight += 1;
        self.admitted.fetch_add(1, Ordering::Relaxed);
        true
    }

    /// Whether a tick could be let in.
    pub fn has_room(&self) -> bool {
        let state = self.state();
        let room = state.in_flight < self.limit;
        if !room {
            self.full.store(true, Ordering::Relaxed);
        }
        room
    }

    /// Lets a live source's tick in, or keeps it waiting in place of an older one. Answers the outputs to deliver now and whether an older
    /// tick was dropped.
    pub fn admit_or_keep(&self, outputs: Vec<FrameRef>) -> (Option<Vec<FrameRef>>, Option<Vec<FrameRef>>) {
        let mut state = self.state();
        if state.in_flight < self.limit {
            state.in_flight += 1;
            self.admitted.fetch_add(1, Ordering::Relaxed);
            (Some(outputs), None)
        } else {
            (None, state.pending.replace(outputs))
        }
    }

    /// An empty list for the head's outputs.
    pub fn spare(&self) -> Vec<FrameRef> {
        self.state().spare.pop().unwrap_or_default()
    }

    /// Takes a list back.
    pub fn recycle(&self, mut list: Vec<FrameRef>) {
        list.clear();
        let mut state = self.state();
        if state.spare.len() < 4 {
            state.spare.push(list);
        }
    }

    /// Whether a tick waits to enter.
    pub fn has_pending(&self) -> bool {
        self.state().pending.is_some()
    }

    /// Ticks inside now.
    pub fn in_flight(&self) -> u32 {
        self.state().in_flight
    }

    /// A leaf is done with its `nth` tick (counted from 0 by that leaf).
    pub fn leaf_done(&self, nth: u64) -> Freed {
        let slot = &self.remaining[nth as usize % RING];
        if slot.fetch_sub(1, Ordering::AcqRel) != 1 {
            return Freed::Nothing;
        }
        slot.store(self.leaves, Ordering::Release);
        let mut state = self.state();
        state.in_flight = state.in_flight.saturating_sub(1);
        if let Some(outputs) = state.pending.take() {
            state.in_flight += 1;
            self.admitted.fetch_add(1, Ordering::Relaxed);
            return Freed::Pending(outputs);
        }
        if self.full.swap(false, Ordering::Relaxed) { Freed::Head } else { Freed::Nothing }
    }
}
