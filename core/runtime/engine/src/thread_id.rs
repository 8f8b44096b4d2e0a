//! Numbers of the threads that run nodes.

use std::cell::Cell;
use std::sync::atomic::{AtomicU32, Ordering};

thread_local! {
    static NUMBER: Cell<u32> = const { Cell::new(0) };
}

/// Number of the calling thread if it runs nodes, else 0.
#[inline]
pub(crate) fn current() -> u32 {
    NUMBER.with(Cell::get)
}

/// Sets the number of the calling thread.
pub(crate) fn set(number: u32) {
    NUMBER.with(|n| n.set(number));
}

/// A number no other thread has.
pub(crate) fn next() -> u32 {
    static NEXT: AtomicU32 = AtomicU32::new(1);
    NEXT.fetch_add(1, Ordering::Relaxed)
}
