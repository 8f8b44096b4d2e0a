//! Work memory of chunks: as many rooms as threads, not as many as chunks.

use std::sync::atomic::{AtomicU64, Ordering};

use crate::{Parallel, SharedMut};

/// Room for what a chunk needs while it runs, one for each thread that takes part: what a chunk leaves there is in the
/// cache when the next one writes it.
#[derive(Debug, Default)]
pub(crate) struct Rooms {
    data: Vec<f32>,
}

/// Rooms handed out during one loop.
pub(crate) struct Lent<'a> {
    data: SharedMut<'a, f32>,
    size: usize,
    /// One bit for each room that is free.
    free: AtomicU64,
}

impl Rooms {
    /// Rooms of `size` numbers for the chunks of one loop.
    pub fn lend(&mut self, size: usize, pool: &dyn Parallel) -> Lent<'_> {
        let count = pool.threads().clamp(1, 64);
        if self.data.len() < count * size {
            self.data.resize(count * size, 0.0);
        }
        Lent { data: SharedMut::new(&mut self.data), size, free: AtomicU64::new(u64::MAX >> (64 - count)) }
    }
}

impl Lent<'_> {
    /// Runs `body` in a room of its own; waits should more threads come than were announced.
    pub fn with(&self, body: impl FnOnce(&mut [f32])) {
        loop {
            let free = self.free.load(Ordering::Relaxed);
            let bit = free & free.wrapping_neg();
            if bit != 0 && self.free.compare_exchange(free, free & !bit, Ordering::Acquire, Ordering::Relaxed).is_ok() {
                // SAFETY: the bit says that nobody else is in this room until it is set again.
                body(unsafe { self.data.part(bit.trailing_zeros() as usize * self.size, self.size) });
                self.free.fetch_or(bit, Ordering::Release);
                return;
            }
            std::hint::spin_loop();
        }
    }
}
