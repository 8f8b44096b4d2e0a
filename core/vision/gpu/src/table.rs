//! The device as the contract's table of functions.

use std::cell::RefCell;
use std::ffi::c_void;
use std::sync::{OnceLock, mpsc};
use std::time::Duration;

use panoscope_abi::{self as abi, Device, DeviceStep, Status, Str};
use wgpu::{
    BindGroupDescriptor, BindGroupEntry, Buffer, BufferDescriptor, BufferUsages, CommandEncoder,
    CommandEncoderDescriptor, ComputePassDescriptor, ComputePipelineDescriptor, MapMode, PipelineCompilationOptions,
    PollType, ShaderModuleDescriptor, ShaderSource,
};

use crate::device::{CHOICE, Gpu, GpuError};
use crate::items::Item;

/// Time limit for the report of finished work.
const ANSWER: Duration = Duration::from_secs(5);
/// Alignment of parts in memory for writing, bytes.
const ALIGNMENT: u64 = 16;

thread_local! {
    static FAILURE: RefCell<String> = const { RefCell::new(String::new()) };
}

/// The device of this process; opens it at the first call, which takes some tenths of a second. [`CHOICE`] chooses it.
///
/// # Errors
/// The message of a [`GpuError`], the same at each call.
pub fn table() -> Result<&'static Device, String> {
    static TABLE: OnceLock<Result<&'static Device, String>> = OnceLock::new();
    let open = || Ok(Gpu::open(std::env::var(CHOICE).ok().as_deref()).map_err(|e| e.to_string())?.into_table());
    TABLE.get_or_init(open).clone()
}

