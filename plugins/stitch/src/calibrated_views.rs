//! The views that a calibration describes, and the disparity maps that belong to them.

use panoscope_data::calibration::packet;
use panoscope_imaging::stereo::{Lens, StereoError};
use panoscope_imaging::stitch::{RectifiedView, map_factor};
use panoscope_node::abi::{Calibration, Camera};
use panoscope_node::{Result, error};

/// Views of the newest calibration.
#[derive(Default)]
pub(crate) struct CalibratedViews {
    known: Option<(Calibration, [RectifiedView; 2])>,
}

impl CalibratedViews {
    /// Both views of a calibration; without one, views of these sizes that are already rectified. If the calibration does not state a rectification,
    /// it is computed when the calibration changes.
    ///
    /// # Errors
    /// The calibration states no rectification, and none can be computed.
    pub fn of(
        &mut self,
        calibration: Option<&Calibration>,
        sizes: [(usize, usize); 2],
    ) -> std::result::Result<[RectifiedView; 2], StereoError> {
        let Some(calibration) = calibration else { return Ok(sizes.map(rectified)) };
        if let Some((_, views)) = self.known.filter(|(known, _)| packet::same(known, calibration)) {
            return Ok(views);
        }
        let is_rectified = calibration.is_rectified != 0;
        let is_stated = is_rectified || packet::states_rectification(calibration);
        let c = match is_stated {
            true => *calibration,
            false => packet::with_rectification(calibration, &packet::rectification(calibration)?),
        };
        let views = [
            view(&c.left, &c.rectified_from_left, &c.left_projection, is_rectified)?,
            view(&c.right, &c.rectified_from_right, &c.right_projection, is_rectified)?,
        ];
        self.known = Some((*calibration, views));
        Ok(views)
    }
}

/// One side of a calibration.
fn view(
    camera: &Camera,
    rotation: &[f64; 9],
    projection: &[f64; 12],
    rectified: bool,
) -> std::result::Result<RectifiedView, StereoError> {
    let focal_px = [projection[0], projection[5]];
    let centre_px = [projection[2], projection[6]];
    let size = (camera.width as usize, camera.height as usize);
    if rectified {
        let rectified_from_camera = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
        return Ok(RectifiedView {
            size,
            focal_px,
            centre_px,
            lens: Lens::NONE,
            rectified_from_camera,
            rectified_focal_px: focal_px,
            rectified_centre_px: centre_px,
        });
    }
    Ok(RectifiedView {
        size,
        focal_px: [camera.fx, camera.fy],
        centre_px: [camera.cx, camera.cy],
        lens: Lens::of_coefficients(&camera.distortion)?,
        rectified_from_camera: *rotation,
        rectified_focal_px: focal_px,
        rectified_centre_px: centre_px,
    })
}

/// A view that is already rectified.
fn rectified(size: (usize, usize)) -> RectifiedView {
    RectifiedView {
        size,
        focal_px: [1.0; 2],
        centre_px: [0.0; 2],
        lens: Lens::NONE,
        rectified_from_camera: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        rectified_focal_px: [1.0; 2],
        rectified_centre_px: [0.0; 2],
    }
}

/// Refuses a disparity map that does not belong to an image of this size.
pub(crate) fn check_map(map: (usize, usize), picture: (usize, usize)) -> Result<()> {
    match map_factor(map, picture) {
        Some(_) => Ok(()),
        None => Err(error!(
            "the disparity is {}x{}, but the left view is {}x{}: connect the disparity of these views, of their size or smaller by an integer factor",
            map.0, map.1, picture.0, picture.1
        )),
    }
}
