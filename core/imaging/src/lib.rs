//! Imaging algorithms of Panoscope as plain functions on slices.
//!
//! Nothing here knows a framework type. Functions take [`View`]s and a [`Parallel`]; whoever calls
//! decides whose threads run the chunks. Work memory lives in structs that the caller keeps, so that
//! nothing is allocated per frame. AVX2 paths are chosen at run time; a portable path always exists.

pub mod parallel;
pub mod report;
pub mod view;

pub use parallel::{Parallel, Serial, SharedMut};
pub use report::{Report, Silent};
pub use view::{View, ViewMut};

pub mod draw;
pub mod features;
pub mod geometry;
pub mod mosaic;
pub mod random;
pub mod stereo;
pub mod stitch;
