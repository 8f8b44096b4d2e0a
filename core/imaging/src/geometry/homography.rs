//! Plane homographies: algebra, direct linear transform, least-squares refinement.
//!
//! R. Hartley, A. Zisserman, "Multiple View Geometry in Computer Vision", 2nd ed., chapter 4.

use super::solve::{jacobi_smallest, solve_symmetric};

/// A point `[x, y]` in pixels.
pub type Point = [f64; 2];

/// A map is singular when its determinant is smaller than this part of the product of its rows' lengths.
///
/// That product bounds the determinant (Hadamard's inequality), so the rule does not depend on the scale of the matrix. Rounding of the
/// nine products alone leaves about five times 2.2e-16 of it: a smaller determinant says nothing, not even its sign.
pub const SINGULAR_DETERMINANT: f64 = 1e-15;

/// A projective map of the plane, row-major, scaled so that the last element is 1 where that is possible.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Homography(pub [f64; 9]);

impl Default for Homography {
    fn default() -> Self {
        Self::identity()
    }
}

impl Homography {
    /// The map that changes nothing.
    pub const fn identity() -> Self {
        Self([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])
    }

    /// Moves every point by `(x, y)` pixels.
    pub fn translation(x: f64, y: f64) -> Self {
        Self([1.0, 0.0, x, 0.0, 1.0, y, 0.0, 0.0, 1.0])
    }

    /// Multiplies coordinates by `factor`.
    pub fn scaling(factor: f64) -> Self {
        Self([factor, 0.0, 0.0, 0.0, factor, 0.0, 0.0, 0.0, 1.0])
    }

    /// Where `(x, y)` goes. Infinite or NaN on the horizon.
    pub fn map(&self, [x, y]: Point) -> Point {
        let h = &self.0;
        let w = h[6] * x + h[7] * y + h[8];
        [(h[0] * x + h[1] * y + h[2]) / w, (h[3] * x + h[4] * y + h[5]) / w]
    }

    /// Third homogeneous coordinate of the image of `(x, y)`.
    pub fn weight(&self, [x, y]: Point) -> f64 {
        self.0[6] * x + self.0[7] * y + self.0[8]
    }

    /// The four warped corner pixels of a `width` x `height` frame: top left, top right, bottom right, bottom left.
    ///
    /// `None` when the frame is empty, or a corner is on or behind the horizon or not finite.
    pub fn map_corners(&self, width: usize, height: usize) -> Option<[Point; 4]> {
        let (right, bottom) = (width.checked_sub(1)? as f64, height.checked_sub(1)? as f64);
        let mut corners = [[0.0, 0.0], [right, 0.0], [right, bottom], [0.0, bottom]];
        let sign = self.weight(corners[0]).signum();
        for corner in &mut corners {
            let weight = self.weight(*corner);
            let in_front = weight * sign > 1e-9;
            if !in_front {
                return None;
            }
            *corner = self.map(*corner);
            if !(corner[0].is_finite() && corner[1].is_finite()) {
                return None;
            }
        }
        Some(corners)
    }

    /// First `other`, then this map.
    pub fn compose(&self, other: &Homography) -> Homography {
        let (a, b) = (&self.0, &other.0);
        let mut c = [0.0; 9];
        for row in 0..3 {
            for column in 0..3 {
                c[row * 3 + column] =
                    a[row * 3] * b[column] + a[row * 3 + 1] * b[3 + column] + a[row * 3 + 2] * b[6 + column];
            }
        }
        Homography(c).normalized()
    }

    /// The matrix product `self * other`, at the scale that it has.
    pub fn product(&self, other: &Homography) -> Homography {
        let (a, b) = (&self.0, &other.0);
        let mut c = [0.0; 9];
        for (index, value) in c.iter_mut().enumerate() {
            let (row, column) = (index / 3, index % 3);
            *value = (0..3).map(|k| a[row * 3 + k] * b[k * 3 + column]).sum();
        }
        Homography(c)
    }

    /// The map back, or `None` when this one is singular (see [`SINGULAR_DETERMINANT`]).
    pub fn inverse(&self) -> Option<Homography> {
        let inverse = Homography(self.inverse_raw()?).normalized();
        inverse.is_finite().then_some(inverse)
    }

    /// The map back, scaled so that its largest element is 1 or -1; points in front of the camera keep a positive weight.
    /// `None` when this map is singular.
    pub fn inverse_bounded(&self) -> Option<Homography> {
        let scale = self.0.iter().fold(0.0f64, |largest, value| largest.max(value.abs()));
        let scaled = Homography(self.0.map(|value| value / scale));
        let (adjugate, determinant) = scaled.adjugate();
        if scaled.is_singular(determinant) {
            return None;
        }
        let size = adjugate.iter().fold(0.0f64, |largest, value| largest.max(value.abs()));
        Some(Homography(adjugate.map(|value| value / size * determinant.signum())))
    }

    /// The inverse matrix at its own scale.
    pub(crate) fn inverse_raw(&self) -> Option<[f64; 9]> {
        let (adjugate, determinant) = self.adjugate();
        if self.is_singular(determinant) {
            return None;
        }
        Some(adjugate.map(|value| value / determinant))
    }

