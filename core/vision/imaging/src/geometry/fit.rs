//! Fits homographies to pairs of points: direct linear transform, least-squares refinement.
//!
//! R. Hartley, A. Zisserman, "Multiple View Geometry in Computer Vision", 2nd ed., chapter 4.

use std::f64::consts::SQRT_2;

use super::homography::{Homography, Point};
use super::normalizer::Normalizer;
use super::solve::{jacobi_smallest, solve_symmetric};

impl Homography {
    /// The map with `H source = target` in the least-squares sense of the direct linear transform.
    ///
    /// Hartley-normalised (Hartley and Zisserman, algorithm 4.2). `None` for fewer than four pairs or degenerate
    /// ones. `select` picks the pairs that take part.
    pub fn fit(source: &[Point], target: &[Point], select: impl Fn(usize) -> bool) -> Option<Homography> {
        let count = source.len().min(target.len());
        let from = Normalizer::of(&source[..count], &select, SQRT_2)?;
        let to = Normalizer::of(&target[..count], &select, SQRT_2)?;
        let mut normal = [[0.0f64; 9]; 9];
        for index in (0..count).filter(|&index| select(index)) {
            let [x, y] = from.apply(source[index]);
            let [u, v] = to.apply(target[index]);
            let rows = [[-x, -y, -1.0, 0.0, 0.0, 0.0, u * x, u * y, u], [0.0, 0.0, 0.0, -x, -y, -1.0, v * x, v * y, v]];
            for row in &rows {
                for i in 0..9 {
                    for j in i..9 {
                        normal[i][j] += row[i] * row[j];
                    }
                }
            }
        }
        for i in 0..9 {
            for j in 0..i {
                normal[i][j] = normal[j][i];
            }
        }
        let solution = jacobi_smallest(&mut normal)?;
        let map = to.inverse().product(&Homography(solution)).product(&from.matrix()).normalized();
        (map.is_finite() && map.inverse().is_some()).then_some(map)
    }

    /// Levenberg-Marquardt on the reprojection error in the target frame, at most `iterations` steps.
    ///
    /// Returns the better map; never one with a larger error than this one's.
    pub fn refine(
        &self,
        source: &[Point],
        target: &[Point],
        select: impl Fn(usize) -> bool,
        iterations: usize,
    ) -> Homography {
        self.refine_robust(source, target, select, iterations, f64::INFINITY)
    }

    /// As [`Homography::refine`], with the Cauchy loss: errors well above `scale_px` hardly pull.
    ///
    /// Large keypoints are placed several times less exactly than small ones; plain squares would follow them.
    pub fn refine_robust(
        &self,
        source: &[Point],
        target: &[Point],
        select: impl Fn(usize) -> bool,
        iterations: usize,
        scale_px: f64,
    ) -> Homography {
        let count = source.len().min(target.len());
        let (Some(from), Some(to)) =
            (Normalizer::of(&source[..count], &select, SQRT_2), Normalizer::of(&target[..count], &select, SQRT_2))
        else {
            return *self;
        };
        // Work where coordinates are about 1, so that one damping suits all eight parameters.
        let mut map = to.matrix().product(self).product(&from.inverse()).normalized();
        let pairs = || (0..count).filter(|&index| select(index));
        // Errors in units of the loss's scale; without one the loss is the square itself.
        let per_scale = 1.0 / (scale_px.max(1e-6) * to.scale).powi(2);
        let loss = |squared: f64| if per_scale > 0.0 { (squared * per_scale).ln_1p() / per_scale } else { squared };
        let error = |map: &Homography| -> f64 {
            pairs().map(|index| loss(map.squared_error(from.apply(source[index]), to.apply(target[index])))).sum()
        };
        let mut best = error(&map);
        let mut damping = 1e-3;
        for _ in 0..iterations {
            let mut normal = [[0.0f64; 8]; 8];
            let mut gradient = [0.0f64; 8];
            for index in pairs() {
                let [x, y] = from.apply(source[index]);
                let [u, v] = to.apply(target[index]);
                let inverse = 1.0 / map.weight([x, y]);
                let [px, py] = map.map([x, y]);
                let (xs, ys) = (x * inverse, y * inverse);
                let squared = (u - px) * (u - px) + (v - py) * (v - py);
                let weight = 1.0 / (1.0 + squared * per_scale);
                let rows = [
                    ([xs, ys, inverse, 0.0, 0.0, 0.0, -px * xs, -px * ys], u - px),
                    ([0.0, 0.0, 0.0, xs, ys, inverse, -py * xs, -py * ys], v - py),
                ];
                for (row, residual) in &rows {
                    for i in 0..8 {
                        let weighted = row[i] * weight;
                        gradient[i] += weighted * residual;
                        for j in i..8 {
                            normal[i][j] += weighted * row[j];
                        }
                    }
                }
            }
            let mut improved = false;
            for _ in 0..4 {
                let mut damped = normal;
                for i in 0..8 {
                    damped[i][i] += damping * (normal[i][i] + 1e-12);
                    for j in 0..i {
                        damped[i][j] = damped[j][i];
                    }
                }
                let Some(step) = solve_symmetric(&damped, &gradient) else {
                    damping *= 10.0;
                    continue;
                };
                let mut candidate = map;
                for (value, change) in candidate.0.iter_mut().zip(step) {
                    *value += change;
                }
                let value = error(&candidate);
                if value < best {
                    improved = best - value > best * 1e-9;
                    (map, best) = (candidate, value);
                    damping *= 0.1;
                    break;
                }
                damping *= 10.0;
            }
            if !improved {
                break;
            }
        }
        let refined = to.inverse().product(&map).product(&from.matrix()).normalized();
        if refined.is_finite() { refined } else { *self }
    }
}
