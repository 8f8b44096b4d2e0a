//! The closed loop without images: tracker, controller, interlock and simulated arm as the nodes use them, with
//! scripted tips.
//!
//! As in the graph, the cameras are where the arm was one tick ago, and the tip is known only while it is in the left
//! image, with the noise of stereo. Finds and evaluates gains quickly; the graph is evaluated separately.

use crate::tracking::kalman::Model;
use crate::tracking::tracker::{Known, Report, Rules, Tracker};
use nalgebra::{Isometry3, Point3, Vector3};

use crate::campaign::Random;
use crate::chain::{Chain, JointVector};
use crate::control::{CameraGeometry, Controller, Goals, SeenTip, goal_mm};
use crate::dynamics::{Quality, SimArm};
use crate::interlock::{Evidence, Interlock, TubePose};
use crate::pid::Gains;

/// Left image of the thesis's scope, px.
const WIDTH_PX: f64 = 640.0;
const HEIGHT_PX: f64 = 480.0;
const FOCAL_PX: f64 = 750.0;
const BASELINE_MM: f64 = 15.0;
/// Rest before anything moves, s.
pub const START_S: f64 = 2.0;

/// Movement of the tip, and faults of its detection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scenario {
    /// The tip rests away from the centre.
    Rest,
    /// Steps of 12 mm to the side and back at up to 25 mm/s.
    Step,
    /// 36 mm to and fro at 12 mm/s.
    Ramp,
    /// A circle of 12 mm radius in 5 s.
    Circle,
    /// Strokes like a surgeon's at up to 25 mm/s.
    Strokes,
    /// The tool leaves the image and returns.
    Leave,
    /// Another tool passes in front; detections have no track numbers.
    Cross,
    /// Strokes; the tip is hidden for 0.2 s every 2 s.
    Occlusion,
    /// Strokes; detections are noisy, have low scores, and miss every fifth tip.
    Smoke,
}

impl Scenario {
    /// All scenarios.
    pub const ALL: [Self; 9] = [
        Self::Rest,
        Self::Step,
        Self::Ramp,
        Self::Circle,
        Self::Strokes,
        Self::Leave,
        Self::Cross,
        Self::Occlusion,
        Self::Smoke,
    ];

    /// Name of the scenario.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rest => "rest",
            Self::Step => "step",
            Self::Ramp => "ramp",
            Self::Circle => "circle",
            Self::Strokes => "strokes",
            Self::Leave => "leave",
            Self::Cross => "cross",
            Self::Occlusion => "occlusion",
            Self::Smoke => "smoke",
        }
    }
}

/// Default set-points and gains: those of `arm_pid` (a test there compares them). Near the result of `panoscope tune`,
/// with less derivative: more of it lowers the error by a few percent, but the camera shakes by a third more.
pub fn shipped_goals() -> Goals {
    let gains =
        Gains { proportional: 6.0, integral: 0.2, derivative: 0.2, filter_s: 0.08, dead_zone: 2.0, most: 250.0 };
    Goals {
        distance_mm: 66.0,
        picture: gains,
        distance: Gains { dead_zone: 0.2, most: 20.0, ..gains },
        feed_forward: 1.0,
        latency_s: 0.045,
        acceleration_mm_s2: 80.0,
        min_score: 0.3,
    }
}

/// State after one tick.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    /// Time, s.
    pub at_s: f64,
    /// Distance of the true tip from its set-point, mm.
    pub error_mm: f64,
    /// Error of the true tip in the image, px.
    pub error_px: [f64; 2],
    /// Error of its distance from the left camera, mm.
    pub distance_error_mm: f64,
    /// Whether the true tip is in the left image.
    pub in_view: bool,
    /// Whether the tip is hidden in the left image.
    pub is_hidden: bool,
    /// Whether the scenario hides or removes it.
    pub is_away: bool,
    /// Distance of the true tube from the trocar, mm.
    pub pivot_mm: f64,
    /// Whether the arm follows.
    pub following: bool,
    /// The camera's speed, mm/s.
    pub camera_mm_s: f64,
    /// The camera's acceleration, mm/s^2.
    pub camera_mm_s2: f64,
    /// Time since the tip was last seen, s: 0 in a tick in which it is seen, NaN while it is lost.
    pub gap_s: f64,
    /// Distance of the tracker's tip from the true one, mm; NaN while it is lost.
    pub track_off_mm: f64,
}

