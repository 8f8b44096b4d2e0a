//! The theatre over running graphs, without a screen.
#![allow(dead_code, reason = "each test binary uses a part")]

pub mod golden;
pub mod hand;
mod shared;
pub mod window;

pub use shared::{Folder, PATIENCE, has_plugin};