impl Gpu {
    /// The table of this device, which stays open until the process ends.
    pub fn into_table(self) -> &'static Device {
        let gpu: &'static Gpu = Box::leak(Box::new(self));
        Box::leak(Box::new(Device {
            struct_size: size_of::<Device>() as u32,
            reserved: 0,
            name: Str::borrow(gpu.name()),
            ctx: std::ptr::from_ref(gpu).cast_mut().cast(),
            max_buffer_bytes: gpu.max_buffer_bytes(),
            kernel: Some(kernel),
            buffer: Some(buffer),
            free: Some(free),
            submit: Some(submit),
            read: Some(read),
            failure: Some(failure),
        }))
    }

    fn wrong(&self, reason: impl Into<String>) -> GpuError {
        GpuError::Step { name: self.name().to_owned(), reason: reason.into() }
    }

    fn compile(&self, label: &str, source: &str) -> Result<u64, GpuError> {
        let source = ShaderSource::Wgsl(source.into());
        let module = self.device.create_shader_module(ShaderModuleDescriptor { label: Some(label), source });
        let pipeline = self.device.create_compute_pipeline(&ComputePipelineDescriptor {
            label: Some(label),
            layout: None,
            module: &module,
            entry_point: Some("main"),
            // Shaders write memory of their workgroup before they read it; clearing 16 KiB can take as long as the work.
            compilation_options: PipelineCompilationOptions {
                zero_initialize_workgroup_memory: false,
                ..PipelineCompilationOptions::default()
            },
            cache: None,
        });
        self.check()?;
        Ok(self.items.add(Item::Kernel(pipeline)))
    }

    fn make_buffer(&self, bytes: u64) -> Result<u64, GpuError> {
        // Sizes that differ little are one, so that spare buffers fit.
        let size = bytes.max(256).next_multiple_of(256);
        self.check_size(size)?;
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_DST | BufferUsages::COPY_SRC;
        let new =
            || self.device.create_buffer(&BufferDescriptor { label: None, size, usage, mapped_at_creation: false });
        let buffer = self.items.take_spare(size).unwrap_or_else(new);
        self.check()?;
        Ok(self.items.add(Item::Buffer(buffer)))
    }

    fn named_buffer(&self, number: u64) -> Result<Buffer, GpuError> {
        match self.items.get(number) {
            Some(Item::Buffer(buffer)) => Ok(buffer),
            _ => Err(self.wrong(format!("there is no buffer {number}"))),
        }
    }

    fn run_kernel(&self, step: &DeviceStep, encoder: &mut CommandEncoder) -> Result<(), GpuError> {
        let pipeline = match self.items.get(step.handle) {
            Some(Item::Kernel(pipeline)) => pipeline,
            _ => return Err(self.wrong(format!("there is no kernel {}", step.handle))),
        };
        // SAFETY: the caller of `submit` keeps `buffers_len` numbers readable.
        let numbers = unsafe { slice(step.buffers, step.buffers_len) };
        let buffers = numbers.iter().map(|number| self.named_buffer(*number)).collect::<Result<Vec<_>, _>>()?;
        let entries: Vec<BindGroupEntry<'_>> = buffers
            .iter()
            .enumerate()
            .map(|(binding, buffer)| BindGroupEntry { binding: binding as u32, resource: buffer.as_entire_binding() })
            .collect();
        let layout = pipeline.get_bind_group_layout(0);
        let group =
            self.device.create_bind_group(&BindGroupDescriptor { label: None, layout: &layout, entries: &entries });
        let mut pass = encoder.begin_compute_pass(&ComputePassDescriptor::default());
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, &group, &[]);
        pass.dispatch_workgroups(step.groups[0], step.groups[1], 1);
        Ok(())
    }

    /// Encodes and submits steps. All bytes that they write go through one part of memory.
    fn run_steps(&self, steps: &[DeviceStep]) -> Result<(), GpuError> {
        let padded = |step: &DeviceStep| (step.data_len as u64).next_multiple_of(ALIGNMENT);
        let writes = || steps.iter().filter(|step| step.kind == abi::DEVICE_WRITE && step.data_len > 0);
        let total: u64 = writes().map(padded).sum();
        let up = (total > 0).then(|| self.staging.for_writing(&self.device, total));
        let mut encoder = self.device.create_command_encoder(&CommandEncoderDescriptor::default());
        let mut from = 0;
        let filled = steps.iter().try_for_each(|step| {
            match step.kind {
                abi::DEVICE_RUN => return self.run_kernel(step, &mut encoder),
                abi::DEVICE_WRITE if step.data_len == 0 => return Ok(()),
                abi::DEVICE_WRITE => {}
                kind => return Err(self.wrong(format!("kind {kind}"))),
            }
            let Some(up) = &up else { return Ok(()) };
            let target = self.named_buffer(step.handle)?;
            let bytes = (step.data_len as u64).next_multiple_of(4);
            if !step.offset.is_multiple_of(4) || step.offset.saturating_add(bytes) > target.size() {
                let (offset, size) = (step.offset, target.size());
                return Err(self.wrong(format!("{bytes} bytes from {offset} on in a buffer of {size}")));
            }
            let mut view = up.slice(from..from + bytes).get_mapped_range_mut().map_err(|e| self.failed(e))?;
            // SAFETY: the caller of `submit` keeps `data_len` bytes readable.
            view.slice(..step.data_len).copy_from_slice(unsafe { slice(step.data, step.data_len) });
            drop(view);
            encoder.copy_buffer_to_buffer(up, from, &target, step.offset, bytes);
            from += padded(step);
            Ok(())
        });
        if let Some(up) = &up {
            up.unmap();
        }
        let sent = filled.map(|()| _ = self.queue.submit([encoder.finish()]));
        if let Some(up) = up {
            self.staging.written(up);
        }
        sent?;
        // Reports finished work, so that memory for writing comes back.
        self.device.poll(PollType::Poll).map_err(|e| self.failed(e))?;
        self.check()
    }

    /// Waits and copies bytes of a buffer.
    fn read_buffer(&self, number: u64, offset: u64, to: &mut [u8]) -> Result<(), GpuError> {
        let source = self.named_buffer(number)?;
        let bytes = (to.len() as u64).next_multiple_of(4);
        if !offset.is_multiple_of(4) || offset.saturating_add(bytes) > source.size() {
            return Err(self.wrong(format!("{bytes} bytes from {offset} on in a buffer of {}", source.size())));
        }
        let down = self.staging.for_reading(&self.device, bytes);
        let mut encoder = self.device.create_command_encoder(&CommandEncoderDescriptor::default());
        encoder.copy_buffer_to_buffer(&source, offset, &down, 0, bytes);
        let submission = self.queue.submit([encoder.finish()]);
        let part = down.slice(..bytes);
        let (done, seen) = mpsc::channel();
        part.map_async(MapMode::Read, move |result| {
            let _ = done.send(result);
        });
        let wait = PollType::Wait { submission_index: Some(submission), timeout: None };
        self.device.poll(wait).map_err(|e| self.failed(e))?;
        self.check()?;
        // Another thread that waits for its own work may be the one that reports this.
        match seen.recv_timeout(ANSWER) {
            Ok(Ok(())) => {}
            Ok(Err(e)) => return Err(self.failed(e)),
            Err(_) => return Err(self.failed("it did not respond")),
        }
        let view = part.get_mapped_range().map_err(|e| self.failed(e))?;
        to.copy_from_slice(&view[..to.len()]);
        drop(view);
        down.unmap();
        self.staging.was_read(down);
        Ok(())
    }
}

/// A slice of the caller's memory; empty for null.
///
/// # Safety
/// Null, or `len` readable values that nobody writes while the slice is used.
unsafe fn slice<'a, T>(first: *const T, len: usize) -> &'a [T] {
    // SAFETY: the caller's promise.
    if first.is_null() || len == 0 { &[] } else { unsafe { std::slice::from_raw_parts(first, len) } }
}

/// # Safety
/// `ctx` is that of a table.
unsafe fn gpu<'a>(ctx: *mut c_void) -> Option<&'a Gpu> {
    // SAFETY: tables and their devices stay until the process ends.
    unsafe { ctx.cast::<Gpu>().as_ref() }
}

fn noted<T>(result: Result<T, GpuError>) -> Option<T> {
    result.map_err(|error| FAILURE.with(|place| *place.borrow_mut() = error.to_string())).ok()
}

fn status(result: Result<(), GpuError>) -> Status {
    noted(result).map_or(abi::STATUS_ERROR, |()| abi::STATUS_OK)
}

