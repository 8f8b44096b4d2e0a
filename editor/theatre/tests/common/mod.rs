//! Helpers for tests of the theatre.
#![allow(dead_code, reason = "each test binary uses a part")]

pub mod input;
pub mod program;
mod shared;
pub mod window;

pub use shared::{Folder, PATIENCE, has_plugin};
