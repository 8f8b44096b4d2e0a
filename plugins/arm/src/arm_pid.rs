//! `arm_pid`: from the tip's error in the image (px) and in distance (mm) to joint velocities (thesis, chapter 6, fig. 6.3).

use std::path::PathBuf;

use nalgebra::Vector3;
use panoscope_arm_core::control::{CameraGeometry, Controller, Goals, SeenTip};
use panoscope_arm_core::pid::Gains;
use panoscope_arm_core::tracking::real_time::RealTime;
use panoscope_node::abi::{Calibration, Joints, Tip};
use panoscope_node::{Context, Node, NodeInfo, Open, Params, Ports, Result, Slot, TableData, Validation, Value, error};

use crate::joints::{angles, arm_of, check_arm, packet};

/// Input ports of `arm_pid`.
#[derive(Ports)]
pub struct In<'f> {
    /// The tip to follow, in the left rectified camera's frame, mm. Empty: no velocities are requested.
    tip: Option<Value<'f, Tip>>,
    /// Joint angles when the image was taken: the driver's `joints`, wired with `delay = 1`.
    joints: Option<Value<'f, Joints>>,
    /// Newest set-points of the driver, wired with `delay = 1`. With them the controller accounts for set-points that the arm has not reached yet.
    setpoint: Option<Value<'f, Joints>>,
    /// Calibration of the rectified views; without it `focal_px` and `baseline_mm` are used.
    calibration: Option<Value<'f, Calibration>>,
}

/// Output ports of `arm_pid`.
#[derive(Ports)]
pub struct Out<'f> {
    /// Requested joint velocities (rad/s), with the present joint angles (rad). Empty without a tip.
    joints: Slot<'f, Joints>,
    /// One row per tick with a tip: errors in px, mm and percent, speed of the tip (mm/s), largest requested velocity (rad/s), distance from a
    /// singular pose, share of the limits used, score.
    table: Slot<'f, TableData>,
}

/// Parameters. `panoscope tune` finds gains for an arm and writes them as these.
#[derive(Params)]
pub struct PidParams {
    /// URDF file of the arm; empty takes the arm that comes with the plugin. The driver must use the same.
    #[param(default = "", reopen)]
    arm: PathBuf,
    /// Distance of the tip from the left camera.
    #[param(default = 66.0, range = 30.0..=120.0, step = 1.0, unit = "mm")]
    distance_mm: f64,
    /// Proportional gain of the tip's position in the image, 1/s.
    #[param(default = 6.0, range = 0.0..=20.0, step = 0.1)]
    picture_p: f64,
    /// Integral gain of the tip's position in the image, 1/s^2.
    #[param(default = 0.2, range = 0.0..=10.0, step = 0.05)]
    picture_i: f64,
    /// Derivative gain on the tip's measured position in the image. A new goal causes no kick, because the goal is not differentiated.
    #[param(default = 0.2, range = 0.0..=1.0, step = 0.01)]
    picture_d: f64,
    /// Proportional gain of the distance, 1/s.
    #[param(default = 6.0, range = 0.0..=20.0, step = 0.1)]
    distance_p: f64,
    /// Integral gain of the distance, 1/s^2.
    #[param(default = 0.2, range = 0.0..=10.0, step = 0.05)]
    distance_i: f64,
    /// Derivative gain on the measured distance.
    #[param(default = 0.2, range = 0.0..=1.0, step = 0.01)]
    distance_d: f64,
    /// Time constant of the low-pass filter of the derivatives.
    #[param(default = 0.08, range = 0.0..=1.0, step = 0.01, unit = "s")]
    filter_s: f64,
    /// Share of the tip's own velocity that is fed forward.
    #[param(default = 1.0, range = 0.0..=1.0, step = 0.05, unit = "ratio")]
    feed_forward: f64,
    /// Dead zone of the error in the image, for 640 columns.
    #[param(default = 2.0, range = 0.0..=50.0, step = 0.5, unit = "px")]
    dead_zone_px: f64,
    /// Dead zone of the error of the distance.
    #[param(default = 0.2, range = 0.0..=10.0, step = 0.1, unit = "mm")]
    dead_zone_mm: f64,
    /// Time from a set-point to the movement.
    #[param(default = 0.045, range = 0.0..=0.5, step = 0.005, unit = "s")]
    latency_s: f64,
    /// Standard deviation of the tip's unknown acceleration, mm/s^2. Higher values follow faster and are less smooth.
    #[param(default = 80.0, range = 1.0..=5000.0, step = 1.0)]
    tip_acceleration: f64,
    /// Lowest score of a tip that is followed.
    #[param(default = 0.3, range = 0.0..=1.0, step = 0.01, unit = "ratio")]
    min_score: f64,
    /// Focal length when no calibration is connected.
    #[param(default = 750.0, range = 10.0..=20000.0, step = 1.0, unit = "px")]
    focal_px: f64,
    /// Distance of the cameras when no calibration is connected.
    #[param(default = 15.0, range = 1.0..=100.0, step = 0.5, unit = "mm")]
    baseline_mm: f64,
}

