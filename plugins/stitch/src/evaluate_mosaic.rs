//! `evaluate_mosaic`: positions of frames in a mosaic compared with their true positions, one row per tick.

use panoscope_imaging::geometry::{Homography as Map, Point};
use panoscope_node::abi::{self, Calibration, Homography, Pose};
use panoscope_node::{Context, Depth, Image, Node, NodeInfo, Open, Params, Ports, Result, Slot, TableData, Value};

/// Columns of the table.
const COLUMNS: [&str; 8] = ["tick", "state", "drift_px", "drift_mm", "drift_pct", "floor_px", "path_mm", "start_mm"];
/// Value of `state` for a tick without a homography.
const STATE_NONE: f64 = 3.0;
/// Minimum number of points per frame.
const MIN_POINTS: usize = 12;

/// Parameters of the evaluation.
#[derive(Params, Clone, PartialEq)]
pub struct EvaluateMosaicParams {
    /// Spacing of the points that are compared.
    #[param(default = 40, range = 4..=200, unit = "px")]
    step: u32,
}

/// Inputs of the evaluation.
#[derive(Ports)]
pub struct In<'f> {
    /// The homography of the frame to evaluate.
    homography: Option<Value<'f, Homography>>,
    /// True pose of the camera in the scene.
    pose: Value<'f, Pose>,
    /// True depth of the frame.
    depth: Image<'f, Depth>,
    /// True calibration; only the left camera is used.
    calibration: Value<'f, Calibration>,
}

/// Outputs of the evaluation.
#[derive(Ports)]
pub struct Out<'f> {
    /// A row for every tick so far; NaN where the frame has no position. `state`: 0 fresh, 2 lost, 3 none. `drift_px`: root mean square distance,
    /// over the frame, between where the mosaic puts its points and where the camera of the first frame would see them; `drift_mm`: the same on the
    /// tissue; `drift_pct`: the same as a percentage of the camera's path so far. `floor_px`: residual of the best homography, 0 for a plane.
    /// `start_mm`: distance of the camera from its first position.
    table: Slot<'f, TableData>,
}

/// The `evaluate_mosaic` node.
pub struct EvaluateMosaic {
    rows: Vec<f64>,
    first: Option<Pose>,
    last_mm: Option<[f64; 3]>,
    path_mm: f64,
    ticks: u64,
    frame: Vec<Point>,
    truth: Vec<Point>,
    per_px_mm: Vec<f64>,
}

/// Rotates a vector by a quaternion `w, x, y, z`, or by its inverse if `back`.
fn turned(q: [f64; 4], v: [f64; 3], back: bool) -> [f64; 3] {
    let sign = if back { -1.0 } else { 1.0 };
    let (w, u) = (q[0], [q[1] * sign, q[2] * sign, q[3] * sign]);
    let cross =
        |a: [f64; 3], b: [f64; 3]| [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    let t = cross(u, v).map(|c| 2.0 * c);
    let s = cross(u, t);
    [0, 1, 2].map(|i| v[i] + w * t[i] + s[i])
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|i| (a[i] - b[i]) * (a[i] - b[i])).sum::<f64>().sqrt()
}

impl EvaluateMosaic {
    /// Points of the frame, their positions in the camera of the first frame, and the size of its pixels there.
    fn points(&mut self, input: &In<'_>, first: &Pose, step: usize) {
        self.frame.clear();
        self.truth.clear();
        self.per_px_mm.clear();
        let (depth, camera, pose) = (input.depth.view(), &input.calibration.left, &*input.pose);
        for y in (step / 2..depth.height).step_by(step) {
            for x in (step / 2..depth.width).step_by(step) {
                let z = f64::from(depth.row(y)[x]);
                if !(z.is_finite() && z > 0.0) {
                    continue;
                }
                let (u, v) = (x as f64, y as f64);
                let seen = [(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z];
                let turned_to_scene = turned(pose.a_from_b_wxyz, seen, false);
                let scene = [0, 1, 2].map(|i| turned_to_scene[i] + pose.a_from_b_mm[i] - first.a_from_b_mm[i]);
                let [px, py, pz] = turned(first.a_from_b_wxyz, scene, true);
                if pz > 0.0 {
                    self.frame.push([u, v]);
                    self.truth.push([px / pz * camera.fx + camera.cx, py / pz * camera.fy + camera.cy]);
                    self.per_px_mm.push(pz / camera.fx);
                }
            }
        }
    }
}

impl Node for EvaluateMosaic {
    const INFO: NodeInfo = NodeInfo::compute(
        "evaluate_mosaic",
        "stitch",
        "Compares where a mosaic puts its frames with where the phantom's cameras truly were: drift in pixels, mm and percent of the path.",
    );
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = EvaluateMosaicParams;

    fn open(_: &Open<'_>, _: &EvaluateMosaicParams) -> Result<Self> {
        Ok(Self {
            rows: Vec::new(),
            first: None,
            last_mm: None,
            path_mm: 0.0,
            ticks: 0,
            frame: Vec::new(),
            truth: Vec::new(),
            per_px_mm: Vec::new(),
        })
    }

    fn process<'f>(
        &mut self,
        _: &Context<'f>,
        input: In<'f>,
        mut out: Out<'f>,
        params: &EvaluateMosaicParams,
    ) -> Result<()> {
        let mut row = [f64::NAN; COLUMNS.len()];
        let state = input.homography.as_ref().map_or(STATE_NONE, |h| f64::from(h.state));
        let is_fresh = state == f64::from(abi::STATE_FRESH);
        let at_mm = input.pose.a_from_b_mm;
        self.path_mm += self.last_mm.map_or(0.0, |last| distance(last, at_mm));
        self.last_mm = Some(at_mm);
        // The mosaic's plane is that of the first frame that it took.
        if is_fresh && self.first.is_none() {
            self.first = Some(*input.pose);
            self.path_mm = 0.0;
        }
        (row[0], row[1], row[6]) = (self.ticks as f64, state, self.path_mm);
        if let Some(first) = self.first {
            row[7] = distance(first.a_from_b_mm, at_mm);
            if let Some(given) = input.homography.as_ref().filter(|_| is_fresh) {
                let map = Map(given.left_from_right);
                self.points(&input, &first, params.step.max(1) as usize);
                if self.frame.len() >= MIN_POINTS {
                    let count = self.frame.len() as f64;
                    let pairs = || self.frame.iter().zip(&self.truth);
                    let rms = |map: &Map| (pairs().map(|(p, q)| map.squared_error(*p, *q)).sum::<f64>() / count).sqrt();
                    let squares = pairs().zip(&self.per_px_mm).map(|((p, q), mm)| map.squared_error(*p, *q) * mm * mm);
                    row[2] = rms(&map);
                    row[3] = (squares.sum::<f64>() / count).sqrt();
                    row[4] = if self.path_mm > 0.0 { 100.0 * row[3] / self.path_mm } else { f64::NAN };
                    let best = Map::fit(&self.frame, &self.truth, |_| true);
                    row[5] = best.map_or(f64::NAN, |best| rms(&best.refine(&self.frame, &self.truth, |_| true, 10)));
                }
            }
        }
        self.ticks += 1;
        self.rows.extend(row);
        out.table.set_table(&COLUMNS, &self.rows)
    }
}
