//! Outlines of frames in the mosaic, their shared area and bounds.

use crate::geometry::{Homography, Point, plausible};

/// Maximum number of corners of two convex quadrilaterals' intersection.
const MAX_CORNERS: usize = 8;

/// A frame's outline in the mosaic.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Outline {
    pub corners: [Point; 4],
    pub area: f64,
    pub centre: Point,
}

impl Outline {
    /// `None` for a map that folds the frame, mirrors it or sends it beyond the horizon.
    pub fn of(mosaic_from_frame: &Homography, size: (usize, usize)) -> Option<Self> {
        let corners = mosaic_from_frame.map_corners(size.0, size.1)?;
        let area = plausible::area(&corners);
        let upright = plausible::is_convex(&corners) && area > 1.0;
        let centre = mosaic_from_frame.map([(size.0 as f64 - 1.0) / 2.0, (size.1 as f64 - 1.0) / 2.0]);
        upright.then_some(Self { corners, area, centre })
    }

    /// Shared area over the larger of both areas, 0..=1: also decreases when one frame is much nearer than the other.
    pub fn overlap(&self, other: &Self) -> f64 {
        let reach = (self.area.sqrt() + other.area.sqrt()) * 2.0;
        if distance(self.centre, other.centre) > reach {
            return 0.0;
        }
        (shared_area(&self.corners, &other.corners) / self.area.max(other.area)).clamp(0.0, 1.0)
    }

    /// Smallest and largest coordinates of all corners: left, top, right, bottom.
    pub fn bounds(&self) -> [f64; 4] {
        let mut b = [f64::MAX, f64::MAX, f64::MIN, f64::MIN];
        for [x, y] in self.corners {
            b = [b[0].min(x), b[1].min(y), b[2].max(x), b[3].max(y)];
        }
        b
    }

    /// Whether the point is inside.
    pub fn contains(&self, [x, y]: Point) -> bool {
        (0..4).all(|i| {
            let (a, b) = (self.corners[i], self.corners[(i + 1) % 4]);
            (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0]) >= 0.0
        })
    }
}

/// The smallest rectangle around two: left, top, right, bottom.
pub(super) fn union(a: [f64; 4], b: [f64; 4]) -> [f64; 4] {
    [a[0].min(b[0]), a[1].min(b[1]), a[2].max(b[2]), a[3].max(b[3])]
}

/// Euclidean distance.
pub(super) fn distance(a: Point, b: Point) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// Area of the intersection of two convex quadrilaterals (Sutherland and Hodgman 1974).
fn shared_area(subject: &[Point; 4], clip: &[Point; 4]) -> f64 {
    let mut now = [[0.0; 2]; MAX_CORNERS];
    now[..4].copy_from_slice(subject);
    let mut count = 4;
    for i in 0..4 {
        let (a, b) = (clip[i], clip[(i + 1) % 4]);
        let side = |p: Point| (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]);
        let mut next = [[0.0; 2]; MAX_CORNERS];
        let mut kept = 0;
        for j in 0..count {
            let (p, q) = (now[j], now[(j + 1) % count]);
            let (sp, sq) = (side(p), side(q));
            if sp >= 0.0 && kept < MAX_CORNERS {
                next[kept] = p;
                kept += 1;
            }
            if (sp >= 0.0) != (sq >= 0.0) && kept < MAX_CORNERS {
                let t = sp / (sp - sq);
                next[kept] = [p[0] + (q[0] - p[0]) * t, p[1] + (q[1] - p[1]) * t];
                kept += 1;
            }
        }
        (now, count) = (next, kept);
        if count < 3 {
            return 0.0;
        }
    }
    let twice = |i: usize| {
        let (a, b) = (now[i], now[(i + 1) % count]);
        a[0] * b[1] - b[0] * a[1]
    };
    (0..count).map(twice).sum::<f64>() * 0.5
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64, y: f64, scale: f64) -> Outline {
        let map = Homography::translation(x, y).compose(&Homography::scaling(scale));
        Outline::of(&map, (101, 81)).unwrap()
    }

    #[test]
    fn overlap_is_the_shared_part_of_the_larger_outline() {
        assert!((at(0.0, 0.0, 1.0).overlap(&at(0.0, 0.0, 1.0)) - 1.0).abs() < 1e-12);
        assert!((at(0.0, 0.0, 1.0).overlap(&at(25.0, 40.0, 1.0)) - 0.375).abs() < 1e-12);
        assert!((at(10.0, 10.0, 0.5).overlap(&at(0.0, 0.0, 1.0)) - 0.25).abs() < 1e-12);
        assert_eq!(at(0.0, 0.0, 1.0).overlap(&at(101.0, 0.0, 1.0)), 0.0);
        assert_eq!(at(0.0, 0.0, 1.0).overlap(&at(9000.0, 0.0, 1.0)), 0.0);
    }

    #[test]
    fn an_eighth_turn_leaves_an_octagon() {
        let (c, s) = (std::f64::consts::FRAC_1_SQRT_2, std::f64::consts::FRAC_1_SQRT_2);
        let turn = Homography([c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0]);
        let about = Homography::translation(50.0, 50.0).compose(&turn).compose(&Homography::translation(-50.0, -50.0));
        let (a, b) = (Outline::of(&Homography::identity(), (101, 101)), Outline::of(&about, (101, 101)));
        // Two squares turned by 45 degrees share 2 (sqrt 2 - 1) of each.
        let shared = a.unwrap().overlap(&b.unwrap());
        assert!((shared - 2.0 * (2f64.sqrt() - 1.0)).abs() < 1e-9, "{shared}");
    }

    #[test]
    fn mirrored_and_folded_frames_have_no_outline() {
        let mirrored = Homography([-1.0, 0.0, 100.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
        assert_eq!(Outline::of(&mirrored, (101, 81)), None);
        let folded = Homography([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, -0.02, 0.0, 1.0]);
        assert_eq!(Outline::of(&folded, (101, 81)), None);
    }
}
