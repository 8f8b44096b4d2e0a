//! A mosaic from one moving camera (thesis, section 2.5): every frame is registered to a keyframe, keyframes are held
//! together by a graph of overlaps, and closed loops spread their error over it.
//!
//! [`Mosaic`] is the whole: frames in, a picture and a report out. A frame that cannot be registered changes nothing. Memory
//! is bounded by the number of keyframes; the oldest one is dropped, and counted, when a new one needs its place.

mod adjust;
mod canvas;
mod coverage;
mod graph;
mod keyframe;
mod outline;
mod params;
mod picture;
mod shown;
mod skyline;
#[cfg(test)]
mod tests;
mod track;
mod update;

pub use params::{MosaicError, MosaicModel, MosaicParams, MosaicReport, MosaicState, MosaicView};
pub use update::Mosaic;
