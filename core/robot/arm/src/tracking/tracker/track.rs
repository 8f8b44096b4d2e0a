//! One tracked tip, and one observation of a tip.

use nalgebra::{Isometry3, Matrix3, Point3, Vector3};

use super::report::{Report, Rules, UNKNOWN_CLASS, passed_s};
use crate::tracking::kalman::{Kalman, stereo_covariance};

/// Largest distance of an observation from the predicted or last seen position, mm. Needed because the gate grows while
/// a tip is hidden, until every report passes.
const JUMP_MM: f64 = 6.0;
/// Distance below which two reports belong to one tip, mm.
const SAME_MM: f64 = 2.5;

/// Added to the cost where the tool's number agrees: outweighs every distance.
const SAME_NUMBER: f64 = -1000.0;
/// Added to the cost of another class: twenty times less likely.
const OTHER_CLASS: f64 = 6.0;
/// Standard deviation of a lost tip about its last seen position, mm.
const LOST_MM: f64 = 3.0;
/// Older observations count as this old, s.
const MAX_AGE_S: f64 = 0.5;
/// Number of observations after which the class is certain.
const SUREST_CLASS: u32 = 30;

/// A report in the room.
#[derive(Clone, Copy, Debug)]
pub struct Observation {
    /// Index of the report.
    index: usize,
    report: Report,
    at_mm: Vector3<f64>,
    covariance_mm2: Matrix3<f64>,
    age_s: f64,
    /// Tangent of the angle to the centre of the image that both cameras share.
    off_axis: f64,
    /// Whether it is assigned to a track.
    pub is_taken: bool,
}

impl Observation {
    /// A report, moved to the room by the camera's pose.
    pub fn new(index: usize, report: Report, room_from_camera: &Isometry3<f64>, rules: &Rules) -> Self {
        let p = &report.xyz_mm;
        let seen = stereo_covariance(p, rules.focal_px, rules.baseline_mm, rules.lateral_px, rules.disparity_px);
        let turn = room_from_camera.rotation.to_rotation_matrix();
        Self {
            index,
            report,
            at_mm: (room_from_camera * Point3::from(*p)).coords,
            covariance_mm2: turn.matrix() * seen * turn.matrix().transpose(),
            age_s: if report.age_s > 0.0 { report.age_s.min(MAX_AGE_S) } else { 0.0 },
            off_axis: ((p.x - rules.baseline_mm / 2.0) / p.z).hypot(p.y / p.z),
            is_taken: false,
        }
    }

    /// Position now, if the tip moved by the filter's velocity since it was seen, and its covariance.
    fn now(&self, filter: &Kalman, rules: &Rules) -> (Vector3<f64>, Matrix3<f64>) {
        let strayed = 0.5 * rules.model.acceleration_mm_s2 * self.age_s * self.age_s;
        let covariance = self.covariance_mm2 + Matrix3::from_diagonal_element(strayed * strayed);
        (self.at_mm + filter.velocity_mm_s() * self.age_s, covariance)
    }

    /// Whether both observe one tip.
    pub fn is_same_as(&self, other: &Self) -> bool {
        let two_numbers = self.report.track_id >= 0 && other.report.track_id >= 0;
        (!two_numbers || self.report.track_id == other.report.track_id) && (self.at_mm - other.at_mm).norm() <= SAME_MM
    }
}

/// One tracked tip.
#[derive(Debug)]
pub struct Track {
    /// Identifies the track; older ones have smaller keys.
    pub key: u64,
    /// Position and velocity; `None` while lost.
    pub filter: Option<Kalman>,
    /// Number of the tool; below 0 until a detector gives one.
    pub number: i64,
    /// Time at which it was last seen.
    pub seen_ns: i64,
    /// Index of the report in which it was last seen.
    pub report: usize,
    /// Off-axis angle of the last observation; see [`Observation::off_axis`].
    pub off_axis: f64,
    /// Position at which it was last seen, mm.
    seen_mm: Vector3<f64>,
    class_index: u32,
    /// Observations of that class minus those of others.
    class_count: u32,
}

impl Track {
    /// Starts a track; `None` when a number is not finite.
    pub fn begin(key: u64, observation: &Observation, now_ns: i64) -> Option<Self> {
        let filter = Kalman::begin(&observation.at_mm, &observation.covariance_mm2)?;
        Some(Self {
            key,
            filter: Some(filter),
            number: observation.report.track_id,
            seen_ns: now_ns,
            report: observation.index,
            off_axis: observation.off_axis,
            seen_mm: observation.at_mm,
            class_index: observation.report.class_index,
            class_count: u32::from(observation.report.class_index != UNKNOWN_CLASS),
        })
    }

