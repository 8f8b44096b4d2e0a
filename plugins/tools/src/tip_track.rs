//! `tip_track`: the leading tip over time, in space: filtered, gated, predicted over short gaps (thesis, fig. 6.5: the tip's trajectory).

use std::collections::VecDeque;
use std::time::Duration;

use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};
use panoscope_arm_core::tracking::kalman::Model;
use panoscope_arm_core::tracking::real_time::RealTime;
use panoscope_arm_core::tracking::tracker::{Known, Report, Rules, Tracker, UNKNOWN_CLASS};
use panoscope_node::abi::{Calibration, Pose, Tip};
use panoscope_node::{Context, List, Node, NodeInfo, Open, Params, Ports, Result, Slot, TableData, Value, error};

/// Input ports of `tip_track`.
#[derive(Ports)]
pub struct In<'f> {
    /// Tips of one or more detectors, mm, in the left rectified camera's frame at the time of their images. Wire a detector that is slower than the
    /// camera with `align = "latest"`: each of its tips is used once, with the age of its image.
    tip: List<'f, Value<'f, Tip>>,
    /// Tips that another tool hides: the output `hidden` of `tool_tip`. A leading tool whose tip is hidden keeps the lead for up to 5 s.
    hidden: Option<List<'f, Value<'f, Tip>>>,
    /// Pose of the left camera in the scene. Without it the camera's own movement counts as the tip's movement.
    camera_pose: Option<Value<'f, Pose>>,
    /// Calibration of the rectified views, for the uncertainty of depth and for the pixels of predicted tips.
    calibration: Option<Value<'f, Calibration>>,
}

/// Output ports of `tip_track`.
#[derive(Ports)]
pub struct Out<'f> {
    /// The leading tip in the left camera's frame, mm. The score of a predicted tip falls with the time since it was last seen. A tip of unknown
    /// class gets the class that its tool had most often. Empty when lost.
    tip: Slot<'f, Tip>,
    /// One row per tick while the tip is known: position in the camera's frame and in the scene (mm), velocity (mm/s), standard deviation (mm), time
    /// since it was seen (ms), score, number of the tool.
    table: Slot<'f, TableData>,
}

/// Parameters of `tip_track`.
#[derive(Params)]
pub struct TrackParams {
    /// Standard deviation of a tool's unknown acceleration, mm/s^2. Higher values follow faster and are less smooth.
    #[param(default = 200.0, range = 1.0..=5000.0, step = 1.0)]
    acceleration: f64,
    /// Squared Mahalanobis distance above which a detection does not belong to this tip; 16.3 accepts 99.9 % of the true ones.
    #[param(default = 16.3, range = 1.0..=200.0, step = 0.1)]
    gate: f64,
    /// Standard deviation of a tip's position in the image.
    #[param(default = 1.0, range = 0.05..=20.0, step = 0.05, unit = "px")]
    lateral_px: f64,
    /// Standard deviation of a tip's disparity.
    #[param(default = 0.5, range = 0.05..=20.0, step = 0.05, unit = "px")]
    disparity_px: f64,
    /// Minimum score of a tip that is used.
    #[param(default = 0.3, range = 0.0..=1.0, step = 0.01, unit = "ratio")]
    min_score: f64,
    /// Maximum duration of a prediction without a detection; after it the tip is lost.
    #[param(default = 300.0, range = 0.0..=2000.0, step = 10.0, unit = "ms")]
    max_gap_ms: f64,
    /// Time for which only other tools must be seen before one of them leads.
    #[param(default = 600.0, range = 0.0..=10000.0, step = 10.0, unit = "ms")]
    switch_ms: f64,
}

/// Columns of the table.
pub const COLUMNS: [&str; 13] = [
    "x_mm",
    "y_mm",
    "z_mm",
    "room_x_mm",
    "room_y_mm",
    "room_z_mm",
    "speed_x_mm_s",
    "speed_y_mm_s",
    "speed_z_mm_s",
    "deviation_mm",
    "gap_ms",
    "score",
    "track_id",
];

/// Maximum number of tips of one tick that are used.
const MAX_TIPS: usize = 16;
/// Maximum number of poses of the camera that are stored for late tips.
const MAX_POSES: usize = 64;

