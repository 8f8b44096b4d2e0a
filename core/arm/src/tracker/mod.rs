//! Which tip leads, where it is, and where it is while nobody sees it.
//!
//! All tips in view are followed, each by a filter of its own, and every tick says at once which report belongs to whom (global nearest
//! neighbour; Bar-Shalom, Li, Kirubarajan 2001, and Blackman and Popoli 1999, chapter 6). So a tool that passes before the leading one takes its own
//! reports with it: one report is one tool's, and the filter that knows best claims it. Numbers of tools decide where detectors give any; their
//! class breaks ties.

mod assign;
mod track;

use nalgebra::{Isometry3, Vector3};

use crate::kalman::Model;
use track::{Sight, Track};

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
    /// Kind of the tool, by the detector's own labels.
    pub class_index: u32,
    /// How long ago it was seen so, s; its place is as the camera of now would see what stood still since.
    pub age_s: f64,
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
/// Reports nearer to each other than this are two words for one tip, mm.
const SAME_MM: f64 = 2.5;

/// Follows tips, and knows which of them leads.
#[derive(Debug, Default)]
pub struct Tracker {
    tracks: Vec<Track>,
    sights: Vec<Sight>,
    /// Key of the track that leads, or led last; it is kept until another leads.
    leader: Option<u64>,
    next_key: u64,
    last_ns: Option<i64>,
    /// Since when only others are seen.
    others_ns: Option<i64>,
}

/// Seconds from one time to another.
fn passed_s(since_ns: i64, now_ns: i64) -> f64 {
    now_ns.saturating_sub(since_ns) as f64 * 1e-9
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
        let dt_s = self.last_ns.map_or(0.0, |last| passed_s(last, capture_ns));
        if dt_s < 0.0 {
            *self = Self::default();
        }
        let before_ns = self.last_ns.replace(capture_ns).unwrap_or(capture_ns);
        for track in &mut self.tracks {
            track.predict(capture_ns, dt_s, rules);
        }
        self.sights.clear();
        let usable = |report: &Report| {
            report.score >= rules.min_score && report.xyz_mm.z > 0.0 && report.xyz_mm.iter().all(|v| v.is_finite())
        };
        for (index, report) in reports.enumerate().filter(|(_, report)| usable(report)) {
            if self.sights.len() < assign::COLUMNS {
                self.sights.push(Sight::of(index, report, room_from_camera, rules));
            }
        }
        self.share_out(before_ns, capture_ns, rules);
        self.forget(capture_ns, rules);
        self.decide(capture_ns, rules)
    }

    /// Gives each report to the track that it belongs to, and begins tracks for those that belong to none.
    fn share_out(&mut self, before_ns: i64, now_ns: i64, rules: &Rules) {
        let mut costs = [[f64::INFINITY; assign::COLUMNS]; assign::ROWS];
        for (track, row) in self.tracks.iter().zip(&mut costs) {
            for (sight, cost) in self.sights.iter().zip(row.iter_mut()) {
                *cost = track.cost(sight, now_ns, rules);
            }
        }
        let found = assign::assign(&costs, self.tracks.len(), self.sights.len());
        let (tracks, sights) = (&self.tracks, &self.sights);
        let is_fresh = |row: usize| tracks.get(row).is_some_and(|track| track.seen_ns >= before_ns);
        // A hidden tip does not come back as the second word for one that is in view.
        let is_double = |row: usize, column: usize| {
            let same = |other: usize| found[other].is_some_and(|c| sights[c].is_same_as(&sights[column]));
            !is_fresh(row) && (0..assign::ROWS).any(|other| other != row && is_fresh(other) && same(other))
        };
        let kept: [Option<usize>; assign::ROWS] =
            std::array::from_fn(|row| found[row].filter(|column| !is_double(row, *column)));
        for (track, column) in self.tracks.iter_mut().zip(kept) {
            if let Some(sight) = column.and_then(|column| self.sights.get_mut(column)) {
                sight.is_taken = true;
                track.see(sight, now_ns, rules);
            }
        }
        for index in 0..self.sights.len() {
            let sight = self.sights[index];
            // A number that is known already, or a second word for what was just seen, makes no new tip.
            if sight.is_taken || self.tracks.iter().any(|track| track.has_number(&sight) || track.is_at(&sight, now_ns))
            {
                continue;
            }
            if self.tracks.len() == assign::ROWS {
                let leader = self.leader;
                let oldest = self.tracks.iter().enumerate().filter(|(_, track)| Some(track.key) != leader);
                let Some((oldest, _)) = oldest.min_by_key(|(_, track)| track.seen_ns) else { continue };
                self.tracks.swap_remove(oldest);
            }
            if let Some(track) = Track::begin(self.next_key, &sight, now_ns) {
                self.next_key += 1;
                self.tracks.push(track);
            }
        }
    }

    /// Lets go of others that are long unseen.
    fn forget(&mut self, now_ns: i64, rules: &Rules) {
        let (leader, memory_s) = (self.leader, rules.max_gap_s.max(rules.switch_s));
        self.tracks.retain(|track| Some(track.key) == leader || passed_s(track.seen_ns, now_ns) <= memory_s);
    }

    /// Which track leads now, and what is known of it.
    fn decide(&mut self, now_ns: i64, rules: &Rules) -> Known {
        let is_seen = |track: &&Track| track.seen_ns == now_ns;
        let leading = self.leading();
        if let Some(track) = leading.filter(is_seen) {
            let report = track.report;
            self.others_ns = None;
            return Known::Seen(report);
        }
        let nobody_led = leading.is_none();
        let gap_s = leading.map_or(f64::INFINITY, |track| passed_s(track.seen_ns, now_ns));
        // The one nearest to the middle of the shared picture is next.
        let next = self.tracks.iter().filter(is_seen).min_by(|a, b| a.aside.total_cmp(&b.aside));
        if let Some((key, report)) = next.map(|track| (track.key, track.report)) {
            let waited_s = passed_s(*self.others_ns.get_or_insert(now_ns), now_ns);
            if nobody_led || waited_s >= rules.switch_s {
                (self.leader, self.others_ns) = (Some(key), None);
                return Known::Seen(report);
            }
        } else {
            self.others_ns = None;
        }
        if gap_s <= rules.max_gap_s { Known::Predicted(gap_s) } else { Known::Lost }
    }

    fn leading(&self) -> Option<&Track> {
        self.tracks.iter().find(|track| Some(track.key) == self.leader)
    }

    /// Place and movement in the room, mm and mm/s; none while lost.
    pub fn state(&self) -> Option<(Vector3<f64>, Vector3<f64>)> {
        let filter = self.leading()?.filter?;
        Some((filter.position_mm(), filter.velocity_mm_s()))
    }

    /// Standard deviation of the place, mm.
    pub fn deviation_mm(&self) -> f64 {
        self.leading().and_then(|track| track.filter).map_or(f64::NAN, |filter| filter.deviation_mm())
    }

    /// Number of the leading tool; below 0 where it has none.
    pub fn track_id(&self) -> i64 {
        self.leading().filter(|track| track.filter.is_some()).map_or(-1, |track| track.number)
    }

    /// Tips that are followed, the leading one included.
    pub fn count(&self) -> usize {
        self.tracks.iter().filter(|track| track.filter.is_some()).count()
    }
}

#[cfg(test)]
mod tests;
