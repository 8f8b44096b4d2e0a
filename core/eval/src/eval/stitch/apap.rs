//! As-projective-as-possible warps by the book, as a reference: J. Zaragoza, T.-J. Chin, M. S. Brown, D. Suter,
//! "As-projective-as-possible image stitching with moving DLT", CVPR 2013.
//!
//! Each vertex of a grid over the panorama gets its own homography, by a direct linear transform in which nearby
//! matches have the largest weights. It follows parallax where there are matches and uses no depth. Its authors'
//! parameters are kept.

use nalgebra::{SMatrix, SymmetricEigen};
use panoscope_imaging::geometry::{Homography, Point, Ransac, RansacParams};
use panoscope_imaging::stitch::{Lattice, Mesh};

/// Distance at which the weight of a match has fallen to 1/e, px (the authors' `sigma`).
const REACH_PX: f64 = 8.5;
/// Minimum weight of a match (the authors' `gamma`): far from all matches the warp is that of all of them.
const MIN_WEIGHT: f64 = 0.01;
/// Cells of the grid along the panorama's longer side.
const CELLS: f64 = 100.0;
/// Maximum error of a match that RANSAC accepts, in units in which the mean distance of the points from their centroid
/// is the root of two.
const RANSAC_UNITS: f64 = 0.1;
/// Matches below which there is no warp.
const MIN_MATCHES: usize = 8;
/// Cells that the grid reaches beyond the view's corners.
const MARGIN_CELLS: i32 = 3;
/// Distance from the other view, in multiples of its size, beyond which positions follow the homography of all matches.
const FAR_VIEWS: f64 = 4.0;

type Matrix9 = SMatrix<f64, 9, 9>;

/// Brings points to the centroid 0 and the mean distance of the root of two.
#[derive(Clone, Copy, Debug)]
struct Units {
    middle: Point,
    scale: f64,
}

impl Units {
    fn of(points: &[Point]) -> Option<Self> {
        let count = points.len() as f64;
        let middle = [0, 1].map(|k| points.iter().map(|p| p[k]).sum::<f64>() / count);
        let mean = points.iter().map(|p| (p[0] - middle[0]).hypot(p[1] - middle[1])).sum::<f64>() / count;
        (mean.is_finite() && mean > 1e-9).then(|| Self { middle, scale: std::f64::consts::SQRT_2 / mean })
    }

    fn apply(&self, p: Point) -> Point {
        [0, 1].map(|k| (p[k] - self.middle[k]) * self.scale)
    }

    fn matrix(&self) -> Homography {
        let (s, [x, y]) = (self.scale, self.middle);
        Homography([s, 0.0, -s * x, 0.0, s, -s * y, 0.0, 0.0, 1.0])
    }
}

/// Homographies that change over the reference plane.
pub struct MovingDlt {
    /// Position of each match in the reference view, px, and the product of its two equations with their transpose.
    matches: Vec<(Point, Matrix9)>,
    reference: Units,
    other: Units,
    /// Homography of all matches with equal weights.
    whole: Homography,
}

impl MovingDlt {
    /// From matches without outliers: the same points in the reference view and in the other one, px. `None` if they do
    /// not determine a homography.
    pub fn new(reference: &[Point], other: &[Point]) -> Option<Self> {
        if reference.len() != other.len() || reference.len() < MIN_MATCHES {
            return None;
        }
        let (from, to) = (Units::of(reference)?, Units::of(other)?);
        let equations = |(r, o): (&Point, &Point)| {
            let ([x, y], [u, v]) = (from.apply(*r), to.apply(*o));
            let rows = SMatrix::<f64, 2, 9>::from_row_slice(&[
                0.0,
                0.0,
                0.0,
                -x,
                -y,
                -1.0,
                v * x,
                v * y,
                v, //
                x,
                y,
                1.0,
                0.0,
                0.0,
                0.0,
                -u * x,
                -u * y,
                -u,
            ]);
            (*r, rows.transpose() * rows)
        };
        let matches = reference.iter().zip(other).map(equations).collect();
        let mut new = Self { matches, reference: from, other: to, whole: Homography::identity() };
        new.whole = new.solve(|_| 1.0)?;
        Some(new)
    }

    /// Maps the reference view to the other one with equal weights of all matches.
    pub fn whole(&self) -> &Homography {
        &self.whole
    }

    /// The homography from the reference view to the other one at a position of the reference plane.
    pub fn at(&self, [x, y]: Point) -> Option<Homography> {
        let square = REACH_PX * REACH_PX;
        self.solve(|[a, b]| (-((x - a).powi(2) + (y - b).powi(2)) / square).exp().max(MIN_WEIGHT))
    }

    /// The homography that minimises the weighted algebraic error: the eigenvector of the smallest eigenvalue.
    fn solve(&self, weight: impl Fn(Point) -> f64) -> Option<Homography> {
        let mut sum = Matrix9::zeros();
        for (at, product) in &self.matches {
            sum += product * weight(*at).powi(2);
        }
        let eigen = SymmetricEigen::new(sum);
        let h = eigen.eigenvectors.column(eigen.eigenvalues.imin());
        let normalised = Homography(std::array::from_fn(|k| h[k]));
        let map = self.other.matrix().inverse()?.product(&normalised).product(&self.reference.matrix());
        // The sign of an eigenvector is its solver's choice.
        let [x, y] = self.reference.middle;
        let sign = map.0[6] * x + map.0[7] * y + map.0[8];
        let map = Homography(map.0.map(|v| v / sign));
        map.is_finite().then_some(map)
    }