/// Tracks the leading tip.
pub struct TipTrack {
    tracker: Tracker,
    /// The last detected tip, and its capture time, ns.
    last: Option<(Tip, i64)>,
    had_pose: bool,
    /// Poses of the camera in the last ticks, with their capture times, ns.
    poses: VecDeque<(i64, Isometry3<f64>)>,
    /// Capture time of the newest tip used of each detector, ns.
    used_ns: Vec<i64>,
    time: RealTime,
}

fn pose_of(pose: &Pose) -> Option<Isometry3<f64>> {
    let [w, x, y, z] = pose.a_from_b_wxyz;
    let [tx, ty, tz] = pose.a_from_b_mm;
    let turn = UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-9)?;
    let all = [w, x, y, z, tx, ty, tz];
    all.iter().all(|v| v.is_finite()).then(|| Isometry3::from_parts(Translation3::new(tx, ty, tz), turn))
}

/// Settings of the tracker, and the projection of the left view if a calibration is connected.
fn rules_of(params: &TrackParams, calibration: Option<&Calibration>) -> Result<(Rules, Option<[f64; 12]>)> {
    let mut rules = Rules {
        model: Model { acceleration_mm_s2: params.acceleration, gate: params.gate },
        lateral_px: params.lateral_px,
        disparity_px: params.disparity_px,
        focal_px: 750.0,
        baseline_mm: 15.0,
        min_score: params.min_score,
        max_gap_s: params.max_gap_ms * 1e-3,
        switch_s: params.switch_ms * 1e-3,
    };
    let Some(c) = calibration else { return Ok((rules, None)) };
    let p = &c.left_projection;
    if !(p[0] > 0.0 && p[5] > 0.0 && c.baseline_mm > 0.0 && (p[0] + p[5] + c.baseline_mm).is_finite()) {
        return Err(error!(
            "the calibration has focal lengths {}, {} px and baseline {} mm",
            p[0], p[5], c.baseline_mm
        ));
    }
    (rules.focal_px, rules.baseline_mm) = (p[0], c.baseline_mm);
    Ok((rules, Some(*p)))
}

impl TipTrack {
    /// Stores the camera's pose at a tick, and drops what a new frame of reference or a step back in time makes invalid.
    fn begin_tick(&mut self, now_ns: i64, pose: Option<Isometry3<f64>>, detectors: usize) {
        if pose.is_some() != self.had_pose {
            // The frame has changed, so positions of the filter are invalid.
            self.had_pose = pose.is_some();
            self.tracker = Tracker::default();
        }
        if self.poses.back().is_some_and(|(newest, _)| *newest >= now_ns) {
            // Time went backwards.
            self.poses.clear();
            self.used_ns.fill(i64::MIN);
        }
        if self.poses.len() == MAX_POSES {
            self.poses.pop_front();
        }
        self.poses.push_back((now_ns, pose.unwrap_or_default()));
        self.used_ns.resize(detectors, i64::MIN);
    }

    /// Writes the outputs for the tracked tip. `lens`: projection of the left view, for the tip's pixel.
    fn write(
        &mut self,
        cx: &Context<'_>,
        out: &mut Out<'_>,
        real_ns: i64,
        room_from_camera: &Isometry3<f64>,
        (rules, lens): (&Rules, Option<[f64; 12]>),
    ) -> Result<()> {
        // Counts from the image in which it was last seen: tips of a slow detector are old when they arrive.
        let gap_s = self.last.map_or(0.0, |(_, seen_ns)| real_ns.saturating_sub(seen_ns) as f64 * 1e-9);
        let fade = if gap_s > 0.0 { (1.0 - gap_s / rules.max_gap_s.max(1e-9)).clamp(0.0, 1.0) } else { 1.0 };
        let (Some((room, speed)), Some((mut tip, _))) = (self.tracker.state(), self.last) else { return Ok(()) };
        let at = room_from_camera.inverse_transform_point(&Point3::from(room)).coords;
        tip.xyz_mm = [at.x, at.y, at.z];
        tip.score *= fade;
        // A tool that was named before keeps its name while its kind is not sure.
        if tip.class_index == UNKNOWN_CLASS {
            tip.class_index = self.tracker.class_index();
        }
        if let Some(p) = lens.filter(|_| at.z > 0.0) {
            (tip.u_px, tip.v_px) = (p[0] * at.x / at.z + p[2], p[5] * at.y / at.z + p[6]);
        }
        cx.metric("gap_ms", gap_s * 1e3);
        if gap_s > 0.0 {
            // What is predicted is as old as the image in which the tip was last seen.
            cx.set_lag(Duration::from_secs_f64(gap_s));
        }
        out.tip.set(tip)?;
        let row: [f64; COLUMNS.len()] = [
            at.x,
            at.y,
            at.z,
            room.x,
            room.y,
            room.z,
            speed.x,
            speed.y,
            speed.z,
            self.tracker.deviation_mm(),
            gap_s * 1e3,
            tip.score,
            self.tracker.track_id() as f64,
        ];
        out.table.set_table(&COLUMNS, &row)
    }
}

