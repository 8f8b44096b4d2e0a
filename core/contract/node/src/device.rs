//! Work on the GPU of the process: kernels in WGSL, buffers, and images that stay there between nodes.
//!
//! An image that a node makes by [`Slot::alloc_on_device`] is copied to the host's memory when somebody reads it there,
//! once, and an input is copied to the GPU by [`Image::on_device`] when it is not there yet. A node on the GPU that
//! reads what another one made there copies nothing.
//!
//! [`Slot::alloc_on_device`]: crate::Slot::alloc_on_device
//! [`Image::on_device`]: crate::Image::on_device

use panoscope_base::Report;

use crate::abi::{self, Str};
use crate::error::{NodeError, Result};
use crate::host;
use crate::packet::{Plain, bytes_of, bytes_of_mut};

/// Columns and rows of threads in a workgroup of all kernels.
pub const GROUP: [usize; 2] = [32, 4];

/// Bytes after the last pixel of an image that a kernel may read.
pub const MARGIN_BYTES: usize = 16;

/// WGSL functions for pixels of three bytes. `two_pixels`, `left_pixel` and `right_pixel` read by the kernel's function
/// `source_word(at: u32) -> u32`; `joined` and `store_four` write the kernel's array of words, `target_words`.
pub const PIXELS: &str = include_str!("pixels.wgsl");

/// Words as a kernel reads them.
pub fn bytes_of_words(words: &[u32]) -> Vec<u8> {
    words.iter().flat_map(|word| word.to_le_bytes()).collect()
}

/// Device that computes the images of a node.
#[derive(crate::Choice, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Device {
    /// The processor.
    #[default]
    Cpu,
    /// The GPU, through Vulkan.
    Gpu,
}

impl Device {
    /// Opens the device; `None` for the processor and, after a warning, if there is no GPU.
    pub fn open<T>(self, report: &dyn Report, new: impl FnOnce(Gpu) -> Result<T>) -> Option<T> {
        if self == Self::Cpu {
            return None;
        }
        match Gpu::open().and_then(|gpu| Ok((new(gpu)?, gpu))) {
            Ok((kernel, gpu)) => {
                report.info(&format!("computes on {}", gpu.name()));
                Some(kernel)
            }
            Err(error) => {
                report.warn(&given_up(&error));
                None
            }
        }
    }
}

/// The warning of a node that continues without the GPU.
pub fn given_up(reason: &dyn std::fmt::Display) -> String {
    format!("the processor computes the images: {reason}")
}

/// What a node does on the device that its parameter `device` names.
#[derive(Debug)]
pub struct OnDevice<T> {
    device: Device,
    /// `None` for the processor, without a GPU, and after the GPU failed.
    work: Option<T>,
}

impl<T> Default for OnDevice<T> {
    fn default() -> Self {
        Self { device: Device::Cpu, work: None }
    }
}

impl<T> OnDevice<T> {
    /// Opens the device if the parameter has changed; warns if it cannot be opened. Returns whether it has changed.
    pub fn choose(&mut self, device: Device, report: &dyn Report, new: impl FnOnce(Gpu) -> Result<T>) -> bool {
        let has_changed = device != self.device;
        if has_changed {
            self.device = device;
            self.work = device.open(report, new);
        }
        has_changed
    }

    /// What is done on the GPU.
    pub fn get(&self) -> Option<&T> {
        self.work.as_ref()
    }

    /// What is done on the GPU.
    pub fn get_mut(&mut self) -> Option<&mut T> {
        self.work.as_mut()
    }

    /// Leaves all further work to the processor, until another device is chosen.
    pub fn give_up(&mut self) {
        self.work = None;
    }

    /// Whether `job` was done on the GPU. If it fails, warns and leaves all further work to the processor.
    ///
    /// # Errors
    /// There was no frame memory for an output, which is not the GPU's fault.
    pub fn attempt(&mut self, report: &dyn Report, job: impl FnOnce(&mut T) -> Result<()>) -> Result<bool> {
        let Some(work) = &mut self.work else { return Ok(false) };
        match job(work) {
            Ok(()) => Ok(true),
            Err(error) if error.is_exhausted() => Err(error),
            Err(error) => {
                self.give_up();
                report.warn(&given_up(&error));
                Ok(false)
            }
        }
    }
}

