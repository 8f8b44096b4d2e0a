//! Frames whose content is in the memory of the GPU, alone or as well.
//!
//! Each buffer of the pools can have a copy on the GPU. A node that computes there makes frames whose content is in the
//! copy alone ([`panoscope_abi::HOME_DEVICE`]); it is copied to the buffer when somebody reads it there, once. The copy
//! of a frame of the processor is made when a node on the GPU reads it. Copies go with their buffers.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock};

use panoscope_abi::{self as abi, BufferId, Frame};

use super::{DeviceMemory, Memory};
use crate::current_node;
use crate::sync::lock;

const GRAY: &str = include_str!("gray.wgsl");
/// Columns and rows of threads in a workgroup of [`GRAY`].
const GRAY_GROUP: [u32; 2] = [32, 4];

static GRAY_KERNEL: OnceLock<u64> = OnceLock::new();
/// Copies by pool and offset of their buffers.
type Copies = HashMap<(u32, u64), Arc<Mutex<DeviceCopy>>>;

static COPIES: Mutex<Option<Copies>> = Mutex::new(None);
/// Whether a frame was ever made on the GPU.
static IN_USE: AtomicBool = AtomicBool::new(false);
/// Frames whose content the GPU lost.
static LOST: AtomicU64 = AtomicU64::new(0);
static LOST_BECAUSE: Mutex<String> = Mutex::new(String::new());

/// Where the content of a buffer is.
struct DeviceCopy {
    /// The buffer on the GPU.
    handle: u64,
    is_on_device: bool,
    is_in_memory: bool,
}

/// Whether frames can have their content on the GPU alone.
#[inline]
pub(crate) fn in_use() -> bool {
    IN_USE.load(Ordering::Relaxed)
}

/// Number of frames whose content the GPU lost since the process started, and why the last one was.
pub(crate) fn lost() -> (u64, String) {
    match LOST.load(Ordering::Relaxed) {
        0 => (0, String::new()),
        count => (count, lock(&LOST_BECAUSE).clone()),
    }
}

fn key(id: BufferId) -> (u32, u64) {
    (id.pool, id.offset)
}

/// The content of a frame in the host's memory.
///
/// # Safety
/// The caller holds the frame, and nobody writes it.
unsafe fn bytes(frame: &Frame) -> &[u8] {
    // SAFETY: the caller's promise.
    if frame.len == 0 { &[] } else { unsafe { std::slice::from_raw_parts(frame.data, frame.len) } }
}

/// Writes black, or NaN, into a frame whose content is lost.
fn blank(frame: &Frame) {
    let value = if [abi::FORMAT_F32, abi::FORMAT_CLOUD].contains(&frame.format) { 0xff } else { 0 };
    // SAFETY: the frame's buffer has `len` bytes; its content was never in this memory, so that nobody reads it yet.
    unsafe { frame.data.write_bytes(value, frame.len) };
}

impl Memory {
    fn copy_of(id: BufferId) -> Option<Arc<Mutex<DeviceCopy>>> {
        lock(&COPIES).as_ref()?.get(&key(id)).cloned()
    }

    /// The copy of a buffer that the caller holds, or a new one; `None` when that cannot be made.
    fn copy_or(&self, id: BufferId, new: impl FnOnce() -> Option<DeviceCopy>) -> Option<Arc<Mutex<DeviceCopy>>> {
        let mut copies = lock(&COPIES);
        let copies = copies.get_or_insert_default();
        if let Some(copy) = copies.get(&key(id)) {
            return Some(Arc::clone(copy));
        }
        let (pool, slot) = self.slot(id)?;
        let copy = Arc::new(Mutex::new(new()?));
        copies.insert(key(id), Arc::clone(&copy));
        pool.has_device_copy[slot].store(1, Ordering::Relaxed);
        Some(copy)
    }

    /// Drops the copy of a buffer.
    #[cold]
    pub(super) fn drop_device_copy(&self, id: BufferId) {
        let copy = lock(&COPIES).as_mut().and_then(|copies| copies.remove(&key(id)));
        if let (Some(copy), Some(device)) = (copy, DeviceMemory::opened()) {
            device.free(lock(&copy).handle);
        }
    }

    /// Before the host's memory of a buffer is written: its copy would not follow.
    pub(crate) fn forget_device_copy(&self, id: BufferId) {
        if let Some((pool, slot)) = self.slot(id)
            && pool.has_device_copy[slot].swap(0, Ordering::Relaxed) != 0
        {
            self.drop_device_copy(id);
        }
    }

