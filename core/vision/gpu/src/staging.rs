//! Memory by which bytes reach and leave the device. Buffers are used again.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use wgpu::{Buffer, BufferDescriptor, BufferUsages, Device, MapMode};

/// Buffers that are kept for later use, at most.
const MAX_KEPT: usize = 32;

/// Buffers that nobody uses. Those for writing are mapped.
#[derive(Debug, Default)]
pub struct Staging {
    up: Kept,
    down: Kept,
}

type Kept = Arc<Mutex<Vec<Buffer>>>;

fn lock(kept: &Kept) -> MutexGuard<'_, Vec<Buffer>> {
    kept.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Takes the smallest buffer of at least `bytes` bytes that is not four times too large.
fn take(kept: &Kept, bytes: u64) -> Option<Buffer> {
    let mut kept = lock(kept);
    let fits = |buffer: &Buffer| buffer.size() >= bytes && buffer.size() / 4 <= bytes.max(1 << 16);
    let at = kept.iter().enumerate().filter(|(_, buffer)| fits(buffer)).min_by_key(|(_, buffer)| buffer.size())?.0;
    Some(kept.swap_remove(at))
}

fn keep(kept: &Kept, buffer: Buffer) {
    let mut kept = lock(kept);
    if kept.len() < MAX_KEPT {
        kept.push(buffer);
    }
}

/// Size of a buffer for so many bytes: sizes that differ little are one.
fn rounded(bytes: u64) -> u64 {
    bytes.max(1 << 12).next_multiple_of(1 << 12)
}

impl Staging {
    /// A mapped buffer for writing `bytes` bytes.
    pub fn for_writing(&self, device: &Device, bytes: u64) -> Buffer {
        take(&self.up, bytes).unwrap_or_else(|| {
            device.create_buffer(&BufferDescriptor {
                label: None,
                size: rounded(bytes),
                usage: BufferUsages::MAP_WRITE | BufferUsages::COPY_SRC,
                mapped_at_creation: true,
            })
        })
    }

    /// Takes a buffer for writing back once the work that was submitted no longer reads it.
    pub fn written(&self, buffer: Buffer) {
        let (kept, back) = (Arc::clone(&self.up), buffer.clone());
        buffer.slice(..).map_async(MapMode::Write, move |mapped| {
            if mapped.is_ok() {
                keep(&kept, back);
            }
        });
    }

    /// A buffer for reading `bytes` bytes, not mapped.
    pub fn for_reading(&self, device: &Device, bytes: u64) -> Buffer {
        take(&self.down, bytes).unwrap_or_else(|| {
            device.create_buffer(&BufferDescriptor {
                label: None,
                size: rounded(bytes),
                usage: BufferUsages::MAP_READ | BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        })
    }

    /// Takes a buffer for reading back, which is not mapped any more.
    pub fn was_read(&self, buffer: Buffer) {
        keep(&self.down, buffer);
    }
}
