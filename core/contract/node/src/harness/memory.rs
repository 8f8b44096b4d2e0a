//! Frame memory of all harnesses of the process: heap buffers with reference counts.
//!
//! There is one table for all, because a plugin has one host: `retain` and `release` find a harness by the pool number
//! of the buffer.

use std::collections::HashMap;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Mutex, MutexGuard, OnceLock};

use crate::abi::{self, BufferId};

/// Alignment of every buffer in bytes, the same as in the host's pool.
const ALIGN: usize = 64;
/// Fill value of fresh memory; makes pixels visible that a node did not write.
pub(super) const FRESH: u8 = 0xA5;

#[repr(C, align(64))]
#[derive(Clone, Copy)]
struct Line([u8; ALIGN]);

struct Buffer {
    memory: Box<[Line]>,
    holders: u32,
}

impl Buffer {
    fn address(&mut self) -> *mut u8 {
        self.memory.as_mut_ptr().cast()
    }
}

#[derive(Default)]
struct Pool {
    buffers: HashMap<u64, Buffer>,
    next: u64,
    /// Buffers that may be alive at once.
    limit: Option<usize>,
    /// The first violation of the ABI.
    violation: Option<String>,
}

fn pools() -> MutexGuard<'static, HashMap<u32, Pool>> {
    static POOLS: OnceLock<Mutex<HashMap<u32, Pool>>> = OnceLock::new();
    POOLS.get_or_init(Mutex::default).lock().unwrap_or_else(|poisoned| poisoned.into_inner())
}

/// Opens a pool and returns its number.
pub(super) fn open_pool() -> u32 {
    static NEXT: AtomicU32 = AtomicU32::new(1);
    let number = NEXT.fetch_add(1, Ordering::Relaxed);
    pools().insert(number, Pool::default());
    number
}

/// Frees a pool; returns how many buffers were still held.
pub(super) fn close_pool(pool: u32) -> usize {
    pools().remove(&pool).map_or(0, |pool| pool.buffers.len())
}

/// Number of buffers alive in a pool.
pub(super) fn alive(pool: u32) -> usize {
    pools().get(&pool).map_or(0, |pool| pool.buffers.len())
}

/// Sets how many buffers may be alive at once; `None` for no limit.
pub(super) fn limit(pool: u32, buffers: Option<usize>) {
    if let Some(pool) = pools().get_mut(&pool) {
        pool.limit = buffers;
    }
}

/// Takes the first violation of the ABI with this pool, if any.
pub(super) fn take_violation(pool: u32) -> Option<String> {
    pools().get_mut(&pool).and_then(|pool| pool.violation.take())
}

/// Allocates a buffer of `len` bytes with one reference; `None` when the pool is exhausted.
pub(super) fn allocate(pool: u32, len: usize) -> Option<(BufferId, *mut u8)> {
    let mut pools = pools();
    let entry = pools.get_mut(&pool)?;
    if entry.limit.is_some_and(|limit| entry.buffers.len() >= limit) {
        return None;
    }
    let memory = vec![Line([FRESH; ALIGN]); len.div_ceil(ALIGN).max(1)].into_boxed_slice();
    let offset = entry.next;
    entry.next += (memory.len() * ALIGN) as u64;
    let mut buffer = Buffer { memory, holders: 1 };
    let address = buffer.address();
    entry.buffers.insert(offset, buffer);
    Some((BufferId { pool, home: 0, offset }, address))
}

/// Adds a reference; false when there is no such buffer.
pub(super) fn retain(id: BufferId) -> bool {
    with(id, |buffer| buffer.holders += 1).is_some()
}

/// Drops a reference and frees the buffer with the last one.
pub(super) fn release(id: BufferId) {
    let mut pools = pools();
    let Some(pool) = pools.get_mut(&id.pool) else { return };
    match pool.buffers.get_mut(&id.offset) {
        Some(buffer) if buffer.holders > 1 => buffer.holders -= 1,
        Some(_) => drop(pool.buffers.remove(&id.offset)),
        None => {
            pool.violation.get_or_insert_with(|| "it released a buffer that nobody holds".to_owned());
        }
    }
}

/// Records a violation of the ABI, unless there is one already.
pub(super) fn record_violation(pool: u32, problem: String) {
    if let Some(pool) = pools().get_mut(&pool) {
        pool.violation.get_or_insert(problem);
    }
}

/// Address of a buffer; null when there is none.
pub(super) fn resolve(id: BufferId) -> *mut u8 {
    with(id, Buffer::address).unwrap_or(std::ptr::null_mut())
}

/// Number of references; 0 when there is no such buffer.
pub(super) fn holders(id: BufferId) -> u32 {
    with(id, |buffer| buffer.holders).unwrap_or(0)
}

fn with<R>(id: BufferId, body: impl FnOnce(&mut Buffer) -> R) -> Option<R> {
    pools().get_mut(&id.pool)?.buffers.get_mut(&id.offset).map(body)
}

/// Copies `bytes` into a fresh buffer. Returns `frame` with that buffer; `None` when the pool is exhausted.
pub(super) fn store(pool: u32, bytes: &[u8], frame: abi::Frame) -> Option<abi::Frame> {
    let (buffer, data) = allocate(pool, bytes.len())?;
    // SAFETY: `allocate` returned memory of at least that length that nobody else refers to yet.
    unsafe { std::ptr::copy_nonoverlapping(bytes.as_ptr(), data, bytes.len()) };
    Some(abi::Frame { buffer, data, len: bytes.len(), ..frame })
}
