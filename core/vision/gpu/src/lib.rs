//! Image work on a GPU through Vulkan: the same results as the functions of `panoscope-imaging`, up to rounding.
//!
//! [`Gpu::shared`] finds the device, once in a process. Each kernel keeps its memory on the device and uses images in
//! the host's memory: a frame costs a copy there and a copy back, which pays for images of 1920x1080 and more. No GPU
//! is required: users of a kernel fall back to the function of `panoscope-imaging` if there is no GPU or it fails.

mod block_matching;
mod choice;
mod device;
mod kernel;
mod memory;
mod rectify;
mod warp;

pub use block_matching::GpuBlockMatcher;
pub use choice::{Device, given_up};
pub use device::{CHOICE, Gpu, GpuError};
pub use rectify::{Rectifier, RectifyJob};
pub use warp::Warper;