/// The GPU of the process.
#[derive(Clone, Copy, Debug)]
pub struct Gpu {
    table: &'static abi::Device,
}

/// An image on the GPU. Its buffer holds at least [`MARGIN_BYTES`] more than the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DeviceImage {
    /// The buffer; the first pixel is at its start.
    pub buffer: u64,
    /// Columns in px.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Bytes from one row's start to the next one's.
    pub stride_bytes: usize,
}

impl DeviceImage {
    /// Bytes of a row of an image that is made on the GPU: whole groups of four pixels.
    pub const fn stride_bytes(width: usize, pixel_bytes: usize) -> usize {
        width.next_multiple_of(4) * pixel_bytes
    }

    /// The content of a frame of pixels, copied to the GPU if it is not there.
    pub(crate) fn of(frame: &abi::Frame) -> Result<Self> {
        let buffer = host::device_buffer(frame);
        if buffer == 0 {
            return Err(Gpu::open()?.failed());
        }
        let [width, height, stride_bytes] = [frame.width, frame.height, frame.stride_bytes].map(|n| n as usize);
        Ok(Self { buffer, width, height, stride_bytes })
    }
}

impl Gpu {
    /// The GPU that the host opened; the first call of the process may take some tenths of a second.
    ///
    /// # Errors
    /// There is none, or it could not be opened.
    pub fn open() -> Result<Self> {
        host::device().map(Self::of).map_err(NodeError::new)
    }

    /// The GPU behind a table.
    pub fn of(table: &'static abi::Device) -> Self {
        Self { table }
    }

    /// Name of the device, as its driver gives it.
    pub fn name(&self) -> &'static str {
        // SAFETY: the text lives as long as the table.
        unsafe { self.table.name.text() }.unwrap_or("the GPU")
    }

    /// The error of the last function that failed on this thread.
    fn failed(&self) -> NodeError {
        // SAFETY: the table's own handle; the text stays readable until another function fails on this thread.
        let reason = self.table.failure.map(|failure| unsafe { failure(self.table.ctx) });
        // SAFETY: as above.
        let reason = reason.as_ref().and_then(|reason| unsafe { reason.text() }).filter(|reason| !reason.is_empty());
        NodeError::new(reason.map_or_else(|| format!("{} failed", self.name()), str::to_owned))
    }

    /// Compiles a compute shader from its parts: entry point `main`, workgroups of [`GROUP`], bindings are storage
    /// buffers numbered from 0 on.
    ///
    /// # Errors
    /// The device rejects it.
    pub fn kernel(&self, label: &str, parts: &[&str]) -> Result<Kernel> {
        let source = parts.concat();
        let make = self.table.kernel.ok_or_else(|| self.failed())?;
        // SAFETY: the table's own handle; both texts live until the call returns.
        let handle = unsafe { make(self.table.ctx, Str::borrow(label), Str::borrow(&source)) };
        if handle == 0 { Err(self.failed()) } else { Ok(Kernel(Handle { gpu: *self, handle })) }
    }

    /// Runs steps in their order, after all that was submitted before. Does not wait for them.
    ///
    /// # Errors
    /// The device failed, now or at something submitted before.
    pub fn submit(&self, steps: &Steps<'_>) -> Result<()> {
        let list: Vec<abi::DeviceStep> = steps.0.iter().map(Step::raw).collect();
        let submit = self.table.submit.ok_or_else(|| self.failed())?;
        // SAFETY: the table's own handle; the steps and what they point to live until the call returns.
        let status = unsafe { submit(self.table.ctx, list.as_ptr(), list.len()) };
        if status == abi::STATUS_OK { Ok(()) } else { Err(self.failed()) }
    }

    /// Waits for all work and copies the first bytes of a buffer into `to`.
    ///
    /// # Errors
    /// The device failed.
    pub fn read(&self, buffer: u64, to: &mut [u8]) -> Result<()> {
        let read = self.table.read.ok_or_else(|| self.failed())?;
        // SAFETY: the table's own handle, and a place for as many bytes.
        let status = unsafe { read(self.table.ctx, buffer, 0, to.as_mut_ptr(), to.len()) };
        if status == abi::STATUS_OK { Ok(()) } else { Err(self.failed()) }
    }

    /// Waits for all work and copies the first numbers of a buffer into `to`, see [`Self::read`].
    ///
    /// # Errors
    /// The device failed.
    pub fn read_plain<T: Plain>(&self, buffer: u64, to: &mut [T]) -> Result<()> {
        self.read(buffer, bytes_of_mut(to))
    }
}