struct Stroke {
    from: Vector3<f64>,
    to: Vector3<f64>,
    start_s: f64,
    length_s: f64,
}

/// Minimum-jerk rise from 0 to 1; its peak speed is 15/8.
fn bell(t: f64) -> f64 {
    let t = t.clamp(0.0, 1.0);
    t * t * t * (10.0 - t * (15.0 - 6.0 * t))
}

fn strokes(random: &mut Random, until_s: f64) -> Vec<Stroke> {
    let (mut out, mut at, mut clock) = (Vec::new(), Vector3::zeros(), 0.0);
    while clock < until_s {
        let mut any = |reach: f64| (2.0 * random.unit() - 1.0) * reach;
        let to = Vector3::new(any(20.0), any(13.0), any(8.0));
        let length_s = (1.875 * (to - at).norm() / (12.0 + 13.0 * random.unit())).max(0.1);
        out.push(Stroke { from: at, to, start_s: clock, length_s });
        clock += length_s + 0.1 + 0.5 * random.unit();
        at = to;
    }
    out
}

/// The true tip's offset from home, mm.
fn offset(scenario: Scenario, script: &[Stroke], seconds: f64) -> Vector3<f64> {
    let t = (seconds - START_S).max(0.0);
    match scenario {
        Scenario::Rest => Vector3::new(6.0, -4.0, 5.0),
        Scenario::Cross => Vector3::zeros(),
        Scenario::Step => {
            let turn = (t / 4.0).floor();
            let rise = bell((t - 4.0 * turn) / 0.9);
            let part = if turn % 2.0 == 0.0 { rise } else { 1.0 - rise };
            Vector3::new(10.0, 6.0, 0.0) * part
        }
        Scenario::Ramp => {
            let saw = (t / 6.0 + 0.25).fract();
            Vector3::new(18.0 * if saw < 0.5 { 4.0 * saw - 1.0 } else { 3.0 - 4.0 * saw }, 0.0, 0.0)
        }
        Scenario::Circle => {
            let angle = t / 5.0 * std::f64::consts::TAU;
            Vector3::new(angle.cos(), angle.sin(), 0.3 * (2.0 * angle).sin()) * 12.0 * bell(t / 5.0)
        }
        Scenario::Strokes | Scenario::Occlusion | Scenario::Smoke => {
            let index = script.partition_point(|stroke| stroke.start_s <= t).saturating_sub(1);
            script
                .get(index)
                .map_or(Vector3::zeros(), |s| s.from + (s.to - s.from) * bell((t - s.start_s) / s.length_s))
        }
        Scenario::Leave => {
            let phase = t % 12.0;
            // Leaves faster than the arm can follow, 80 mm at up to 150 mm/s; returns at 40 mm/s.
            Vector3::new(69.0, 16.0, -37.0) * (bell(phase) - bell((phase - 6.0) / 3.75))
        }
    }
}

/// A point of the room in the left camera's frame, mm, and whether it is in the left image.
fn seen_from(camera: &Isometry3<f64>, point: &Point3<f64>) -> (Vector3<f64>, bool) {
    let p = camera.inverse_transform_point(point).coords;
    let (u, v) = (FOCAL_PX * p.x / p.z + (WIDTH_PX - 1.0) / 2.0, FOCAL_PX * p.y / p.z + (HEIGHT_PX - 1.0) / 2.0);
    (p, p.z > 0.0 && (0.0..WIDTH_PX).contains(&u) && (0.0..HEIGHT_PX).contains(&v))
}

/// Score of a detection.
fn score(scenario: Scenario) -> f64 {
    if scenario == Scenario::Smoke { 0.55 } else { 0.9 }
}

