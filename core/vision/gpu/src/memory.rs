//! Memory of a kernel on the device, and transfers of images.

use std::ops::Range;
use std::sync::{Mutex, PoisonError, mpsc};
use std::time::Duration;

use panoscope_imaging::{Parallel, View, ViewMut};
use wgpu::{Buffer, BufferDescriptor, BufferUsages, BufferViewMut, CommandEncoder, MapMode, PollType};

use crate::device::{Gpu, GpuError};

/// Bytes of a row of a BGR image on the device: whole groups of four pixels, three words each.
pub fn row_bytes(width: usize) -> usize {
    width.div_ceil(4) * 12
}

/// Time limit for the report of finished work.
const ANSWER: Duration = Duration::from_secs(5);

/// A buffer that grows.
#[derive(Debug, Default)]
pub struct Store {
    buffer: Option<Buffer>,
}

impl Store {
    /// Ensures a size of at least `bytes`. Returns the buffer; the content of a new one is undefined.
    pub fn reserve(&mut self, gpu: &Gpu, bytes: u64) -> Result<&Buffer, GpuError> {
        self.reserve_as(gpu, bytes, BufferUsages::STORAGE | BufferUsages::COPY_DST | BufferUsages::COPY_SRC)
    }

    fn reserve_as(&mut self, gpu: &Gpu, bytes: u64, usage: BufferUsages) -> Result<&Buffer, GpuError> {
        let size = bytes.max(16).next_multiple_of(16);
        if self.buffer.as_ref().is_none_or(|held| held.size() < size) {
            gpu.check_size(size)?;
            self.buffer = None;
        }
        let mapped_at_creation = usage.contains(BufferUsages::MAP_WRITE);
        let new = || gpu.device.create_buffer(&BufferDescriptor { label: None, size, usage, mapped_at_creation });
        Ok(self.buffer.get_or_insert_with(new))
    }

    /// The buffer, if there is one.
    pub fn buffer(&self) -> Option<&Buffer> {
        self.buffer.as_ref()
    }
}

/// Upload and download of a frame.
#[derive(Debug, Default)]
pub struct Transfer {
    up: Store,
    down: Store,
    /// Whether a frame has begun and not finished; a failed one may have left its memory with the device.
    is_open: bool,
}

impl Transfer {
    /// Returns memory of `bytes` bytes for the upload.
    pub fn begin<'t>(&'t mut self, gpu: &'t Gpu, bytes: u64) -> Result<Filling<'t>, GpuError> {
        if std::mem::replace(&mut self.is_open, true) {
            *self = Self { is_open: true, ..Self::default() };
        }
        let buffer = self.up.reserve_as(gpu, bytes, BufferUsages::MAP_WRITE | BufferUsages::COPY_SRC)?;
        Ok(Filling { gpu, buffer })
    }

    /// Copies `bytes` bytes of the upload, from `from` on, to the start of `target`.
    pub fn send(&self, encoder: &mut CommandEncoder, from: u64, target: &Buffer, bytes: u64) {
        if let Some(up) = self.up.buffer() {
            encoder.copy_buffer_to_buffer(up, from, target, 0, bytes.next_multiple_of(4));
        }
    }

    /// Submits the upload and the encoded work, calls `meanwhile`, downloads the first `bytes` bytes of `result` and
    /// passes them to `read`.
    pub fn finish(
        &mut self,
        gpu: &Gpu,
        mut encoder: CommandEncoder,
        result: &Buffer,
        bytes: u64,
        meanwhile: impl FnOnce(),
        read: impl FnOnce(&[u8]),
    ) -> Result<(), GpuError> {
        let bytes = bytes.next_multiple_of(16);
        let down = self.down.reserve_as(gpu, bytes, BufferUsages::MAP_READ | BufferUsages::COPY_DST)?;
        encoder.copy_buffer_to_buffer(result, 0, down, 0, bytes);
        if let Some(up) = self.up.buffer() {
            up.unmap();
        }
        gpu.queue.submit([encoder.finish()]);
        let part = down.slice(..bytes);
        let (done, seen) = mpsc::channel();
        part.map_async(MapMode::Read, move |result| {
            let _ = done.send(result);
        });
        // Given back for the next frame: it becomes free with the work that was submitted.
        if let Some(up) = self.up.buffer() {
            up.slice(..).map_async(MapMode::Write, |_| {});
        }
        meanwhile();
        gpu.device.poll(PollType::wait_indefinitely()).map_err(|e| gpu.failed(e))?;
        gpu.check()?;
        // Another thread that waits for its own work may be the one that reports this.
        match seen.recv_timeout(ANSWER) {
            Ok(Ok(())) => {}
            Ok(Err(e)) => return Err(gpu.failed(e)),
            Err(_) => return Err(gpu.failed("it did not respond")),
        }
        let view = part.get_mapped_range().map_err(|e| gpu.failed(e))?;
        read(&view);
        drop(view);
        down.unmap();
        self.is_open = false;
        Ok(())
    }
}

