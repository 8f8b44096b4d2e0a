//! GStreamer for the plugins that read and write video: initialization, elements and their packages, errors.
//!
//! `capture` and `sinks` are separate libraries that share one GStreamer in a process. What both need stands here.

mod elements;
mod error;
pub mod input;

pub use elements::{init, is_installed, make};
pub use error::MediaError;
