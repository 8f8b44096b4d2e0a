//! Robust estimation from an overlap too narrow to determine a homography.
//!
//! A strip some tens of pixels wide leaves five of a homography's eight parameters undetermined: in a free fit the far side of the view folds
//! over or grows without bound. Between two parallel cameras a point moves along the baseline, by an amount that depends on its depth;
//! within a strip that amount is about linear in the position. The displacement is therefore modelled as an affine function with a prior
//! on a plain translation, and errors along the displacement, which are parallax, may be larger than those across it.

use super::homography::{Homography, Point};
use super::ransac::RansacFit;
use super::solve::solve_symmetric;
use panoscope_base::random::SplitMix64;

/// Number of samples of two pairs.
const SAMPLES: usize = 512;
/// Error allowed along the displacement over that allowed across it: tissue is not a plane.
pub const ALONG: f64 = 4.0;
/// Slopes of the displacement beyond this are wrong matches: the far side of the view would be stretched or squeezed by a fifth.
const MAX_SLOPE: f64 = 0.2;
/// Prior on a constant displacement: standard deviation of its slopes.
const SLOPE_DEVIATION: f64 = 0.06;
/// Pairs whose errors are correlated.
const ALIKE: f64 = 4.0;
/// Smallest distance of a sample's points from which a slope is computed, px.
const MIN_SPAN_PX: f64 = 24.0;
/// Rounds of the reweighted fit.
const ROUNDS: usize = 5;

/// Thresholds and seed of the estimation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NarrowParams {
    /// Largest error of an inlier across the displacement, px of the target frame.
    pub threshold_px: f64,
    /// Fewer inliers than this are no fit.
    pub min_inliers: usize,
    /// Seed of the sampling; the same seed and pairs give the same result.
    pub seed: u64,
}

/// Displacement of source points: `offset + x_slope * x + y_slope * y`, each a vector.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Displacement {
    offset: Point,
    x_slope: Point,
    y_slope: Point,
}

impl Displacement {
    /// The translation of one pair.
    fn shift((from, to): (Point, Point)) -> Self {
        Self { offset: [to[0] - from[0], to[1] - from[1]], ..Self::default() }
    }

    fn at(&self, [x, y]: Point) -> Point {
        std::array::from_fn(|i| self.offset[i] + self.x_slope[i] * x + self.y_slope[i] * y)
    }

    /// Linear along the line through two pairs, constant across it.
    fn through(a: (Point, Point), b: (Point, Point)) -> Option<Self> {
        let line: Point = std::array::from_fn(|i| b.0[i] - a.0[i]);
        let squared = line[0] * line[0] + line[1] * line[1];
        if squared < MIN_SPAN_PX * MIN_SPAN_PX {
            return None;
        }
        let first: Point = std::array::from_fn(|i| a.1[i] - a.0[i]);
        let change: Point = std::array::from_fn(|i| b.1[i] - b.0[i] - first[i]);
        let (x_slope, y_slope) = (change.map(|c| c * line[0] / squared), change.map(|c| c * line[1] / squared));
        let offset = std::array::from_fn(|i| first[i] - x_slope[i] * a.0[0] - y_slope[i] * a.0[1]);
        Some(Self { offset, x_slope, y_slope }).filter(Self::is_plausible)
    }

    fn is_plausible(&self) -> bool {
        // NaN is not plausible.
        self.x_slope.iter().chain(&self.y_slope).all(|slope| slope.abs() <= MAX_SLOPE)
            && self.offset.iter().all(|value| value.is_finite())
    }

    /// Squared error of a pair in units of the threshold; parallax counts less.
    fn squared_error(&self, from: Point, to: Point, threshold_px: f64) -> f64 {
        let moved = self.at(from);
        let error = [from[0] + moved[0] - to[0], from[1] + moved[1] - to[1]];
        let length = moved[0].hypot(moved[1]).max(1e-9);
        let along = (error[0] * moved[0] + error[1] * moved[1]) / length;
        let across = (error[0] * moved[1] - error[1] * moved[0]) / length;
        (along / ALONG).mul_add(along / ALONG, across * across) / (threshold_px * threshold_px)
    }

