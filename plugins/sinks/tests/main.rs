//! All tests of the package as one program: `cargo nextest` runs each test in its own process.

#[path = "../../../tests/support/chromium.rs"]
mod chromium;
mod common;
mod disk;
mod files;
mod stream;
mod video;
mod webrtc;