    /// The warp as a mesh over the area of the other view; `None` if the homography of all matches folds it.
    pub fn mesh(&self, (width, height): (usize, usize)) -> Option<Mesh> {
        let corners = self.whole.inverse()?.map_corners(width, height)?;
        let bounds = [0, 1].map(|k| {
            let along = corners.map(|corner| corner[k]);
            (along.iter().copied().fold(f64::MAX, f64::min), along.iter().copied().fold(f64::MIN, f64::max))
        });
        let longest = bounds.iter().map(|(low, high)| high - low).fold(0.0, f64::max);
        let cell_px = (longest / CELLS).ceil().max(4.0);
        let first = bounds.map(|(low, _)| (low / cell_px).floor() as i32 - MARGIN_CELLS);
        let last = bounds.map(|(_, high)| (high / cell_px).ceil() as i32 + MARGIN_CELLS);
        let [columns, rows] = [0, 1].map(|k| (last[k] - first[k] + 1) as usize);
        let far = [width as f64 * FAR_VIEWS, height as f64 * FAR_VIEWS];
        Mesh::new(Lattice { cell_px: cell_px as usize, first, columns, rows }, |at| {
            let own = self.at(at).filter(|map| map.weight(at) > 0.0).map(|map| map.map(at));
            // Near its horizon a homography brings points anywhere.
            own.filter(|p| p[0].abs() < far[0] && p[1].abs() < far[1]).unwrap_or_else(|| self.whole.map(at))
        })
    }
}

/// The matches that agree on a homography, with a loose threshold so that parallax is kept. `None` when there are too
/// few.
pub fn inliers(reference: &[Point], other: &[Point]) -> Option<(Vec<Point>, Vec<Point>)> {
    let units = Units::of(reference)?;
    let params = RansacParams { threshold_px: RANSAC_UNITS / units.scale, ..RansacParams::default() };
    let mut mask = Vec::new();
    Ransac::new().estimate(other, reference, &params, &mut mask).ok()?;
    let kept = reference.iter().zip(other).zip(&mask).filter(|(_, kept)| **kept).map(|((r, o), _)| (*r, *o));
    let kept: (Vec<Point>, Vec<Point>) = kept.unzip();
    (kept.0.len() >= MIN_MATCHES).then_some(kept)
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_base::random::SplitMix64;

    /// Two planes that meet at column 320 of the reference view: the exact map to the other view.
    fn truth([x, y]: Point) -> Point {
        let disparity = if x < 320.0 { 180.0 } else { 180.0 + 0.08 * (x - 320.0) };
        [x - disparity, y + 2.0]
    }

    /// Matches all over the overlap; every tenth is wrong when `with_outliers`.
    fn pairs(with_outliers: bool) -> (Vec<Point>, Vec<Point>) {
        let mut random = SplitMix64(4);
        (0..600)
            .map(|index| {
                let at = [200.0 + random.below(430) as f64, random.below(480) as f64];
                let is_wrong = with_outliers && index % 10 == 0;
                let [u, v] = truth(at);
                (at, if is_wrong { [u + 60.0, v - 45.0] } else { [u, v] })
            })
            .unzip()
    }

    fn error_px(map: impl Fn(Point) -> Option<Point>, columns: std::ops::Range<usize>) -> f64 {
        let at = columns.step_by(10).flat_map(|x| (20..460).step_by(20).map(move |y| [x as f64, y as f64]));
        let errors: Vec<f64> = at
            .map(|at| {
                let ([u, v], [a, b]) = (map(at).expect("inside"), truth(at));
                (u - a).powi(2) + (v - b).powi(2)
            })
            .collect();
        (errors.iter().sum::<f64>() / errors.len() as f64).sqrt()
    }

    #[test]
    fn two_planes_are_followed_where_one_homography_is_off() {
        let (reference, other) = pairs(false);
        let moving = MovingDlt::new(&reference, &other).unwrap();
        let mesh = moving.mesh((640, 480)).unwrap();
        let (plane, followed) =
            (error_px(|p| Some(moving.whole().map(p)), 220..620), error_px(|p| mesh.map(p), 220..620));
        assert!(plane > 1.0 && followed < plane / 2.0, "{plane} px by one homography, {followed} px by many");
    }

    #[test]
    fn one_plane_is_exact_everywhere_and_far_away() {
        let plane = Homography([1.02, 0.01, -190.0, 0.005, 0.99, 3.0, 2e-5, 1e-5, 1.0]);
        let reference = pairs(false).0;
        let other: Vec<Point> = reference.iter().map(|p| plane.map(*p)).collect();
        let moving = MovingDlt::new(&reference, &other).unwrap();
        for at in [[400.0, 200.0], [210.0, 5.0], [900.0, 470.0]] {
            let ([u, v], [a, b]) = (moving.at(at).unwrap().map(at), plane.map(at));
            assert!((u - a).hypot(v - b) < 1e-3, "{at:?}: {u} {v} for {a} {b}");
        }
    }

    #[test]
    fn wrong_matches_are_left_out_and_parallax_stays() {
        let (reference, other) = pairs(true);
        let (kept, _) = inliers(&reference, &other).unwrap();
        assert!((530..=545).contains(&kept.len()), "{} of 540 right ones", kept.len());
        assert_eq!(inliers(&reference[..6], &other[..6]), None);
        assert!(MovingDlt::new(&reference[..6], &other[..6]).is_none());
        assert!(MovingDlt::new(&[[5.0, 5.0]; 20], &[[1.0, 1.0]; 20]).is_none(), "all at one position");
    }
}