/// Detection of a tip at `p`, in the left camera's frame, with the noise of stereo.
fn detection(scenario: Scenario, p: Vector3<f64>, random: &mut Random) -> Report {
    let bad = if scenario == Scenario::Smoke { 3.0 } else { 1.0 };
    let mut bell = |deviation: f64| ((0..6).map(|_| random.unit()).sum::<f64>() - 3.0) * 1.414 * deviation * bad;
    let inverse = p.z.recip() * (1.0 + bell(0.3) * p.z / (FOCAL_PX * BASELINE_MM));
    let (x, y, z) = (p.x / p.z + bell(0.5) / FOCAL_PX, p.y / p.z + bell(0.5) / FOCAL_PX, 1.0 / inverse);
    let xyz_mm = Vector3::new(x * z, y * z, z);
    Report { xyz_mm, score: score(scenario), track_id: -1, class_index: 0, age_s: 0.0 }
}

/// All detections of one image, with the leading tip at `tip` in the room.
fn detections(
    scenario: Scenario,
    at_s: f64,
    tip: &Point3<f64>,
    camera: &Isometry3<f64>,
    random: &mut Random,
) -> Vec<Report> {
    let (p, in_view) = seen_from(camera, tip);
    let mut reports = Vec::new();
    let shown = match scenario {
        Scenario::Cross => {
            let aside = -18.0 * (at_s / 8.0 * std::f64::consts::TAU).cos();
            let (other, other_in_view) = seen_from(camera, &(tip + Vector3::new(aside, 2.0, -8.0)));
            if other_in_view {
                reports.push(detection(scenario, other, random));
            }
            // The other tool hides the leading tip while it is in front of it.
            aside.abs() > 2.5
        }
        Scenario::Occlusion => at_s <= START_S || at_s % 2.0 >= 0.2,
        Scenario::Smoke => in_view && random.of(5) != 0,
        _ => true,
    };
    if in_view && shown {
        reports.push(detection(scenario, p, random));
    }
    reports
}

/// How the tracker follows tips.
fn rules() -> Rules {
    Rules {
        model: Model { acceleration_mm_s2: 200.0, ..Model::default() },
        lateral_px: 1.0,
        disparity_px: 0.5,
        focal_px: FOCAL_PX,
        baseline_mm: BASELINE_MM,
        min_score: 0.3,
        max_gap_s: 0.3,
        switch_s: 0.6,
    }
}

