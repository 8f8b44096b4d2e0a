//! The memory of the GPU, by the functions of its table.

use std::ptr::null;
use std::sync::OnceLock;

use panoscope_abi::{self as abi, Device, DeviceStep, Str};

/// Opens the GPU of the process, or says why there is none.
pub type OpenDevice = fn() -> Result<&'static Device, String>;

/// Bytes that kernels may read after a frame: whole words, and the words after the last one.
const MARGIN_BYTES: u64 = 16;

static OPENER: OnceLock<OpenDevice> = OnceLock::new();
static DEVICE: OnceLock<Result<&'static Device, String>> = OnceLock::new();

/// Sets how the GPU is opened, once a node asks for it. Only the first call has an effect.
pub fn open_device_by(open: OpenDevice) {
    let _ = OPENER.set(open);
}

/// See [`abi::Host::device`].
///
/// # Safety
/// `reason` is null or a place for a text.
pub unsafe fn device_table(reason: *mut Str) -> *const Device {
    match DeviceMemory::open() {
        Ok(device) => device.0,
        Err(words) => {
            // SAFETY: the caller's promise; the text lives as long as the process.
            if let Some(place) = unsafe { reason.as_mut() } {
                *place = Str::borrow(words);
            }
            null()
        }
    }
}

/// The memory of the process's GPU.
#[derive(Clone, Copy, Debug)]
pub struct DeviceMemory(&'static Device);

impl DeviceMemory {
    /// Opens the GPU at the first call.
    ///
    /// # Errors
    /// Why there is none; the same at each call.
    pub fn open() -> Result<Self, &'static str> {
        let open =
            || OPENER.get().map_or_else(|| Err("the program offers none to its nodes".to_owned()), |open| open());
        match DEVICE.get_or_init(open) {
            Ok(device) => Ok(Self(device)),
            Err(reason) => Err(reason),
        }
    }

    /// The GPU, if it was opened.
    pub fn opened() -> Option<Self> {
        DEVICE.get()?.as_ref().ok().map(|device| Self(device))
    }

    /// A buffer for a frame of `len` bytes; `None` when there is no room.
    pub fn buffer(self, len: usize) -> Option<u64> {
        let bytes = (len as u64).next_multiple_of(4) + MARGIN_BYTES;
        // SAFETY: the table's own handle.
        self.0.buffer.map(|buffer| unsafe { buffer(self.0.ctx, bytes) }).filter(|handle| *handle != 0)
    }

    /// Gives a kernel or a buffer back.
    pub fn free(self, handle: u64) {
        if let Some(free) = self.0.free {
            // SAFETY: the table's own handle and a number; an unknown one is nothing.
            unsafe { free(self.0.ctx, handle) };
        }
    }

    /// Compiles a kernel; 0 when that fails.
    pub(super) fn kernel(self, label: &'static str, source: &'static str) -> u64 {
        // SAFETY: the table's own handle; both texts are statics.
        self.0.kernel.map_or(0, |kernel| unsafe { kernel(self.0.ctx, Str::new(label), Str::new(source)) })
    }

    fn submit(self, steps: &[DeviceStep]) -> bool {
        // SAFETY: the table's own handle; the callers keep what the steps point to until it returns.
        self.0.submit.is_some_and(|submit| unsafe { submit(self.0.ctx, steps.as_ptr(), steps.len()) == abi::STATUS_OK })
    }

    /// Copies bytes to a buffer; `false` when that fails.
    pub fn write(self, handle: u64, data: &[u8]) -> bool {
        self.submit(&[write(handle, data)])
    }

    /// Copies bytes to `sizes`, the first of `buffers`, then runs a kernel on them; `false` when that fails.
    pub(super) fn run(self, kernel: u64, sizes: &[u8], buffers: &[u64], groups: [u32; 2]) -> bool {
        let Some(&first) = buffers.first() else { return false };
        let run = DeviceStep {
            kind: abi::DEVICE_RUN,
            groups,
            handle: kernel,
            buffers: buffers.as_ptr(),
            buffers_len: buffers.len(),
            ..write(0, &[])
        };
        self.submit(&[write(first, sizes), run])
    }

    /// Waits for all work and copies the first `len` bytes of a buffer; `false` when that fails.
    ///
    /// # Safety
    /// `to` has room for `len` bytes that nobody reads or writes meanwhile.
    pub unsafe fn read(self, handle: u64, to: *mut u8, len: usize) -> bool {
        // SAFETY: the table's own handle; the caller's promise.
        self.0.read.is_some_and(|read| unsafe { read(self.0.ctx, handle, 0, to, len) == abi::STATUS_OK })
    }

    /// Why the last function that failed on this thread did.
    pub(super) fn failure(self) -> String {
        // SAFETY: the table's own handle; the text is readable until another function fails on this thread.
        let text = self.0.failure.map(|failure| unsafe { failure(self.0.ctx) });
        // SAFETY: as above.
        text.as_ref().and_then(|text| unsafe { text.text() }).unwrap_or("the GPU failed").to_owned()
    }
}

fn write(handle: u64, data: &[u8]) -> DeviceStep {
    DeviceStep {
        kind: abi::DEVICE_WRITE,
        groups: [0; 2],
        reserved: 0,
        handle,
        offset: 0,
        buffers: null(),
        buffers_len: 0,
        data: data.as_ptr(),
        data_len: data.len(),
    }
}
