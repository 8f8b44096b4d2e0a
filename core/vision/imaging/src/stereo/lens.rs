//! Lenses: where the ray `(x, y, 1)` appears on the plane at distance 1 behind the lens, and which ray appears at a position there.
//!
//! [`Equidistant`] is the model of Kannala and Brandt, "A generic camera model and calibration method for conventional, wide-angle, and fish-eye
//! lenses", 2006, with the four coefficients of OpenCV's `fisheye`, of Kalibr's `equidistant` and of ROS.

use crate::stereo::StereoError;

/// Distance of the farthest ray from the optical axis, at depth 1: 76 degrees. No rectified view reaches farther.
pub const MAX_RADIUS: f64 = 4.0;

/// Value of `tau_x` among the 14 coefficients of a packet `calibration` that marks an equidistant lens: no sensor is tilted so far.
pub const EQUIDISTANT_TAU: f64 = 1e6;

/// Steps in which a radius up to [`MAX_RADIUS`] is searched for a fold.
const STEPS: usize = 2000;

/// What a lens does to rays.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Lens {
    /// OpenCV's rational, tangential and thin-prism model: `k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4`.
    Polynomial([f64; 12]),
    /// A fisheye.
    Equidistant(Equidistant),
}

impl Lens {
    /// A pinhole.
    pub const NONE: Self = Self::Polynomial([0.0; 12]);

    /// Reads coefficients in any of OpenCV's lengths (0, 4, 5, 8, 12, or 14 with no tilt), or the 14 of [`Self::coefficients`].
    ///
    /// # Errors
    /// [`StereoError::Calibration`] for another length, a tilted sensor, or numbers next to the four of an equidistant lens.
    pub fn of_coefficients(d: &[f64]) -> Result<Self, StereoError> {
        let refuse = |reason: String| Err(StereoError::Calibration { reason });
        if ![0, 4, 5, 8, 12, 14].contains(&d.len()) {
            return refuse(format!("{} distortion coefficients (0, 4, 5, 8, 12 or 14 are known)", d.len()));
        }
        if d.len() == 14 && d[12] == EQUIDISTANT_TAU {
            if d[4..12].iter().chain(&d[13..]).any(|value| *value != 0.0) {
                return refuse("an equidistant lens has four coefficients".into());
            }
            return Ok(Self::Equidistant(Equidistant::new([d[0], d[1], d[2], d[3]])));
        }
        if d.len() == 14 && (d[12] != 0.0 || d[13] != 0.0) {
            return refuse("a tilted sensor (tau) is not supported".into());
        }
        let mut all = [0.0; 12];
        all.iter_mut().zip(d).for_each(|(to, value)| *to = *value);
        Ok(Self::Polynomial(all))
    }

    /// The coefficients as a packet `calibration` has them.
    pub fn coefficients(&self) -> [f64; 14] {
        let mut all = [0.0; 14];
        match self {
            Self::Polynomial(given) => all[..12].copy_from_slice(given),
            Self::Equidistant(lens) => {
                all[..4].copy_from_slice(&lens.k);
                all[12] = EQUIDISTANT_TAU;
            }
        }
        all
    }

    /// Whether all coefficients are finite.
    pub fn is_finite(&self) -> bool {
        self.coefficients().iter().all(|value| value.is_finite())
    }

