//! Benches of the runtime itself.

mod copper;
pub mod cost;
mod death;
mod dora;
pub mod editor;
mod graph;
mod gstreamer;
pub mod hop;
pub mod igtl;
mod python;
pub mod remote;
pub mod scale;
pub mod start;
pub mod stereo;
pub mod stitch;
pub mod system;
pub mod tools;

/// Default frames per second of a camera.
pub const CAMERA_HZ: u32 = 30;
