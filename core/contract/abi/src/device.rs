use core::ffi::c_void;

use crate::{Status, Str};

/// Writes `data` into buffer `handle`, from byte `offset` on. `offset` is a multiple of 4.
pub const DEVICE_WRITE: u32 = 1;
/// Runs kernel `handle` on `buffers` in `groups` workgroups.
pub const DEVICE_RUN: u32 = 2;

/// One step of [`Device::submit`].
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct DeviceStep {
    /// One of the `DEVICE_` constants.
    pub kind: u32,
    /// Workgroups in x and y.
    pub groups: [u32; 2],
    /// Reserved, 0.
    pub reserved: u32,
    /// The kernel that runs or the buffer that is written.
    pub handle: u64,
    /// First byte that is written.
    pub offset: u64,
    /// Buffers of the kernel: binding `i` of group 0 is `buffers[i]`.
    pub buffers: *const u64,
    /// Count of `buffers`.
    pub buffers_len: usize,
    /// Bytes to write; read before `submit` returns.
    pub data: *const u8,
    /// Count of `data`.
    pub data_len: usize,
}

/// The GPU of a process: buffers in its memory and kernels that compute on them. Kernels and buffers are numbers above
/// 0. All functions may be called from any thread. What threads submit runs in the order of the calls.
#[repr(C)]
#[derive(Debug)]
pub struct Device {
    /// Size of this struct in bytes.
    pub struct_size: u32,
    /// Reserved, 0.
    pub reserved: u32,
    /// Name of the device, as its driver gives it.
    pub name: Str,
    /// Handle for the functions.
    pub ctx: *mut c_void,
    /// Maximum number of bytes of a buffer.
    pub max_buffer_bytes: u64,
    /// Compiles a compute shader in WGSL with the entry point `main`, whose bindings are storage buffers of group 0. 0
    /// when that fails.
    pub kernel: Option<unsafe extern "C" fn(ctx: *mut c_void, label: Str, source: Str) -> u64>,
    /// Makes a buffer of at least `bytes` bytes whose content is unspecified. 0 when that fails.
    pub buffer: Option<unsafe extern "C" fn(ctx: *mut c_void, bytes: u64) -> u64>,
    /// Gives a kernel or a buffer back. Work that was submitted still has it.
    pub free: Option<unsafe extern "C" fn(ctx: *mut c_void, handle: u64)>,
    /// Queues steps in their order and returns without waiting for them.
    pub submit: Option<unsafe extern "C" fn(ctx: *mut c_void, steps: *const DeviceStep, len: usize) -> Status>,
    /// Waits for the work submitted so far and copies bytes of a buffer, from `offset` on, to `to`. `offset` is a
    /// multiple of 4.
    pub read:
        Option<unsafe extern "C" fn(ctx: *mut c_void, buffer: u64, offset: u64, to: *mut u8, len: usize) -> Status>,
    /// Why the last function that failed on this thread did; valid until the next one fails.
    pub failure: Option<unsafe extern "C" fn(ctx: *mut c_void) -> Str>,
}

// SAFETY: the table is immutable and its functions may be called from any thread.
unsafe impl Send for Device {}
// SAFETY: the table is immutable and its functions may be called from any thread.
unsafe impl Sync for Device {}
