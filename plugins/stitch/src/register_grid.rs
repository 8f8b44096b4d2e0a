//! `register_grid`: computes the homography between two views from a disparity map (thesis, chapter 4).

use panoscope_imaging::features::RegisterSurf;
use panoscope_imaging::geometry::RansacParams;
use panoscope_imaging::stitch::{CellPoint, GridParams, RegisterGrid};
use panoscope_node::abi::Calibration;
use panoscope_node::pick::{Grid, Parts};
use panoscope_node::{
    Choice, Context, Disparity, Image, Node, NodeInfo, Open, Params, Picture, Ports, Result, Validation, Value,
};

use crate::calibrated_views::{CalibratedViews, check_map};
use crate::register_surf;
use crate::registration::{HoldParams, Out, Registered, Reporter};

/// Point that a grid cell contributes.
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Point {
    /// The centre of the cell with the median of its disparities.
    Median,
    /// The valid pixel with the largest disparity.
    Peak,
}

/// Parameters of the registration.
#[derive(Params, Clone, PartialEq)]
pub struct RegisterGridParams {
    /// Number of rows of the grid on the overlap.
    #[param(default = 9, range = 2..=100)]
    rows: u32,
    /// Number of columns of the grid on the overlap.
    #[param(default = 24, range = 2..=200)]
    columns: u32,
    /// Point that each cell contributes.
    #[param(default = "median")]
    point: Point,
    /// Spacing of the pixels that are read in a cell.
    #[param(default = 3, range = 1..=16, unit = "px")]
    scale: u32,
    /// Minimum share of a cell's pixels that have a disparity.
    #[param(default = 0.3, range = 0.0..=1.0, step = 0.05, unit = "ratio")]
    least_valid: f32,
    /// Maximum reprojection error of an inlier.
    #[param(default = 4.0, range = 0.2..=40.0, step = 0.1, unit = "px")]
    ransac_px: f64,
    /// Minimum number of inliers of a registration.
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
            min_valid: self.least_valid,
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
    /// Disparity of the left rectified view, as large as the views or smaller by an integer factor.
    disparity: Option<Image<'f, Disparity>>,
    /// Calibration of the views. The homography is between these views, not between the rectified ones, unless the calibration states that they are
    /// rectified. Unconnected: they are assumed to be rectified.
    calibration: Option<Value<'f, Calibration>>,
    /// Left view. With `right` connected too, a tick without a disparity is registered by features.
    left: Option<Picture<'f>>,
    /// Right view of the same instant.
    right: Option<Picture<'f>>,
}

/// The `register_grid` node.
pub struct RegisterGridNode {
    kernel: RegisterGrid,
    views: CalibratedViews,
    parts: Parts<f32>,
    /// Registration by features, for ticks without a disparity.
    features: Option<RegisterSurf>,
    reporter: Reporter,
}

impl RegisterGridNode {
    /// Registers a tick without a disparity by features, as `register_surf` does with its defaults. Does nothing if the views are not connected.
    fn by_features(
        &mut self,
        cx: &Context<'_>,
        input: &In<'_>,
        out: &mut Out<'_>,
        params: &RegisterGridParams,
    ) -> Result<()> {
        let (Some(left), Some(right)) = (&input.left, &input.right) else { return Ok(()) };
        if self.features.is_none() {
            cx.warn("no disparity arrived: the views are registered by their features, with one homography");
        }
        let wanted = register_surf::by_default(&params.keep);
        let kernel = self.features.get_or_insert_with(|| RegisterSurf::new(wanted));
        kernel.set_params(wanted);
        let found = kernel.register(left.view(), right.view(), cx.pool());
        let found = Registered {
            left_from_right: &found.left_from_right,
            rms_px: found.rms_px,
            refused_rms_px: found.refused_rms_px,
            inliers: found.inliers,
            state: found.state,
            roi_left: &found.roi_left,
            roi_right: &found.roi_right,
        };
        let help = "connect a calibration, move back, or clean the lenses";
        self.reporter.finish(cx, out, &found, params.keep.max_rms_px, help)
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

    fn validate(_: &RegisterGridParams, check: &mut Validation<'_>) {
        let is_open = |name: &str| check.is_connected(name) == Some(false);
        if is_open("disparity") && (is_open("left") || is_open("right")) {
            check.node_error(
                "neither a disparity nor two views are connected",
                "connect `disparity`, as in disparity = \"match.disparity\", or the views `left` and `right`",
            );
        }
    }

    fn open(_: &Open<'_>, params: &RegisterGridParams) -> Result<Self> {
        Ok(Self {
            kernel: RegisterGrid::new(params.kernel()),
            views: CalibratedViews::default(),
            parts: Parts::default(),
            features: None,
            reporter: Reporter::default(),
        })
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
        let Some(disparity) = &input.disparity else { return self.by_features(cx, &input, &mut out, params) };
        if self.features.take().is_some() {
            cx.info("a disparity arrived: it is used to register the views from now on");
        }
        let size = (disparity.width(), disparity.height());
        // Without a calibration the pictures tell their own size.
        let picture = input.left.as_ref().map_or(size, |left| (left.width(), left.height()));
        let [left, right] = self.views.of(input.calibration.as_deref(), [picture; 2])?;
        check_map(size, left.size)?;
        // Of a map on the GPU only what is read.
        let read = if disparity.is_from_device() { self.kernel.pixels(size, &left, &right) } else { None };
        let map = match read {
            Some([columns, rows]) => self.parts.view(*disparity, &[Grid { columns, rows }]),
            None => disparity.view(),
        };
        let found = self.kernel.register(map, &left, &right);
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
