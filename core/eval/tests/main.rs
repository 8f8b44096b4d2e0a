//! All tests of the package as one program: `cargo nextest` runs each test in a separate process.

#[path = "../../runtime/engine/tests/common/mod.rs"]
mod common;
mod detect_folds;
mod library;
mod sweep;