unsafe extern "C" fn kernel(ctx: *mut c_void, label: Str, source: Str) -> u64 {
    // SAFETY: the caller passes the table's handle and lends both texts for the call (the contract).
    let (Some(gpu), Some(label), Some(source)) = (unsafe { (gpu(ctx), label.text(), source.text()) }) else { return 0 };
    noted(gpu.compile(label, source)).unwrap_or(0)
}

unsafe extern "C" fn buffer(ctx: *mut c_void, bytes: u64) -> u64 {
    // SAFETY: the caller passes the table's handle (the contract).
    unsafe { gpu(ctx) }.and_then(|gpu| noted(gpu.make_buffer(bytes))).unwrap_or(0)
}

unsafe extern "C" fn free(ctx: *mut c_void, handle: u64) {
    // SAFETY: the caller passes the table's handle (the contract).
    if let Some(gpu) = unsafe { gpu(ctx) } {
        gpu.items.free(handle);
    }
}

unsafe extern "C" fn submit(ctx: *mut c_void, steps: *const DeviceStep, len: usize) -> Status {
    // SAFETY: the caller passes the table's handle and lends the steps for the call (the contract).
    let (gpu, steps) = unsafe { (gpu(ctx), slice(steps, len)) };
    gpu.map_or(abi::STATUS_INVALID, |gpu| status(gpu.run_steps(steps)))
}

unsafe extern "C" fn read(ctx: *mut c_void, buffer: u64, offset: u64, to: *mut u8, len: usize) -> Status {
    if to.is_null() {
        return abi::STATUS_INVALID;
    }
    // SAFETY: the caller passes the table's handle and room for `len` bytes that nobody else uses meanwhile (the contract).
    let (gpu, to) = unsafe { (gpu(ctx), std::slice::from_raw_parts_mut(to, len)) };
    gpu.map_or(abi::STATUS_INVALID, |gpu| status(gpu.read_buffer(buffer, offset, to)))
}

unsafe extern "C" fn failure(_: *mut c_void) -> Str {
    // The text moves only when another function fails on this thread.
    FAILURE.with(|text| Str::borrow(&text.borrow()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn step(kind: u32, handle: u64, data: &[u8], buffers: &[u64]) -> DeviceStep {
        DeviceStep {
            kind,
            groups: [1; 2],
            reserved: 0,
            handle,
            offset: 0,
            buffers: buffers.as_ptr(),
            buffers_len: buffers.len(),
            data: data.as_ptr(),
            data_len: data.len(),
        }
    }

    const DOUBLE: &str = "@group(0) @binding(0) var<storage, read> given: array<u32>;
@group(0) @binding(1) var<storage, read_write> made: array<u32>;
@compute @workgroup_size(1) fn main(@builtin(global_invocation_id) id: vec3<u32>) { made[id.x] = 2u * given[id.x]; }";

    #[test]
    fn wrong_steps_are_refused_by_name_and_the_device_goes_on() {
        let choice = std::env::var(CHOICE).ok().filter(|choice| !choice.is_empty());
        let gpu = match Gpu::open(Some(choice.as_deref().unwrap_or("software"))) {
            Ok(gpu) => gpu,
            Err(e) => return panoscope_testing::skipped!("{e}"),
        };
        let refused = |steps: &[DeviceStep]| gpu.run_steps(steps).expect_err("refused").to_string();
        assert!(gpu.compile("broken", "fn main(").expect_err("refused").to_string().contains("main"));
        let double = gpu.compile("double", DOUBLE).expect("a kernel");
        let [from, to] = [0, 1].map(|_| gpu.make_buffer(16).expect("a buffer"));
        assert!(refused(&[step(abi::DEVICE_WRITE, 999, &[1; 4], &[])]).contains("no buffer 999"));
        assert!(refused(&[step(abi::DEVICE_WRITE, double, &[1; 4], &[])]).contains("no buffer"));
        assert!(refused(&[step(abi::DEVICE_RUN, from, &[], &[])]).contains("no kernel"));
        assert!(refused(&[step(abi::DEVICE_WRITE, from, &[1; 4096], &[])]).contains("4096 bytes"));
        assert!(refused(&[step(77, from, &[1; 4], &[])]).contains("kind 77"));
        assert!(gpu.make_buffer(1 << 60).is_err());
        assert!(gpu.read_buffer(999, 0, &mut [0; 4]).is_err());
        let words: Vec<u8> = [5_u32, 7].iter().flat_map(|word| word.to_le_bytes()).collect();
        let buffers = [from, to];
        let steps = [step(abi::DEVICE_WRITE, from, &words, &[]), step(abi::DEVICE_RUN, double, &[], &buffers)];
        gpu.run_steps(&steps).expect("done");
        let mut found = [0; 4];
        gpu.read_buffer(to, 0, &mut found).expect("read");
        assert_eq!(u32::from_le_bytes(found), 10);
        gpu.items.free(from);
        assert!(refused(&[step(abi::DEVICE_WRITE, from, &words, &[])]).contains("no buffer"));
    }
}