    /// Where the ray `(x, y, 1)` appears.
    pub fn distort(&self, x: f64, y: f64) -> (f64, f64) {
        let [k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4] = match self {
            Self::Polynomial(k) => *k,
            Self::Equidistant(lens) => return lens.distort(x, y),
        };
        let r2 = x * x + y * y;
        let radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)));
        let xy = 2.0 * x * y;
        (
            x * radial + p1 * xy + p2 * (r2 + 2.0 * x * x) + r2 * (s1 + r2 * s2),
            y * radial + p1 * (r2 + 2.0 * y * y) + p2 * xy + r2 * (s3 + r2 * s4),
        )
    }

    /// The ray that appears at `(x0, y0)`. Of a polynomial by fixed-point iteration on its inverse, as no closed form exists. Beyond the rays that the
    /// lens has, the position itself (polynomial) or the farthest ray of that direction (equidistant).
    pub fn undistort(&self, x0: f64, y0: f64) -> (f64, f64) {
        let [k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4] = match self {
            Self::Polynomial(k) => *k,
            Self::Equidistant(lens) => return lens.undistort(x0, y0).unwrap_or_else(|| lens.farthest(x0, y0)),
        };
        let (mut x, mut y) = (x0, y0);
        for _ in 0..30 {
            let r2 = x * x + y * y;
            let inverse = (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))) / (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)));
            if !inverse.is_finite() || inverse < 0.0 {
                return (x0, y0);
            }
            let xy = 2.0 * x * y;
            let dx = p1 * xy + p2 * (r2 + 2.0 * x * x) + r2 * (s1 + r2 * s2);
            let dy = p1 * (r2 + 2.0 * y * y) + p2 * xy + r2 * (s3 + r2 * s4);
            (x, y) = ((x0 - dx) * inverse, (y0 - dy) * inverse);
        }
        (x, y)
    }

    /// Distance from the optical axis, at depth 1, from which on the radial distortion turns back: rays farther out land nearer to the centre again,
    /// on pixels that other rays already have. `None` where it never does. A polynomial that was fitted near the centre alone may turn back within
    /// the image.
    pub fn fold_radius(&self) -> Option<f64> {
        let [k1, k2, _, _, k3, k4, k5, k6, ..] = match self {
            Self::Polynomial(k) => *k,
            Self::Equidistant(lens) => return lens.is_folded().then(|| lens.limit_rad.tan()),
        };
        // The slope of `r * numerator / denominator`, times the square of the denominator, which does not change its sign.
        last_growing(MAX_RADIUS, |r| {
            let s = r * r;
            let (n, d) = (1.0 + s * (k1 + s * (k2 + s * k3)), 1.0 + s * (k4 + s * (k5 + s * k6)));
            let (dn, dd) = (k1 + s * (2.0 * k2 + s * 3.0 * k3), k4 + s * (2.0 * k5 + s * 3.0 * k6));
            d > 0.0 && (n + 2.0 * s * dn) * d - 2.0 * s * n * dd > 0.0
        })
    }

    /// How far from the axis a ray of distance `r` appears, by the radial part alone.
    pub fn radius(&self, r: f64) -> f64 {
        match self {
            Self::Polynomial([k1, k2, _, _, k3, k4, k5, k6, ..]) => {
                let s = r * r;
                r * (1.0 + s * (k1 + s * (k2 + s * k3))) / (1.0 + s * (k4 + s * (k5 + s * k6)))
            }
            Self::Equidistant(lens) => lens.height(r.atan()),
        }
    }
}

/// The last of the values from 0 to `end` before `grows` fails for the first time; `None` where it holds for all.
fn last_growing(end: f64, grows: impl Fn(f64) -> bool) -> Option<f64> {
    let at = |step: usize| end * step as f64 / STEPS as f64;
    let first = (1..=STEPS).find(|step| !grows(at(*step)))?;
    let (mut inside, mut outside) = (at(first - 1), at(first));
    for _ in 0..40 {
        let middle = (inside + outside) / 2.0;
        if grows(middle) {
            inside = middle;
        } else {
            outside = middle;
        }
    }
    Some(inside)
}

/// A fisheye: a ray at the angle `a` from the axis appears at the distance `a (1 + k1 a^2 + k2 a^4 + k3 a^6 + k4 a^8)` from the centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Equidistant {
    k: [f64; 4],
    /// Up to this angle the distance grows.
    limit_rad: f64,
}

