//! Stereo calibrations: the `calibration` packet, the files it is read from and written to, and the boards it is made with.
//!
//! The only parser of calibration files: plugins that read them, nodes that make them and the command share it. It is not part of
//! `imaging` because it needs a YAML parser.
//!
//! - [`read`] understands OpenCV's `FileStorage` YAML, ROS `camera_info`, Kalibr camera chains, MATLAB's `stereoParameters` as JSON and the files of data sets (KITTI, Middlebury,
//!   StereoMIS, EndoVis, rectified Hamlyn); [`write()`] writes `FileStorage` YAML that OpenCV reads back bit by bit.
//! - [`packet`] turns the packet into camera models and a rectification, and refuses impossible ones.
//! - [`pictures`] finds the picture files that a pattern matches, [`views`] groups those of several views by instant.
//! - [`Board`] describes a printed pattern, [`ViewState`] says whether a view of it was used and if not, why.

#![forbid(unsafe_code)]

mod board;
mod document;
mod endovis;
mod entries;
mod error;
mod file;
mod hamlyn;
mod kalibr;
mod kitti;
mod matlab;
mod middlebury;
mod opencv;
pub mod packet;
pub mod pictures;
mod rectified;
pub mod ros;
mod stereomis;
mod view;
pub mod views;

pub use board::{Board, BoardError};
pub use error::FileError;
pub use file::{KittiCameras, parse, read, read_kitti, write};
pub use opencv::text_of;
pub use view::ViewState;

use panoscope_abi::{Calibration, Camera};
use panoscope_imaging::stereo::{Equidistant, Lens};

/// Rows of the 3x3 unit matrix, one after the other.
pub(crate) const EYE3: [f64; 9] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];

/// The packet of two cameras and the pose between them, without a rectification: callers compute it.
pub(crate) fn packet_of(
    [left, right]: [Camera; 2],
    right_from_left_rotation: [f64; 9],
    right_from_left_mm: [f64; 3],
) -> Calibration {
    Calibration {
        left,
        right,
        right_from_left_rotation,
        right_from_left_mm,
        rectified_from_left: EYE3,
        rectified_from_right: EYE3,
        left_projection: [0.0; 12],
        right_projection: [0.0; 12],
        baseline_mm: right_from_left_mm.iter().map(|t| t * t).sum::<f64>().sqrt(),
        rms_px: f64::NAN,
        is_rectified: 0,
        stated_error: 0,
    }
}

/// Shortest baseline that a stereo scope has, mm. Below it the unit is most likely another one.
const MIN_BASELINE_MM: f64 = 0.5;

/// Why nine numbers by rows are no camera matrix; `None` if they are.
pub(crate) fn no_camera_matrix(matrix: &[f64; 9]) -> Option<&'static str> {
    let near = |at: usize, value: f64| (matrix[at] - value).abs() <= 1e-6 * matrix[0].abs().max(1.0);
    if near(6, 0.0) && near(7, 0.0) && near(8, 1.0) && near(3, 0.0) {
        return None;
    }
    let is_transposed = near(2, 0.0) && near(5, 0.0) && near(8, 1.0);
    Some(if is_transposed {
        "is transposed: the principal point belongs into the last column, and the last row is 0 0 1"
    } else {
        "is not a camera matrix: its last row is not 0 0 1, or its second row does not begin with 0"
    })
}

/// Names of the equidistant lens in files and messages: that of ROS and Kalibr, and that of OpenCV.
pub(crate) const EQUIDISTANT: [&str; 2] = ["equidistant", "fisheye"];

/// The packet's coefficients of an equidistant lens.
pub(crate) fn equidistant(k: [f64; 4]) -> [f64; 14] {
    Lens::Equidistant(Equidistant::new(k)).coefficients()
}

/// The four coefficients of a camera with an equidistant lens.
pub fn equidistant_of(camera: &Camera) -> Option<[f64; 4]> {
    match Lens::of_coefficients(&camera.distortion) {
        Ok(Lens::Equidistant(lens)) => Some(lens.coefficients()),
        _ => None,
    }
}

/// What makes a calibration doubtful although its numbers fit together; for a warning.
pub fn doubt(calibration: &Calibration) -> Option<String> {
    let baseline_mm = calibration.baseline_mm;
    (baseline_mm < MIN_BASELINE_MM).then(|| {
        format!(
            "its cameras are only {baseline_mm:.4} mm apart: lengths of this file are in mm, is its translation in m? All distances would be 1000 times too small"
        )
    })
}
