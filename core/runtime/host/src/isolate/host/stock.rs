//! Buffers that the host reserves for the next call of an instance, so that its outputs need no round trip.

use panoscope_abi::Frame;
use panoscope_engine::memory::{FrameRef, memory, room_for};

use super::process::Process;
use crate::isolate::wire::lane::Reserved;

/// A buffer is replaced when the output needs less than 1 / `MIN_SHARE` of it.
const MIN_SHARE: usize = 4;

/// At most one buffer per output, of the size of the last output.
#[derive(Default)]
pub(super) struct Stock {
    outputs: Vec<Reserve>,
}

#[derive(Default)]
struct Reserve {
    wanted_bytes: usize,
    buffer: Option<FrameRef>,
}

impl Stock {
    /// Records the size of an output that the node made.
    pub fn note(&mut self, output: u32, len: usize) {
        let len = room_for(len);
        if let Some(reserve) = self.outputs.get_mut(output as usize)
            && (len > reserve.wanted_bytes || len < reserve.wanted_bytes / MIN_SHARE)
        {
            *reserve = Reserve { wanted_bytes: len, buffer: None };
        }
    }

    /// Reserves missing buffers and lists one for each output.
    pub fn list(&mut self, outputs_len: usize, process: &Process, list: &mut Vec<Reserved>) {
        list.clear();
        self.outputs.resize_with(outputs_len, Reserve::default);
        for reserve in &mut self.outputs {
            if reserve.buffer.is_none() && reserve.wanted_bytes > 0 {
                reserve.buffer = buffer(reserve.wanted_bytes, process);
            }
            let frame = reserve.buffer.as_ref().map(FrameRef::frame);
            list.push(
                frame.map_or_else(Reserved::default, |frame| Reserved { buffer: frame.buffer, len: frame.len as u64 }),
            );
        }
    }

    /// The buffer of an output, which the child has used.
    pub fn take(&mut self, output: u32) -> Option<FrameRef> {
        self.outputs.get_mut(output as usize)?.buffer.take()
    }
}

/// A buffer in the memory of the process; `None` while frame memory is exhausted.
fn buffer(len: usize, process: &Process) -> Option<FrameRef> {
    let (buffer, data) = memory().allocate_in(process.domain(), len).ok()?;
    // SAFETY: the one reference of a new buffer of at least `len` bytes.
    let frame = unsafe { FrameRef::adopt(Frame { buffer, data, len, ..Frame::EMPTY }) };
    process.give_pool(buffer).ok().map(|()| frame)
}