    fn homography(&self) -> Homography {
        let (x, y, c) = (self.x_slope, self.y_slope, self.offset);
        Homography([1.0 + x[0], y[0], c[0], x[1], 1.0 + y[1], c[1], 0.0, 0.0, 1.0])
    }

    /// Least squares over the inliers with the prior on the slopes.
    fn refit(&self, from: &[Point], to: &[Point], threshold_px: f64) -> Option<Self> {
        let inliers = || from.iter().zip(to).filter(|(f, t)| self.squared_error(**f, **t, threshold_px) < 1.0);
        let (mut middle, mut count) = ([0.0; 2], 0.0);
        for (f, _) in inliers() {
            middle = [middle[0] + f[0], middle[1] + f[1]];
            count += 1.0;
        }
        if count < 3.0 {
            return None;
        }
        let middle = middle.map(|m| m / count);
        // Around the middle the offset does not depend on the slopes.
        let (mut normal, mut right, mut mean) = ([[0.0; 2]; 2], [[0.0; 2]; 2], [0.0; 2]);
        for (f, t) in inliers() {
            let place = [f[0] - middle[0], f[1] - middle[1]];
            for i in 0..2 {
                let moved = t[i] - f[i];
                mean[i] += moved / count;
                right[i][0] += place[0] * moved;
                right[i][1] += place[1] * moved;
                normal[i][0] += place[i] * place[0];
                normal[i][1] += place[i] * place[1];
            }
        }
        // The noise of a pair is about a third of what is allowed; it is mostly relief, which neighbours share, so that more pairs do not
        // lessen it as independent ones would.
        let prior = count / ALIKE * (ALONG * threshold_px / 3.0 / SLOPE_DEVIATION).powi(2);
        normal[0][0] += prior;
        normal[1][1] += prior;
        let [u, v] = [solve_symmetric(&normal, &right[0])?, solve_symmetric(&normal, &right[1])?];
        let (x_slope, y_slope) = ([u[0], v[0]], [u[1], v[1]]);
        let offset = std::array::from_fn(|i| mean[i] - x_slope[i] * middle[0] - y_slope[i] * middle[1]);
        Some(Self { offset, x_slope, y_slope })
    }
}

/// The affine map near a translation that most pairs agree on; `mask` becomes one flag per pair. `None` when fewer than `min_inliers` agree.
pub fn fit_narrow(from: &[Point], to: &[Point], params: &NarrowParams, mask: &mut Vec<bool>) -> Option<RansacFit> {
    let count = from.len().min(to.len());
    mask.clear();
    mask.resize(count, false);
    let least = params.min_inliers.max(3);
    if count < least {
        return None;
    }
    let (from, to, threshold_px) = (&from[..count], &to[..count], params.threshold_px.max(1e-6));
    let mut random = SplitMix64(params.seed);
    let mut best: Option<(f64, Displacement)> = None;
    for sample in 0..SAMPLES + count {
        let mut draw = || {
            let index = random.below(count);
            (from[index], to[index])
        };
        // Each pair alone, then two at a time.
        let model = match sample.checked_sub(count) {
            None => Some(Displacement::shift((from[sample], to[sample]))),
            Some(_) => Displacement::through(draw(), draw()),
        };
        let Some(model) = model else { continue };
        // MSAC (Torr and Zisserman 2000): an outlier costs its threshold.
        let cost: f64 = from.iter().zip(to).map(|(f, t)| model.squared_error(*f, *t, threshold_px).min(1.0)).sum();
        if best.is_none_or(|(least, _)| cost < least) {
            best = Some((cost, model));
        }
    }
    let mut model = best?.1;
    for _ in 0..ROUNDS {
        model = model.refit(from, to, threshold_px)?;
    }
    if !model.is_plausible() {
        return None;
    }
    let (homography, mut inliers, mut squares) = (model.homography(), 0, 0.0);
    for ((flag, f), t) in mask.iter_mut().zip(from).zip(to) {
        *flag = model.squared_error(*f, *t, threshold_px) < 1.0;
        if *flag {
            inliers += 1;
            squares += homography.squared_error(*f, *t);
        }
    }
    let rms_px = (squares / f64::max(inliers as f64, 1.0)).sqrt();
    (inliers >= least).then_some(RansacFit { homography, inliers, rms_px, iterations: SAMPLES + count })
}