/// Focal length at 640 columns for which the dead zone is stated, px.
const THESIS_FOCAL_PX: f64 = 750.0;
/// Speed limit for correcting an error, at 640 columns, px/s and mm/s, in addition to the feed-forward. Above it the joints' accelerations limit the
/// movement, and the tube misses the trocar by more.
const MAX_PX_S: f64 = 250.0;
const MAX_MM_S: f64 = 20.0;

/// Columns of the table, in order.
pub const COLUMNS: [&str; 10] = [
    "error_u_px",
    "error_v_px",
    "error_distance_mm",
    "error_mm",
    "error_share_pct",
    "tip_mm_s",
    "asked_rad_s",
    "singular",
    "limit_share",
    "score",
];

impl PidParams {
    fn goals(&self, focal_px: f64) -> Goals {
        let scale = focal_px / THESIS_FOCAL_PX;
        let picture = Gains {
            proportional: self.picture_p,
            integral: self.picture_i,
            derivative: self.picture_d,
            filter_s: self.filter_s,
            dead_zone: self.dead_zone_px * scale,
            most: MAX_PX_S * scale,
        };
        let distance = Gains {
            proportional: self.distance_p,
            integral: self.distance_i,
            derivative: self.distance_d,
            filter_s: self.filter_s,
            dead_zone: self.dead_zone_mm,
            most: MAX_MM_S,
        };
        Goals {
            distance_mm: self.distance_mm,
            picture,
            distance,
            feed_forward: self.feed_forward,
            latency_s: self.latency_s,
            acceleration_mm_s2: self.tip_acceleration,
            min_score: self.min_score,
        }
    }
}

/// PID controller with feed-forward of the tip's velocity.
pub struct ArmPid {
    controller: Controller,
    time: RealTime,
}

impl Node for ArmPid {
    const INFO: NodeInfo = NodeInfo::compute(
        "arm_pid",
        "arm",
        "Requests joint velocities about the trocar that bring the tip to the centre of the shared image and to its distance.",
    );
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = PidParams;

    fn validate(params: &PidParams, check: &mut Validation<'_>) {
        check_arm(check, &params.arm);
    }

    fn open(_: &Open<'_>, params: &PidParams) -> Result<Self> {
        Ok(Self { controller: Controller::new(arm_of(&params.arm)?), time: RealTime::default() })
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, mut out: Out<'f>, params: &PidParams) -> Result<()> {
        let mut cameras =
            CameraGeometry { focal_px: (params.focal_px, params.focal_px), baseline_mm: params.baseline_mm };
        let mut width_px = None;
        if let Some(c) = &input.calibration {
            let (fx, fy) = (c.left_projection[0], c.left_projection[5]);
            if !(fx > 0.0 && fy > 0.0 && c.baseline_mm > 0.0 && (fx + fy + c.baseline_mm).is_finite()) {
                return Err(error!(
                    "the calibration has focal lengths {fx}, {fy} px and baseline {} mm",
                    c.baseline_mm
                ));
            }
            cameras = CameraGeometry { focal_px: (fx, fy), baseline_mm: c.baseline_mm };
            width_px = Some(f64::from(c.left.width));
        }
        let joints = input.joints.map(|j| angles(&j)).transpose()?;
        let set_point = input.setpoint.map(|j| angles(&j)).transpose()?;
        let tip = input.tip.filter(|tip| tip.xyz_valid == 1);
        // A slow detector's tips are older than the tick, and the tick's light is as old as the host says.
        let now_ns = self.time.step(cx.tick().capture_ns, cx.tick_arrived_ns());
        let behind = |tip: &Value<'_, Tip>| cx.tick().capture_ns.saturating_sub(tip.tick().capture_ns);
        let behind_ns = tip.as_ref().map_or(0, |tip| self.time.real(behind(tip)));
        let age_s = cx.tick_age().as_secs_f64() + behind_ns as f64 * 1e-9;
        let place = |tip: &Value<'_, Tip>| SeenTip { xyz_mm: Vector3::from(tip.xyz_mm), score: tip.score, age_s };
        let seen = tip.as_ref().map(place);
        let Some(joints) = joints else { return Ok(()) };
        let taken_ns = now_ns.saturating_sub(behind_ns);
        let goals = params.goals(cameras.focal_px.0);
        let Some(step) = self.controller.step(taken_ns, seen, &joints, set_point.as_ref(), &cameras, &goals) else {
            return Ok(());
        };
        out.joints.set(packet(&joints, &step.velocity))?;
        cx.metric("error_mm", step.error_mm);
        let width_px = width_px.unwrap_or(cameras.focal_px.0 * 640.0 / THESIS_FOCAL_PX);
        let share_pct = 100.0 * step.errors.x.hypot(step.errors.y) / width_px;
        let row: [f64; COLUMNS.len()] = [
            step.errors.x,
            step.errors.y,
            step.errors.z,
            step.error_mm,
            share_pct,
            step.tip_mm_s.norm(),
            step.velocity.amax(),
            step.singular,
            step.share,
            seen.map_or(0.0, |tip| tip.score),
        ];
        out.table.set_table(&COLUMNS, &row)
    }
}
