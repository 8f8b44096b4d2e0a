//! Frames of a call on the GPU of the child.
//!
//! Frames reach and leave the child in shared memory: inputs are copied to the GPU in each call, outputs come from there
//! when it ends.

use std::sync::{Mutex, PoisonError};

use panoscope_abi::Frame;
use panoscope_engine::memory::DeviceMemory;

/// A buffer on the GPU that a call uses.
struct Held {
    /// Address of the lane of the call.
    lane: usize,
    handle: u64,
    /// The output that it holds, until it is brought.
    output: Option<Frame>,
}

// SAFETY: `output` describes memory of the call that made it, which alone uses it.
unsafe impl Send for Held {}

static HELD: Mutex<Vec<Held>> = Mutex::new(Vec::new());

fn hold(lane: usize, handle: u64, output: Option<Frame>) -> u64 {
    let held = Held { lane, handle, output };
    HELD.lock().unwrap_or_else(PoisonError::into_inner).push(held);
    handle
}

/// Copies a frame to the GPU; `None` when that fails.
///
/// # Safety
/// The frame is held and mapped.
pub unsafe fn upload(lane: usize, frame: &Frame) -> Option<u64> {
    let device = DeviceMemory::open().ok()?;
    let handle = hold(lane, device.buffer(frame.len)?, None);
    // SAFETY: the caller's promise.
    let bytes = if frame.len == 0 { &[] } else { unsafe { std::slice::from_raw_parts(frame.data, frame.len) } };
    device.write(handle, bytes).then_some(handle)
}

/// Makes a buffer for the content of a new output; `None` when that fails.
pub fn make(lane: usize, output: Frame) -> Option<u64> {
    Some(hold(lane, DeviceMemory::open().ok()?.buffer(output.len)?, Some(output)))
}

/// Copies what the running call of a lane made on the GPU into its outputs; `false` when some of it is lost.
pub fn bring(lane: usize) -> bool {
    let Some(device) = DeviceMemory::opened() else { return true };
    let mut held = HELD.lock().unwrap_or_else(PoisonError::into_inner);
    held.iter_mut().filter(|held| held.lane == lane).fold(true, |all, held| {
        let Some(output) = held.output.take() else { return all };
        // SAFETY: the output is a mapped buffer of this call.
        all & unsafe { device.read(held.handle, output.data, output.len) }
    })
}

/// Ends the running call of a lane: its outputs are brought, its buffers given back. `false` when an output is lost.
pub fn end(lane: usize) -> bool {
    let Some(device) = DeviceMemory::opened() else { return true };
    let is_whole = bring(lane);
    let gone = HELD
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
        .extract_if(.., |held| held.lane == lane)
        .collect::<Vec<_>>();
    gone.iter().for_each(|held| device.free(held.handle));
    is_whole
}