    /// The transposed cofactors, and the determinant.
    fn adjugate(&self) -> ([f64; 9], f64) {
        let h = &self.0;
        let adjugate = [
            h[4] * h[8] - h[5] * h[7],
            h[2] * h[7] - h[1] * h[8],
            h[1] * h[5] - h[2] * h[4],
            h[5] * h[6] - h[3] * h[8],
            h[0] * h[8] - h[2] * h[6],
            h[2] * h[3] - h[0] * h[5],
            h[3] * h[7] - h[4] * h[6],
            h[1] * h[6] - h[0] * h[7],
            h[0] * h[4] - h[1] * h[3],
        ];
        (adjugate, h[0] * adjugate[0] + h[1] * adjugate[3] + h[2] * adjugate[6])
    }

    fn is_singular(&self, determinant: f64) -> bool {
        let [a, b, c, d, e, f, g, h, i] = self.0;
        // Squares on both sides: three roots less for each sample of a RANSAC.
        let bound = (a * a + b * b + c * c) * (d * d + e * e + f * f) * (g * g + h * h + i * i);
        let is_regular = determinant * determinant >= SINGULAR_DETERMINANT * SINGULAR_DETERMINANT * bound;
        !(is_regular && determinant != 0.0 && determinant.is_finite() && bound.is_finite())
    }

    /// Scaled so that the last element is 1, unless that is (nearly) zero.
    pub fn normalized(&self) -> Homography {
        let last = self.0[8];
        if last.abs() < 1e-12 { *self } else { Homography(self.0.map(|value| value / last)) }
    }

    /// Whether every element is a finite number.
    pub fn is_finite(&self) -> bool {
        self.0.iter().all(|value| value.is_finite())
    }

    /// Carries a map between two shrunk regions back to the full frames (thesis, Alg. 2.2).
    ///
    /// `full = T(to) S(k) H S(1/k) T(-from)`, where `from` and `to` are the regions' first pixels in the source
    /// and the target frame. Pixel centres are whole numbers, so shrinking also shifts by half a pixel.
    pub fn unshrink(&self, to: Point, from: Point, shrink: f64) -> Homography {
        let half = (shrink - 1.0) * 0.5;
        let grow = Self::translation(to[0] + half, to[1] + half).compose(&Self::scaling(shrink));
        let reduce = Self::scaling(1.0 / shrink).compose(&Self::translation(-from[0] - half, -from[1] - half));
        grow.compose(self).compose(&reduce)
    }

    /// Squared distance between `target` and where `source` goes.
    pub fn squared_error(&self, source: Point, target: Point) -> f64 {
        let [x, y] = self.map(source);
        (x - target[0]) * (x - target[0]) + (y - target[1]) * (y - target[1])
    }

    /// The map with `H source = target` in the least-squares sense of the direct linear transform.
    ///
    /// Hartley-normalised (Hartley and Zisserman, algorithm 4.2). `None` for fewer than four pairs or degenerate
    /// ones. `select` picks the pairs that take part.
    pub fn fit(source: &[Point], target: &[Point], select: impl Fn(usize) -> bool) -> Option<Homography> {
        let count = source.len().min(target.len());
        let from = Normalizer::of(&source[..count], &select)?;
        let to = Normalizer::of(&target[..count], &select)?;
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
            (Normalizer::of(&source[..count], &select), Normalizer::of(&target[..count], &select))
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

/// Moves points to their centroid and scales their mean distance to sqrt(2).
#[derive(Clone, Copy, Debug)]
struct Normalizer {
    x: f64,
    y: f64,
    scale: f64,
}

impl Normalizer {
    fn of(points: &[Point], select: impl Fn(usize) -> bool) -> Option<Self> {
        let chosen = || points.iter().enumerate().filter(|(index, _)| select(*index)).map(|(_, point)| point);
        let (mut count, mut x, mut y) = (0usize, 0.0, 0.0);
        for point in chosen() {
            (count, x, y) = (count + 1, x + point[0], y + point[1]);
        }
        if count < 4 {
            return None;
        }
        (x, y) = (x / count as f64, y / count as f64);
        let mean: f64 = chosen().map(|point| (point[0] - x).hypot(point[1] - y)).sum::<f64>() / count as f64;
        (mean.is_finite() && mean > 1e-9).then(|| Self { x, y, scale: std::f64::consts::SQRT_2 / mean })
    }

    fn apply(&self, point: Point) -> Point {
        [(point[0] - self.x) * self.scale, (point[1] - self.y) * self.scale]
    }

    fn matrix(&self) -> Homography {
        let s = self.scale;
        Homography([s, 0.0, -s * self.x, 0.0, s, -s * self.y, 0.0, 0.0, 1.0])
    }

    fn inverse(&self) -> Homography {
        let s = 1.0 / self.scale;
        Homography([s, 0.0, self.x, 0.0, s, self.y, 0.0, 0.0, 1.0])
    }
}
