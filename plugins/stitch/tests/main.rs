//! All tests of the package as one program: `cargo nextest` runs each test in its own process.

mod composite;
mod composite_lost;
mod composite_mesh;
mod device;
mod errors;
mod gpu_warp;
mod instruments;
mod mosaic;
#[path = "../../../tests/support/gpu.rs"]
mod support;
