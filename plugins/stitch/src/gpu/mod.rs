//! Kernels of the nodes on the GPU.

pub mod warp;
