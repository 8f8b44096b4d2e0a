//! The calibration of two views whose rows are already aligned.

use panoscope_abi::{Calibration, Camera};

/// A calibration of any camera: neither disparities nor the homography of a disparity grid depend on the focal length.
pub fn calibration((width, height): (u32, u32)) -> Calibration {
    const EYE: [f64; 9] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let (focal, baseline_mm) = (f64::from(width), 5.0);
    let (cx, cy) = ((f64::from(width) - 1.0) / 2.0, (f64::from(height) - 1.0) / 2.0);
    let camera = Camera { width, height, fx: focal, fy: focal, cx, cy, distortion: [0.0; 14] };
    let projection = |tx: f64| [focal, 0.0, cx, tx, 0.0, focal, cy, 0.0, 0.0, 0.0, 1.0, 0.0];
    Calibration {
        left: camera,
        right: camera,
        right_from_left_rotation: EYE,
        right_from_left_mm: [-baseline_mm, 0.0, 0.0],
        rectified_from_left: EYE,
        rectified_from_right: EYE,
        left_projection: projection(0.0),
        right_projection: projection(-focal * baseline_mm),
        baseline_mm,
        rms_px: 0.0,
        is_rectified: 1,
        stated_error: 0,
    }
}