#[cfg(test)]
mod tests {
    use super::*;

    const PARAMS: NarrowParams = NarrowParams { threshold_px: 5.0, min_inliers: 8, seed: 1 };

    /// Pairs of a strip 50 px wide: the right view's left edge and where the left view shows it.
    fn pairs(displacement: impl Fn(f64, f64) -> Point) -> (Vec<Point>, Vec<Point>) {
        let from: Vec<Point> = (0..40).map(|i| [f64::from(i * 17 % 50), f64::from(i * 12)]).collect();
        let to = from.iter().map(|&[x, y]| [x + displacement(x, y)[0], y + displacement(x, y)[1]]).collect();
        (from, to)
    }

    #[test]
    fn curved_tissue_in_a_strip_keeps_the_far_side_of_the_view() {
        // Relief of 15 px that no plane follows, and a third of wrong matches.
        let relief = |x: f64, y: f64| 570.0 + 0.03 * y + 8.0 * (y / 60.0).sin() + 7.0 * (x / 9.0).cos();
        let (from, mut to) = pairs(|x, y| [relief(x, y), 1.0]);
        for (index, place) in to.iter_mut().enumerate().filter(|(index, _)| index % 3 == 0) {
            *place = [480.0 + (index * 37 % 160) as f64, (index * 101 % 480) as f64];
        }
        let mut mask = Vec::new();
        let fit = fit_narrow(&from, &to, &PARAMS, &mut mask).unwrap();
        assert!(fit.inliers >= 22 && mask.iter().filter(|inlier| **inlier).count() == fit.inliers, "{fit:?}");
        for corner in [[639.0, 0.0], [639.0, 479.0]] {
            let [u, v] = fit.homography.map(corner);
            let expected = 639.0 + 570.0 + 0.03 * corner[1];
            assert!((u - expected).abs() < 40.0 && (v - corner[1] - 1.0).abs() < 10.0, "{corner:?} goes to {u}, {v}");
        }
    }

    #[test]
    fn a_strip_above_another_is_registered_as_well() {
        let (from, to) = pairs(|x, _| [2.0, 430.0 + 0.05 * x]);
        let flip = |points: &[Point]| points.iter().map(|&[x, y]| [y, x]).collect::<Vec<_>>();
        let mut mask = Vec::new();
        let upright = fit_narrow(&from, &to, &PARAMS, &mut mask).unwrap().homography;
        let turned = fit_narrow(&flip(&from), &flip(&to), &PARAMS, &mut mask).unwrap().homography;
        let ([u, v], [q, p]) = (upright.map([30.0, 200.0]), turned.map([200.0, 30.0]));
        assert!((u - p).abs() < 1e-6 && (v - q).abs() < 1e-6 && (v - 631.5).abs() < 1.0, "{u}, {v}");
    }

    #[test]
    fn matches_without_a_common_displacement_are_refused() {
        let mut random = SplitMix64(3);
        let mut place = || [random.below(160) as f64, random.below(480) as f64];
        let (from, to): (Vec<Point>, Vec<Point>) = (0..60).map(|_| (place(), place())).unzip();
        let mut mask = Vec::new();
        assert_eq!(fit_narrow(&from, &to, &PARAMS, &mut mask), None);
        assert_eq!(fit_narrow(&from[..5], &to[..5], &PARAMS, &mut mask), None);
        assert_eq!(mask, [false; 5]);
    }
}
