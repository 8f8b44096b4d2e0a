//! One camera in OpenCV's model, and two of them side by side.

use crate::stereo::StereoError;
use crate::stereo::rotation::{Matrix3, Vector3};

/// Pinhole camera with OpenCV's rational, tangential and thin-prism distortion. Pixels count from the
/// centre of the upper left one.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraModel {
    /// Columns of the images.
    pub width: usize,
    /// Rows of the images.
    pub height: usize,
    /// Focal length along columns, in px.
    pub fx: f64,
    /// Focal length along rows, in px.
    pub fy: f64,
    /// Column of the principal point.
    pub cx: f64,
    /// Row of the principal point.
    pub cy: f64,
    /// `k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4`, OpenCV's order.
    pub distortion: [f64; 12],
}

impl CameraModel {
    /// A camera whose distortion has any of OpenCV's lengths (0, 4, 5, 8, 12, or 14 with no tilt).
    ///
    /// # Errors
    /// [`StereoError::Calibration`] when a number is not finite, a focal length is not positive, or the
    /// distortion has another length or a tilted sensor.
    pub fn new(size: (usize, usize), focal: (f64, f64), centre: (f64, f64), d: &[f64]) -> Result<Self, StereoError> {
        let refuse = |reason: String| Err(StereoError::Calibration { reason });
        if ![0, 4, 5, 8, 12, 14].contains(&d.len()) {
            return refuse(format!("{} distortion coefficients (0, 4, 5, 8, 12 or 14 are known)", d.len()));
        }
        if d.len() == 14 && (d[12] != 0.0 || d[13] != 0.0) {
            return refuse("a tilted sensor (tau) is not supported".into());
        }
        let mut distortion = [0.0; 12];
        for (target, value) in distortion.iter_mut().zip(d) {
            *target = *value;
        }
        let camera =
            Self { width: size.0, height: size.1, fx: focal.0, fy: focal.1, cx: centre.0, cy: centre.1, distortion };
        camera.validate()?;
        Ok(camera)
    }

    /// Refuses parameters that no camera can have.
    ///
    /// # Errors
    /// [`StereoError::Calibration`].
    pub fn validate(&self) -> Result<(), StereoError> {
        let refuse = |reason: String| Err(StereoError::Calibration { reason });
        let numbers = [self.fx, self.fy, self.cx, self.cy];
        if numbers.iter().chain(&self.distortion).any(|value| !value.is_finite()) {
            return refuse("a number is not finite".into());
        }
        if self.fx <= 0.0 || self.fy <= 0.0 {
            return refuse(format!("focal lengths {} and {} px must be positive", self.fx, self.fy));
        }
        if self.width < 2 || self.height < 2 {
            return refuse(format!("image size {}x{} is too small", self.width, self.height));
        }
        Ok(())
    }

    /// Where the ray through `(x, y, 1)` lands, in px.
    pub fn project(&self, x: f64, y: f64) -> (f64, f64) {
        let (x, y) = self.distort(x, y);
        (self.fx * x + self.cx, self.fy * y + self.cy)
    }

    /// Radial factor of the distortion at a squared distance from the axis.
    fn radial(&self, r2: f64) -> f64 {
        let [k1, k2, _, _, k3, k4, k5, k6, ..] = self.distortion;
        (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    }

    /// Distorts normalised coordinates.
    fn distort(&self, x: f64, y: f64) -> (f64, f64) {
        let [_, _, p1, p2, _, _, _, _, s1, s2, s3, s4] = self.distortion;
        let r2 = x * x + y * y;
        let radial = self.radial(r2);
        let xy = 2.0 * x * y;
        (
            x * radial + p1 * xy + p2 * (r2 + 2.0 * x * x) + r2 * (s1 + r2 * s2),
            y * radial + p1 * (r2 + 2.0 * y * y) + p2 * xy + r2 * (s3 + r2 * s4),
        )
    }

    /// Distance from the optical axis, at depth 1, from which on the radial distortion turns back: rays farther out land nearer to the centre again,
    /// on pixels that other rays already have. `None` where it never does. A polynomial that was fitted near the centre alone may turn back within
    /// the image.
    pub fn fold_radius(&self) -> Option<f64> {
        /// Rays at 76 degrees: no rectified view reaches farther.
        const FARTHEST: f64 = 4.0;
        const STEPS: usize = 2000;
        let [k1, k2, _, _, k3, k4, k5, k6, ..] = self.distortion;
        // The slope of `r * numerator / denominator`, times the square of the denominator, which does not change its sign.
        let grows = |r: f64| {
            let s = r * r;
            let (n, d) = (1.0 + s * (k1 + s * (k2 + s * k3)), 1.0 + s * (k4 + s * (k5 + s * k6)));
            let (dn, dd) = (k1 + s * (2.0 * k2 + s * 3.0 * k3), k4 + s * (2.0 * k5 + s * 3.0 * k6));
            d > 0.0 && (n + 2.0 * s * dn) * d - 2.0 * s * n * dd > 0.0
        };
        let at = |step: usize| FARTHEST * step as f64 / STEPS as f64;
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

    /// Distance from the principal point at which the distortion turns back, in px along columns; `None` as for [`CameraModel::fold_radius`].
    pub fn fold_px(&self) -> Option<f64> {
        self.fold_radius().map(|r| self.fx * r * self.radial(r * r))
    }

    /// The normalised, undistorted coordinates of a pixel: fixed-point iteration on the inverse of the
    /// distortion, as no closed form exists.
    pub fn unproject(&self, u: f64, v: f64) -> (f64, f64) {
        let [k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4] = self.distortion;
        let (x0, y0) = ((u - self.cx) / self.fx, (v - self.cy) / self.fy);
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
}

/// Two cameras; a point `p` of the left camera is `rotation * p + translation_mm` in the right one.
#[derive(Clone, Debug, PartialEq)]
pub struct StereoCameras {
    /// The left camera.
    pub left: CameraModel,
    /// The right camera.
    pub right: CameraModel,
    /// Right camera's axes from the left one's.
    pub rotation: Matrix3,
    /// Origin of the left camera seen from the right one, in mm (`x` is negative unless the views are swapped).
    pub translation_mm: Vector3,
}
