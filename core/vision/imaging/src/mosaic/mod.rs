//! A mosaic from one moving camera (thesis, section 2.5): every frame is registered to a keyframe, a graph of overlaps
//! connects the keyframes, and the error of a closed loop is distributed over it.
//!
//! [`Mosaic`] takes frames and returns an image and a report. A frame that cannot be registered changes nothing. Memory
//! is bounded by the number of keyframes; the oldest one is dropped, and counted, for a new one.

mod adjust;
mod canvas;
mod coverage;
mod graph;
mod keyframe;
mod outline;
mod params;
mod picture;
mod rim;
mod shown;
mod skyline;
#[cfg(test)]
mod tests;
mod track;
mod update;

pub use params::{MosaicError, MosaicModel, MosaicParams, MosaicReport, MosaicState, MosaicView};
pub use update::Mosaic;
