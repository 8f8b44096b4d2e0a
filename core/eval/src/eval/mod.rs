//! Evaluation of results against ground truth and peers.

pub mod arm;
pub mod calibrate;
pub mod detect;
pub mod disparity;
pub mod mosaic;
pub mod proximity;
pub mod screen;
pub mod skill;
pub mod stitch;
pub mod surf;