    /// Advances the filter; drops it when the tip was not seen for too long.
    pub fn predict(&mut self, now_ns: i64, dt_s: f64, rules: &Rules) {
        if passed_s(self.seen_ns, now_ns) > rules.max_gap_s {
            self.filter = None;
        }
        if let Some(filter) = &mut self.filter {
            filter.predict(&rules.model, dt_s);
        }
    }

    /// Whether an observation has this tool's number.
    pub fn has_number(&self, observation: &Observation) -> bool {
        self.number >= 0 && observation.report.track_id == self.number
    }

    /// Most frequent class of the last observations; [`UNKNOWN_CLASS`] if they have none.
    pub fn class_index(&self) -> u32 {
        self.class_index
    }

    /// Whether this is the tip of a tool, by its number or, without one, by its class.
    pub fn is_tool(&self, track_id: i64, class_index: u32) -> bool {
        if self.number >= 0 && track_id >= 0 { self.number == track_id } else { self.class_index == class_index }
    }

    /// Cost of assigning an observation to this track; infinite if it cannot be this tip.
    pub fn cost(&self, observation: &Observation, now_ns: i64, rules: &Rules) -> f64 {
        // Another number is another tool, however near it is.
        if self.number >= 0 && observation.report.track_id >= 0 && !self.has_number(observation) {
            return f64::INFINITY;
        }
        let mut cost = match &self.filter {
            Some(filter) => {
                let (at, covariance) = observation.now(filter, rules);
                match filter.unlikelihood(&at, &covariance) {
                    Some((distance, cost)) if self.may_be(filter, &at, observation, distance, rules) => cost,
                    _ => f64::INFINITY,
                }
            }
            None => {
                let far = (observation.at_mm - self.seen_mm).norm();
                if far <= JUMP_MM { (far / LOST_MM).powi(2) + 6.0 * LOST_MM.ln() } else { f64::INFINITY }
            }
        };
        if self.has_number(observation) {
            // A numbered tool may jump once its gap is over.
            if cost == f64::INFINITY && self.gap_s(now_ns) >= rules.max_gap_s.min(rules.switch_s) {
                cost = 0.0;
            }
            cost += SAME_NUMBER;
        }
        if ![self.class_index, UNKNOWN_CLASS].contains(&observation.report.class_index) {
            cost += OTHER_CLASS * f64::from(self.class_count) / f64::from(SUREST_CLASS);
        }
        cost
    }

    fn gap_s(&self, now_ns: i64) -> f64 {
        passed_s(self.seen_ns, now_ns)
    }

    /// Whether an observation is near enough to the predicted position, or to the last seen one, because a hidden tip
    /// may have stopped. Very near observations always pass, because detector errors exceed the model.
    fn may_be(
        &self,
        filter: &Kalman,
        at: &Vector3<f64>,
        observation: &Observation,
        distance: f64,
        rules: &Rules,
    ) -> bool {
        let far = |place: Vector3<f64>| (at - place).norm();
        let ahead = far(filter.position_mm());
        let is_in_gate = distance <= rules.model.gate;
        ahead <= SAME_MM || is_in_gate && (self.has_number(observation) || ahead.min(far(self.seen_mm)) <= JUMP_MM)
    }

    /// Updates the track with an observation.
    pub fn update(&mut self, observation: &Observation, now_ns: i64, rules: &Rules) {
        let is_updated = self.filter.as_mut().is_some_and(|filter| {
            let (at, seen) = observation.now(filter, rules);
            // An observation beyond the model's gate is noisier than the model says.
            let off = (at - filter.position_mm()).norm_squared() / 9.0;
            filter.update(&rules.model, &at, &seen)
                || filter.update(&rules.model, &at, &(seen + Matrix3::from_diagonal_element(off)))
        });
        if !is_updated {
            self.filter = Kalman::begin(&observation.at_mm, &observation.covariance_mm2);
        }
        (self.seen_ns, self.report, self.seen_mm, self.off_axis) =
            (now_ns, observation.index, observation.at_mm, observation.off_axis);
        if observation.report.track_id >= 0 {
            self.number = observation.report.track_id;
        }
        if observation.report.class_index == UNKNOWN_CLASS {
            // No vote.
        } else if observation.report.class_index == self.class_index {
            self.class_count = (self.class_count + 1).min(SUREST_CLASS);
        } else {
            self.class_count = self.class_count.saturating_sub(1);
            if self.class_count == 0 {
                (self.class_index, self.class_count) = (observation.report.class_index, 1);
            }
        }
    }

    /// Whether an observation is a second report of this tip in the same tick.
    pub fn is_at(&self, observation: &Observation, now_ns: i64) -> bool {
        let two_numbers = self.number >= 0 && observation.report.track_id >= 0;
        self.seen_ns == now_ns && !two_numbers && (self.seen_mm - observation.at_mm).norm() <= SAME_MM
    }
}
