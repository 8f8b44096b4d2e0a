//! Typed outputs: buffers of the host, handed to it when the call returns. An output that the node does not make is
//! empty.

use panoscope_base::format::IMAGE_FORMATS;
use std::marker::PhantomData;

use crate::ViewMut;
use crate::abi;
use crate::context::has;
use crate::device::DeviceImage;
use crate::error::{NodeError, Result};
use crate::input::Retained;
use crate::packet::{
    AnyFormat, LabeledDetections, LabeledInstances, Packet, Plain, Plane, PlaneFormat, PointCloud, TableData,
    TextPacket, bytes_of,
};
use crate::port::{PortField, RawCall, nameless};

/// An output port.
pub struct Slot<'f, T> {
    call: RawCall<'f>,
    index: u32,
    packet: PhantomData<T>,
}

/// A packet type that an output port may carry.
pub trait SlotPacket {
    /// Port declaration without name and doc.
    const PORT: abi::Port;
}

impl<P: Plane> SlotPacket for PlaneOf<P> {
    const PORT: abi::Port = nameless(P::PACKET, 0, abi::format_bit(P::FORMAT), 0);
}

/// Lets [`SlotPacket`] be implemented for planes without overlapping the implementation for [`Packet`].
pub struct PlaneOf<P>(PhantomData<P>);

macro_rules! slot_ports {
    ($($ty:ty => $port:expr),* $(,)?) => {$(
        impl<'f> PortField<'f> for Slot<'f, $ty> {
            const PORT: abi::Port = $port;

            fn bind(call: RawCall<'f>, index: usize, _: &'static str) -> Result<Self> {
                Ok(Slot::new(call, index))
            }
        }
    )*};
}
slot_ports! {
    crate::Gray8 => <PlaneOf<crate::Gray8> as SlotPacket>::PORT,
    crate::Bgr8 => <PlaneOf<crate::Bgr8> as SlotPacket>::PORT,
    crate::Rgba8 => <PlaneOf<crate::Rgba8> as SlotPacket>::PORT,
    crate::Gray16 => <PlaneOf<crate::Gray16> as SlotPacket>::PORT,
    crate::GrayF32 => <PlaneOf<crate::GrayF32> as SlotPacket>::PORT,
    crate::Mask => <PlaneOf<crate::Mask> as SlotPacket>::PORT,
    crate::Disparity => <PlaneOf<crate::Disparity> as SlotPacket>::PORT,
    crate::Confidence => <PlaneOf<crate::Confidence> as SlotPacket>::PORT,
    crate::Depth => <PlaneOf<crate::Depth> as SlotPacket>::PORT,
    AnyFormat => nameless("image", 0, IMAGE_FORMATS, 0),
    PointCloud => nameless("cloud", 0, abi::format_bit(abi::FORMAT_CLOUD), 0),
    TextPacket => nameless("text", 0, 0, 0),
    TableData => nameless("table", 0, 0, 0),
    LabeledDetections => nameless("detections", 0, 0, 0),
    LabeledInstances => nameless("instances", 0, 0, 0),
}

impl<'f, T: Packet> PortField<'f> for Slot<'f, T> {
    const PORT: abi::Port = nameless(T::NAME, T::LAYOUT_HASH, 0, 0);

    fn bind(call: RawCall<'f>, index: usize, _: &'static str) -> Result<Self> {
        Ok(Slot::new(call, index))
    }
}

impl<'f, T> Slot<'f, T> {
    fn new(call: RawCall<'f>, index: usize) -> Self {
        Self { call, index: index as u32, packet: PhantomData }
    }

    /// Whether this output has a reader. Without one, the node need not compute it.
    pub fn is_read(&self) -> bool {
        // SAFETY: the host's call is valid for `'f`.
        let read = unsafe { (*self.call.raw()).outputs_read };
        self.index >= 64 || read >> self.index & 1 == 1
    }

    /// Hands on the buffer of an input as this output, without copying it.
    pub fn forward(&mut self, frame: &abi::Frame) -> Result<()> {
        // SAFETY: the host's call is valid for `'f`, and so is its function table.
        let status = unsafe {
            let call = self.call.raw();
            match (*(*call).host).forward {
                Some(forward) => forward((*call).call, self.index, frame),
                None => abi::STATUS_INVALID,
            }
        };
        outcome(status, 0)
    }

    /// Hands on the buffer of an input, then replaces it by a private copy if it is shared.
    fn copy_of(&mut self, frame: &abi::Frame) -> Result<()> {
        self.forward(frame)?;
        // SAFETY: the host's call is valid for `'f`, and so is its function table.
        let status = unsafe {
            let call = self.call.raw();
            match (*(*call).host).make_mut {
                Some(make_mut) => make_mut((*call).call, self.index),
                None => abi::STATUS_INVALID,
            }
        };
        outcome(status, frame.len)?;
        if self.call.output(self.index).data == frame.data {
            // The input is lent for the whole call, so its buffer must not be writable here.
            return Err(NodeError::new("the host returned a writable frame that other nodes read"));
        }
        Ok(())
    }

