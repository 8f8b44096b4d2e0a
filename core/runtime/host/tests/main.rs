//! All tests of the package as one program: `cargo nextest` runs each test in a separate process.

mod audit_log;
#[path = "../../engine/tests/common/mod.rs"]
mod common;
mod loading;
mod seal;
