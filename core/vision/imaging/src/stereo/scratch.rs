//! Scratch memory of the chunks of a loop: one buffer per thread, not per chunk.

use std::sync::atomic::{AtomicU64, Ordering};

use crate::{Parallel, SharedMut};

/// One buffer for each thread that takes part in a loop. A buffer is still in the cache when the thread's next chunk uses it.
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    data: Vec<f32>,
}

/// The buffers during one loop.
pub(crate) struct Buffers<'a> {
    data: SharedMut<'a, f32>,
    size: usize,
    /// One bit for each free buffer.
    free: AtomicU64,
}

impl Scratch {
    /// Buffers of `size` numbers for the chunks of one loop.
    pub fn lend(&mut self, size: usize, pool: &dyn Parallel) -> Buffers<'_> {
        let count = pool.threads().clamp(1, 64);
        if self.data.len() < count * size {
            self.data.resize(count * size, 0.0);
        }
        Buffers { data: SharedMut::new(&mut self.data), size, free: AtomicU64::new(u64::MAX >> (64 - count)) }
    }
}

impl Buffers<'_> {
    /// Calls `body` with a buffer that no other call uses meanwhile. Waits when more threads come than [`Parallel::threads`] said.
    pub fn with(&self, body: impl FnOnce(&mut [f32])) {
        loop {
            let free = self.free.load(Ordering::Relaxed);
            let bit = free & free.wrapping_neg();
            if bit != 0 && self.free.compare_exchange(free, free & !bit, Ordering::Acquire, Ordering::Relaxed).is_ok() {
                // SAFETY: this thread cleared the bit, and no other takes the buffer until the bit is set again, after `body`.
                body(unsafe { self.data.part(bit.trailing_zeros() as usize * self.size, self.size) });
                self.free.fetch_or(bit, Ordering::Release);
                return;
            }
            std::hint::spin_loop();
        }
    }
}
