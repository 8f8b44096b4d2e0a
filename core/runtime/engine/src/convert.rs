//! Conversions that the host does for readers, once per output and tick.

use panoscope_abi::{self as abi, Frame};
use panoscope_base::format::{image_bytes, pixel_bytes};
use panoscope_base::gray::bgr_to_gray;
use panoscope_base::{View, ViewMut};

use crate::memory::{FrameRef, memory};

/// Whether a reader of gray8 needs a copy of this frame.
pub(crate) fn wants(frame: &Frame) -> bool {
    !frame.is_empty() && frame.format == abi::FORMAT_BGR8
}

/// The frame as gray8; `None` when frame memory is exhausted.
pub(crate) fn to_gray8(source: &FrameRef) -> Option<FrameRef> {
    let frame = source.frame();
    let (width, height, stride) = (frame.width as usize, frame.height as usize, frame.stride_bytes as usize);
    if image_bytes(width, height, stride, pixel_bytes(abi::FORMAT_BGR8)).is_none_or(|need| need > frame.len) {
        return Some(FrameRef::empty(frame.tick));
    }
    if frame.buffer.home != abi::HOME_HOST
        && let Some(gray) = to_gray8_on_device(frame)
    {
        return Some(gray);
    }
    let (buffer, data) = memory().allocate(width * height).ok()?;
    // SAFETY: a new buffer of at least `width * height` initialised bytes that only this function has.
    let out = unsafe { std::slice::from_raw_parts_mut(data, width * height) };
    if width * height > 0 {
        let from = View::with_stride(source.bytes(), width, height, 3, stride);
        bgr_to_gray(&from, &mut ViewMut::new(out, width, height, 1));
    }
    let len = width * height;
    let gray = Frame { buffer, data, len, format: abi::FORMAT_GRAY8, stride_bytes: width as u32, ..*frame };
    // SAFETY: `allocate` handed out the only reference to the new buffer.
    Some(unsafe { FrameRef::adopt(gray) })
}

/// The same on the GPU, where the frame is; `None` when frame memory is exhausted or the GPU fails.
fn to_gray8_on_device(frame: &Frame) -> Option<FrameRef> {
    let stride = (frame.width as usize).next_multiple_of(4);
    let len = stride * frame.height as usize;
    let (mut buffer, data) = memory().allocate(len).ok()?;
    let is_made = memory().gray_on_device(frame, buffer, stride);
    buffer.home = abi::HOME_DEVICE;
    let gray = Frame { buffer, data, len, format: abi::FORMAT_GRAY8, stride_bytes: stride as u32, ..*frame };
    // SAFETY: `allocate` handed out the only reference to the new buffer.
    let gray = unsafe { FrameRef::adopt(gray) };
    is_made.then_some(gray)
}
