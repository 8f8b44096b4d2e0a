//! Image-related files and data. This crate does not know graphs.
//!
//! - [`bit_depth`]: which value of images with more than eight bits is white.
//! - [`calibration`]: stereo calibrations, their packet and their files, printed boards, files of images that a pattern
//!   matches.
//! - [`truth`]: ground truth in files: maps of disparity and depth, points, boxes, images of classes.
//! - [`data_sets`]: the folder layouts of public data sets.
//! - [`formats`]: encoders of images, arrays, clouds and the fields of packets.

#![forbid(unsafe_code)]

pub mod bit_depth;
pub mod calibration;
pub mod data_sets;
pub mod formats;
pub mod truth;
