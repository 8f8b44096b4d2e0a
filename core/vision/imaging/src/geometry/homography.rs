//! Plane homographies: algebra.
//!
//! R. Hartley, A. Zisserman, "Multiple View Geometry in Computer Vision", 2nd ed., chapter 4.

/// A point `[x, y]` in pixels.
pub type Point = [f64; 2];

/// Length of a vector whose square does not overflow, faster than `hypot`.
pub(crate) fn length([x, y]: Point) -> f64 {
    (x * x + y * y).sqrt()
}

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
}
