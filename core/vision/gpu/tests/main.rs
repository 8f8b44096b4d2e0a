//! All tests of the package as one program: `cargo nextest` runs each test in a separate process.

mod block_matching;
mod common;
mod rectify;
mod threads;
mod warp;
