//! Work of the nodes on the GPU.

pub mod below;
pub mod colors;
pub mod draw;
pub mod fit;
pub mod surface;
