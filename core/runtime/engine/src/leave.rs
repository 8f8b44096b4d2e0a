//! A request to a thread to end.

use std::sync::atomic::{AtomicU8, Ordering};

/// A request to end; the thread acknowledges it before it returns.
#[derive(Default)]
pub(crate) struct Leave(AtomicU8);

impl Leave {
    const REQUESTED: u8 = 1;
    const ACCEPTED: u8 = 2;

    pub fn request(&self) {
        let _ = self.0.compare_exchange(0, Self::REQUESTED, Ordering::AcqRel, Ordering::Relaxed);
    }

    pub fn is_requested(&self) -> bool {
        self.0.load(Ordering::Relaxed) != 0
    }

    /// Called by the thread: whether it has to leave now.
    pub fn accept(&self) -> bool {
        self.0.load(Ordering::Relaxed) != 0 && {
            let _ = self.0.compare_exchange(Self::REQUESTED, Self::ACCEPTED, Ordering::AcqRel, Ordering::Relaxed);
            self.0.load(Ordering::Acquire) == Self::ACCEPTED
        }
    }

    /// Withdraws the request; `false` if the thread has acknowledged it.
    pub fn withdraw(&self) -> bool {
        self.0.compare_exchange(Self::REQUESTED, 0, Ordering::AcqRel, Ordering::Acquire) != Err(Self::ACCEPTED)
    }

    /// Resets the request for the next thread.
    pub fn reset(&self) {
        self.0.store(0, Ordering::Release);
    }
}
