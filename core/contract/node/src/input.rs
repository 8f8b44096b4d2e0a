//! Typed inputs, borrowed from the host for the length of the call.

use std::marker::PhantomData;
use std::ops::Deref;

use panoscope_base::format;

use crate::View;
use crate::abi;
use crate::device::DeviceImage;
use crate::error::{NodeError, Result};
use crate::host;
use crate::packet::{Bgr8, Gray8, Packet, Plain, Plane};
use crate::port::{PortField, RawCall, nameless};

/// A type that wraps one frame.
pub trait FromFrame<'f>: Sized {
    /// Port declaration without name and doc.
    const PORT: abi::Port;

    /// Checks the frame against the type and wraps it.
    fn from_frame(frame: &'f abi::Frame) -> Result<Self>;
}

impl<'f, T: FromFrame<'f>> PortField<'f> for T {
    const PORT: abi::Port = T::PORT;

    #[inline]
    fn bind(call: RawCall<'f>, index: usize, name: &'static str) -> Result<Self> {
        match call.input(index).first() {
            Some(frame) if !frame.is_empty() => in_port(T::from_frame(frame), name),
            _ => Err(missing(name)),
        }
    }
}

impl<'f, T: FromFrame<'f>> PortField<'f> for Option<T> {
    const PORT: abi::Port = abi::Port { flags: abi::PORT_OPTIONAL, ..T::PORT };

    fn bind(call: RawCall<'f>, index: usize, name: &'static str) -> Result<Self> {
        match call.input(index).first() {
            Some(frame) if !frame.is_empty() => in_port(T::from_frame(frame), name).map(Some),
            _ => Ok(None),
        }
    }
}

#[inline]
fn in_port<T>(result: Result<T>, name: &str) -> Result<T> {
    #[cold]
    fn named(error: &NodeError, name: &str) -> NodeError {
        NodeError::new(format!("input `{name}`: {error}"))
    }
    result.map_err(|error| named(&error, name))
}

#[cold]
fn missing(name: &str) -> NodeError {
    NodeError::new(format!("input `{name}` is required but empty"))
}

/// An input with any number of connections, in the order of the graph file.
#[derive(Clone, Copy)]
pub struct List<'f, T> {
    frames: &'f [abi::Frame],
    item: PhantomData<T>,
}

impl<'f, T: FromFrame<'f>> PortField<'f> for List<'f, T> {
    const PORT: abi::Port = abi::Port { flags: abi::PORT_LIST, ..T::PORT };

    fn bind(call: RawCall<'f>, index: usize, name: &'static str) -> Result<Self> {
        let frames = call.input(index);
        for frame in frames {
            if !frame.is_empty() {
                in_port(T::from_frame(frame), name)?;
            }
        }
        Ok(Self { frames, item: PhantomData })
    }
}

/// A list that need not be connected.
impl<'f, T: FromFrame<'f>> PortField<'f> for Option<List<'f, T>> {
    const PORT: abi::Port = abi::Port { flags: abi::PORT_LIST | abi::PORT_OPTIONAL, ..T::PORT };

    fn bind(call: RawCall<'f>, index: usize, name: &'static str) -> Result<Self> {
        let list = <List<'f, T> as PortField<'f>>::bind(call, index, name)?;
        Ok(if list.is_empty() { None } else { Some(list) })
    }
}

impl<'f, T: FromFrame<'f>> List<'f, T> {
    /// Number of connections, with those that are empty for this tick.
    pub fn len(&self) -> usize {
        self.frames.len()
    }

    /// Whether the input has no connection.
    pub fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }

    /// Entry `index`; `None` when it is empty for this tick.
    pub fn get(&self, index: usize) -> Option<T> {
        let frame = self.frames.get(index)?;
        if frame.is_empty() { None } else { T::from_frame(frame).ok() }
    }

    /// All entries in order; empty ones are `None`.
    pub fn iter(&self) -> impl Iterator<Item = Option<T>> + use<'f, T> {
        let list = Self { frames: self.frames, item: PhantomData };
        (0..list.frames.len()).map(move |index| list.get(index))
    }
}

/// A plane of pixels: `Image<'f, Bgr8>`, `Image<'f, Disparity>`.
pub struct Image<'f, P> {
    frame: &'f abi::Frame,
    plane: PhantomData<P>,
}