impl Equidistant {
    /// The lens of `k1 k2 k3 k4`.
    pub fn new(k: [f64; 4]) -> Self {
        let max_rad = MAX_RADIUS.atan();
        let limit_rad = last_growing(max_rad, |angle| Self { k, limit_rad: max_rad }.slope(angle) > 0.0);
        Self { k, limit_rad: limit_rad.unwrap_or(max_rad) }
    }

    /// `k1 k2 k3 k4`.
    pub fn coefficients(&self) -> [f64; 4] {
        self.k
    }

    fn is_folded(&self) -> bool {
        self.limit_rad < MAX_RADIUS.atan()
    }

    /// Distance from the centre at which a ray of this angle appears through the lens of `k1 k2 k3 k4`.
    pub fn height_of([k1, k2, k3, k4]: [f64; 4], angle: f64) -> f64 {
        let s = angle * angle;
        angle * (1.0 + s * (k1 + s * (k2 + s * (k3 + s * k4))))
    }

    fn height(&self, angle: f64) -> f64 {
        Self::height_of(self.k, angle)
    }

    /// Derivative of the height by the angle.
    fn slope(&self, angle: f64) -> f64 {
        let ([k1, k2, k3, k4], s) = (self.k, angle * angle);
        1.0 + s * (3.0 * k1 + s * (5.0 * k2 + s * (7.0 * k3 + s * 9.0 * k4)))
    }

    /// Where the ray `(x, y, 1)` appears.
    pub fn distort(&self, x: f64, y: f64) -> (f64, f64) {
        let r = x.hypot(y);
        let scale = if r > 1e-9 { self.height(r.atan()) / r } else { 1.0 };
        (x * scale, y * scale)
    }

    /// The ray that appears at a position, by Newton's method within bounds; `None` beyond 76 degrees or the fold of the lens.
    pub fn undistort(&self, x: f64, y: f64) -> Option<(f64, f64)> {
        let height = x.hypot(y);
        if !height.is_finite() || height > self.height(self.limit_rad) {
            return None;
        }
        if height <= 1e-9 {
            return Some((x, y));
        }
        // Between these the height grows, so the one solution stays between them.
        let (mut low, mut high) = (0.0, self.limit_rad);
        let mut angle = height.min(self.limit_rad);
        for _ in 0..60 {
            let error = self.height(angle) - height;
            if error.abs() < 1e-15 {
                break;
            }
            if error > 0.0 {
                high = angle;
            } else {
                low = angle;
            }
            let next = angle - error / self.slope(angle);
            let is_between = next > low && next < high;
            let next = if is_between { next } else { (low + high) / 2.0 };
            if next == angle {
                break;
            }
            angle = next;
        }
        let scale = angle.tan() / height;
        Some((x * scale, y * scale))
    }