    /// Gives a new buffer of `len` bytes a copy that holds its content. Returns the buffer on the GPU, `None` when that
    /// fails.
    pub(crate) fn place_on_device(&self, id: BufferId, len: usize) -> Option<u64> {
        let handle = DeviceMemory::open().ok()?.buffer(len)?;
        IN_USE.store(true, Ordering::Relaxed);
        self.copy_or(id, || Some(DeviceCopy { handle, is_on_device: true, is_in_memory: false }))?;
        Some(handle)
    }

    /// The buffer on the GPU with the content of a frame that the caller holds, copied there if it is not; `None` when
    /// that fails.
    pub(crate) fn device_buffer(&self, frame: &Frame) -> Option<u64> {
        let device = DeviceMemory::open().ok()?;
        let copy = self.copy_or(frame.buffer, || {
            let handle = device.buffer(frame.len)?;
            Some(DeviceCopy { handle, is_on_device: false, is_in_memory: true })
        })?;
        let mut copy = lock(&copy);
        if !copy.is_on_device {
            // SAFETY: the caller holds the frame, and nodes write only frames that nobody shares.
            if !device.write(copy.handle, unsafe { bytes(frame) }) {
                return None;
            }
            current_node::count_copy(frame.len);
            copy.is_on_device = true;
        }
        Some(copy.handle)
    }

    /// Makes sure that the content of a frame that the caller holds is in the host's memory. `false` when it is lost.
    pub fn fetch(&self, frame: &Frame) -> bool {
        if frame.buffer.home == abi::HOME_HOST {
            return true;
        }
        let Some(copy) = Self::copy_of(frame.buffer) else { return true };
        let mut copy = lock(&copy);
        if copy.is_in_memory {
            return true;
        }
        let Some(device) = DeviceMemory::opened() else { return false };
        // SAFETY: the buffer has `len` bytes, and its readers wait for this copy.
        let is_read = unsafe { device.read(copy.handle, frame.data, frame.len) };
        copy.is_in_memory = true;
        current_node::count_copy(frame.len);
        if !is_read {
            blank(frame);
            *lock(&LOST_BECAUSE) = device.failure();
            LOST.fetch_add(1, Ordering::Relaxed);
        }
        is_read
    }

    /// Writes the gray values of a frame of [`abi::FORMAT_BGR8`], whose content is on the GPU, into the copy of `gray`,
    /// a new buffer for `width` x `height` bytes with rows of `stride` bytes, a multiple of 4. `false` when that fails.
    pub(crate) fn gray_on_device(&self, frame: &Frame, gray: BufferId, stride: usize) -> bool {
        let Ok(device) = DeviceMemory::open() else { return false };
        let kernel = *GRAY_KERNEL.get_or_init(|| device.kernel("gray", GRAY));
        let (Some(source), true) = (self.device_buffer(frame), kernel != 0) else { return false };
        let words = [frame.width, frame.height, frame.stride_bytes, stride as u32];
        let sizes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        let Some(target) = self.place_on_device(gray, stride * frame.height as usize) else { return false };
        let Some(scratch) = device.buffer(sizes.len()) else { return false };
        let groups = [frame.width.div_ceil(4 * GRAY_GROUP[0]), frame.height.div_ceil(GRAY_GROUP[1])];
        let is_done = device.run(kernel, &sizes, &[scratch, source, target], groups);
        // The work that was submitted keeps it.
        device.free(scratch);
        is_done
    }
}

#[cfg(test)]
mod tests {
    use std::ffi::c_void;

    use panoscope_abi::{Device, DeviceStep, Status, Str};

    use super::*;
    use crate::memory::{FrameRef, memory, open_device_by};

    /// Buffers of a device that is none.
    static BUFFERS: Mutex<Vec<Option<Vec<u8>>>> = Mutex::new(Vec::new());
    static BROKEN: AtomicBool = AtomicBool::new(false);
    /// The device is that of the process: one test at a time.
    static ALONE: Mutex<()> = Mutex::new(());

    unsafe extern "C" fn buffer(_: *mut c_void, bytes: u64) -> u64 {
        let mut buffers = lock(&BUFFERS);
        buffers.push(Some(vec![0; bytes as usize]));
        buffers.len() as u64
    }

    unsafe extern "C" fn free(_: *mut c_void, handle: u64) {
        lock(&BUFFERS)[handle as usize - 1] = None;
    }