impl<P> Clone for Image<'_, P> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<P> Copy for Image<'_, P> {}

impl<P> Image<'_, P> {
    pub(crate) fn raw_frame(&self) -> &abi::Frame {
        self.frame
    }
}

/// Bytes from the first pixel of a frame to the end of the last. Checks that they lie inside the buffer and are aligned
/// to elements of `size` bytes, a power of two.
#[inline]
fn checked_len(frame: &abi::Frame, channels: usize, size: usize) -> Result<usize> {
    let (width, height, stride) = (frame.width as usize, frame.height as usize, frame.stride_bytes as usize);
    let aligned = (stride | frame.data.addr()) & (size - 1) == 0;
    match format::image_bytes(width, height, stride, channels * size) {
        Some(need) if aligned && need <= frame.len => Ok(need),
        _ => Err(misfit(frame)),
    }
}

#[cold]
fn misfit(frame: &abi::Frame) -> NodeError {
    let abi::Frame { width, height, stride_bytes, len, .. } = *frame;
    NodeError::new(format!("a {width}x{height} frame with {stride_bytes} bytes per row does not match its {len} bytes"))
}

/// The elements of a frame and its stride in elements. Checks that they lie inside the buffer.
fn elements<T: Plain>(frame: &abi::Frame, channels: usize) -> Result<(&[T], usize)> {
    const { assert!(size_of::<T>().is_power_of_two() && align_of::<T>() <= size_of::<T>()) }
    let size = size_of::<T>();
    let need = checked_len(frame, channels, size)?;
    let stride = frame.stride_bytes as usize / size;
    if need == 0 {
        return Ok((&[], stride));
    }
    // SAFETY: the host lends `len` bytes at `data` for the call; `checked_len` checked size and alignment.
    Ok((unsafe { std::slice::from_raw_parts(frame.data.cast(), need / size) }, stride))
}

impl<'f, P: Plane> FromFrame<'f> for Image<'f, P> {
    const PORT: abi::Port = nameless(P::PACKET, 0, abi::format_bit(P::FORMAT), 0);

    fn from_frame(frame: &'f abi::Frame) -> Result<Self> {
        if frame.format != P::FORMAT {
            return Err(NodeError::new(format!("expected format {}, got {}", P::FORMAT, frame.format)));
        }
        elements::<P::Element>(frame, P::CHANNELS)?;
        Ok(Self { frame, plane: PhantomData })
    }
}

impl<'f, P: Plane> Image<'f, P> {
    /// Columns in px.
    pub fn width(&self) -> usize {
        self.frame.width as usize
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.frame.height as usize
    }

    /// The pixels.
    pub fn view(&self) -> View<'f, P::Element> {
        host::fetch(self.frame);
        let (data, stride) = elements(self.frame, P::CHANNELS).unwrap_or((&[], 0));
        View::with_stride(data, self.width(), self.height(), P::CHANNELS, stride)
    }

    /// Whether the image was made on the GPU, so that [`Self::view`] copies it to the host's memory if nobody read it
    /// there before.
    pub fn is_from_device(&self) -> bool {
        self.frame.buffer.home == abi::HOME_DEVICE
    }

    /// The buffer on the GPU with these pixels: copied there if they are not there yet.
    pub fn on_device(&self) -> Result<DeviceImage> {
        DeviceImage::of(self.frame)
    }

    /// Capture time of the frame, in ns of media time.
    pub fn capture_ns(&self) -> i64 {
        self.frame.tick.capture_ns
    }

    /// The frame as the host describes it.
    pub fn frame(&self) -> &'f abi::Frame {
        self.frame
    }

    /// Retains the buffer beyond this call; the result releases it when dropped.
    pub fn retain(&self) -> Retained<P> {
        Retained::of(*self.frame)
    }
}

/// An image whose format is known only when it arrives.
#[derive(Clone, Copy)]
pub struct AnyImage<'f> {
    frame: &'f abi::Frame,
}

impl<'f> FromFrame<'f> for AnyImage<'f> {
    const PORT: abi::Port = nameless("image", 0, format::IMAGE_FORMATS, 0);

    #[inline]
    fn from_frame(frame: &'f abi::Frame) -> Result<Self> {
        match format::of(frame.format) {
            Some(format) if format.is_image => checked_len(frame, format.channels, format.element_bytes)?,
            _ => return Err(no_image(frame.format)),
        };
        Ok(Self { frame })
    }
}