    /// The pixels of a frame that [`Slot::copy_of`] made.
    fn writable<E: Plain>(&mut self, frame: &abi::Frame, channels: usize) -> Result<ViewMut<'_, E>> {
        let (width, height, size) = (frame.width as usize, frame.height as usize, size_of::<E>());
        let stride = frame.stride_bytes as usize;
        let need = height.saturating_sub(1) * stride + width * channels * size;
        if width == 0
            || height == 0
            || need > frame.len
            || !stride.is_multiple_of(size)
            || !frame.data.addr().is_multiple_of(size)
        {
            return Err(NodeError::new(format!("a {width}x{height} frame cannot be copied to an output")));
        }
        // SAFETY: the host made this buffer for this output alone; size and alignment were checked; `self` stays borrowed.
        let data = unsafe { std::slice::from_raw_parts_mut(frame.data.cast(), need / size) };
        Ok(ViewMut::with_stride(data, width, height, channels, stride / size))
    }

    /// Hands on the buffer of another output of this call as this output, without copying it.
    pub fn forward_from(&mut self, other: &Slot<'_, T>) -> Result<()> {
        let frame = other.call.output(other.index);
        self.forward(&frame)
    }

    fn allocate(&mut self, format: u32, width: usize, height: usize, stride: usize, len: usize) -> Result<abi::Frame> {
        let (Ok(width), Ok(height), Ok(stride)) = (u32::try_from(width), u32::try_from(height), u32::try_from(stride))
        else {
            return Err(NodeError::new(format!("an output of {width}x{height} is too large")));
        };
        // SAFETY: the host's call is valid for `'f`, and so is its function table.
        let status = unsafe {
            let call = self.call.raw();
            match (*(*call).host).alloc {
                Some(alloc) => alloc((*call).call, self.index, format, width, height, stride, len),
                None => abi::STATUS_INVALID,
            }
        };
        outcome(status, len)?;
        Ok(self.call.output(self.index))
    }

    /// A writable buffer of `len` bytes.
    pub(crate) fn allocate_bytes(&mut self, len: usize) -> Result<&mut [u8]> {
        let frame = self.allocate(abi::FORMAT_BYTES, 0, 0, 0, len)?;
        if len == 0 {
            return Ok(&mut []);
        }
        // SAFETY: the host lends `len` fresh bytes to this call alone; `self` stays borrowed.
        Ok(unsafe { std::slice::from_raw_parts_mut(frame.data, len) })
    }

    fn allocate_on_device(&mut self, format: u32, width: usize, height: usize, stride: usize) -> Result<DeviceImage> {
        let size = [width, height, stride].map(u32::try_from);
        let ([Ok(columns), Ok(rows), Ok(stride_bytes)], Some(len)) = (size, stride.checked_mul(height)) else {
            return Err(NodeError::new(format!("an output of {width}x{height} is too large")));
        };
        let mut buffer = 0;
        // SAFETY: the host's call is valid for `'f`, and so is its function table.
        let status = unsafe {
            let call = self.call.raw();
            let host = &*(*call).host;
            let end = std::mem::offset_of!(abi::Host, alloc_on_device) + size_of::<usize>();
            match host.alloc_on_device.filter(|_| has(host, end)) {
                Some(alloc) => {
                    alloc((*call).call, self.index, format, columns, rows, stride_bytes, len, &raw mut buffer)
                }
                None => abi::STATUS_INVALID,
            }
        };
        outcome(status, len)?;
        Ok(DeviceImage { buffer, width, height, stride_bytes: stride })
    }

    fn allocate_plane<E: Plain>(
        &mut self,
        format: u32,
        channels: usize,
        width: usize,
        height: usize,
    ) -> Result<ViewMut<'_, E>> {
        if width == 0 || height == 0 {
            return Err(NodeError::new(format!("an output of {width}x{height} has no pixels")));
        }
        let row = width * channels;
        let Some(count) = row.checked_mul(height).filter(|n| n.checked_mul(size_of::<E>()).is_some()) else {
            return Err(NodeError::new(format!("an output of {width}x{height} is too large")));
        };
        let frame = self.allocate(format, width, height, row * size_of::<E>(), count * size_of::<E>())?;
        // SAFETY: the host lends fresh, initialised, 64-byte-aligned memory to this call alone; `self` stays borrowed.
        let data = unsafe { std::slice::from_raw_parts_mut(frame.data.cast(), count) };
        Ok(ViewMut::new(data, width, height, channels))
    }
}

#[inline]
fn outcome(status: abi::Status, len: usize) -> Result<()> {
    if status == abi::STATUS_OK { Ok(()) } else { Err(refusal(status, len)) }
}