impl Node for TipTrack {
    const INFO: NodeInfo = NodeInfo::compute(
        "tip_track",
        "tools",
        "Tracks the leading tool's tip in space: filters it, distinguishes it from other tips, predicts it over short gaps.",
    );
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = TrackParams;

    fn open(_: &Open<'_>, _: &TrackParams) -> Result<Self> {
        let poses = VecDeque::with_capacity(MAX_POSES);
        Ok(Self {
            tracker: Tracker::default(),
            last: None,
            had_pose: false,
            poses,
            used_ns: Vec::new(),
            time: RealTime::default(),
        })
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, mut out: Out<'f>, params: &TrackParams) -> Result<()> {
        let (rules, lens) = rules_of(params, input.calibration.as_deref())?;
        let no_pose = || error!("the camera pose is not valid: its numbers are not finite, or its quaternion is 0");
        let pose = input.camera_pose.as_ref().map(|pose| pose_of(pose).ok_or_else(no_pose)).transpose()?;
        let room_from_camera = pose.unwrap_or_default();
        let now_ns = cx.tick().capture_ns;
        let real_ns = self.time.step(now_ns, cx.tick_arrived_ns());
        self.begin_tick(now_ns, pose, input.tip.len());
        let time = &self.time;
        let age_ns = |tip: &Value<'_, Tip>| time.real(now_ns.saturating_sub(tip.tick().capture_ns));
        let (poses, used_ns) = (&self.poses, &mut self.used_ns);
        let tips = || {
            let all = input.tip.iter().enumerate().filter_map(|(index, tip)| Some((index, tip?)));
            all.filter(|(_, tip)| tip.xyz_valid == 1 && tip.tick().capture_ns <= now_ns)
        };
        // Tips that were used before are skipped.
        let new_tips = tips().filter_map(|(index, tip)| {
            let seen_ns = tip.tick().capture_ns;
            let is_new = std::mem::replace(&mut used_ns[index], seen_ns) < seen_ns;
            is_new.then(|| {
                let at = Vector3::from(tip.xyz_mm);
                let then = poses.iter().min_by_key(|(pose_ns, _)| pose_ns.abs_diff(seen_ns));
                let moved = then.filter(|_| seen_ns < now_ns).map_or(at, |(_, room_from_then)| {
                    room_from_camera.inverse_transform_point(&(room_from_then * Point3::from(at))).coords
                });
                let age_s = age_ns(&tip) as f64 * 1e-9;
                let seen = Report {
                    xyz_mm: moved,
                    score: tip.score,
                    track_id: tip.track_id,
                    class_index: tip.class_index,
                    age_s,
                };
                (index, seen)
            })
        });
        let (mut from, mut count) = ([0_usize; MAX_TIPS], 0);
        let reports = new_tips.take(MAX_TIPS).map(|(index, report)| {
            from[count] = index;
            count += 1;
            report
        });
        for tip in input.hidden.iter().flat_map(|tips| tips.iter()).flatten() {
            let age_s = age_ns(&tip) as f64 * 1e-9;
            if (0.0..=rules.max_gap_s).contains(&age_s) {
                self.tracker.cover(tip.track_id, tip.class_index);
            }
        }
        let known = self.tracker.step(real_ns, reports, &room_from_camera, &rules);
        if known == Known::Lost {
            self.last = None;
            cx.metric("gap_ms", f64::NAN);
            return Ok(());
        }
        if let Known::Seen(report) = known {
            let index = from.get(report).copied();
            self.last =
                index.and_then(|index| input.tip.get(index)).map(|tip| (*tip, real_ns.saturating_sub(age_ns(&tip))));
        }
        self.write(cx, &mut out, real_ns, &room_from_camera, (&rules, lens))
    }
}
