//! All tests of the package as one program: `cargo nextest` runs each test in a process of its own.

mod audit_log;
#[path = "../../engine/tests/common/mod.rs"]
mod common;
mod loading;
mod seal;
