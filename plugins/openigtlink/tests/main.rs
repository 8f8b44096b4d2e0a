//! All tests of the package as one program: `cargo nextest` runs each test in its own process.

mod common;
mod library;
mod own;
mod pyigtl;
