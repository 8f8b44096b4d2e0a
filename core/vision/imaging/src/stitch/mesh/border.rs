//! The sides of the reference view beyond which the other view reaches, beyond which the mesh is extrapolated.

use crate::geometry::Homography;

/// Maximum share of the overlap that the transition takes.
const MAX_SHARE: f64 = 0.15;

/// A side of the reference view beyond which the other view reaches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Border {
    /// 0 for a border of constant x, 1 for one of constant y.
    pub axis: usize,
    /// 1.0 when the other view reaches beyond it towards larger coordinates, -1.0 towards smaller ones.
    pub outwards: f64,
    /// Position, px of the reference view.
    pub at_px: f64,
    /// Width of the overlap on the inner side, px.
    pub overlap_px: f64,
}

impl Border {
    /// Width of the transition before the border, at most `max_px`, px; 0 for none.
    pub fn zone_px(&self, max_px: f64) -> f64 {
        max_px.min(MAX_SHARE * self.overlap_px).max(0.0)
    }
}

/// The sides of the reference view beyond which the other view reaches, by the homography.
pub fn borders(
    beyond_px: [f64; 2],
    left_from_right: &Homography,
    left: (usize, usize),
    right: (usize, usize),
) -> [Option<Border>; 4] {
    let Some(corners) = left_from_right.map_corners(right.0, right.1) else { return [None; 4] };
    let extent = |axis: usize| {
        let along = corners.map(|corner| corner[axis]);
        (along.iter().copied().fold(f64::MAX, f64::min), along.iter().copied().fold(f64::MIN, f64::max))
    };
    let sizes = [left.0 as f64, left.1 as f64];
    let side = |axis: usize, outwards: f64| {
        let ((low, high), size, beyond_px) = (extent(axis), sizes[axis], beyond_px[axis]);
        let is_outwards = outwards > 0.0;
        let is_beyond = if is_outwards { high > size + beyond_px } else { low < -beyond_px };
        let at_px = if is_outwards { size } else { 0.0 };
        let overlap_px = high.min(size) - low.max(0.0);
        is_beyond.then_some(Border { axis, outwards, at_px, overlap_px })
    };
    [side(0, 1.0), side(0, -1.0), side(1, 1.0), side(1, -1.0)]
}
