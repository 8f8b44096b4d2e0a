//! `evaluate_cloud`: distances of points from the true surface.

use panoscope_data::calibration::packet as calibration;
use panoscope_imaging::stereo::{Rectification, score_surface};
use panoscope_node::abi::{Calibration, Scalar};
use panoscope_node::{
    Cloud, Context, Depth, Image, Node, NodeInfo, Open, Params, Ports, Result, Slot, TableData, Validation, Value,
    error,
};

use super::needs;

/// Inputs.
#[derive(Ports)]
pub struct In<'f> {
    /// The points to evaluate, in the left rectified camera's frame. A tick without them covers nothing.
    cloud: Option<Cloud<'f>>,
    /// True depth of the left rectified view.
    truth: Image<'f, Depth>,
    /// Calibration of the rectified views.
    calibration: Value<'f, Calibration>,
}

/// Outputs, of one tick; NaN without points.
#[derive(Ports)]
pub struct Out<'f> {
    /// Median distance of the points from the nearest point of the true surface; distances beyond `reach_mm` count as `reach_mm`.
    median_mm: Slot<'f, Scalar>,
    /// Mean distance.
    mean_mm: Slot<'f, Scalar>,
    /// Distance that 95 % of the points stay below.
    p95_mm: Slot<'f, Scalar>,
    /// Percent of the true surface with a point nearer than `reach_mm`.
    coverage_pct: Slot<'f, Scalar>,
    /// One row: the numbers above, and the number of points that were compared.
    table: Slot<'f, TableData>,
}

/// Parameters.
#[derive(Params)]
pub struct EvaluateCloudParams {
    /// Largest distance that is measured.
    #[param(default = 2.0, range = 0.1..=50.0, step = 0.1, unit = "mm")]
    reach_mm: f32,
    /// Spacing of the points that are compared, in columns and rows.
    #[param(default = 8, range = 1..=64, unit = "px")]
    step: usize,
}

/// Columns of the table.
const COLUMNS: [&str; 5] = ["median_mm", "mean_mm", "p95_mm", "coverage_pct", "points"];

/// See the module.
#[derive(Default)]
pub struct EvaluateCloud {
    views: Option<(Calibration, Rectification)>,
    surface: Vec<[f32; 3]>,
    sparse_surface: Vec<[f32; 3]>,
    points: Vec<[f32; 3]>,
    sparse_points: Vec<[f32; 3]>,
}

/// Collects the known points of a picture: all of them, and those of every `step`th column and row.
fn gather(
    (width, height): (usize, usize),
    step: usize,
    point: impl Fn(usize, usize) -> [f32; 3],
    all: &mut Vec<[f32; 3]>,
    sparse: &mut Vec<[f32; 3]>,
) {
    all.clear();
    sparse.clear();
    for y in 0..height {
        for x in 0..width {
            let point = point(x, y);
            if point.iter().all(|v| v.is_finite()) {
                all.push(point);
                // A list of points without rows is thinned out all the same.
                if x % step == step / 2 && (height == 1 || y % step == step / 2) {
                    sparse.push(point);
                }
            }
        }
    }
}

impl Node for EvaluateCloud {
    const INFO: NodeInfo = NodeInfo::compute(
        "evaluate_cloud",
        "stereo",
        "Compares points with the true surface: distances in mm to its nearest points, coverage.",
    );
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = EvaluateCloudParams;

    fn validate(_: &EvaluateCloudParams, check: &mut Validation<'_>) {
        needs(check, "cloud");
    }

    fn open(_: &Open<'_>, _: &EvaluateCloudParams) -> Result<Self> {
        Ok(Self::default())
    }

    fn process<'f>(
        &mut self,
        cx: &Context<'f>,
        input: In<'f>,
        mut out: Out<'f>,
        params: &EvaluateCloudParams,
    ) -> Result<()> {
        if self.views.as_ref().is_none_or(|(seen, _)| !calibration::same(seen, &input.calibration)) {
            self.views = None;
            self.views = Some((*input.calibration, calibration::of_rectified_views(&input.calibration)?));
        }
        let Some((_, views)) = &self.views else { return Ok(()) };
        let truth = input.truth.view();
        if (truth.width, truth.height) != (views.width, views.height) {
            return Err(error!(
                "`truth` is {}x{}, the calibration was made for {}x{}",
                truth.width, truth.height, views.width, views.height
            ));
        }
        let (cx_px, cy_px, per_px) = (views.left.cx, views.left.cy, 1.0 / views.left.focal_px);
        let on_surface = |x: usize, y: usize| {
            let z = truth.row(y)[x];
            [((x as f64 - cx_px) * per_px) as f32 * z, ((y as f64 - cy_px) * per_px) as f32 * z, z]
        };
        let step = params.step.max(1);
        gather((truth.width, truth.height), step, on_surface, &mut self.surface, &mut self.sparse_surface);
        self.points.clear();
        self.sparse_points.clear();
        if let Some(cloud) = &input.cloud {
            let (width, points) = (cloud.width(), cloud.points());
            let measured = |x: usize, y: usize| {
                let point = points.get(y * width + x).filter(|point| point.is_measured());
                point.map_or([f32::NAN; 3], |point| [point.x_mm, point.y_mm, point.z_mm])
            };
            gather((width, cloud.height()), step, measured, &mut self.points, &mut self.sparse_points);
        }
        let (mut row, mut count) = ([f64::NAN; 4], 0);
        if !self.surface.is_empty() {
            row[3] = 0.0;
            if !self.points.is_empty() {
                let found = score_surface(&self.sparse_points, &self.surface, params.reach_mm)?;
                let covered = score_surface(&self.sparse_surface, &self.points, params.reach_mm)?;
                row = [found.median_mm, found.mean_mm, found.p95_mm, 100.0 * covered.within_reach];
                count = found.points;
            }
        }
        cx.metric("median_mm", row[0]);
        out.median_mm.set_scalar("median distance", row[0], "mm")?;
        out.mean_mm.set_scalar("mean distance", row[1], "mm")?;
        out.p95_mm.set_scalar("95 % distance", row[2], "mm")?;
        out.coverage_pct.set_scalar("coverage", row[3], "%")?;
        out.table.set_table(&COLUMNS, &[row[0], row[1], row[2], row[3], count as f64])
    }
}
