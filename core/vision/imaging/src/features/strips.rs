//! Search regions for an overlap that a search of whole views does not find: strips along facing sides.
//!
//! Two views near the tissue share a strip some tens of pixels wide. In whole views, shrunk, its few keypoints are
//! outnumbered by the others; alone and at full size they are found.

use super::matching::Gate;
use super::surf::SurfParams;
use crate::Rect;
use crate::geometry::{Homography, overlap_rois};

/// Overlaps shorter than this share of a view's side are narrow: searched at full size and registered by a model of
/// fewer parameters.
const NARROW_SHARE: f64 = 0.34;
/// Width of the strips in shares of a view's side: the narrower, the fewer keypoints without a partner.
const STRIP_SHARE: f64 = 0.25;
/// Minimum width of an overlap with keypoints, px.
const MIN_NARROW_PX: usize = 16;
/// Widens the search regions of a narrow overlap, px: most of it is lost when the views move by little.
const NARROW_MARGIN_PX: usize = 24;
/// Maximum offset of partners in facing strips across the direction between the views, as a share of the strip's
/// length, because neighbouring cameras look in about the same direction.
const ACROSS_SHARE: f64 = 0.05;
/// Maximum distance of partners in a known overlap from the predicted position, px.
const AROUND_PX: f32 = 24.0;
/// Weight of distances along the displacement, which depends on the depth.
const ALONG_WEIGHT: f64 = 0.25;

/// Windows of descriptors in a narrow overlap: there the viewing directions differ by tens of degrees, which distorts
/// large windows.
const NARROW_WINDOW: f32 = 0.5;
/// Factor on the determinant threshold there, because few pixels are available.
const NARROW_HESSIAN: f32 = 0.2;
/// Factor on the number of keypoints there.
const NARROW_POINTS: usize = 2;

/// Detection parameters for a narrow overlap.
pub(super) fn narrow_surf(surf: SurfParams) -> SurfParams {
    SurfParams {
        window: NARROW_WINDOW * surf.window,
        hessian_threshold: NARROW_HESSIAN * surf.hessian_threshold,
        max_points: NARROW_POINTS * surf.max_points,
        ..surf
    }
}

/// Sizes (width, height) of the left and the right view.
pub(super) type Sizes = [(usize, usize); 2];

/// One search for the overlap.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Search {
    /// Regions in which keypoints are searched in the left and in the right view.
    pub(super) regions: [Rect; 2],
    /// Shrink factor of the regions.
    pub(super) shrink: usize,
    /// Region in which partners may be.
    pub(super) gate: Option<Gate>,
    /// Whether the overlap is narrow: an affine map near a shift is estimated.
    pub(super) is_narrow: bool,
}

/// Possible positions of the second view relative to the first: -1, 0 or 1 views to the right and below. Every other
/// attempt is for a pair side by side, but a square of four cameras comes first.
const SIDES: [(i8, i8); 12] =
    [(1, 0), (0, 1), (1, 1), (1, 0), (-1, 0), (1, 0), (0, -1), (1, 0), (-1, -1), (1, 0), (1, -1), (-1, 1)];

/// The strips that face each other when the second view is at `side`, or at a corner the strips above and below.
fn strips((x, y): (i8, i8), [left, right]: Sizes) -> Search {
    let part = |length: usize| ((length as f64 * STRIP_SHARE) as usize).max(1).min(length);
    let at_end = |(width, height): (usize, usize), is_end: bool| {
        if y == 0 {
            Rect::new(if is_end { width - part(width) } else { 0 }, 0, part(width), height)
        } else {
            Rect::new(0, if is_end { height - part(height) } else { 0 }, width, part(height))
        }
    };
    let is_end = if y == 0 { x > 0 } else { y > 0 };
    let weights = if y == 0 { [0.0, 1.0] } else { [1.0, 0.0] };
    let length = if y == 0 { left.1 } else { left.0 };
    let across = Gate { weights, ..Gate::circle(Homography::identity(), (ACROSS_SHARE * length as f64) as f32) };
    let is_corner = x != 0 && y != 0;
    Search {
        regions: [at_end(left, is_end), at_end(right, !is_end)],
        shrink: 1,
        gate: (!is_corner).then_some(across),
        is_narrow: true,
    }
}

/// Chooses one pair of strips for each frame in which whole views fail.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Strips {
    next: usize,
    is_last_tried: bool,
}

