//! The true calibration of the rendered cameras.

use panoscope_imaging::stereo::Lens;
use panoscope_node::abi::{Calibration, Camera};

use crate::render::{CameraModel, Rig};

fn camera(model: &CameraModel) -> Camera {
    let mut distortion = [0.0; 14];
    match model.equidistant {
        Some(lens) => distortion = Lens::Equidistant(lens).coefficients(),
        None => distortion[..5].copy_from_slice(&model.distortion),
    }
    Camera {
        width: model.width as u32,
        height: model.height as u32,
        fx: model.fx,
        fy: model.fy,
        cx: model.cx,
        cy: model.cy,
        distortion,
    }
}

const EYE3: [f64; 9] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];

/// True calibration of cameras 0 and 1.
pub fn calibration(rig: &Rig) -> Calibration {
    let (left, right) = (&rig.cameras[0], &rig.cameras[1]);
    let baseline_mm = right.offset_mm[0] - left.offset_mm[0];
    let projection = |tx: f64| [left.fx, 0.0, left.cx, tx, 0.0, left.fy, left.cy, 0.0, 0.0, 0.0, 1.0, 0.0];
    Calibration {
        left: camera(left),
        right: camera(right),
        right_from_left_rotation: EYE3,
        right_from_left_mm: [
            -baseline_mm,
            left.offset_mm[1] - right.offset_mm[1],
            left.offset_mm[2] - right.offset_mm[2],
        ],
        rectified_from_left: EYE3,
        rectified_from_right: EYE3,
        left_projection: projection(0.0),
        right_projection: projection(-left.fx * baseline_mm),
        baseline_mm,
        rms_px: 0.0,
        is_rectified: u32::from(left.is_pinhole() && right.is_pinhole()),
        stated_error: 0,
    }
}