    unsafe extern "C" fn submit(_: *mut c_void, steps: *const DeviceStep, len: usize) -> Status {
        for at in 0..len {
            // SAFETY: the caller lends `len` steps, and the bytes of each.
            let (step, data) = unsafe {
                let step = &*steps.add(at);
                (step, std::slice::from_raw_parts(step.data, step.data_len))
            };
            let mut buffers = lock(&BUFFERS);
            buffers[step.handle as usize - 1].as_mut().expect("a buffer")[..data.len()].copy_from_slice(data);
        }
        abi::STATUS_OK
    }

    unsafe extern "C" fn read(_: *mut c_void, handle: u64, _: u64, to: *mut u8, len: usize) -> Status {
        if BROKEN.load(Ordering::Relaxed) {
            return abi::STATUS_ERROR;
        }
        let buffers = lock(&BUFFERS);
        let from = &buffers[handle as usize - 1].as_ref().expect("a buffer")[..len];
        // SAFETY: the caller lends `len` bytes.
        unsafe { to.copy_from_nonoverlapping(from.as_ptr(), len) };
        abi::STATUS_OK
    }

    unsafe extern "C" fn failure(_: *mut c_void) -> Str {
        Str::new("it is broken")
    }

    fn open() -> Result<&'static Device, String> {
        static DEVICE: Device = Device {
            struct_size: size_of::<Device>() as u32,
            reserved: 0,
            name: Str::new("none"),
            ctx: std::ptr::null_mut(),
            max_buffer_bytes: 1 << 20,
            kernel: None,
            buffer: Some(buffer),
            free: Some(free),
            submit: Some(submit),
            read: Some(read),
            failure: Some(failure),
        };
        Ok(&DEVICE)
    }

    fn frame(home: u32) -> FrameRef {
        let (mut buffer, data) = memory().allocate(100).expect("memory");
        buffer.home = home;
        // SAFETY: a new buffer of at least 100 bytes that only this function has.
        unsafe {
            data.write_bytes(7, 100);
            FrameRef::adopt(Frame { buffer, data, len: 100, ..Frame::EMPTY })
        }
    }

    fn content(handle: u64) -> Option<Vec<u8>> {
        lock(&BUFFERS)[handle as usize - 1].clone().map(|bytes| bytes[..100].to_vec())
    }

    #[test]
    fn content_moves_when_it_is_read_and_only_once() {
        let _alone = lock(&ALONE);
        open_device_by(open);
        let here = frame(abi::HOME_HOST);
        let handle = memory().device_buffer(here.frame()).expect("a buffer");
        assert_eq!(content(handle), Some(vec![7; 100]));
        lock(&BUFFERS)[handle as usize - 1].as_mut().expect("a buffer")[0] = 9;
        assert_eq!(memory().device_buffer(here.frame()), Some(handle));
        assert_eq!(content(handle).expect("a buffer")[0], 9, "it is copied once");
        memory().forget_device_copy(here.frame().buffer);
        assert_eq!(content(handle), None, "a frame that is written has no copy");
        let handle = memory().device_buffer(here.frame()).expect("a buffer");
        drop(here);
        assert_eq!(content(handle), None, "copies go with their frames");

        let there = frame(abi::HOME_DEVICE);
        let handle = memory().place_on_device(there.frame().buffer, 100).expect("a buffer");
        lock(&BUFFERS)[handle as usize - 1].as_mut().expect("a buffer")[..100].fill(3);
        assert_eq!(memory().device_buffer(there.frame()), Some(handle), "nothing is copied to where it is");
        assert_eq!(there.bytes(), [3; 100]);
        lock(&BUFFERS)[handle as usize - 1].as_mut().expect("a buffer")[..100].fill(4);
        assert_eq!(there.clone().bytes(), [3; 100], "it is fetched once");
    }

    #[test]
    fn content_that_is_lost_is_black_and_counted() {
        let _alone = lock(&ALONE);
        open_device_by(open);
        let there = frame(abi::HOME_DEVICE);
        memory().place_on_device(there.frame().buffer, 100).expect("a buffer");
        BROKEN.store(true, Ordering::Relaxed);
        let (before, _) = lost();
        assert_eq!(there.bytes(), [0; 100]);
        BROKEN.store(false, Ordering::Relaxed);
        assert_eq!(lost(), (before + 1, "it is broken".to_owned()));
        assert_eq!(there.bytes(), [0; 100], "readers agree");
    }
}
