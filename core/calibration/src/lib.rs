//! Stereo calibrations: the `calibration` packet as the kernels want it, the files it is read from and written to,
//! and the boards it is made with.
//!
//! The one place where calibration files are understood, shared by the plugins that read them, the nodes that make them
//! and the command. It stands apart from `imaging`, which has no dependencies, because YAML is read by a crate of its own.
//!
//! - [`read`] understands OpenCV's `FileStorage` YAML, ROS `camera_info` and Kalibr camera chains; [`write`] writes
//!   `FileStorage` YAML that OpenCV reads back bit by bit.
//! - [`packet`] turns the packet into camera models and a rectification, and refuses what cannot be.
//! - [`pictures`] finds the picture files that a pattern means, [`views`] puts those of several views together.
//! - [`Board`] names a printed pattern, [`ViewState`] what became of one view of it.

#![forbid(unsafe_code)]

mod board;
mod document;
mod error;
mod file;
mod kalibr;
mod opencv;
pub mod packet;
pub mod pictures;
mod ros;
mod view;
pub mod views;

pub use board::{Board, BoardError};
pub use error::FileError;
pub use file::{parse, read, write};
pub use opencv::text_of;
pub use view::ViewState;

/// Rows of the 3x3 unit matrix, one after the other.
pub(crate) const EYE3: [f64; 9] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
