//! One tip that is followed, and one sight of a tip.

use nalgebra::{Isometry3, Matrix3, Point3, Vector3};

use super::{JUMP_MM, Report, Rules, SAME_MM, passed_s};
use crate::kalman::{Kalman, stereo_covariance};

/// What a number that agrees takes off the cost: it outweighs every distance.
const SAME_NUMBER: f64 = -1000.0;
/// What another class adds to the cost: one is twenty times less likely than the other.
const OTHER_CLASS: f64 = 6.0;
/// Standard deviation of a lost tip about where it was seen last, mm.
const LOST_MM: f64 = 3.0;
/// Older sights count as that old, s.
const LONGEST_AGE_S: f64 = 0.5;
/// Sights after which a class is as sure as it gets.
const SUREST_CLASS: u32 = 30;

/// A report in the room.
#[derive(Clone, Copy, Debug)]
pub struct Sight {
    /// Number of the report.
    index: usize,
    report: Report,
    at_mm: Vector3<f64>,
    covariance_mm2: Matrix3<f64>,
    age_s: f64,
    /// How far from the middle of the shared picture it is seen, as a tangent.
    aside: f64,
    /// Whether somebody has it.
    pub is_taken: bool,
}

impl Sight {
    /// A report where the camera stands so.
    pub fn of(index: usize, report: Report, room_from_camera: &Isometry3<f64>, rules: &Rules) -> Self {
        let p = &report.xyz_mm;
        let seen = stereo_covariance(p, rules.focal_px, rules.baseline_mm, rules.lateral_px, rules.disparity_px);
        let turn = room_from_camera.rotation.to_rotation_matrix();
        Self {
            index,
            report,
            at_mm: (room_from_camera * Point3::from(*p)).coords,
            covariance_mm2: turn.matrix() * seen * turn.matrix().transpose(),
            age_s: if report.age_s > 0.0 { report.age_s.min(LONGEST_AGE_S) } else { 0.0 },
            aside: ((p.x - rules.baseline_mm / 2.0) / p.z).hypot(p.y / p.z),
            is_taken: false,
        }
    }

    /// Where the tip stands now if it has moved as the filter thinks since it was seen, and how well that is known.
    fn now(&self, filter: &Kalman, rules: &Rules) -> (Vector3<f64>, Matrix3<f64>) {
        let strayed = 0.5 * rules.model.acceleration_mm_s2 * self.age_s * self.age_s;
        let covariance = self.covariance_mm2 + Matrix3::from_diagonal_element(strayed * strayed);
        (self.at_mm + filter.velocity_mm_s() * self.age_s, covariance)
    }

    /// Whether both are words for one tip.
    pub fn is_same_as(&self, other: &Self) -> bool {
        let two_numbers = self.report.track_id >= 0 && other.report.track_id >= 0;
        (!two_numbers || self.report.track_id == other.report.track_id) && (self.at_mm - other.at_mm).norm() <= SAME_MM
    }
}

/// See the module.
#[derive(Debug)]
pub struct Track {
    /// Tells tracks apart; older ones have smaller keys.
    pub key: u64,
    /// Place and movement; none while lost.
    pub filter: Option<Kalman>,
    /// Of the tool, where a detector gave one.
    pub number: i64,
    /// When it was seen last.
    pub seen_ns: i64,
    /// Number of the report that it was seen in last.
    pub report: usize,
    /// See [`Sight::aside`].
    pub aside: f64,
    /// Where it was seen last, mm.
    seen_mm: Vector3<f64>,
    class_index: u32,
    /// Sights of that class less those of others.
    class_count: u32,
}

impl Track {
    /// A tip seen for the first time.
    pub fn begin(key: u64, sight: &Sight, now_ns: i64) -> Option<Self> {
        let filter = Kalman::begin(&sight.at_mm, &sight.covariance_mm2)?;
        Some(Self {
            key,
            filter: Some(filter),
            number: sight.report.track_id,
            seen_ns: now_ns,
            report: sight.index,
            aside: sight.aside,
            seen_mm: sight.at_mm,
            class_index: sight.report.class_index,
            class_count: 1,
        })
    }

