//! Registration of a frame to one keyframe.

use super::graph::MAX_PAIRS;
use super::params::{MosaicModel, MosaicParams};
use crate::Parallel;
use crate::features::{Features, Gate, Match, Matcher};
use crate::geometry::{Homography, Point, Ransac};

/// Cells of a frame; each contributes one inlier to an edge.
const CELLS: (usize, usize) = (6, 4);
/// Minimum spread of the inliers across their narrow direction, as a share of the frame's larger side: an instrument
/// that moves with the camera, or a gap in smoke, has matches that agree with each other but not with the scene.
const MIN_SPREAD: f64 = 0.035;
/// Factor on the evidence that a strict test needs.
const STRICT: f64 = 1.6;

/// Strictness of the test of a registration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Test {
    /// The position is near the predicted one.
    Usual,
    /// There is no prediction, or a wrong result would bend the whole mosaic.
    Strict,
}

/// A frame's position in a keyframe.
#[derive(Clone, Copy, Debug)]
pub(super) struct Link {
    pub keyframe_from_frame: Homography,
    pub inliers: usize,
    pub rms_px: f64,
    /// Inliers in the frame, spread over it.
    pub points: [Point; MAX_PAIRS],
    pub count: usize,
}

impl Link {
    /// The inliers in the frame.
    pub fn points(&self) -> &[Point] {
        &self.points[..self.count]
    }
}

/// Matcher and estimator with their work memory.
#[derive(Clone, Debug, Default)]
pub(super) struct Tracker {
    matcher: Matcher,
    ransac: Ransac,
    matches: Vec<Match>,
    from: Vec<Point>,
    to: Vec<Point>,
    mask: Vec<bool>,
}

impl Tracker {
    /// Reserves memory for this many keypoints.
    pub fn reserve(&mut self, points: usize) {
        self.from.reserve(points);
        self.to.reserve(points);
        self.mask.reserve(points);
        self.matches.reserve(points);
        self.ransac.reserve(points);
    }

    /// Position of a frame in a keyframe; `None` if the evidence is insufficient.
    ///
    /// `expected` limits matching to the surroundings of a predicted position.
    pub fn register(
        &mut self,
        keyframe: &Features,
        frame: &Features,
        expected: Option<Homography>,
        test: Test,
        size: (usize, usize),
        params: &MosaicParams,
        pool: &dyn Parallel,
    ) -> Option<Link> {
        let gate = expected
            .filter(|_| params.gate_px > 0.0)
            .map(|left_from_right| Gate::circle(left_from_right, params.gate_px));
        self.matcher.match_features(keyframe, frame, &params.matching, gate.as_ref(), pool, &mut self.matches);
        self.from.clear();
        self.to.clear();
        for pair in &self.matches {
            self.to.push(keyframe.keypoints.position(pair.left as usize));
            self.from.push(frame.keypoints.position(pair.right as usize));
        }
        let fit = self.ransac.estimate(&self.from, &self.to, &params.ransac, &mut self.mask).ok()?;
        let more = if test == Test::Strict { STRICT } else { 1.0 };
        let enough = (params.min_inliers.max(4) as f64 * more) as usize;
        let share = (params.min_inlier_share * more).min(1.0);
        if fit.inliers < enough || (fit.inliers as f64) < share * self.matches.len() as f64 {
            return None;
        }
        let map = match params.model {
            MosaicModel::Homography => fit.homography,
            model => linear_fit(&self.from, &self.to, &self.mask, model)?,
        };
        if !params.plausibility.accepts(&map, size) || self.spread_px() < MIN_SPREAD * size.0.max(size.1) as f64 {
            return None;
        }
        let squares: f64 = self.inliers().map(|(p, q)| map.squared_error(p, q)).sum();
        let (points, count) = self.spread_points(size);
        let rms_px = (squares / fit.inliers as f64).sqrt();
        Some(Link { keyframe_from_frame: map, inliers: fit.inliers, rms_px, points, count })
    }

