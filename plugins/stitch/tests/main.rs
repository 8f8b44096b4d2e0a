//! All tests of the package as one program: `cargo nextest` runs each test in its own process.

mod composite;
mod composite_lost;
mod composite_mesh;
mod device;
mod errors;
mod instruments;
mod mosaic;