    /// Lets time pass; what is unseen for too long is lost.
    pub fn predict(&mut self, now_ns: i64, dt_s: f64, rules: &Rules) {
        if passed_s(self.seen_ns, now_ns) > rules.max_gap_s {
            self.filter = None;
        }
        if let Some(filter) = &mut self.filter {
            filter.predict(&rules.model, dt_s);
        }
    }

    /// Whether a sight has the number of this tool.
    pub fn has_number(&self, sight: &Sight) -> bool {
        self.number >= 0 && sight.report.track_id == self.number
    }

    /// How unlikely it is that a sight is of this tip; infinite where it cannot be.
    pub fn cost(&self, sight: &Sight, now_ns: i64, rules: &Rules) -> f64 {
        // A tool known by its number to be another one is not let in, however near it is.
        if self.number >= 0 && sight.report.track_id >= 0 && !self.has_number(sight) {
            return f64::INFINITY;
        }
        let mut cost = match &self.filter {
            Some(filter) => {
                let (at, covariance) = sight.now(filter, rules);
                match filter.surprise(&at, &covariance) {
                    Some((distance, cost)) if self.may_be(filter, &at, sight, distance, rules) => cost,
                    _ => f64::INFINITY,
                }
            }
            None => {
                let far = (sight.at_mm - self.seen_mm).norm();
                if far <= JUMP_MM { (far / LOST_MM).powi(2) + 6.0 * LOST_MM.ln() } else { f64::INFINITY }
            }
        };
        if self.has_number(sight) {
            // A tool known by its number may jump once its gap is over.
            if cost == f64::INFINITY && self.gap_s(now_ns) >= rules.max_gap_s.min(rules.switch_s) {
                cost = 0.0;
            }
            cost += SAME_NUMBER;
        }
        if sight.report.class_index != self.class_index {
            cost += OTHER_CLASS * f64::from(self.class_count) / f64::from(SUREST_CLASS);
        }
        cost
    }

    fn gap_s(&self, now_ns: i64) -> f64 {
        passed_s(self.seen_ns, now_ns)
    }

    /// Whether a sight is near enough to where the tip should be, or to where it was: what is hidden may have stopped. Very near ones always are,
    /// however sure the filter may feel: detectors err more than their model says.
    fn may_be(&self, filter: &Kalman, at: &Vector3<f64>, sight: &Sight, distance: f64, rules: &Rules) -> bool {
        let far = |place: Vector3<f64>| (at - place).norm();
        let ahead = far(filter.position_mm());
        let is_in_gate = distance <= rules.model.gate;
        ahead <= SAME_MM || is_in_gate && (self.has_number(sight) || ahead.min(far(self.seen_mm)) <= JUMP_MM)
    }

    /// Takes a sight in.
    pub fn see(&mut self, sight: &Sight, now_ns: i64, rules: &Rules) {
        let kept = self.filter.as_mut().is_some_and(|filter| {
            let (at, seen) = sight.now(filter, rules);
            // What is farther off than the model allows was seen worse than the model thinks.
            let off = (at - filter.position_mm()).norm_squared() / 9.0;
            filter.update(&rules.model, &at, &seen)
                || filter.update(&rules.model, &at, &(seen + Matrix3::from_diagonal_element(off)))
        });
        if !kept {
            self.filter = Kalman::begin(&sight.at_mm, &sight.covariance_mm2);
        }
        (self.seen_ns, self.report, self.seen_mm, self.aside) = (now_ns, sight.index, sight.at_mm, sight.aside);
        if sight.report.track_id >= 0 {
            self.number = sight.report.track_id;
        }
        if sight.report.class_index == self.class_index {
            self.class_count = (self.class_count + 1).min(SUREST_CLASS);
        } else {
            self.class_count = self.class_count.saturating_sub(1);
            if self.class_count == 0 {
                (self.class_index, self.class_count) = (sight.report.class_index, 1);
            }
        }
    }

    /// Whether a sight is a second word for this tip, seen at this moment.
    pub fn is_at(&self, sight: &Sight, now_ns: i64) -> bool {
        let two_numbers = self.number >= 0 && sight.report.track_id >= 0;
        self.seen_ns == now_ns && !two_numbers && (self.seen_mm - sight.at_mm).norm() <= SAME_MM
    }
}
