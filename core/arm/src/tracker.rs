//! Which tip leads, where it is, and where it is while nobody sees it.

use nalgebra::{Isometry3, Point3, Vector3};

use crate::kalman::{Kalman, Model, stereo_covariance};

/// How a tip is followed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rules {
    /// Movement and gate.
    pub model: Model,
    /// Standard deviation of a tip in the picture, px.
    pub lateral_px: f64,
    /// Standard deviation of its disparity, px.
    pub disparity_px: f64,
    /// Focal length, px.
    pub focal_px: f64,
    /// Distance of the cameras, mm.
    pub baseline_mm: f64,
    /// Lowest score of a tip that counts.
    pub min_score: f64,
    /// Longest time that an unseen tip is predicted for, s.
    pub max_gap_s: f64,
    /// Time for which only another tip has to be seen before that one leads, s.
    pub switch_s: f64,
}

/// A tip as a detector reports it, in the left camera's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Report {
    /// mm.
    pub xyz_mm: Vector3<f64>,
    /// 0..1.
    pub score: f64,
    /// Of the tool, where the detector knows it; else below 0.
    pub track_id: i64,
}

/// What is known after a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Known {
    /// The leading tip was seen: number of the report.
    Seen(usize),
    /// It was not, for so many seconds.
    Predicted(f64),
    /// There is no tip.
    Lost,
}

/// Farthest that a tip may be from where it is thought to be, mm: the gate alone grows with the time that it is unseen, until everything fits.
const JUMP_MM: f64 = 6.0;

/// Follows one tip.
#[derive(Debug, Default)]
pub struct Tracker {
    filter: Option<Kalman>,
    /// Number of the tool that leads, or led last.
    leader: Option<i64>,
    last_ns: Option<i64>,
    seen_ns: i64,
    /// Where the leading tip was seen last, in the room, mm.
    seen_mm: Option<Vector3<f64>>,
    /// Since when only others are seen.
    others_ns: Option<i64>,
}

impl Tracker {
    /// One tick at `capture_ns`: what detectors report, and where the camera stood (`room_from_camera`; the identity where it is not known).
    pub fn step(
        &mut self,
        capture_ns: i64,
        reports: impl Iterator<Item = Report>,
        room_from_camera: &Isometry3<f64>,
        rules: &Rules,
    ) -> Known {
        let passed_s = |since: i64| capture_ns.saturating_sub(since) as f64 * 1e-9;
        let dt_s = self.last_ns.map_or(0.0, passed_s);
        if dt_s < 0.0 {
            *self = Self::default();
        }
        self.last_ns = Some(capture_ns);
        if let Some(filter) = &mut self.filter {
            filter.predict(&rules.model, dt_s);
        }
        let usable = |report: &Report| {
            report.score >= rules.min_score && report.xyz_mm.z > 0.0 && report.xyz_mm.iter().all(|v| v.is_finite())
        };
        let in_room = |report: &Report| {
            let turn = room_from_camera.rotation.to_rotation_matrix();
            let seen = stereo_covariance(
                &report.xyz_mm,
                rules.focal_px,
                rules.baseline_mm,
                rules.lateral_px,
                rules.disparity_px,
            );
            let at = room_from_camera * Point3::from(report.xyz_mm);
            (at.coords, turn.matrix() * seen * turn.matrix().transpose())
        };
        let usable = reports.enumerate().filter(|(_, report)| usable(report));
        // The tool that led goes on leading; where tools have no numbers, the tip that lies nearest does.
        let centre = self.filter.map(|filter| filter.position_mm());
        let best = usable.min_by(|(_, a), (_, b)| {
            let other = |report: &Report| self.leader.is_some_and(|leader| report.track_id != leader);
            // Nobody leads yet: the tip nearest to the middle of the shared picture does.
            let aside = |p: &Vector3<f64>| ((p.x - rules.baseline_mm / 2.0) / p.z).hypot(p.y / p.z);
            let far = |report: &Report| {
                centre.map_or_else(|| aside(&report.xyz_mm), |centre| (in_room(report).0 - centre).norm())
            };
            other(a).cmp(&other(b)).then(far(a).total_cmp(&far(b)))
        });
        let Some((index, report)) = best else {
            self.others_ns = None;
            return self.unseen(passed_s(self.seen_ns), rules);
        };
        let (at, covariance) = in_room(&report);
        let numbered = report.track_id >= 0 && self.leader.is_some_and(|leader| leader >= 0);
        let same_tool = !numbered || self.leader == Some(report.track_id);
        // A tool known by its number to be another one is not let in, however near it is.
        if same_tool && self.filter.as_mut().is_some_and(|filter| filter.update(&rules.model, &at, &covariance)) {
            self.lead(&report, at, capture_ns);
            return Known::Seen(index);
        }
        let waited_s = passed_s(*self.others_ns.get_or_insert(capture_ns));
        // A tool known by its number may jump once its gap is over; another one has to be alone for longer, also after the first is lost.
        let due_s = match (same_tool, self.filter.is_some()) {
            // Lost: back where it was seen last, or known by its number, it leads at once.
            (true, false) if numbered || self.seen_mm.is_none_or(|seen| (at - seen).norm() <= JUMP_MM) => 0.0,
            (true, true) if numbered => rules.max_gap_s.min(rules.switch_s),
            _ => rules.switch_s,
        };
        if waited_s >= due_s {
            self.filter = Kalman::begin(&at, &covariance);
            self.lead(&report, at, capture_ns);
            return if self.filter.is_some() { Known::Seen(index) } else { Known::Lost };
        }
        self.unseen(passed_s(self.seen_ns), rules)
    }