#[cold]
fn no_image(format: u32) -> NodeError {
    NodeError::new(format!("format {format} is not an image format"))
}

impl<'f> AnyImage<'f> {
    pub(crate) fn raw_frame(&self) -> &abi::Frame {
        self.frame
    }

    /// The image as a plane of format `P`; `None` when it has another format.
    pub fn as_plane<P: crate::PlaneFormat>(&self) -> Option<Image<'f, P>> {
        Image::from_frame(self.frame).ok()
    }

    /// One of the ABI's `FORMAT_` constants.
    pub fn format(&self) -> u32 {
        self.frame.format
    }

    /// Columns in px.
    pub fn width(&self) -> usize {
        self.frame.width as usize
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.frame.height as usize
    }

    /// The bytes of each row, without padding.
    pub fn rows(&self) -> impl Iterator<Item = &'f [u8]> + use<'f> {
        let frame = self.frame;
        let (all, row) = (bytes(frame), self.width() * format::pixel_bytes(frame.format));
        (0..self.height()).map(move |y| &all[y * frame.stride_bytes as usize..][..row])
    }

    /// The frame as the host describes it.
    pub fn frame(&self) -> &'f abi::Frame {
        self.frame
    }
}

/// An image in colour (BGR) or gray, as it arrives, for nodes that need gray values of few pixels or in few ticks. For
/// an `Image<'f, Gray8>` the host converts the whole image in every tick.
#[derive(Clone, Copy)]
pub struct Picture<'f> {
    frame: &'f abi::Frame,
    channels: usize,
}

impl<'f> FromFrame<'f> for Picture<'f> {
    const PORT: abi::Port = nameless("image", 0, abi::format_bit(Bgr8::FORMAT) | abi::format_bit(Gray8::FORMAT), 0);

    fn from_frame(frame: &'f abi::Frame) -> Result<Self> {
        let channels = match frame.format {
            Bgr8::FORMAT => Bgr8::CHANNELS,
            Gray8::FORMAT => Gray8::CHANNELS,
            other => {
                return Err(NodeError::new(format!("expected a colour or gray image, got format {other}")));
            }
        };
        elements::<u8>(frame, channels)?;
        Ok(Self { frame, channels })
    }
}

impl<'f> Picture<'f> {
    pub(crate) fn raw_frame(&self) -> &abi::Frame {
        self.frame
    }

    /// Columns in px.
    pub fn width(&self) -> usize {
        self.frame.width as usize
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.frame.height as usize
    }

    /// The pixels: 3 channels, or 1.
    pub fn view(&self) -> View<'f, u8> {
        host::fetch(self.frame);
        let (data, stride) = elements(self.frame, self.channels).unwrap_or((&[], 0));
        View::with_stride(data, self.width(), self.height(), self.channels, stride)
    }
}

/// A retained frame: valid beyond the call that lent it, released when dropped.
pub struct Retained<P> {
    frame: abi::Frame,
    plane: PhantomData<P>,
}

impl<P: Plane> Retained<P> {
    /// Retains the buffer of a frame that the running call holds.
    pub(crate) fn of(frame: abi::Frame) -> Self {
        host::retain(frame.buffer);
        Self { frame, plane: PhantomData }
    }

    /// The pixels.
    pub fn view(&self) -> View<'_, P::Element> {
        host::fetch(&self.frame);
        let image: Image<'_, P> = Image { frame: &self.frame, plane: PhantomData };
        let (data, stride) = elements(image.frame, P::CHANNELS).unwrap_or((&[], 0));
        View::with_stride(data, image.width(), image.height(), P::CHANNELS, stride)
    }

    /// The frame as the host describes it.
    pub fn frame(&self) -> &abi::Frame {
        &self.frame
    }
}

impl<P> Drop for Retained<P> {
    fn drop(&mut self) {
        host::release(self.frame.buffer);
    }
}

/// Plain data: a homography, a calibration, a plugin's own packet.
#[derive(Clone, Copy)]
pub struct Value<'f, T> {
    value: &'f T,
    frame: &'f abi::Frame,
}

