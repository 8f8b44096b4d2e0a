//! `evaluate_arm`: errors of an arm that follows an exactly known tip, one row per tick.

use nalgebra::Vector3;
use panoscope_arm_core::control::{CameraGeometry, errors, goal_mm};
use panoscope_node::abi::{Calibration, Tip};
use panoscope_node::{Context, Node, NodeInfo, Open, Params, Ports, Result, Slot, Table, TableData, Value};

/// Input ports of `evaluate_arm`.
#[derive(Ports)]
pub struct In<'f> {
    /// The true tip (`lead` of the phantom), mm; score 0 while it is hidden or outside the image.
    tip: Option<Value<'f, Tip>>,
    /// Table of the arm's driver.
    arm: Option<Table<'f>>,
    /// Table of the `tip_track` that controls the arm, for the time since the tip was seen and the tracker's error.
    track: Option<Table<'f>>,
    /// Calibration of the rectified views.
    calibration: Value<'f, Calibration>,
}

/// Output ports of `evaluate_arm`.
#[derive(Ports)]
pub struct Out<'f> {
    /// One row per tick; errors are NaN while the tip is not known. `in_view`: the tip is inside the left image. `seen`: nothing hides it there.
    /// `gap_ms`: time since the tracker saw the tip. `track_off_mm`: error of the tracker's position. Both are NaN while the tracker has no tip.
    table: Slot<'f, TableData>,
}

/// Parameters of `evaluate_arm`.
#[derive(Params)]
pub struct JudgeParams {
    /// Requested distance of the tip from the left camera.
    #[param(default = 66.0, range = 30.0..=120.0, step = 1.0, unit = "mm")]
    distance_mm: f64,
    /// Number of the tool that is followed; tips of other tools are not evaluated. -1 evaluates all.
    #[param(default = -1, range = -1..=1_000_000_000)]
    track_id: i64,
}

/// Columns of the table. Columns copied from the arm's table keep their names.
pub const COLUMNS: [&str; 13] = [
    "time_s",
    "error_mm",
    "error_u_px",
    "error_v_px",
    "error_distance_mm",
    "in_view",
    "pivot_mm",
    "following",
    "camera_mm_s",
    "camera_mm_s2",
    "seen",
    "gap_ms",
    "track_off_mm",
];

/// Positions of the columns that are copied from the arm's table.
const OF_THE_ARM: std::ops::Range<usize> = 6..10;

/// The `evaluate_arm` node.
pub struct EvaluateArm;

impl Node for EvaluateArm {
    const INFO: NodeInfo =
        NodeInfo::compute("evaluate_arm", "arm", "Evaluates how well an arm follows an exactly known tip.");
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = JudgeParams;

    fn open(_: &Open<'_>, _: &JudgeParams) -> Result<Self> {
        Ok(Self)
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, mut out: Out<'f>, params: &JudgeParams) -> Result<()> {
        let c = &input.calibration;
        let cameras =
            CameraGeometry { focal_px: (c.left_projection[0], c.left_projection[5]), baseline_mm: c.baseline_mm };
        let tip = input.tip.filter(|tip| params.track_id < 0 || tip.track_id == params.track_id);
        let mut row = [f64::NAN; COLUMNS.len()];
        row[0] = cx.tick().capture_ns as f64 * 1e-9;
        let (width, height) = (f64::from(c.left.width), f64::from(c.left.height));
        let inside = |tip: &Tip| {
            tip.xyz_mm[2] > 0.0 && (-0.5..width - 0.5).contains(&tip.u_px) && (-0.5..height - 0.5).contains(&tip.v_px)
        };
        row[5] = f64::from(u8::from(tip.as_ref().is_some_and(|tip| inside(tip))));
        row[10] = f64::from(u8::from(tip.as_ref().is_some_and(|tip| tip.score > 0.0)));
        if let Some(tip) = tip {
            let at = Vector3::from(tip.xyz_mm);
            let off = errors(&at, &cameras, params.distance_mm);
            row[1] = (at - goal_mm(params.distance_mm, cameras.baseline_mm)).norm();
            row[2..5].copy_from_slice(off.as_slice());
        }
        if let Some(table) = &input.arm
            && let Some(values) = table.rows().next()
        {
            for (name, value) in table.names().zip(values) {
                if let Some(column) = OF_THE_ARM.into_iter().find(|column| COLUMNS[*column] == name) {
                    row[column] = *value;
                }
            }
        }
        if let Some(table) = &input.track
            && let Some(values) = table.rows().next()
        {
            let value = |name: &str| {
                let column = table.names().position(|n| n == name);
                column.and_then(|column| values.get(column)).copied().unwrap_or(f64::NAN)
            };
            row[11] = value("gap_ms");
            if let Some(tip) = tip {
                let tracked = Vector3::new(value("x_mm"), value("y_mm"), value("z_mm"));
                row[12] = (tracked - Vector3::from(tip.xyz_mm)).norm();
            }
        }
        out.table.set_table(&COLUMNS, &row)
    }
}
