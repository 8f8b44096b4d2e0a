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
    /// Address of the input that it holds a copy of; 0 for none.
    input: usize,
}

// SAFETY: `output` describes memory of the call that made it, which alone uses it.
unsafe impl Send for Held {}

static HELD: Mutex<Vec<Held>> = Mutex::new(Vec::new());

fn hold(lane: usize, handle: u64, output: Option<Frame>, input: usize) -> u64 {
    let held = Held { lane, handle, output, input };
    HELD.lock().unwrap_or_else(PoisonError::into_inner).push(held);
    handle
}

/// The copy of an input that the running call of a lane has made.
fn copy_of(lane: usize, input: usize) -> Option<u64> {
    let held = HELD.lock().unwrap_or_else(PoisonError::into_inner);
    held.iter().find(|held| held.lane == lane && held.input == input).map(|held| held.handle)
}

/// Copies an input to the GPU, once in a call; `None` when that fails.
///
/// # Safety
/// The frame is held and mapped.
pub unsafe fn upload(lane: usize, frame: &Frame) -> Option<u64> {
    let device = DeviceMemory::open().ok()?;
    let input = frame.data as usize;
    if let Some(copy) = copy_of(lane, input) {
        return Some(copy);
    }
    let handle = device.buffer(frame.len)?;
    // SAFETY: the caller's promise.
    let bytes = if frame.len == 0 { &[] } else { unsafe { std::slice::from_raw_parts(frame.data, frame.len) } };
    let is_copied = device.write(handle, bytes);
    hold(lane, handle, None, if is_copied { input } else { 0 });
    is_copied.then_some(handle)
}

/// Makes a buffer for the content of a new output; `None` when that fails.
pub fn make(lane: usize, output: Frame) -> Option<u64> {
    Some(hold(lane, DeviceMemory::open().ok()?.buffer(output.len)?, Some(output), 0))
}

/// Does not bring the content of `replaced`, the memory of an output that the running call of a lane made again.
pub fn forget(lane: usize, replaced: *mut u8) {
    let mut held = HELD.lock().unwrap_or_else(PoisonError::into_inner);
    for held in held.iter_mut().filter(|held| held.lane == lane) {
        held.output.take_if(|output| output.data == replaced);
    }
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

#[cfg(test)]
mod tests {
    use std::ffi::c_void;
    use std::sync::atomic::{AtomicU64, Ordering};

    use panoscope_abi::{self as abi, BufferId, Device, DeviceStep, Status, Str, Tick};
    use panoscope_engine::memory::open_device_by;

    use super::*;
    use crate::isolate::child::table::{CallFrame, ChildLane};
    use crate::isolate::lane::Lane;

    unsafe extern "C" fn buffer(_: *mut c_void, _: u64) -> u64 {
        static NEXT: AtomicU64 = AtomicU64::new(1);
        NEXT.fetch_add(1, Ordering::Relaxed)
    }

    unsafe extern "C" fn submit(_: *mut c_void, _: *const DeviceStep, _: usize) -> Status {
        abi::STATUS_OK
    }

    /// A device that fails to give anything back.
    fn open() -> Result<&'static Device, String> {
        unsafe extern "C" fn read(_: *mut c_void, _: u64, _: u64, _: *mut u8, _: usize) -> Status {
            abi::STATUS_ERROR
        }
        static DEVICE: Device = Device {
            struct_size: size_of::<Device>() as u32,
            reserved: 0,
            name: Str::new("none"),
            ctx: std::ptr::null_mut(),
            max_buffer_bytes: 1 << 20,
            kernel: None,
            buffer: Some(buffer),
            free: None,
            submit: Some(submit),
            read: Some(read),
            failure: None,
        };
        Ok(&DEVICE)
    }

    #[test]
    fn an_input_is_copied_once_in_a_call() {
        open_device_by(open);
        let (bytes, other) = ([1_u8; 8], [2_u8; 8]);
        let frame = |bytes: &[u8; 8]| Frame { data: bytes.as_ptr().cast_mut(), len: 8, ..Frame::EMPTY };
        // SAFETY: both arrays outlive the calls.
        let copies = [&bytes, &bytes, &other].map(|bytes| unsafe { upload(7, &frame(bytes)) });
        assert!(copies.iter().all(Option::is_some) && copies[0] == copies[1] && copies[0] != copies[2], "{copies:?}");
        assert!(end(7));
    }

    #[test]
    fn an_output_that_is_made_again_in_memory_is_not_brought_from_the_device() {
        open_device_by(open);
        let lane = ChildLane::new(Lane::create().expect("memory").0);
        let at = std::ptr::from_ref(&lane) as usize;
        let mut outputs = [Frame::EMPTY; 2];
        let mut call = CallFrame {
            lane: &lane,
            node: String::new(),
            tick: Tick::default(),
            outputs: outputs.as_mut_ptr(),
            outputs_len: 2,
            formats: &[0; 2],
            random: None,
            file: String::new(),
        };
        let mut memory = [[0_u8; 8]; 2];
        let [there, here] = memory.each_mut().map(|memory| {
            let buffer = BufferId { home: abi::HOME_DEVICE, ..Frame::EMPTY.buffer };
            Frame { buffer, data: memory.as_mut_ptr(), len: 8, ..Frame::EMPTY }
        });
        let mut is_whole = |shown: &[(u32, Frame)]| {
            assert!(make(at, there).is_some());
            shown.iter().for_each(|(output, frame)| call.show(*output, *frame));
            end(at)
        };
        assert!(!is_whole(&[(0, there)]), "the device has it");
        assert!(is_whole(&[(0, there), (0, here)]));
        assert!(!is_whole(&[(0, there), (1, there), (0, here)]), "another output is the same frame");
    }
}