impl Strips {
    /// The next search: the last narrow overlap, if there is one, then one pair of sides after the other.
    ///
    /// `None` for views that are too small for strips.
    pub(super) fn choose(&mut self, last: Option<&Homography>, sizes: Sizes) -> Option<Search> {
        let seen = last.and_then(|map| narrow(map, sizes)).filter(|_| !self.is_last_tried);
        self.is_last_tried = seen.is_some();
        let search = seen.unwrap_or_else(|| {
            let search = strips(SIDES[self.next % SIDES.len()], sizes);
            self.next += 1;
            search
        });
        search.regions.iter().all(|r| r.width >= MIN_NARROW_PX && r.height >= MIN_NARROW_PX).then_some(search)
    }

    /// Restarts with the first pair of sides.
    pub(super) fn reset(&mut self) {
        *self = Self::default();
    }
}

/// The search of the overlap under `map`, widened; `None` unless the overlap is narrow and some pixels wide.
pub(super) fn narrow(map: &Homography, sizes: Sizes) -> Option<Search> {
    let (left, right) = overlap_rois(map, sizes[0], sizes[1]);
    let both = [left, right];
    let is_wide = |(roi, (width, height)): (&Rect, (usize, usize))| {
        roi.width as f64 >= NARROW_SHARE * width as f64 && roi.height as f64 >= NARROW_SHARE * height as f64
    };
    let least = both.iter().map(|roi| roi.width.min(roi.height)).min().unwrap_or(0);
    if least < MIN_NARROW_PX || both.iter().zip(sizes).all(is_wide) {
        return None;
    }
    let grown = |roi: Rect, (width, height): (usize, usize)| roi.grown(NARROW_MARGIN_PX, width, height);
    let centre = [sizes[1].0 as f64 / 2.0, sizes[1].1 as f64 / 2.0];
    let [u, v] = map.map(centre);
    let (dx, dy) = (u - centre[0], v - centre[1]);
    let length = dx.hypot(dy).max(1e-9);
    let weights = [dx, dy].map(|d| 1.0 - (1.0 - ALONG_WEIGHT) * (d / length).abs());
    Some(Search {
        regions: [grown(left, sizes[0]), grown(right, sizes[1])],
        shrink: 1,
        gate: Some(Gate { weights, ..Gate::circle(*map, AROUND_PX) }),
        is_narrow: true,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZES: Sizes = [(640, 480); 2];

    #[test]
    fn sides_take_turns_after_the_overlap_seen_last() {
        let narrow = Homography::translation(580.0, 0.0);
        let mut strips = Strips::default();
        let mut choose = |last: Option<&Homography>| strips.choose(last, SIZES).map(|search| search.regions);
        let seen = choose(Some(&narrow)).unwrap();
        assert_eq!(seen, [Rect::new(556, 0, 84, 480), Rect::new(0, 0, 84, 480)]);
        let right = [Rect::new(480, 0, 160, 480), Rect::new(0, 0, 160, 480)];
        let below = [Rect::new(0, 360, 640, 120), Rect::new(0, 0, 640, 120)];
        assert_eq!(choose(Some(&narrow)), Some(right));
        assert_eq!(choose(Some(&narrow)), Some(seen));
        let corner = below;
        let (left, above) = ([right[1], right[0]], [below[1], below[0]]);
        for (attempt, sides) in [below, corner, right, left, right, above, right].into_iter().enumerate() {
            assert_eq!(choose(None), Some(sides), "attempt {attempt}");
        }
        assert_eq!(Strips::default().choose(None, [(40, 40); 2]), None);
    }

    #[test]
    fn partners_lie_across_the_sides_and_anywhere_at_a_corner() {
        let weights = |side| strips(side, SIZES).gate.map(|gate| (gate.weights, gate.radius_px));
        assert_eq!(weights((1, 0)), Some(([0.0, 1.0], 24.0)));
        assert_eq!(weights((0, -1)), Some(([1.0, 0.0], 32.0)));
        assert_eq!(weights((1, 1)), None);
    }

    #[test]
    fn only_narrow_overlaps_have_narrow_searches() {
        let of = |x, y| narrow(&Homography::translation(x, y), SIZES);
        assert_eq!((of(400.0, 0.0), of(635.0, 0.0), of(700.0, 0.0)), (None, None, None));
        let below = of(0.0, 400.0).unwrap();
        assert_eq!(below.regions, [Rect::new(0, 376, 640, 104), Rect::new(0, 0, 640, 104)]);
        assert_eq!(below.gate.map(|gate| gate.weights), Some([1.0, ALONG_WEIGHT]));
    }
}
