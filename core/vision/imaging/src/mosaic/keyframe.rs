//! A frame that the mosaic keeps.

use super::outline::Outline;
use super::picture::Picture;
use crate::features::Features;
use crate::geometry::Homography;

/// Pixels, features and pose of a frame.
#[derive(Clone, Debug)]
pub(super) struct Keyframe {
    /// Unique and increasing.
    pub id: u64,
    pub picture: Picture,
    pub features: Features,
    pub mosaic_from_frame: Homography,
    pub outline: Outline,
    /// Pose when it was last drawn.
    pub drawn: Homography,
    /// Gain of blue, green and red.
    pub gain: [f32; 3],
    /// Area that no older keyframe covers, in square pixels of the mosaic.
    pub own_area: f64,
}

/// Position of a keyframe in a list ordered by `id`.
pub(super) fn index_of(keyframes: &[Keyframe], id: u64) -> Option<usize> {
    keyframes.binary_search_by_key(&id, |keyframe| keyframe.id).ok()
}
