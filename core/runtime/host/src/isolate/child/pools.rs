//! Frame memory in the child: pools of the host, mapped when their first frame arrives.

use std::fs::File;
use std::os::fd::AsRawFd;
use std::sync::atomic::{AtomicPtr, AtomicUsize, Ordering};
use std::sync::{Condvar, Mutex, PoisonError};
use std::time::Duration;

use panoscope_abi::BufferId;
use panoscope_engine::memory::MAX_POOLS;

use super::wait_while;

/// Maximum wait for a pool's file. Its message is sent before its first frame, but the main thread may not have read it
/// yet.
const MAX_WAIT: Duration = Duration::from_secs(10);

struct Mapped {
    base: AtomicPtr<u8>,
    len: AtomicUsize,
}

static POOLS: [Mapped; MAX_POOLS + 1] =
    [const { Mapped { base: AtomicPtr::new(std::ptr::null_mut()), len: AtomicUsize::new(0) } }; MAX_POOLS + 1];
static CHANGED: Condvar = Condvar::new();
static CHANGES: Mutex<()> = Mutex::new(());

/// Maps a pool.
pub(super) fn map(number: u32, len: usize, writable: bool, file: &File) -> std::io::Result<()> {
    let pool = POOLS.get(number as usize).ok_or(std::io::ErrorKind::InvalidInput)?;
    let protection = if writable { libc::PROT_READ | libc::PROT_WRITE } else { libc::PROT_READ };
    let flags = libc::MAP_SHARED | libc::MAP_NORESERVE;
    // SAFETY: a fresh mapping at an address that the system chooses. The file's size is sealed.
    let base = unsafe { libc::mmap(std::ptr::null_mut(), len, protection, flags, file.as_raw_fd(), 0) };
    if base == libc::MAP_FAILED {
        return Err(std::io::Error::last_os_error());
    }
    let _changes = CHANGES.lock().unwrap_or_else(PoisonError::into_inner);
    pool.len.store(len, Ordering::Relaxed);
    pool.base.store(base.cast(), Ordering::Release);
    CHANGED.notify_all();
    Ok(())
}

/// Address of a buffer; null if there is no such pool.
pub(super) fn resolve(id: BufferId) -> *mut u8 {
    let Some(place) = POOLS.get(id.pool as usize).filter(|_| id.pool != 0) else { return std::ptr::null_mut() };
    let mut base = place.base.load(Ordering::Acquire);
    if base.is_null() {
        base = wait(place);
    }
    let offset = usize::try_from(id.offset).unwrap_or(usize::MAX);
    if base.is_null() || offset >= place.len.load(Ordering::Relaxed) {
        return std::ptr::null_mut();
    }
    // SAFETY: the offset lies inside the mapping, which is never removed.
    unsafe { base.add(offset) }
}

#[cold]
fn wait(place: &Mapped) -> *mut u8 {
    let changes = CHANGES.lock().unwrap_or_else(PoisonError::into_inner);
    let missing = |_: &mut ()| place.base.load(Ordering::Acquire).is_null();
    drop(wait_while(&CHANGED, changes, MAX_WAIT, missing));
    place.base.load(Ordering::Acquire)
}
