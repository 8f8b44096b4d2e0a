//! Kernels on a GPU that Mesa's Vulkan driver plays on the processor.

mod block_matching;
mod pair;
mod rectify;
mod scale;
#[path = "../../../../tests/support/gpu.rs"]
pub mod support;
mod threads;
mod wls;