    /// The farthest ray in the direction of a position.
    fn farthest(&self, x: f64, y: f64) -> (f64, f64) {
        let scale = self.limit_rad.tan() / x.hypot(y);
        (x * scale, y * scale)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const K: [f64; 4] = [0.01, -0.02, 0.001, 0.002];

    /// Figures of OpenCV 4.14's `fisheye::distortPoints` and `fisheye::undistortPoints` for fx = 300, fy = 302, cx = 319.5, cy = 239.5 px.
    #[test]
    fn rays_are_those_of_opencv() {
        let lens = Lens::Equidistant(Equidistant::new(K));
        let px = |(x, y): (f64, f64)| (300.0 * x + 319.5, 302.0 * y + 239.5);
        for (ray, place) in [
            ((0.3, -0.2), (405.9573832, 181.4774895)),
            ((-0.9, 0.4), (106.44211769, 334.82367475)),
            ((1.4, 1.1), (566.9845196, 435.24847002)),
            ((0.02, 2.2), (322.57959791, 580.51414189)),
        ] {
            let (u, v) = px(lens.distort(ray.0, ray.1));
            assert!((u - place.0).hypot(v - place.1) < 1e-7, "{ray:?}: {u} {v}");
        }
        for ((u, v), ray) in [
            ((319.5, 239.5), (0.0, 0.0)),
            ((10.25, 30.5), (-2.623681926064, -1.761416552161)),
            ((600.0, 400.0), (1.654391478749, 0.9403613427037)),
            ((320.0, 0.0), (2.137649024712e-03, -1.017152863745)),
            ((5.0, 239.0), (-1.776957272612, -2.806342358751e-03)),
        ] {
            let (x, y) = lens.undistort((u - 319.5) / 300.0, (v - 239.5) / 302.0);
            assert!((x - ray.0).hypot(y - ray.1) < 1e-9, "{u} {v}: {x} {y}");
        }
        // OpenCV has (3.66, 2.73) for this corner, at 78 degrees: its direction is kept.
        let (x, y) = lens.undistort((639.0 - 319.5) / 300.0, (479.0 - 239.5) / 302.0);
        assert!((x.hypot(y) - MAX_RADIUS).abs() < 1e-9 && (x / y - 3.661207874053 / 2.726298186847).abs() < 1e-9);
    }

    #[test]
    fn rays_come_back_from_where_they_appear() {
        for k in [K, [0.0; 4], [-0.05, 0.01, -0.002, 0.0], [0.2, 0.1, 0.0, 0.0]] {
            let lens = Equidistant::new(k);
            for step in 0..=40 {
                let (r, turn) = (f64::from(step) * 0.0999, f64::from(step) * 0.7);
                let (x, y) = (r * turn.cos(), r * turn.sin());
                let (u, v) = lens.distort(x, y);
                let (a, b) = lens.undistort(u, v).unwrap();
                assert!((a - x).hypot(b - y) < 1e-12 * (1.0 + r * r), "{k:?} {r}: {a} {b} for {x} {y}");
                assert!((lens.height(r.atan()) - u.hypot(v)).abs() < 1e-12);
            }
            assert_eq!((lens.undistort(9.0, 0.0), lens.is_folded()), (None, false));
            assert_eq!(lens.undistort(f64::NAN, 0.0), None);
        }
    }

    #[test]
    fn a_lens_that_folds_ends_at_its_fold() {
        // The height is `a - a^3`, which grows up to 1 / sqrt 3.
        let lens = Lens::Equidistant(Equidistant::new([-1.0, 0.0, 0.0, 0.0]));
        let fold = 1.0 / 3f64.sqrt();
        assert!((lens.fold_radius().unwrap() - fold.tan()).abs() < 1e-9);
        assert!((lens.radius(lens.fold_radius().unwrap()) - (fold - fold.powi(3))).abs() < 1e-9);
        // Beyond it the farthest ray is taken.
        let (x, y) = lens.undistort(0.0, 0.5);
        assert!(x == 0.0 && (y - fold.tan()).abs() < 1e-9, "{x} {y}");
        assert_eq!(Lens::Equidistant(Equidistant::new(K)).fold_radius(), None);
    }

    #[test]
    fn coefficients_lead_back_to_their_lens() {
        let fisheye = Lens::Equidistant(Equidistant::new(K));
        let mut polynomial = [0.0; 12];
        polynomial[..5].copy_from_slice(&[-0.3, 0.1, 0.001, -0.002, 0.01]);
        for lens in [fisheye, Lens::Polynomial(polynomial), Lens::NONE] {
            assert_eq!(Lens::of_coefficients(&lens.coefficients()).unwrap(), lens);
        }
        // The coefficients of a fisheye without any are not those of a pinhole.
        let plain = Lens::Equidistant(Equidistant::new([0.0; 4])).coefficients();
        assert_ne!(plain, [0.0; 14]);
        let mut wrong = fisheye.coefficients();
        wrong[4] = 0.1;
        assert!(Lens::of_coefficients(&wrong).is_err());
        assert!(Lens::of_coefficients(&[0.0; 3]).is_err());
    }
}
