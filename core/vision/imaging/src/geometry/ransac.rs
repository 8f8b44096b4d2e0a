//! Seeded RANSAC for homographies (Fischler and Bolles 1981; thesis, section 2.2).

use super::homography::{Homography, Point};
use super::normalizer::Normalizer;
use crate::Simd;
use crate::simd::dispatch;
use panoscope_base::random::SplitMix64;

/// Threshold, confidence and seed of the estimation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RansacParams {
    /// Largest reprojection error of an inlier in the target frame, in pixels.
    pub threshold_px: f64,
    /// Wanted probability that one sample held inliers only.
    pub confidence: f64,
    /// Largest number of samples.
    pub max_iterations: usize,
    /// Seed of the sampling; the same seed and pairs give the same result.
    pub seed: u64,
}

impl Default for RansacParams {
    fn default() -> Self {
        Self { threshold_px: 3.0, confidence: 0.999, max_iterations: 2000, seed: 1 }
    }
}

/// A homography with its support.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RansacFit {
    /// Maps source points to target points, refitted on all inliers.
    pub homography: Homography,
    /// Number of inliers.
    pub inliers: usize,
    /// Root mean square error of the inliers in the target frame, in pixels.
    pub rms_px: f64,
    /// Number of samples that were drawn.
    pub iterations: usize,
}

/// Why there is no homography.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RansacError {
    /// A homography needs four pairs.
    TooFewMatches {
        /// Pairs that were given.
        found: usize,
    },
    /// No four pairs without three on a line were in agreement.
    Degenerate,
}

impl std::fmt::Display for RansacError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::TooFewMatches { found } => write!(f, "a homography needs at least 4 matches, got {found}"),
            Self::Degenerate => write!(f, "no four matches in general position agree on a homography"),
        }
    }
}

impl std::error::Error for RansacError {}

/// RANSAC with its work memory.
#[derive(Clone, Debug, Default)]
pub struct Ransac {
    simd: Simd,
    x: Vec<f32>,
    y: Vec<f32>,
    u: Vec<f32>,
    v: Vec<f32>,
}

impl Ransac {
    /// An estimator without memory yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Reserves memory for up to `count` pairs, so that frames with more of them than any before allocate nothing.
    pub fn reserve(&mut self, count: usize) {
        for list in [&mut self.x, &mut self.y, &mut self.u, &mut self.v] {
            list.reserve(count.saturating_sub(list.len()));
        }
    }

    /// The homography most pairs agree on; `mask` becomes one flag per pair.
    ///
    /// # Errors
    /// [`RansacError::TooFewMatches`] below four pairs, [`RansacError::Degenerate`] when no sample in general
    /// position has four inliers.
    pub fn estimate(
        &mut self,
        from: &[Point],
        to: &[Point],
        params: &RansacParams,
        mask: &mut Vec<bool>,
    ) -> Result<RansacFit, RansacError> {
        let count = from.len().min(to.len());
        mask.clear();
        mask.resize(count, false);
        if count < 4 {
            return Err(RansacError::TooFewMatches { found: count });
        }
        let (source, target) =
            (Normalizer::of(&from[..count], |_| true, 1.0), Normalizer::of(&to[..count], |_| true, 1.0));
        let (Some(source), Some(target)) = (source, target) else {
            return Err(RansacError::Degenerate);
        };
        for list in [&mut self.x, &mut self.y, &mut self.u, &mut self.v] {
            list.clear();
            list.reserve(count);
        }
        for (from, to) in from.iter().zip(to) {
            let ([x, y], [u, v]) = (source.apply(*from), target.apply(*to));
            self.x.push(x as f32);
            self.y.push(y as f32);
            self.u.push(u as f32);
            self.v.push(v as f32);
        }
        let limit = params.threshold_px.max(1e-6) * target.scale;
        let limit = (limit * limit) as f32;
        let mut random = SplitMix64(params.seed);
        let mut best: Option<(usize, [f64; 9])> = None;
        let mut needed = params.max_iterations.max(1);
        let mut iterations = 0;
        while iterations < needed {
            iterations += 1;
            let Some(sample) = draw(&mut random, count) else {
                break;
            };
            let pick = |points: &[Point], frame: &Normalizer| sample.map(|index| frame.apply(points[index]));
            let Some(map) = from_four(&pick(from, &source), &pick(to, &target)) else {
                continue;
            };
            let inliers = self.count(&map, limit);
            if inliers > best.map_or(3, |(most, _)| most) {
                best = Some((inliers, map));
                needed = needed.min(enough(inliers as f64 / count as f64, params.confidence));
            }
        }
        let Some((_, map)) = best else {
            return Err(RansacError::Degenerate);
        };
        let map = target.inverse().compose(&Homography(map)).compose(&source.matrix());
        let (map, inliers, squares) = polish(map, &from[..count], &to[..count], params.threshold_px, mask)?;
        let rms_px = (squares / inliers as f64).sqrt();
        Ok(RansacFit { homography: map, inliers, rms_px, iterations })
    }

    fn count(&self, map: &[f64; 9], limit: f32) -> usize {
        let map: [f32; 9] = map.map(|value| value as f32);
        let (map, x, y, u, v) = (&map, &self.x[..], &self.y[..], &self.u[..], &self.v[..]);
        dispatch!(self.simd, count_inliers(map: &[f32; 9], x: &[f32], y: &[f32], u: &[f32], v: &[f32], limit: f32) -> usize)
    }
}