/// Upload memory while it is filled. Parts begin at multiples of 16 bytes.
pub struct Filling<'t> {
    gpu: &'t Gpu,
    buffer: &'t Buffer,
}

impl Filling<'_> {
    fn part(&self, start: usize, bytes: usize) -> Result<BufferViewMut, GpuError> {
        let (start, bytes) = (start as u64, bytes.next_multiple_of(4) as u64);
        self.buffer.slice(start..start + bytes).get_mapped_range_mut().map_err(|e| self.gpu.failed(e))
    }

    /// Writes bytes.
    pub fn write(&self, start: usize, bytes: &[u8]) -> Result<(), GpuError> {
        self.part(start, bytes.len())?.slice(..bytes.len()).copy_from_slice(bytes);
        Ok(())
    }

    /// Writes the rows of an image.
    pub fn write_rows(&self, start: usize, upload: &Upload<'_>, pool: &dyn Parallel) -> Result<(), GpuError> {
        let (stride, height) = (upload.stride(), upload.part.height);
        let mut bands = Vec::with_capacity(height.div_ceil(ROWS));
        for first in (0..height).step_by(ROWS) {
            bands.push(Mutex::new(self.part(start + first * stride, ROWS.min(height - first) * stride)?));
        }
        pool.run(bands.len(), &|index| {
            let mut band = bands[index].lock().unwrap_or_else(PoisonError::into_inner);
            for y in index * ROWS..(index * ROWS + ROWS).min(height) {
                let at = (y - index * ROWS) * stride;
                band.slice(at..at + stride).copy_from_slice(upload.part.row(y));
            }
        });
        Ok(())
    }
}

/// Bytes of an image uploaded with its padding.
pub fn picture_bytes(view: &View<'_, u8>) -> u64 {
    (view.data.len() as u64 + 12).next_multiple_of(16)
}

/// Rows that a thread copies at a time; their size is a multiple of 16 bytes.
const ROWS: usize = 64;

/// Columns of a BGR image for the upload, row after row without padding.
#[derive(Clone, Copy, Debug)]
pub struct Upload<'v> {
    part: View<'v, u8>,
}

impl<'v> Upload<'v> {
    /// The columns from `first` on.
    pub fn new(view: View<'v, u8>, first: usize) -> Self {
        let first = first.min(view.width);
        Self { part: view.crop(first, 0, view.width - first, view.height) }
    }

    /// Bytes of a row.
    pub fn stride(&self) -> usize {
        self.part.width * self.part.channels
    }

    /// Size in bytes, with padding for kernels that read whole words.
    pub fn bytes(&self) -> u64 {
        ((self.stride() * self.part.height) as u64 + 12).next_multiple_of(16)
    }
}

/// Calls `row` with each row of an image and its number, on several threads.
pub fn each_row<T: Send>(out: &mut ViewMut<'_, T>, pool: &dyn Parallel, row: impl Fn(usize, &mut [T]) + Sync) {
    let (stride, width, height) = (out.stride, out.width * out.channels, out.height);
    let bands: Vec<_> = out.data.chunks_mut((stride * ROWS).max(1)).map(Mutex::new).collect();
    pool.run(bands.len(), &|index| {
        let mut band = bands[index].lock().unwrap_or_else(PoisonError::into_inner);
        for (at, pixels) in band.chunks_mut(stride).enumerate().take(height.saturating_sub(index * ROWS)) {
            row(index * ROWS + at, &mut pixels[..width]);
        }
    });
}

/// Writes the rows of an image of the device, which is as wide as `columns`, into those columns of a BGR image.
pub fn unpack(rows: &[u8], columns: Range<usize>, out: &mut ViewMut<'_, u8>, pool: &dyn Parallel) {
    let (bytes, per_row) = (columns.len() * 3, row_bytes(columns.len()));
    each_row(out, pool, |y, row| {
        row[columns.start * 3..columns.end * 3].copy_from_slice(&rows[y * per_row..][..bytes]);
    });
}