#[cold]
fn refusal(status: abi::Status, len: usize) -> NodeError {
    match status {
        abi::STATUS_EXHAUSTED => NodeError::with_status(
            format!("the host's frame memory is exhausted ({len} bytes requested)"),
            abi::STATUS_EXHAUSTED,
        ),
        other => NodeError::new(format!("the host refused an output ({other})")),
    }
}

impl<P: Plane> Slot<'_, P> {
    /// Allocates the output: `width` x `height` pixels, rows without padding, contents unspecified.
    pub fn alloc(&mut self, width: usize, height: usize) -> Result<ViewMut<'_, P::Element>> {
        self.allocate_plane(P::FORMAT, P::CHANNELS, width, height)
    }

    /// Makes the output on the GPU: `width` x `height` pixels, in rows with room for whole groups of four, so that a
    /// thread can write whole words. The node writes into the returned buffer; readers on the processor get a copy when
    /// they look.
    pub fn alloc_on_device(&mut self, width: usize, height: usize) -> Result<DeviceImage> {
        let stride = DeviceImage::stride_bytes(width, P::CHANNELS * size_of::<P::Element>());
        self.allocate_on_device(P::FORMAT, width, height, stride)
    }

    /// Hands on a retained frame as an output of this tick, so that its age counts from this tick.
    pub fn forward_anew(&mut self, kept: &Retained<P>) -> Result<()> {
        // SAFETY: the host's call is valid for `'f`.
        let tick = unsafe { (*self.call.raw()).tick };
        self.forward(&abi::Frame { tick, ..*kept.frame() })
    }

    /// Retains the buffer of an output that was made, beyond this call; `None` without one. It can no longer be
    /// written.
    pub fn retain(&self) -> Option<Retained<P>> {
        let frame = self.call.output(self.index);
        (!frame.is_empty()).then(|| Retained::of(frame))
    }

    /// Makes the output equal to `image` and writable, for drawing. The host copies the frame, and counts the copy, if
    /// it is shared.
    pub fn alloc_copy(&mut self, image: &crate::Image<'_, P>) -> Result<ViewMut<'_, P::Element>> {
        self.copy_of(image.frame())?;
        let frame = self.call.output(self.index);
        self.writable(&frame, P::CHANNELS)
    }
}

impl Slot<'_, AnyFormat> {
    /// As [`Slot::alloc_copy`] for a format known only when the image arrives.
    pub fn alloc_copy_as<P: PlaneFormat>(&mut self, image: &crate::Image<'_, P>) -> Result<ViewMut<'_, P::Element>> {
        self.copy_of(image.frame())?;
        let frame = self.call.output(self.index);
        self.writable(&frame, P::CHANNELS)
    }

    /// Allocates the output with format `P`: `width` x `height` pixels, rows without padding, contents unspecified.
    pub fn alloc_as<P: PlaneFormat>(&mut self, width: usize, height: usize) -> Result<ViewMut<'_, P::Element>> {
        self.allocate_plane(P::FORMAT, P::CHANNELS, width, height)
    }
}

impl<T: Packet> Slot<'_, T> {
    /// Copies `value` into the output.
    pub fn set(&mut self, value: T) -> Result<()> {
        let bytes = self.allocate_bytes(size_of::<T>())?;
        bytes.copy_from_slice(bytes_of(std::slice::from_ref(&value)));
        Ok(())
    }
}

impl Slot<'_, abi::Scalar> {
    /// Makes the output: a number with its name and unit. Longer names and units are cut off, at 32 and 16 bytes.
    pub fn set_scalar(&mut self, name: &str, value: f64, unit: &str) -> Result<()> {
        fn padded<const N: usize>(text: &str) -> [u8; N] {
            let mut out = [0; N];
            let end = text.floor_char_boundary(N);
            out[..end].copy_from_slice(&text.as_bytes()[..end]);
            out
        }
        self.set(abi::Scalar { value, name: padded(name), unit: padded(unit) })
    }
}

impl Slot<'_, TextPacket> {
    /// Copies `text` into the output.
    pub fn set_text(&mut self, text: &str) -> Result<()> {
        self.allocate_bytes(text.len())?.copy_from_slice(text.as_bytes());
        Ok(())
    }
}

// SAFETY: repr(C), three floats and four bytes without padding.
unsafe impl Plain for abi::CloudPoint {}

impl Slot<'_, PointCloud> {
    /// Allocates the output: `width` x `height` points, contents unspecified.
    pub fn alloc_cloud(&mut self, width: usize, height: usize) -> Result<ViewMut<'_, abi::CloudPoint>> {
        self.allocate_plane(abi::FORMAT_CLOUD, 1, width, height)
    }

    /// Makes the output on the GPU: `width` x `height` points of 16 bytes, rows without padding; see
    /// [`Slot::alloc_on_device`].
    pub fn alloc_cloud_on_device(&mut self, width: usize, height: usize) -> Result<DeviceImage> {
        self.allocate_on_device(abi::FORMAT_CLOUD, width, height, width * size_of::<abi::CloudPoint>())
    }
}
