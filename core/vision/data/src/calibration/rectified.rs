//! Cameras whose views a data set has rectified already.

use panoscope_abi::{Calibration, Camera};

use crate::calibration::EYE3;

/// One rectified view: pinhole, no distortion.
#[derive(Clone, Copy, Debug)]
pub(crate) struct View {
    /// Columns and rows, 0 where the file states none.
    pub size: (u32, u32),
    /// Focal lengths along rows and columns, px.
    pub focal: (f64, f64),
    /// Principal point, px.
    pub centre: (f64, f64),
}

/// The packet of two rectified views whose cameras stand `baseline_mm` apart along the rows. A `rectify` node leaves such views as they are.
pub(crate) fn packet(left: View, right: View, baseline_mm: f64) -> Calibration {
    let camera = |view: &View| Camera {
        width: view.size.0,
        height: view.size.1,
        fx: view.focal.0,
        fy: view.focal.1,
        cx: view.centre.0,
        cy: view.centre.1,
        distortion: [0.0; 14],
    };
    let projection = |view: &View, shift_mm: f64| {
        let ((fx, fy), (cx, cy)) = (view.focal, view.centre);
        [fx, 0.0, cx, fx * shift_mm, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    };
    Calibration {
        left: camera(&left),
        right: camera(&right),
        right_from_left_rotation: EYE3,
        right_from_left_mm: [-baseline_mm, 0.0, 0.0],
        rectified_from_left: EYE3,
        rectified_from_right: EYE3,
        left_projection: projection(&left, 0.0),
        right_projection: projection(&right, -baseline_mm),
        baseline_mm: baseline_mm.abs(),
        rms_px: f64::NAN,
        is_rectified: 1,
        stated_error: 0,
    }
}