/// Plays a scenario for `seconds` at `rate_hz`.
pub fn play(chain: &Chain, scenario: Scenario, seed: u64, seconds: f64, rate_hz: f64, goals: &Goals) -> Vec<Row> {
    let mut random = Random::new(seed);
    let script = strokes(&mut random, seconds);
    let quality = Quality::default();
    let home = chain.stance(&JointVector::zeros());
    let (base_from_home, down) = (home.base_from_camera, home.base_from_tip * Vector3::z());
    let mut lock = Interlock::new(chain.clone(), JointVector::zeros(), 0);
    let mut arm = SimArm::new(quality, JointVector::zeros());
    let (mut tracker, mut controller) = (Tracker::default(), Controller::new(chain.clone()));
    let cameras = CameraGeometry { focal_px: (FOCAL_PX, FOCAL_PX), baseline_mm: BASELINE_MM };
    let rules = rules();
    let (mut encoders, mut set_point) = (JointVector::zeros(), JointVector::zeros());
    let mut camera = base_from_home.inverse() * home.base_from_camera;
    let mut rows = Vec::new();
    let mut last = (camera.translation.vector, Vector3::zeros());
    for tick in 0..(seconds * rate_hz) as i64 {
        let now_ns = (tick as f64 * 1e9 / rate_hz) as i64;
        let at_s = now_ns as f64 * 1e-9;
        // The picture.
        let tip_room = Point3::from(Vector3::new(BASELINE_MM / 2.0, 0.0, 66.3) + offset(scenario, &script, at_s));
        let (p, in_view) = seen_from(&camera, &tip_room);
        let reports = detections(scenario, at_s, &tip_room, &camera, &mut random);
        // The nodes, in their order.
        let known = tracker.step(now_ns, reports.iter().copied(), &camera, &rules);
        let (gap_s, fade) = match known {
            Known::Seen(_) => (0.0, 1.0),
            Known::Predicted(gap_s) => (gap_s, (1.0 - gap_s / rules.max_gap_s).clamp(0.0, 1.0)),
            Known::Lost => (0.0, 0.0),
        };
        let tip = tracker.state().map(|(place, _)| SeenTip {
            xyz_mm: camera.inverse_transform_point(&Point3::from(place)).coords,
            score: fade * score(scenario),
            age_s: 0.0,
        });
        let demand = controller.step(now_ns, tip, &encoders, Some(&set_point), &cameras, goals);
        lock.advance(now_ns, &mut |point| arm.step(point));
        if let Some(tip) = tip {
            // A predicted tip is as old as the picture in which it was last seen.
            let light_ns = now_ns.saturating_sub((gap_s * 1e9) as i64);
            lock.tip(light_ns, Evidence { score: tip.score, in_space: true });
            if let Some(step) = demand {
                lock.demand_of_light(now_ns, light_ns, step.velocity.as_slice());
            }
        }
        let stance = chain.stance(arm.links());
        let velocity = (camera.translation.vector - last.0) * rate_hz;
        let change = (velocity - last.1) * rate_hz;
        last = (camera.translation.vector, velocity);
        rows.push(Row {
            at_s,
            error_mm: (p - goal_mm(goals.distance_mm, BASELINE_MM)).norm(),
            error_px: [FOCAL_PX * (p.x - BASELINE_MM / 2.0) / p.z, FOCAL_PX * p.y / p.z],
            distance_error_mm: p.norm() - goals.distance_mm,
            in_view,
            is_hidden: in_view && reports.iter().all(|r| (r.xyz_mm - p).norm() > 4.0),
            is_away: scenario == Scenario::Leave && (0.0..11.5).contains(&((at_s - START_S).max(0.0) % 12.0)),
            pivot_mm: TubePose::of(chain, &stance, &down).pivot_mm,
            following: lock.stopped().is_none(),
            camera_mm_s: velocity.norm(),
            camera_mm_s2: change.norm(),
            gap_s: match known {
                Known::Seen(_) => 0.0,
                Known::Predicted(gap_s) => gap_s,
                Known::Lost => f64::NAN,
            },
            track_off_mm: tip.map_or(f64::NAN, |tip| (tip.xyz_mm - p).norm()),
        });
        // State for the next tick.
        camera = base_from_home.inverse() * stance.base_from_camera;
        encoders = arm.encoders(|| random.bits());
        set_point = lock.set_point().position;
    }
    rows
}

/// Measures of a run, from `START_S` on.
#[derive(Clone, Copy, Debug, Default)]
pub struct Measures {
    /// Root mean square error, mm; NaN without a tick with a known tip.
    pub rms_mm: f64,
    /// Largest error, mm; NaN without a tick with a known tip.
    pub max_mm: f64,
    /// Standard deviation of the error, mm.
    pub deviation_mm: f64,
    /// Share of ticks with the tip in the image, of those in which the scenario has it there, %.
    pub in_view_pct: f64,
    /// Share of those ticks in which the tip was hidden or not found, %.
    pub hidden_pct: f64,
    /// Share of those ticks in which the tip was observed and not predicted, %.
    pub tip_seen_pct: f64,
    /// Root mean square distance of the tracker's tip from the true one, mm; NaN if it never had one.
    pub track_off_mm: f64,
    /// Largest distance of the tube from the trocar in the whole run, mm.
    pub pivot_mm: f64,
    /// Mean error in the image over the last second, % of its width.
    pub rest_pct: f64,
    /// Mean error of the distance over the last second, mm.
    pub rest_mm: f64,
    /// Root mean square acceleration of the camera, mm/s^2: how steady the image is.
    pub shake_mm_s2: f64,
    /// Settling time: from the end of the tip's first movement until the error stays below 2 mm for a second, s; NaN if
    /// the error never exceeds 2 mm or never settles.
    pub settling_s: f64,
    /// Overshoot in percent of the step; NaN under the same conditions.
    pub overshoot_pct: f64,
}

