//! Packet types: planes of pixels, plain data, point clouds, texts.

use crate::abi;

/// Plain data: no padding, no pointer, every bit pattern valid.
///
/// # Safety
/// The type is `repr(C)` or a primitive, has no padding and no invalid bit pattern.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is not plain data",
    label = "not plain data",
    note = "packets hold numbers, arrays of numbers and structs with `#[derive(Packet)]`: no `bool`, reference, `String` or `Vec`"
)]
pub unsafe trait Plain: Copy + Send + Sync + 'static {}

macro_rules! plain {
    ($($ty:ty),*) => {$(
        // SAFETY: a primitive number has no padding, and every bit pattern is valid.
        unsafe impl Plain for $ty {}
    )*};
}
plain!(u8, u16, u32, u64, i8, i16, i32, i64, f32, f64);
// SAFETY: an array of plain data has no padding of its own.
unsafe impl<T: Plain, const N: usize> Plain for [T; N] {}

/// A packet of plain data with its own name.
pub trait Packet: Plain {
    /// Name in graph files.
    const NAME: &'static str;
    /// Hash of the layout: ports with different hashes cannot be connected.
    const LAYOUT_HASH: u64;
}

macro_rules! packet {
    ($($ty:ident = $name:literal: $size:literal),* $(,)?) => {$(
        const _: () = assert!(size_of::<abi::$ty>() == $size, "the contract fixes this size");
        // SAFETY: repr(C) structs of the contract, laid out without padding (size asserted).
        unsafe impl Plain for abi::$ty {}
        impl Packet for abi::$ty {
            const NAME: &'static str = $name;
            const LAYOUT_HASH: u64 = abi::fnv1a(abi::FNV_START, concat!($name, ":", stringify!($size)).as_bytes());
        }
    )*};
}
packet! {
    Homography = "homography": 88,
    Roi = "roi": 16,
    Calibration = "calibration": 760,
    Tip = "tip": 64,
    Pose = "pose": 88,
    Joints = "joints": 136,
    Scalar = "scalar": 56,
}

/// A name of at most 15 bytes as the contract stores it; longer ones are cut.
pub fn name16(text: &str) -> [u8; 16] {
    padded(text)
}

/// A name of at most 31 bytes as the contract stores it; longer ones are cut.
pub fn name32(text: &str) -> [u8; 32] {
    padded(text)
}

fn padded<const N: usize>(text: &str) -> [u8; N] {
    let mut out = [0; N];
    let mut len = text.len().min(N - 1);
    while !text.is_char_boundary(len) {
        len -= 1;
    }
    out[..len].copy_from_slice(&text.as_bytes()[..len]);
    out
}

/// A 2D array of pixels with a fixed element type.
pub trait Plane: 'static {
    /// One channel of one pixel.
    type Element: Plain;
    /// Elements per pixel.
    const CHANNELS: usize;
    /// Packet type in graph files.
    const PACKET: &'static str;
    /// The contract's format.
    const FORMAT: u32;
}

/// A pixel format of the packet type `image`.
pub trait PlaneFormat: Plane {}

macro_rules! plane {
    ($($(#[$doc:meta])* $name:ident: $packet:literal, $element:ty, $channels:literal, $format:ident;)*) => {$(
        $(#[$doc])*
        #[derive(Clone, Copy, Debug)]
        pub enum $name {}
        impl Plane for $name {
            type Element = $element;
            const CHANNELS: usize = $channels;
            const PACKET: &'static str = $packet;
            const FORMAT: u32 = abi::$format;
        }
    )*};
}
plane! {
    /// `image` with one byte per pixel. As an input it accepts `Bgr8` too: the host converts once for all readers.
    Gray8: "image", u8, 1, FORMAT_GRAY8;
    /// `image` with blue, green, red bytes.
    Bgr8: "image", u8, 3, FORMAT_BGR8;
    /// `image` with red, green, blue, alpha bytes.
    Rgba8: "image", u8, 4, FORMAT_RGBA8;
    /// `image` with one 16-bit number per pixel.
    Gray16: "image", u16, 1, FORMAT_GRAY16;
    /// `image` with one float per pixel.
    GrayF32: "image", f32, 1, FORMAT_F32;
    /// `mask`: 0 or 255.
    Mask: "mask", u8, 1, FORMAT_GRAY8;
    /// `disparity`: full-resolution px of the left rectified view, positive, NaN = unmatched.
    Disparity: "disparity", f32, 1, FORMAT_F32;
    /// `confidence`: 0 (unreliable) to 1.
    Confidence: "confidence", f32, 1, FORMAT_F32;
    /// `depth`: mm along the left rectified camera's axis, NaN = unknown.
    Depth: "depth", f32, 1, FORMAT_F32;
}
impl PlaneFormat for Gray8 {}
impl PlaneFormat for Bgr8 {}
impl PlaneFormat for Rgba8 {}
impl PlaneFormat for Gray16 {}
impl PlaneFormat for GrayF32 {}

/// Marks an output that makes an `image` of a format chosen per tick.
#[derive(Clone, Copy, Debug)]
pub enum AnyFormat {}
/// Marks an output of type `cloud`.
#[derive(Clone, Copy, Debug)]
pub enum PointCloud {}
/// Marks an output of type `text`.
#[derive(Clone, Copy, Debug)]
pub enum TextPacket {}
/// Marks an output of type `table`.
#[derive(Clone, Copy, Debug)]
pub enum TableData {}
/// Marks an output of type `detections`.
#[derive(Clone, Copy, Debug)]
pub enum LabeledDetections {}
/// Marks an output of type `instances`.
#[derive(Clone, Copy, Debug)]
pub enum LabeledInstances {}

/// The bytes of plain data.
pub(crate) fn bytes_of<T: Plain>(items: &[T]) -> &[u8] {
    // SAFETY: plain data has no padding, so every byte is initialised.
    unsafe { std::slice::from_raw_parts(items.as_ptr().cast(), size_of_val(items)) }
}

/// The bytes of plain data, for writing.
pub(crate) fn bytes_of_mut<T: Plain>(items: &mut [T]) -> &mut [u8] {
    // SAFETY: plain data has no padding, and every bit pattern is valid.
    unsafe { std::slice::from_raw_parts_mut(items.as_mut_ptr().cast(), size_of_val(items)) }
}

/// Size of a field, which must be plain data; called by the derive.
pub const fn plain_size<T: Plain>() -> usize {
    size_of::<T>()
}

/// Sum of the sizes of a packet's fields; called by the derive.
pub const fn sum(sizes: &[usize]) -> usize {
    let (mut all, mut i) = (0, 0);
    while i < sizes.len() {
        all += sizes[i];
        i += 1;
    }
    all
}