    fn inliers(&self) -> impl Iterator<Item = (Point, Point)> + '_ {
        let pairs = self.from.iter().zip(&self.to).zip(&self.mask);
        pairs.filter(|(_, inlier)| **inlier).map(|((p, q), _)| (*p, *q))
    }

    /// Standard deviation of the inliers across their narrow direction, in pixels of the frame.
    fn spread_px(&self) -> f64 {
        let (mut n, mut x, mut y, mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        for ([px, py], _) in self.inliers() {
            (n, x, y, xx, xy, yy) = (n + 1.0, x + px, y + py, xx + px * px, xy + px * py, yy + py * py);
        }
        let (x, y) = (x / n, y / n);
        let (xx, xy, yy) = (xx / n - x * x, xy / n - x * y, yy / n - y * y);
        let (half, difference) = ((xx + yy) * 0.5, (xx - yy) * 0.5);
        (half - difference.hypot(xy)).max(0.0).sqrt()
    }

    /// One inlier per cell, then others until the list is full.
    fn spread_points(&self, size: (usize, usize)) -> ([Point; MAX_PAIRS], usize) {
        let mut points = [[0.0; 2]; MAX_PAIRS];
        let mut count = 0;
        let mut taken = [false; CELLS.0 * CELLS.1];
        for (point, _) in self.inliers() {
            let cell = |value: f64, side: usize, cells: usize| {
                ((value.max(0.0) / side as f64 * cells as f64) as usize).min(cells - 1)
            };
            let index = cell(point[1], size.1, CELLS.1) * CELLS.0 + cell(point[0], size.0, CELLS.0);
            if !taken[index] && count < MAX_PAIRS {
                taken[index] = true;
                points[count] = point;
                count += 1;
            }
        }
        for (point, _) in self.inliers() {
            if count == MAX_PAIRS {
                break;
            }
            if !points[..count].contains(&point) {
                points[count] = point;
                count += 1;
            }
        }
        (points, count)
    }
}

/// The affine map or similarity that fits the inliers best.
fn linear_fit(from: &[Point], to: &[Point], mask: &[bool], model: MosaicModel) -> Option<Homography> {
    let pairs = || from.iter().zip(to).zip(mask).filter(|(_, inlier)| **inlier).map(|((p, q), _)| (*p, *q));
    let (mut n, mut from_mean, mut to_mean) = (0.0f64, [0.0f64; 2], [0.0f64; 2]);
    for (p, q) in pairs() {
        n += 1.0;
        for k in 0..2 {
            from_mean[k] += p[k];
            to_mean[k] += q[k];
        }
    }
    let (from_mean, to_mean) = (from_mean.map(|v| v / n), to_mean.map(|v| v / n));
    // Second moments about the means.
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    let mut cross = [[0.0; 2]; 2];
    for (p, q) in pairs() {
        let (x, y) = (p[0] - from_mean[0], p[1] - from_mean[1]);
        (xx, xy, yy) = (xx + x * x, xy + x * y, yy + y * y);
        for (row, cross) in cross.iter_mut().enumerate() {
            let value = q[row] - to_mean[row];
            cross[0] += value * x;
            cross[1] += value * y;
        }
    }
    let linear = if model == MosaicModel::Similarity {
        let total = xx + yy;
        let (a, b) = ((cross[0][0] + cross[1][1]) / total, (cross[1][0] - cross[0][1]) / total);
        [[a, -b], [b, a]]
    } else {
        let determinant = xx * yy - xy * xy;
        cross.map(|[x, y]| [(x * yy - y * xy) / determinant, (y * xx - x * xy) / determinant])
    };
    let shift = |row: usize| to_mean[row] - linear[row][0] * from_mean[0] - linear[row][1] * from_mean[1];
    let [[a, b], [c, d]] = linear;
    let map = Homography([a, b, shift(0), c, d, shift(1), 0.0, 0.0, 1.0]);
    map.is_finite().then_some(map)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn linear_models_fit_what_they_can_hold() {
        let affine = Homography([1.1, 0.2, 5.0, -0.1, 0.9, -7.0, 0.0, 0.0, 1.0]);
        let similar = Homography([0.8, -0.3, 4.0, 0.3, 0.8, 9.0, 0.0, 0.0, 1.0]);
        let from: Vec<Point> = (0..30).map(|i| [f64::from(i * 37 % 101), f64::from(i * 53 % 89)]).collect();
        for (map, model) in
            [(affine, MosaicModel::Affine), (similar, MosaicModel::Similarity), (similar, MosaicModel::Affine)]
        {
            let mut to: Vec<Point> = from.iter().map(|p| map.map(*p)).collect();
            let mut mask = vec![true; from.len()];
            (to[3], mask[3]) = ([500.0, 500.0], false);
            let fit = linear_fit(&from, &to, &mask, model).unwrap();
            assert!(fit.0.iter().zip(map.0).all(|(a, b)| (a - b).abs() < 1e-9), "{model:?}: {fit:?}");
        }
    }
}
