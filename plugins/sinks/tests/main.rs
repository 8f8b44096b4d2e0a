//! All tests of the package as one program: `cargo nextest` runs each test in a process of its own.

#[path = "../../../tests/support/chromium.rs"]
mod chromium;
mod common;
mod disk;
mod files;
mod stream;
mod video;
mod webrtc;
