//! What is known of one instrument over time.

use super::kept::Kept;
use crate::geometry::Point;

/// Distance from the border of a view below which an instrument counts as cut off, px.
pub(super) const BORDER_PX: f64 = 16.0;
/// Minimum number of cells at a border of an instrument that is cut off by it.
pub(super) const MIN_CUT: usize = 2;
/// Width of a band of distances from the border of the other view, px of a view of 640 columns, and their number.
pub(super) const BAND_PX: f64 = 5.0;
pub(super) const BANDS: usize = 27;

/// How far the views show an instrument.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Cut {
    /// Cells at the border of the reference view.
    pub(super) by_reference: usize,
    /// Cells within each [`BAND_PX`] of the border of the other view, from the border on.
    pub(super) bands: [usize; BANDS],
}

impl Cut {
    pub(super) fn add(&mut self, other: Self) {
        self.by_reference += other.by_reference;
        self.bands.iter_mut().zip(other.bands).for_each(|(sum, cells)| *sum += cells);
    }

    /// Whether the border of the reference view cuts it off.
    pub(super) fn is_by_reference(&self) -> bool {
        self.by_reference >= MIN_CUT
    }

    /// Distance from the border of the other view, px of a view of 640 columns; infinite if it is far.
    pub(super) fn clear_px(&self) -> f64 {
        let mut cells = 0;
        for (band, count) in self.bands.iter().enumerate() {
            cells += count;
            if cells >= MIN_CUT {
                return band as f64 * BAND_PX;
            }
        }
        f64::INFINITY
    }

    /// Whether neither view shows all of an instrument.
    pub(super) fn is_twice(&self) -> bool {
        self.is_by_reference() && self.clear_px() < BORDER_PX
    }
}

/// One instrument over time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Track {
    /// View that shows it; free for an unused slot.
    pub view: Kept,
    /// Displacement of its image in the other view from the homography, px.
    pub shift: Option<Point>,
    /// Its ends, px, and the same places in the other view.
    pub(super) ends: Option<[[Point; 2]; 2]>,
    /// Displacement that brings its image in the other view to its position in the reference view.
    pub(super) matched: Option<Sloped>,
    /// Share of that displacement which is applied, 0..=1; it moves the image from one view's position to the other's.
    pub glide: f64,
    /// Slope of an instrument that is cut off by the border of the reference view: change of the position across the
    /// border per position along it.
    pub slope: Option<f64>,
    /// A place next to the border of the reference view, px, and the same in the other view, of an instrument that the other view continues there.
    pub joint: Option<[Point; 2]>,
    /// Whether the other view begins to show it, or to continue it, in this frame: its mesh is rigid at once.
    pub jumps: bool,
    pub(super) missing_frames: u32,
    pub(super) pending_frames: u32,
}

impl Track {
    /// Displacement of its image in the other view from the homography at a point of the reference plane, px.
    pub(super) fn displacement(&self, at: Point) -> Option<Point> {
        let (shift, glide) = (self.shift?, self.glide);
        let Some(matched) = self.matched.filter(|_| glide > 0.0) else { return Some(shift) };
        let matched = matched.at(at);
        Some([0, 1].map(|k| shift[k] + glide * (matched[k] - shift[k])))
    }
}

/// A displacement that changes linearly with the position: at the origin, and per px along x and along y.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sloped([Point; 3]);

impl Sloped {
    /// The displacement that has these values at two points and is constant across the line through them.
    pub(super) fn through([from, to]: [Point; 2], [first, last]: [Point; 2]) -> Self {
        let along = [to[0] - from[0], to[1] - from[1]];
        let square = (along[0] * along[0] + along[1] * along[1]).max(1e-9);
        let per_px = along.map(|step| [0, 1].map(|k| (last[k] - first[k]) * step / square));
        let origin = [0, 1].map(|k| first[k] - per_px[0][k] * from[0] - per_px[1][k] * from[1]);
        Self([origin, per_px[0], per_px[1]])
    }

    /// The displacement at a point.
    pub(super) fn at(&self, [x, y]: Point) -> Point {
        let Self([origin, by_x, by_y]) = self;
        [0, 1].map(|k| origin[k] + by_x[k] * x + by_y[k] * y)
    }

    /// Adds a displacement.
    pub(super) fn move_by(&mut self, [x, y]: Point) {
        self.0[0] = [self.0[0][0] + x, self.0[0][1] + y];
    }

    /// Moves it towards another one by a share.
    pub(super) fn approach(&mut self, other: &Self, share: f64) {
        for (held, new) in self.0.iter_mut().flatten().zip(other.0.iter().flatten()) {
            *held += share * (new - *held);
        }
    }
}
