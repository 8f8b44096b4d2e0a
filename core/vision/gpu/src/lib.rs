//! The GPU of a process through Vulkan, as the contract's table of functions ([`panoscope_abi::Device`]).
//!
//! [`table`] finds the device, once in a process. A program offers it to its nodes; without it, or without a GPU, nodes
//! compute on the processor.

mod device;
mod items;
mod staging;
mod table;

pub use device::{CHOICE, Gpu, GpuError};
pub use table::table;
