//! Kernels and buffers of the device by their numbers.

use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use wgpu::{Buffer, ComputePipeline};

/// Buffers that are kept for later use, at most, and their bytes.
const MAX_SPARE: usize = 64;
const MAX_SPARE_BYTES: u64 = 1 << 30;

/// A kernel or a buffer.
#[derive(Clone, Debug)]
pub enum Item {
    Kernel(ComputePipeline),
    Buffer(Buffer),
}

/// Kernels and buffers by their numbers, and buffers that were given back.
#[derive(Debug, Default)]
pub struct Items {
    last: AtomicU64,
    list: Mutex<HashMap<u64, Item>>,
    spare: Mutex<Vec<Buffer>>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Items {
    /// Adds an item and returns its number.
    pub fn add(&self, item: Item) -> u64 {
        let number = self.last.fetch_add(1, Ordering::Relaxed) + 1;
        lock(&self.list).insert(number, item);
        number
    }

    /// The item of a number.
    pub fn get(&self, number: u64) -> Option<Item> {
        lock(&self.list).get(&number).cloned()
    }

    /// A buffer of this size that was given back. What was submitted for it runs before what comes now.
    pub fn take_spare(&self, size: u64) -> Option<Buffer> {
        let mut spare = lock(&self.spare);
        let at = spare.iter().position(|buffer| buffer.size() == size)?;
        Some(spare.swap_remove(at))
    }

    /// Gives an item back. A buffer may be used again.
    pub fn free(&self, number: u64) {
        if let Some(Item::Buffer(buffer)) = lock(&self.list).remove(&number) {
            let mut spare = lock(&self.spare);
            let bytes: u64 = spare.iter().map(Buffer::size).sum();
            if spare.len() < MAX_SPARE && bytes + buffer.size() <= MAX_SPARE_BYTES {
                spare.push(buffer);
            } else {
                spare.clear();
            }
        }
    }
}
