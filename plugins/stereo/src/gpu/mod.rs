//! Kernels of the nodes on the GPU.

pub mod block_matching;
pub mod pair;
pub mod rectify;
pub mod reproject;
pub mod scale;
pub mod wls;
pub mod wls_filter;
