//! Host functions that can be used outside a call: reference counts and the parallel loop.

use std::ffi::c_void;
use std::sync::atomic::{AtomicPtr, Ordering};

use crate::abi;
use crate::guard::{self, Caught};

/// Every cdylib has its own copy of this static; `attach` sets it before any node opens.
static HOST: AtomicPtr<abi::Host> = AtomicPtr::new(std::ptr::null_mut());

/// Stores the host's function table.
///
/// # Safety
/// `host` stays valid until the process ends.
pub unsafe fn attach(host: *const abi::Host) {
    HOST.store(host.cast_mut(), Ordering::Release);
}

fn host() -> Option<&'static abi::Host> {
    // SAFETY: null, or the table that the caller of `attach` keeps valid until the process ends.
    unsafe { HOST.load(Ordering::Acquire).as_ref() }
}

/// A function that later versions of the host have, with the host; `None` in earlier ones.
macro_rules! late {
    ($host:ident, $field:ident) => {{
        let end = std::mem::offset_of!(abi::Host, $field) + size_of::<usize>();
        $host.$field.filter(|_| $host.struct_size as usize >= end).map(|function| ($host, function))
    }};
}

pub(crate) fn retain(buffer: abi::BufferId) {
    if let Some(host) = host()
        && let Some(retain) = host.retain
    {
        // SAFETY: the host lends the buffer to the running call, so it is alive.
        unsafe { retain(host.ctx, buffer) }
    }
}

pub(crate) fn release(buffer: abi::BufferId) {
    if let Some(host) = host()
        && let Some(release) = host.release
    {
        // SAFETY: `Retained` calls this once per `retain`, so the buffer still has this reference.
        unsafe { release(host.ctx, buffer) }
    }
}

/// The GPU of the process, or why there is none.
pub(crate) fn device() -> Result<&'static abi::Device, String> {
    const NONE: &str = "the program offers none to its nodes";
    let Some(device) = host().and_then(|host| late!(host, device)) else { return Err(NONE.to_owned()) };
    let mut reason = abi::Str::EMPTY;
    // SAFETY: the host's own handle, and a place for the reason.
    let table = unsafe { device.1(device.0.ctx, &raw mut reason).as_ref() };
    // SAFETY: the host keeps the reason readable.
    table.ok_or_else(|| unsafe { reason.text() }.filter(|reason| !reason.is_empty()).unwrap_or(NONE).to_owned())
}

/// See [`abi::Host::device_buffer`]; 0 when that fails.
pub(crate) fn device_buffer(frame: &abi::Frame) -> u64 {
    match host().and_then(|host| late!(host, device_buffer)) {
        // SAFETY: the host lends the frame to the running call, or the caller retains it.
        Some((host, buffer)) => unsafe { buffer(host.ctx, frame) },
        None => 0,
    }
}

/// Makes sure that the content of a frame is at its address, see [`abi::Host::fetch`].
#[inline]
pub(crate) fn fetch(frame: &abi::Frame) {
    if frame.buffer.home != abi::HOME_HOST {
        fetch_now(frame);
    }
}

#[cold]
fn fetch_now(frame: &abi::Frame) {
    if let Some((host, fetch)) = host().and_then(|host| late!(host, fetch)) {
        // SAFETY: the host lends the frame to the running call, or the caller retains it.
        // The host itself reports a failure.
        unsafe { fetch(host.ctx, frame) };
    }
}

/// Runs `body` once for each index below `chunks` on the host's pool; continues a panic of `body` on this thread.
pub(crate) fn parallel_for(host: &abi::Host, chunks: usize, body: &(dyn Fn(usize) + Sync)) {
    unsafe extern "C" fn chunk(data: *mut c_void, index: usize) {
        // SAFETY: `data` is the `Loop` below, alive until the host's `parallel_for` returns.
        let this = unsafe { &*data.cast::<Loop<'_>>() };
        if let Err(caught) = guard::catch(|| (this.body)(index)) {
            let mut panic = this.panic.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
            // The panic of the lowest index wins, so that the message does not depend on the number of threads.
            match &*panic {
                Some((first, _)) if *first < index => caught.discard(),
                _ => {
                    if let Some((_, later)) = panic.replace((index, caught)) {
                        later.discard();
                    }
                }
            }
        }
    }
    struct Loop<'a> {
        body: &'a (dyn Fn(usize) + Sync),
        panic: std::sync::Mutex<Option<(usize, Caught)>>,
    }
    let mut this = Loop { body, panic: std::sync::Mutex::new(None) };
    let status = match host.parallel_for {
        // SAFETY: the host calls `chunk` with `data` only until it returns.
        Some(run) => unsafe { run(host.ctx, chunks, Some(chunk), (&raw mut this).cast()) },
        None => abi::STATUS_INVALID,
    };
    if let Some((_, caught)) = this.panic.into_inner().unwrap_or_else(|poisoned| poisoned.into_inner()) {
        caught.resume();
    }
    if status != abi::STATUS_OK {
        (0..chunks).for_each(body);
    }
}
