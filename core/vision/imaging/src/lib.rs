//! Imaging algorithms of Panoscope as plain functions on slices.
//!
//! This crate knows no framework type. Functions take [`View`]s and a [`Parallel`]; the caller decides whose threads
//! run the chunks. Work memory is in structs that the caller keeps, so that nothing is allocated per frame. [`Simd`]
//! chooses AVX2 paths at run time; a portable path always exists.

mod grow;
mod pieces;
pub mod shared_mut;
mod simd;

// The types that signatures of this crate are made of.
pub use panoscope_base::{Parallel, Rect, Report, Serial, Silent, Simd, View, ViewMut};
pub use shared_mut::SharedMut;

pub mod composition;
pub mod detect;
pub mod draw;
pub mod features;
pub mod fit;
pub mod geometry;
pub mod lit;
pub mod mosaic;
pub mod rows;
pub mod shrink;
pub mod stereo;
pub mod stitch;
