//! `register_grid`: a disparity map in, the homography between the two pictures out (thesis, chapter 4).

use panoscope_imaging::geometry::RansacParams;
use panoscope_imaging::stitch::{CellPoint, GridParams, RectifiedView, RegisterGrid};
use panoscope_node::abi::{Calibration, Camera};
use panoscope_node::{Choice, Context, Disparity, Image, Node, NodeInfo, Open, Params, Ports, Result, Value};

use crate::registration::{HoldParams, Out, Registered, Reporter};

/// Point that a grid cell contributes.
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Point {
    /// The middle of the cell with the median of its disparities.
    Median,
    /// The valid pixel with the largest disparity.
    Peak,
}

/// Parameters of the registration.
#[derive(Params, Clone, PartialEq)]
pub struct RegisterGridParams {
    /// Rows of the grid on the overlap.
    #[param(default = 9, range = 2..=100)]
    rows: u32,
    /// Columns of the grid on the overlap.
    #[param(default = 24, range = 2..=200)]
    columns: u32,
    /// Point that each cell contributes.
    #[param(default = "median")]
    point: Point,
    /// Spacing of the pixels that are read in a cell.
    #[param(default = 3, range = 1..=16, unit = "px")]
    scale: u32,
    /// Share of a cell's pixels that must have a disparity.
    #[param(default = 0.3, range = 0.0..=1.0, step = 0.05, unit = "ratio")]
    least_valid: f32,
    /// Largest reprojection error of an inlier.
    #[param(default = 4.0, range = 0.2..=40.0, step = 0.1, unit = "px")]
    ransac_px: f64,
    /// Smallest number of inliers of a registration.
    #[param(default = 12, range = 4..=1000, unit = "points")]
    min_inliers: u32,
    #[param(flatten)]
    keep: HoldParams,
}

impl RegisterGridParams {
    fn kernel(&self) -> GridParams {
        let default = GridParams::default();
        GridParams {
            rows: self.rows as usize,
            columns: self.columns as usize,
            point: match self.point {
                Point::Median => CellPoint::Median,
                Point::Peak => CellPoint::Peak,
            },
            step_px: self.scale as usize,
            least_valid: self.least_valid,
            ransac: RansacParams { threshold_px: self.ransac_px, ..default.ransac },
            min_inliers: self.min_inliers as usize,
            stability_px: self.keep.stability_px,
            anchor_fit: self.keep.anchor_fit,
            max_rms_px: self.keep.max_rms_px,
            hold_frames: self.keep.hold_frames as usize,
            ..default
        }
    }
}

/// Inputs of the registration.
#[derive(Ports)]
pub struct In<'f> {
    /// Disparity of the left rectified view, full size.
    disparity: Image<'f, Disparity>,
    /// Calibration of the pictures to stitch. The homography is between these pictures, not between the rectified views, unless the calibration says
    /// that they are rectified.
    calibration: Value<'f, Calibration>,
}

/// See the module.
pub struct RegisterGridNode {
    kernel: RegisterGrid,
    reporter: Reporter,
}

/// One side of a calibration.
pub(crate) fn view(camera: &Camera, rotation: &[f64; 9], projection: &[f64; 12], rectified: bool) -> RectifiedView {
    let focal_px = [projection[0], projection[5]];
    let centre_px = [projection[2], projection[6]];
    let size = (camera.width as usize, camera.height as usize);
    let mut distortion = [0.0; 12];
    if rectified {
        let rectified_from_camera = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
        return RectifiedView {
            size,
            focal_px,
            centre_px,
            distortion,
            rectified_from_camera,
            rectified_focal_px: focal_px,
            rectified_centre_px: centre_px,
        };
    }
    distortion.copy_from_slice(&camera.distortion[..12]);
    RectifiedView {
        size,
        focal_px: [camera.fx, camera.fy],
        centre_px: [camera.cx, camera.cy],
        distortion,
        rectified_from_camera: *rotation,
        rectified_focal_px: focal_px,
        rectified_centre_px: centre_px,
    }
}

impl Node for RegisterGridNode {
    const INFO: NodeInfo = NodeInfo::compute(
        "register_grid",
        "stitch",
        "Finds the homography between two overlapping views from a grid on their disparity, where tissue has no features.",
    );
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = RegisterGridParams;

    fn open(_: &Open<'_>, params: &RegisterGridParams) -> Result<Self> {
        Ok(Self { kernel: RegisterGrid::new(params.kernel()), reporter: Reporter::default() })
    }

    fn process<'f>(
        &mut self,
        cx: &Context<'f>,
        input: In<'f>,
        mut out: Out<'f>,
        params: &RegisterGridParams,
    ) -> Result<()> {
        let wanted = params.kernel();
        if *self.kernel.params() != wanted {
            self.kernel.set_params(wanted);
        }
        let c = &*input.calibration;
        let rectified = c.is_rectified != 0;
        let left = view(&c.left, &c.rectified_from_left, &c.left_projection, rectified);
        let right = view(&c.right, &c.rectified_from_right, &c.right_projection, rectified);
        let found = self.kernel.register(input.disparity.view(), &left, &right);
        cx.metric("grid_points", found.points as f64);
        let found = Registered {
            left_from_right: &found.left_from_right,
            rms_px: found.rms_px,
            refused_rms_px: found.refused_rms_px,
            inliers: found.inliers,
            state: found.state,
            roi_left: &found.roi_left,
            roi_right: &found.roi_right,
        };
        let help = "move back, clean the lenses, or widen the search of the disparity";
        self.reporter.finish(cx, &mut out, &found, params.keep.max_rms_px, help)
    }
}
