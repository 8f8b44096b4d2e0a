//! Frames of a call on the GPU. Inputs are copied there in each call; outputs come from there when they are fetched, at
//! the latest when the call ends.

use std::ffi::c_void;
use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::abi::{self, Device, DeviceStep, Frame, Status, Str};

use super::memory;

static DEVICE: Mutex<Option<&'static Device>> = Mutex::new(None);
static HELD: Mutex<Vec<Held>> = Mutex::new(Vec::new());

/// A buffer on the GPU for a frame.
struct Held {
    pool: u32,
    offset: u64,
    handle: u64,
    /// Bytes of an output that were not fetched yet.
    len: Option<usize>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Offers a GPU to the nodes of all harnesses of this process; `None` takes it back.
pub fn lend_device(device: Option<&'static Device>) {
    *lock(&DEVICE) = device;
}

/// A buffer for a frame; `len` bytes of it are an output.
pub(super) fn make(frame: &Frame, len: Option<usize>) -> Option<u64> {
    let device = (*lock(&DEVICE))?;
    // SAFETY: the table's own handle.
    let handle = device.buffer.map_or(0, |buffer| unsafe { buffer(device.ctx, frame.len as u64 + 16) });
    if handle == 0 {
        return None;
    }
    lock(&HELD).push(Held { pool: frame.buffer.pool, offset: frame.buffer.offset, handle, len });
    Some(handle)
}

/// Copies an output to the host's memory, unless it is there.
fn bring(held: &mut Held) -> bool {
    let (Some(len), Some(device)) = (held.len.take(), *lock(&DEVICE)) else { return true };
    let to = memory::resolve(abi::BufferId { pool: held.pool, home: 0, offset: held.offset });
    // SAFETY: the table's own handle; the harness's buffer has `len` bytes, which the node made for itself alone.
    !to.is_null()
        && device.read.is_some_and(|read| unsafe { read(device.ctx, held.handle, 0, to, len) == abi::STATUS_OK })
}

/// Ends a call: all that it made comes to the host's memory.
pub(super) fn end(pool: u32, outputs: &mut [Frame]) {
    let mut held = lock(&HELD);
    for held in held.extract_if(.., |held| held.pool == pool) {
        let mut held = held;
        bring(&mut held);
        if let Some(device) = *lock(&DEVICE)
            && let Some(free) = device.free
        {
            // SAFETY: the table's own handle and one of its numbers.
            unsafe { free(device.ctx, held.handle) };
        }
    }
    outputs.iter_mut().for_each(|output| output.buffer.home = abi::HOME_HOST);
}

pub(super) unsafe extern "C" fn device(_: *mut c_void, _: *mut Str) -> *const Device {
    lock(&DEVICE).map_or(std::ptr::null(), std::ptr::from_ref)
}

pub(super) unsafe extern "C" fn device_buffer(_: *mut c_void, frame: *const Frame) -> u64 {
    // SAFETY: the ABI requires null or a pointer to a readable frame.
    let Some(frame) = (unsafe { frame.as_ref() }) else { return 0 };
    let is_it = |held: &&Held| (held.pool, held.offset) == (frame.buffer.pool, frame.buffer.offset);
    if let Some(held) = lock(&HELD).iter().find(is_it) {
        return held.handle;
    }
    let (Some(handle), Some(device)) = (make(frame, None), *lock(&DEVICE)) else { return 0 };
    let step = DeviceStep {
        kind: abi::DEVICE_WRITE,
        groups: [0; 2],
        reserved: 0,
        handle,
        offset: 0,
        buffers: std::ptr::null(),
        buffers_len: 0,
        data: frame.data,
        data_len: frame.len,
    };
    // SAFETY: the table's own handle; the frame's bytes are readable.
    let is_done =
        device.submit.is_some_and(|submit| unsafe { submit(device.ctx, &raw const step, 1) == abi::STATUS_OK });
    if is_done { handle } else { 0 }
}

pub(super) unsafe extern "C" fn fetch(_: *mut c_void, frame: *const Frame) -> Status {
    // SAFETY: the ABI requires null or a pointer to a readable frame.
    let Some(frame) = (unsafe { frame.as_ref() }) else { return abi::STATUS_INVALID };
    let mut held = lock(&HELD);
    let found = held.iter_mut().find(|held| (held.pool, held.offset) == (frame.buffer.pool, frame.buffer.offset));
    if found.is_none_or(bring) { abi::STATUS_OK } else { abi::STATUS_ERROR }
}