impl<T> Value<'_, T> {
    pub(crate) fn raw_frame(&self) -> &abi::Frame {
        self.frame
    }

    /// The tick of the frame that holds this value.
    pub fn tick(&self) -> abi::Tick {
        self.frame.tick
    }
}

impl<'f, T: Packet> FromFrame<'f> for Value<'f, T> {
    const PORT: abi::Port = nameless(T::NAME, T::LAYOUT_HASH, 0, 0);

    fn from_frame(frame: &'f abi::Frame) -> Result<Self> {
        if frame.len < size_of::<T>() || !frame.data.addr().is_multiple_of(align_of::<T>()) {
            return Err(NodeError::new(format!("`{}` is {} bytes, {} arrived", T::NAME, size_of::<T>(), frame.len)));
        }
        host::fetch(frame);
        // SAFETY: size and alignment are checked above; `Packet` guarantees that every bit pattern is valid.
        Ok(Self { value: unsafe { &*frame.data.cast::<T>() }, frame })
    }
}

impl<T> Deref for Value<'_, T> {
    type Target = T;

    fn deref(&self) -> &T {
        self.value
    }
}

/// A coloured point cloud of `width` x `height` points.
#[derive(Clone, Copy)]
pub struct Cloud<'f> {
    frame: &'f abi::Frame,
}

impl<'f> FromFrame<'f> for Cloud<'f> {
    const PORT: abi::Port = nameless("cloud", 0, abi::format_bit(abi::FORMAT_CLOUD), 0);

    fn from_frame(frame: &'f abi::Frame) -> Result<Self> {
        let points = frame.width as usize * frame.height as usize;
        let aligned = frame.data.addr().is_multiple_of(align_of::<abi::CloudPoint>());
        if frame.format != abi::FORMAT_CLOUD || frame.len / size_of::<abi::CloudPoint>() < points || !aligned {
            return Err(NodeError::new(format!("expected a cloud of {points} points, got {} bytes", frame.len)));
        }
        Ok(Self { frame })
    }
}

impl<'f> Cloud<'f> {
    /// Points per row.
    pub fn width(&self) -> usize {
        self.frame.width as usize
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.frame.height as usize
    }

    pub(crate) fn raw_frame(&self) -> &abi::Frame {
        self.frame
    }

    /// The frame as the host describes it.
    pub fn frame(&self) -> &'f abi::Frame {
        self.frame
    }

    /// Whether the cloud was made on the GPU, see [`Image::is_from_device`].
    pub fn is_from_device(&self) -> bool {
        self.frame.buffer.home == abi::HOME_DEVICE
    }

    /// The buffer on the GPU with these points, rows without padding: copied there if they are not there yet.
    pub fn on_device(&self) -> Result<DeviceImage> {
        DeviceImage::of(self.frame)
    }

    /// The tick of the frame that holds this cloud.
    pub fn tick(&self) -> abi::Tick {
        self.frame.tick
    }

    /// The points, row after row.
    pub fn points(&self) -> &'f [abi::CloudPoint] {
        let count = self.width() * self.height();
        if count == 0 {
            return &[];
        }
        host::fetch(self.frame);
        // SAFETY: `from_frame` checked size and alignment, and the host lends the bytes for `'f`.
        unsafe { std::slice::from_raw_parts(self.frame.data.cast(), count) }
    }
}

/// One or more lines of UTF-8 text.
#[derive(Clone, Copy)]
pub struct Text<'f> {
    text: &'f str,
}

impl<'f> FromFrame<'f> for Text<'f> {
    const PORT: abi::Port = nameless("text", 0, 0, 0);

    fn from_frame(frame: &'f abi::Frame) -> Result<Self> {
        Ok(Self { text: std::str::from_utf8(bytes(frame))? })
    }
}

impl<'f> Text<'f> {
    /// The text, valid as long as the frame is lent.
    pub fn as_str(&self) -> &'f str {
        self.text
    }
}

impl Deref for Text<'_> {
    type Target = str;

    fn deref(&self) -> &str {
        self.text
    }
}

/// All bytes of a frame.
pub(crate) fn bytes(frame: &abi::Frame) -> &[u8] {
    if frame.len == 0 {
        return &[];
    }
    host::fetch(frame);
    // SAFETY: the host lends `len` bytes at `data` for the length of the call.
    unsafe { std::slice::from_raw_parts(frame.data, frame.len) }
}
