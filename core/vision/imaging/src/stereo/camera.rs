//! One camera in OpenCV's model, and two of them side by side.

use crate::stereo::StereoError;
use crate::stereo::lens::Lens;
use crate::stereo::rotation::{Matrix3, Vector3};

/// A camera with a lens. Pixels count from the centre of the upper left one.
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
    /// What its lens does to rays.
    pub lens: Lens,
}

impl CameraModel {
    /// A camera with the distortion coefficients of [`Lens::of_coefficients`].
    ///
    /// # Errors
    /// [`StereoError::Calibration`] when a number is not finite, a focal length is not positive, or as [`Lens::of_coefficients`].
    pub fn new(size: (usize, usize), focal: (f64, f64), centre: (f64, f64), d: &[f64]) -> Result<Self, StereoError> {
        let lens = Lens::of_coefficients(d)?;
        let camera = Self { width: size.0, height: size.1, fx: focal.0, fy: focal.1, cx: centre.0, cy: centre.1, lens };
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
        if numbers.iter().any(|value| !value.is_finite()) || !self.lens.is_finite() {
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
        let (x, y) = self.lens.distort(x, y);
        (self.fx * x + self.cx, self.fy * y + self.cy)
    }

    /// Distance from the principal point at which the distortion turns back, in px along columns; `None` as for [`Lens::fold_radius`].
    pub fn fold_px(&self) -> Option<f64> {
        self.lens.fold_radius().map(|r| self.fx * self.lens.radius(r))
    }

    /// The ray `(x, y, 1)` of a pixel; see [`Lens::undistort`].
    pub fn unproject(&self, u: f64, v: f64) -> (f64, f64) {
        self.lens.undistort((u - self.cx) / self.fx, (v - self.cy) / self.fy)
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
