//! All tests of the package as one program: `cargo nextest` runs each test in a process of its own.

mod common;
mod device;
mod evaluation;
mod filters;
mod geometry;
mod gpu;
mod lit;
mod matching;
mod order;
