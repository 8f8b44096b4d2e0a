//! Encoders of images, arrays, clouds and the fields of packets. Sinks write single outputs with them, exports whole
//! recordings.
//!
//! Everything here writes to a stream or a text; callers choose the file names.

pub mod array;
pub mod fields;
pub mod json;
mod pixels;
pub mod ply;
pub mod still;

pub use pixels::Pixels;
