//! Stereo calibrations: the `calibration` packet, the files it is read from and written to, and the boards it is made with.
//!
//! The only parser of calibration files: plugins that read them, nodes that make them and the command share it. It is not part of
//! `imaging` because it needs a YAML parser.
//!
//! - [`read`] understands OpenCV's `FileStorage` YAML, ROS `camera_info`, Kalibr camera chains and the files of data sets (KITTI, Middlebury,
//!   StereoMIS, EndoVis, rectified Hamlyn); [`write()`] writes `FileStorage` YAML that OpenCV reads back bit by bit.
//! - [`packet`] turns the packet into camera models and a rectification, and refuses impossible ones.
//! - [`pictures`] finds the picture files that a pattern matches, [`views`] groups those of several views by instant.
//! - [`Board`] describes a printed pattern, [`ViewState`] says whether a view of it was used and if not, why.

#![forbid(unsafe_code)]

mod board;
mod document;
mod endovis;
mod entries;
mod error;
mod file;
mod hamlyn;
mod kalibr;
mod kitti;
mod middlebury;
mod opencv;
pub mod packet;
pub mod pictures;
mod rectified;
pub mod ros;
mod stereomis;
mod view;
pub mod views;

pub use board::{Board, BoardError};
pub use error::FileError;
pub use file::{KittiCameras, parse, read, read_kitti, write};
pub use opencv::text_of;
pub use view::ViewState;

/// Rows of the 3x3 unit matrix, one after the other.
pub(crate) const EYE3: [f64; 9] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