/// Computes the measures of a run.
pub fn measure(rows: &[Row]) -> Measures {
    let judged: Vec<&Row> = rows.iter().filter(|row| row.at_s >= START_S && !row.is_away).collect();
    let known = || judged.iter().map(|r| r.error_mm).filter(|e| e.is_finite());
    let count = known().count().max(1) as f64;
    let mean = known().sum::<f64>() / count;
    let square = known().map(|e| e * e).sum::<f64>() / count;
    let end = rows.last().map_or(0.0, |row| row.at_s);
    let rest: Vec<&Row> = rows.iter().filter(|row| row.at_s > end - 1.0 && row.error_mm.is_finite()).collect();
    let mean_of = |pick: &dyn Fn(&Row) -> f64| rest.iter().map(|r| pick(r)).sum::<f64>() / rest.len() as f64;
    let shakes = || judged.iter().map(|r| r.camera_mm_s2).filter(|a| a.is_finite());
    let offs = || judged.iter().map(|r| r.track_off_mm).filter(|off| off.is_finite());
    let (settling_s, overshoot_pct) = settling(&judged);
    Measures {
        // Nothing known is no error of 0.
        rms_mm: if known().next().is_some() { square.sqrt() } else { f64::NAN },
        max_mm: known().fold(0.0, f64::max),
        deviation_mm: (square - mean * mean).max(0.0).sqrt(),
        in_view_pct: 100.0 * judged.iter().filter(|r| r.in_view).count() as f64 / judged.len().max(1) as f64,
        tip_seen_pct: 100.0 * judged.iter().filter(|r| r.gap_s <= 0.0).count() as f64 / judged.len().max(1) as f64,
        track_off_mm: if offs().next().is_some() {
            (offs().map(|off| off * off).sum::<f64>() / offs().count() as f64).sqrt()
        } else {
            f64::NAN
        },
        hidden_pct: 100.0 * judged.iter().filter(|r| r.is_hidden).count() as f64 / judged.len().max(1) as f64,
        pivot_mm: rows.iter().map(|r| r.pivot_mm).filter(|p| p.is_finite()).fold(0.0, f64::max),
        rest_pct: 100.0 * mean_of(&|r| r.error_px[0]).hypot(mean_of(&|r| r.error_px[1])) / WIDTH_PX,
        rest_mm: mean_of(&|r| r.distance_error_mm),
        shake_mm_s2: (shakes().map(|a| a * a).sum::<f64>() / shakes().count().max(1) as f64).sqrt(),
        settling_s,
        overshoot_pct,
    }
}

/// Settling and overshoot of the first movement of a run; see [`Measures`].
fn settling(rows: &[&Row]) -> (f64, f64) {
    const BAND_MM: f64 = 2.0;
    const MOVEMENT_S: f64 = 0.9;
    // 11.7 mm at 66 mm.
    const WAY_PX: f64 = 11.66 * FOCAL_PX / 66.0;
    let nothing = (f64::NAN, f64::NAN);
    let Some(first) = rows.iter().position(|r| r.error_mm > BAND_MM) else { return nothing };
    let Some(start_s) = rows.first().map(|r| r.at_s) else { return nothing };
    // Within the first movement and its rest, where a script has one (`step`: 4 s).
    let part = &rows[first..rows.iter().position(|r| r.at_s >= start_s + 4.0).unwrap_or(rows.len()).max(first)];
    let Some(last) = part.iter().rposition(|r| r.error_mm > BAND_MM) else { return nothing };
    let calm_s = part.last().map_or(0.0, |r| r.at_s) - part[last].at_s;
    if calm_s < 1.0 {
        return nothing;
    }
    let Some(peak) = part.iter().max_by(|a, b| a.error_mm.total_cmp(&b.error_mm)) else { return nothing };
    let step_px = peak.error_px;
    let size = step_px[0].hypot(step_px[1]).max(1e-9);
    let behind =
        part.iter().map(|r| -(r.error_px[0] * step_px[0] + r.error_px[1] * step_px[1]) / size).fold(0.0, f64::max);
    ((part[last].at_s - start_s - MOVEMENT_S).max(0.0), 100.0 * behind / WAY_PX)
}
