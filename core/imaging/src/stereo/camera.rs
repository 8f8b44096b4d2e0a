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

    /// Distorts normalised coordinates.
    fn distort(&self, x: f64, y: f64) -> (f64, f64) {
        let [k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4] = self.distortion;
        let r2 = x * x + y * y;
        let radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)));
        let xy = 2.0 * x * y;
        (
            x * radial + p1 * xy + p2 * (r2 + 2.0 * x * x) + r2 * (s1 + r2 * s2),
            y * radial + p1 * (r2 + 2.0 * y * y) + p2 * xy + r2 * (s3 + r2 * s4),
        )
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
