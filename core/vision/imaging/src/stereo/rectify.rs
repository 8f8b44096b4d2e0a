//! Rectification: turn both views so that a point lies on one row in both.
//!
//! The rotation is split evenly between the cameras and followed by the smallest turn that makes the
//! baseline horizontal (Bouguet's method), with a common focal length; the same choices as OpenCV's
//! `stereoRectify`, so that calibrations are interchangeable.

use crate::Rect;
use crate::stereo::StereoError;
use crate::stereo::camera::{CameraModel, StereoCameras};
use crate::stereo::lens::Lens;
use crate::stereo::rotation::*;

/// The pinhole camera of a rectified view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RectifiedCamera {
    /// Focal length in px, the same along rows and columns, and in both views.
    pub focal_px: f64,
    /// Column of the principal point.
    pub cx: f64,
    /// Row of the principal point, the same in both views.
    pub cy: f64,
}

/// How a stereo pair is rectified, and what disparities mean afterwards.
#[derive(Clone, Debug, PartialEq)]
pub struct Rectification {
    /// Columns of the rectified views.
    pub width: usize,
    /// Rows of the rectified views.
    pub height: usize,
    /// Rectified left axes from the left camera's.
    pub rotation_left: Matrix3,
    /// Rectified right axes from the right camera's.
    pub rotation_right: Matrix3,
    /// Rectified left camera.
    pub left: RectifiedCamera,
    /// Rectified right camera.
    pub right: RectifiedCamera,
    /// Distance between the cameras in mm, positive.
    pub baseline_mm: f64,
    /// Part of the left view that the left camera covers.
    pub valid_left: Rect,
    /// Part of the right view that the right camera covers.
    pub valid_right: Rect,
}

/// Choices of [`Rectification::new`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RectifyParams {
    /// Whether points at infinity have disparity 0 (both principal points on one column).
    pub zero_disparity: bool,
    /// `None` keeps the common focal length; 0 zooms until every pixel is covered; 1 until no pixel is lost.
    pub alpha: Option<f64>,
}

impl Default for RectifyParams {
    fn default() -> Self {
        Self { zero_disparity: true, alpha: Some(0.0) }
    }
}

/// Smallest and largest coordinates: x0, y0, x1, y1.
type Bounds = [f64; 4];

/// Rotations of the left and the right camera that make their rows parallel to the baseline.
///
/// # Errors
/// As [`Rectification::new`].
fn rotations(cameras: &StereoCameras) -> Result<[Matrix3; 2], StereoError> {
    let refuse = |reason: String| Err(StereoError::Calibration { reason });
    let square = product(&cameras.rotation, &transposed(&cameras.rotation));
    let apart = (0..9).map(|i| (square[i / 3][i % 3] - IDENTITY[i / 3][i % 3]).abs()).fold(0.0, f64::max);
    // Written so that NaN fails too.
    if !(apart < 1e-3 && determinant(&cameras.rotation) > 0.0) {
        return refuse("the rotation between the cameras is not a rotation matrix".into());
    }
    let t = cameras.translation_mm;
    let distance = norm(t);
    if !(distance.is_finite() && distance > 1e-9) {
        return refuse(format!("the baseline is {distance} mm"));
    }
    let half = rotation_of(scaled(vector_of(&cameras.rotation), -0.5));
    let turned = apply(&half, t);
    if turned[0].abs() <= turned[1].abs() {
        return refuse("the cameras stand above one another, not side by side".into());
    }
    if turned[0] > 0.0 {
        return refuse("left and right are swapped: the left camera stands to the right of the right one, disparities would be negative".into());
    }
    let axis = cross(turned, [-1.0, 0.0, 0.0]);
    let length = norm(axis);
    let align = if length > 0.0 {
        rotation_of(scaled(axis, (turned[0].abs() / distance).min(1.0).acos() / length))
    } else {
        IDENTITY
    };
    Ok([product(&align, &transposed(&half)), product(&align, &half)])
}

/// The principal point that puts the middle of a rectified view of this focal length into its centre.
fn centre(camera: &CameraModel, rotation: &Matrix3, focal: f64) -> (f64, f64) {
    let (last_x, last_y) = ((camera.width - 1) as f64, (camera.height - 1) as f64);
    // The corners of a fisheye are so far from the axis that a small shift of its centre moves them much; OpenCV takes the middles too.
    let (middle_x, middle_y) = (last_x / 2.0, last_y / 2.0);
    let places = match camera.lens {
        Lens::Polynomial(_) => [(0.0, 0.0), (last_x, 0.0), (last_x, last_y), (0.0, last_y)],
        Lens::Equidistant(_) => [(middle_x, 0.0), (last_x, middle_y), (middle_x, last_y), (0.0, middle_y)],
    };
    let points = places.map(|(u, v)| turn(camera, rotation, u, v));
    let mean = |of: fn(&(f64, f64)) -> f64| points.iter().map(of).sum::<f64>() / 4.0;
    (last_x / 2.0 - focal * mean(|p| p.0), last_y / 2.0 - focal * mean(|p| p.1))
}

