//! The lock held during a change of the graph.

use std::sync::{Condvar, Mutex, PoisonError};
use std::time::Instant;

use crate::sync::lock;

/// Held during a change of the graph. Unlike a `Mutex`, a caller can wait for it for a limited time.
#[derive(Default)]
pub(crate) struct ChangeLock {
    held: Mutex<bool>,
    freed: Condvar,
}

/// Frees a [`ChangeLock`] when dropped.
pub(crate) struct ChangeGuard<'l>(&'l ChangeLock);

impl ChangeLock {
    /// Waits until the lock is free.
    pub fn lock(&self) -> ChangeGuard<'_> {
        let mut held = lock(&self.held);
        while *held {
            held = self.freed.wait(held).unwrap_or_else(PoisonError::into_inner);
        }
        *held = true;
        ChangeGuard(self)
    }

    /// Waits until a deadline; `None` if the lock is still held then.
    pub fn lock_until(&self, until: Instant) -> Option<ChangeGuard<'_>> {
        let mut held = lock(&self.held);
        while *held {
            let left = until.checked_duration_since(Instant::now()).filter(|left| !left.is_zero())?;
            held = self.freed.wait_timeout(held, left).unwrap_or_else(PoisonError::into_inner).0;
        }
        *held = true;
        Some(ChangeGuard(self))
    }
}

impl Drop for ChangeGuard<'_> {
    fn drop(&mut self) {
        *lock(&self.0.held) = false;
        self.0.freed.notify_one();
    }
}