    fn lead(&mut self, report: &Report, at_mm: Vector3<f64>, capture_ns: i64) {
        (self.leader, self.seen_ns, self.others_ns) = (Some(report.track_id), capture_ns, None);
        self.seen_mm = Some(at_mm);
    }

    fn unseen(&mut self, gap_s: f64, rules: &Rules) -> Known {
        if self.filter.is_none() || gap_s > rules.max_gap_s {
            self.filter = None;
            return Known::Lost;
        }
        Known::Predicted(gap_s)
    }

    /// Place and movement in the room, mm and mm/s; none while lost.
    pub fn state(&self) -> Option<(Vector3<f64>, Vector3<f64>)> {
        self.filter.map(|filter| (filter.position_mm(), filter.velocity_mm_s()))
    }

    /// Standard deviation of the place, mm.
    pub fn deviation_mm(&self) -> f64 {
        self.filter.map_or(f64::NAN, |filter| filter.deviation_mm())
    }

    /// Number of the leading tool; below 0 where it has none.
    pub fn track_id(&self) -> i64 {
        self.filter.and(self.leader).unwrap_or(-1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RULES: Rules = Rules {
        model: Model { acceleration_mm_s2: 150.0, gate: 16.3 },
        lateral_px: 1.0,
        disparity_px: 0.5,
        focal_px: 750.0,
        baseline_mm: 15.0,
        min_score: 0.3,
        max_gap_s: 0.3,
        switch_s: 0.6,
    };

    fn report(x: f64, track_id: i64) -> Report {
        Report { xyz_mm: Vector3::new(x, 0.0, 65.0), score: 0.9, track_id }
    }

    fn step(tracker: &mut Tracker, tick: i64, reports: &[Report]) -> Known {
        tracker.step(tick * 33_333_333, reports.iter().copied(), &Isometry3::identity(), &RULES)
    }

    #[test]
    fn a_tip_that_hides_is_predicted_for_a_while_and_then_lost() {
        let mut tracker = Tracker::default();
        assert_eq!(step(&mut tracker, 0, &[]), Known::Lost);
        for tick in 1..30 {
            assert_eq!(step(&mut tracker, tick, &[report(0.5 * tick as f64, 1)]), Known::Seen(0));
        }
        for tick in 30..38 {
            assert!(matches!(step(&mut tracker, tick, &[]), Known::Predicted(_)), "tick {tick}");
        }
        let (at, _) = tracker.state().expect("predicted");
        assert!((at.x - 0.5 * 37.0).abs() < 0.3, "{at}");
        assert_eq!(step(&mut tracker, 39, &[]), Known::Lost);
        assert_eq!(tracker.state(), None);
        // It comes back elsewhere.
        assert_eq!(step(&mut tracker, 40, &[report(-10.0, 1)]), Known::Seen(0));
        assert_eq!(tracker.track_id(), 1);
    }

    #[test]
    fn another_tool_leads_only_when_the_first_is_long_gone() {
        let mut tracker = Tracker::default();
        for tick in 0..20 {
            // The other one is surer and comes first, the leading one is nearer to the middle of the shared picture.
            let other = Report { score: 1.0, ..report(-12.0, 2) };
            assert_eq!(step(&mut tracker, tick, &[other, report(0.0, 1)]), Known::Seen(1));
            assert_eq!(tracker.track_id(), 1);
        }
        let others = report(-12.0, 2);
        for tick in 20..28 {
            assert!(matches!(step(&mut tracker, tick, &[others]), Known::Predicted(_)), "tick {tick}");
        }
        let back = report(0.0, 1);
        assert!(matches!(step(&mut tracker, 28, &[others, back]), Known::Seen(1)));
        let mut switched = None;
        for tick in 29..60 {
            if step(&mut tracker, tick, &[others]) == Known::Seen(0) && switched.is_none() {
                switched = Some(tick);
            }
        }
        assert!(switched.is_some_and(|tick| (44..=50).contains(&tick)), "{switched:?}");
    }

    #[test]
    fn nonsense_is_no_tip() {
        let mut tracker = Tracker::default();
        step(&mut tracker, 0, &[report(0.0, 1)]);
        let bad = [
            Report { score: f64::NAN, ..report(0.0, 1) },
            Report { xyz_mm: Vector3::new(f64::NAN, 0.0, 65.0), ..report(0.0, 1) },
            Report { xyz_mm: Vector3::new(0.0, 0.0, -65.0), ..report(0.0, 1) },
            Report { score: 0.1, ..report(0.0, 1) },
        ];
        for (tick, bad) in (1..).zip(bad) {
            assert!(matches!(step(&mut tracker, tick, &[bad]), Known::Predicted(_)), "{bad:?}");
        }
        // Time that goes back starts anew.
        assert_eq!(step(&mut tracker, 0, &[]), Known::Lost);
    }
}
