//! Messages of ROS 2 and bags, without a ROS installation.
//!
//! [`messages`] has the messages as structs, [`cdr`] their encoding, [`definitions`] the texts that describe them to
//! readers of bags. [`convert`] turns packets into messages and back. [`bag`] writes and reads bags: folders with MCAP
//! files and `metadata.yaml`.
//!
//! Lengths are in m and frames those of REP 103 and 105: a camera's frame ends with `_optical_frame` and has x right, y
//! down, z forward, like Panoscope's frames; mm become m.

#![forbid(unsafe_code)]

pub mod bag;
pub mod cdr;
pub mod convert;
pub mod definitions;
pub mod messages;
pub mod names;