impl Rectification {
    /// Rectifies `cameras` onto views of the left camera's size.
    ///
    /// # Errors
    /// [`StereoError::Calibration`] when the cameras' sizes differ, the rotation is none, the baseline is
    /// zero, more vertical than horizontal, or points the wrong way (the views are swapped).
    pub fn new(cameras: &StereoCameras, params: RectifyParams) -> Result<Self, StereoError> {
        let refuse = |reason: String| Err(StereoError::Calibration { reason });
        cameras.left.validate()?;
        cameras.right.validate()?;
        let (width, height) = (cameras.left.width, cameras.left.height);
        if (cameras.right.width, cameras.right.height) != (width, height) {
            return refuse(format!(
                "the left camera is {width}x{height}, the right one {}x{}",
                cameras.right.width, cameras.right.height
            ));
        }
        let [rotation_left, rotation_right] = rotations(cameras)?;
        let baseline_mm = -apply(&rotation_right, cameras.translation_mm)[0];

        let views = [(&cameras.left, &rotation_left), (&cameras.right, &rotation_right)];
        let focal = (cameras.left.fy + cameras.right.fy) / 2.0;
        let mut centres = views.map(|(camera, rotation)| centre(camera, rotation, focal));
        let cy = (centres[0].1 + centres[1].1) / 2.0;
        if params.zero_disparity {
            let cx = (centres[0].0 + centres[1].0) / 2.0;
            centres = [(cx, cy); 2];
        } else {
            centres = centres.map(|(cx, _)| (cx, cy));
        }

        let mut inner = [[0.0; 4]; 2];
        let mut scale = (0.0f64, f64::INFINITY);
        for (index, (camera, rotation)) in views.into_iter().enumerate() {
            let centre = centres[index];
            let outer;
            (inner[index], outer) = rectangles(camera, rotation, focal, centre);
            for ratio in ratios(&inner[index], centre, width, height) {
                scale.0 = scale.0.max(ratio);
            }
            for ratio in ratios(&outer, centre, width, height) {
                scale.1 = scale.1.min(ratio);
            }
        }
        let factor = params.alpha.map_or(1.0, |alpha| {
            let alpha = alpha.clamp(0.0, 1.0);
            scale.0 * (1.0 - alpha) + scale.1 * alpha
        });
        if !(factor.is_finite() && factor > 0.0) {
            return refuse("the rectified views do not contain their own centre".into());
        }
        let valid = |index: usize| valid_roi(&inner[index], centres[index], factor, width, height);
        let camera = |index: usize| RectifiedCamera { focal_px: focal * factor, cx: centres[index].0, cy };
        Ok(Self {
            width,
            height,
            rotation_left,
            rotation_right,
            left: camera(0),
            right: camera(1),
            baseline_mm,
            valid_left: valid(0),
            valid_right: valid(1),
        })
    }

    /// OpenCV's 4 x 4 matrix Q: `[u v disparity 1]` to homogeneous mm in the left rectified camera.
    pub fn q(&self) -> [[f64; 4]; 4] {
        [
            [1.0, 0.0, 0.0, -self.left.cx],
            [0.0, 1.0, 0.0, -self.left.cy],
            [0.0, 0.0, 0.0, self.left.focal_px],
            [0.0, 0.0, 1.0 / self.baseline_mm, (self.right.cx - self.left.cx) / self.baseline_mm],
        ]
    }

    /// Depth in mm of a disparity in px; infinite or negative where the rays do not meet in front.
    pub fn depth_mm(&self, disparity_px: f64) -> f64 {
        self.left.focal_px * self.baseline_mm / (disparity_px + self.right.cx - self.left.cx)
    }
}

/// A pixel's direction in the rectified axes, at depth 1.
pub(crate) fn turn(camera: &CameraModel, rotation: &Matrix3, u: f64, v: f64) -> (f64, f64) {
    let (x, y) = camera.unproject(u, v);
    let [x, y, z] = apply(rotation, [x, y, 1.0]);
    (x / z, y / z)
}

/// Largest rectangle inside, and smallest around, the image's border as it lies in the rectified view.
fn rectangles(camera: &CameraModel, rotation: &Matrix3, focal: f64, centre: (f64, f64)) -> (Bounds, Bounds) {
    const SIDE: usize = 9;
    let mut inner = [f64::NEG_INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::INFINITY];
    let mut outer = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
    for j in 0..SIDE {
        for i in 0..SIDE {
            let u = i as f64 * (camera.width - 1) as f64 / (SIDE - 1) as f64;
            let v = j as f64 * (camera.height - 1) as f64 / (SIDE - 1) as f64;
            let (x, y) = turn(camera, rotation, u, v);
            let (x, y) = (focal * x + centre.0, focal * y + centre.1);
            outer = [outer[0].min(x), outer[1].min(y), outer[2].max(x), outer[3].max(y)];
            if i == 0 {
                inner[0] = inner[0].max(x);
            }
            if i == SIDE - 1 {
                inner[2] = inner[2].min(x);
            }
            if j == 0 {
                inner[1] = inner[1].max(y);
            }
            if j == SIDE - 1 {
                inner[3] = inner[3].min(y);
            }
        }
    }
    (inner, outer)
}

/// Zoom at which each side of `bounds` meets the image's side.
fn ratios(bounds: &Bounds, (cx, cy): (f64, f64), width: usize, height: usize) -> [f64; 4] {
    [
        cx / (cx - bounds[0]),
        cy / (cy - bounds[1]),
        (width as f64 - 1.0 - cx) / (bounds[2] - cx),
        (height as f64 - 1.0 - cy) / (bounds[3] - cy),
    ]
}

fn valid_roi(inner: &Bounds, (cx, cy): (f64, f64), factor: f64, width: usize, height: usize) -> Rect {
    let at = |value: f64, centre: f64| (value - centre) * factor + centre;
    let x0 = at(inner[0], cx).ceil().clamp(0.0, width as f64) as usize;
    let y0 = at(inner[1], cy).ceil().clamp(0.0, height as f64) as usize;
    let x1 = (at(inner[2], cx).floor() + 1.0).clamp(x0 as f64, width as f64) as usize;
    let y1 = (at(inner[3], cy).floor() + 1.0).clamp(y0 as f64, height as f64) as usize;
    Rect { x: x0, y: y0, width: x1 - x0, height: y1 - y0 }
}