/// A kernel or buffer that is given back when it is dropped.
#[derive(Debug)]
struct Handle {
    gpu: Gpu,
    handle: u64,
}

impl Drop for Handle {
    fn drop(&mut self) {
        if let Some(free) = self.gpu.table.free {
            // SAFETY: the table's own handle and one of its numbers, given back once.
            unsafe { free(self.gpu.table.ctx, self.handle) };
        }
    }
}

/// A compiled compute shader.
#[derive(Debug)]
pub struct Kernel(Handle);

/// A buffer that grows.
#[derive(Debug, Default)]
pub struct Store(Option<(Handle, u64)>);

impl Store {
    /// Ensures a size of at least `bytes`. Returns the buffer; the content of a new one is undefined.
    ///
    /// # Errors
    /// It does not fit into the device.
    pub fn reserve(&mut self, gpu: Gpu, bytes: usize) -> Result<u64> {
        let bytes = (bytes.max(16) as u64).next_multiple_of(16);
        if let Some((handle, size)) = &self.0
            && *size >= bytes
        {
            return Ok(handle.handle);
        }
        self.0 = None;
        let make = gpu.table.buffer.ok_or_else(|| gpu.failed())?;
        // SAFETY: the table's own handle.
        let handle = unsafe { make(gpu.table.ctx, bytes) };
        if handle == 0 {
            return Err(gpu.failed());
        }
        self.0 = Some((Handle { gpu, handle }, bytes));
        Ok(handle)
    }
}

/// See [`abi::DeviceStep`].
#[derive(Debug)]
enum Step<'a> {
    Write { buffer: u64, offset: u64, data: &'a [u8] },
    Run { kernel: u64, buffers: Vec<u64>, groups: [u32; 2] },
}

impl Step<'_> {
    fn raw(&self) -> abi::DeviceStep {
        let none = abi::DeviceStep {
            kind: abi::DEVICE_WRITE,
            groups: [0; 2],
            reserved: 0,
            handle: 0,
            offset: 0,
            buffers: std::ptr::null(),
            buffers_len: 0,
            data: std::ptr::null(),
            data_len: 0,
        };
        match self {
            Self::Write { buffer, offset, data } => {
                abi::DeviceStep { handle: *buffer, offset: *offset, data: data.as_ptr(), data_len: data.len(), ..none }
            }
            Self::Run { kernel, buffers, groups } => abi::DeviceStep {
                kind: abi::DEVICE_RUN,
                groups: *groups,
                handle: *kernel,
                buffers: buffers.as_ptr(),
                buffers_len: buffers.len(),
                ..none
            },
        }
    }
}

/// Steps for the device, see [`Gpu::submit`].
#[derive(Debug, Default)]
pub struct Steps<'a>(Vec<Step<'a>>);

impl<'a> Steps<'a> {
    /// Writes bytes into a buffer, from byte `offset` on, a multiple of 4. The buffer has room for whole words.
    pub fn write(&mut self, buffer: u64, offset: usize, data: &'a [u8]) {
        self.0.push(Step::Write { buffer, offset: offset as u64, data });
    }

    /// Writes numbers into a buffer, see [`Self::write`].
    pub fn write_plain<T: Plain>(&mut self, buffer: u64, offset: usize, values: &'a [T]) {
        self.write(buffer, offset, bytes_of(values));
    }

    /// Runs a kernel on `buffers`, its bindings from 0 on, with at least `threads` threads: columns and rows.
    pub fn run(&mut self, kernel: &Kernel, buffers: &[u64], threads: [usize; 2]) {
        let groups = [0, 1].map(|k| threads[k].div_ceil(GROUP[k]) as u32);
        self.0.push(Step::Run { kernel: kernel.0.handle, buffers: buffers.to_vec(), groups });
    }
}