/// Refits on the inliers until they stay the same, at most a few times.
///
/// The sample's own map is hardly ever the best one, even where it happens to gather a pair or two more, so the
/// refitted one stands unless it loses a fifth of them.
fn polish(
    start: Homography,
    from: &[Point],
    to: &[Point],
    threshold_px: f64,
    mask: &mut [bool],
) -> Result<(Homography, usize, f64), RansacError> {
    let limit = threshold_px * threshold_px;
    let judge = |map: &Homography, mask: &mut [bool]| {
        let (mut inliers, mut squares, mut changed) = (0usize, 0.0, false);
        for (flag, (&from, &to)) in mask.iter_mut().zip(from.iter().zip(to)) {
            let error = map.squared_error(from, to);
            changed |= *flag != (error <= limit);
            *flag = error <= limit;
            if *flag {
                inliers += 1;
                squares += error;
            }
        }
        (inliers, squares, changed)
    };
    let (inliers, squares, _) = judge(&start, mask);
    let mut best = (start, inliers, squares);
    for _ in 0..4 {
        let chosen = &*mask;
        let Some(fitted) = Homography::fit(from, to, |index| chosen[index]) else {
            break;
        };
        let spread_px = (best.2 / best.1.max(1) as f64).sqrt();
        let map = fitted.refine_robust(from, to, |index| chosen[index], 8, (spread_px * 0.5).max(0.02));
        let (inliers, squares, changed) = judge(&map, mask);
        if inliers * 5 < best.1 * 4 {
            break;
        }
        best = (map, inliers, squares);
        if !changed {
            break;
        }
    }
    let (inliers, squares, _) = judge(&best.0, mask);
    if inliers < 4 { Err(RansacError::Degenerate) } else { Ok((best.0, inliers, squares)) }
}

/// Samples after which the confidence is reached: p = 1 - (1 - w^4)^n.
fn enough(share: f64, confidence: f64) -> usize {
    let miss = 1.0 - share.powi(4);
    if miss <= 1e-12 {
        return 1;
    }
    let samples = (1.0 - confidence.clamp(0.0, 1.0 - 1e-12)).ln() / miss.ln();
    if samples.is_finite() { samples.ceil().clamp(1.0, 1e9) as usize } else { usize::MAX }
}

fn draw(random: &mut SplitMix64, count: usize) -> Option<[usize; 4]> {
    let mut sample = [0; 4];
    for place in 0..4 {
        // With four or more pairs a few tries always find a new one.
        let mut tries = 0;
        loop {
            let index = random.below(count);
            if !sample[..place].contains(&index) {
                sample[place] = index;
                break;
            }
            tries += 1;
            if tries > 1000 {
                return None;
            }
        }
    }
    Some(sample)
}

#[inline(always)]
fn count_inliers(map: &[f32; 9], x: &[f32], y: &[f32], u: &[f32], v: &[f32], limit: f32) -> usize {
    let count = x.len();
    let (y, u, v) = (&y[..count], &u[..count], &v[..count]);
    let mut inliers = 0i32;
    for i in 0..count {
        let w = map[6] * x[i] + map[7] * y[i] + map[8];
        let ex = map[0] * x[i] + map[1] * y[i] + map[2] - u[i] * w;
        let ey = map[3] * x[i] + map[4] * y[i] + map[5] - v[i] * w;
        // The error times w: no division, and points behind the horizon drop out.
        let near = (ex * ex + ey * ey <= limit * (w * w)) & (w > 0.0);
        inliers += i32::from(near);
    }
    inliers as usize
}

/// The homography through four pairs, scaled so that all four lie in front; `None` when three points of a side
/// are (nearly) on a line, or the sides differ in orientation.
fn from_four(from: &[Point; 4], to: &[Point; 4]) -> Option<[f64; 9]> {
    let (a, b) = (basis(from)?, basis(to)?);
    // Every pair must be on the same side of both bases, or the map folds the sample.
    if a.1.iter().zip(&b.1).any(|(&a, &b)| a * b <= 0.0) || a.2 * b.2 <= 0.0 {
        return None;
    }
    let inverse = Homography(a.0).inverse_raw()?;
    let mut map = [0.0; 9];
    for (index, value) in map.iter_mut().enumerate() {
        let (row, column) = (index / 3, index % 3);
        *value = (0..3).map(|k| b.0[row * 3 + k] * inverse[k * 3 + column]).sum();
    }
    let weight = map[6] * from[0][0] + map[7] * from[0][1] + map[8];
    let scale = 1.0 / weight;
    let map = map.map(|value| value * scale);
    map.iter().all(|value| value.is_finite()).then_some(map)
}

/// Least triangle of a sample, in squares of the frame's unit (the spread of all points is about 1).
const MIN_TRIANGLE: f64 = 2e-3;

/// The matrix that takes the projective basis to four points, its coefficients and its orientation.
fn basis(points: &[Point; 4]) -> Option<([f64; 9], [f64; 3], f64)> {
    let [a, b, c, d] = *points;
    let cross = |p: Point, q: Point, r: Point| (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]);
    let whole = cross(a, b, c);
    let parts = [cross(d, b, c), cross(a, d, c), cross(a, b, d)];
    let wide = |part: &f64| part.abs() > MIN_TRIANGLE;
    if !(wide(&whole) && parts.iter().all(wide)) {
        return None;
    }
    let k = parts.map(|part| part / whole);
    let matrix = [k[0] * a[0], k[1] * b[0], k[2] * c[0], k[0] * a[1], k[1] * b[1], k[2] * c[1], k[0], k[1], k[2]];
    Some((matrix, k, whole))
}
