//! Tracks instrument tips in space, selects the leading one, and predicts it while it is hidden.
//!
//! Every tip in view has a track with its own filter. Each tick assigns all reports to all tracks at once (global
//! nearest neighbour; Bar-Shalom, Li, Kirubarajan 2001, and Blackman and Popoli 1999, chapter 6). A tool that passes in
//! front of the leading one therefore keeps its own reports. If detectors number tools, the number decides; the class
//! breaks ties.

mod assign;
mod report;
mod track;

use nalgebra::{Isometry3, Vector3};

use report::passed_s;
pub use report::{Report, Rules, UNKNOWN_CLASS};
use track::{Observation, Track};

/// State of the leading tip after a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Known {
    /// It was seen: index of its report.
    Seen(usize),
    /// It is predicted: seconds since it was last seen.
    Predicted(f64),
    /// No tip leads.
    Lost,
}

/// Tracks tips and selects the leading one.
#[derive(Debug, Default)]
pub struct Tracker {
    tracks: Vec<Track>,
    observations: Vec<Observation>,
    /// Key of the leading track; it stays after the tip is lost, until another leads.
    leader: Option<u64>,
    next_key: u64,
    last_ns: Option<i64>,
    /// Start of the time in which only other tips are seen.
    others_ns: Option<i64>,
    /// Whether another tool covers the leading tip in the next tick.
    is_covered: bool,
}

/// Longest time for which a covered tip keeps the lead, s.
const COVERED_S: f64 = 5.0;

impl Tracker {
    /// Marks the tool with this number (or, if it is below 0, this class) as in view in the next tick with its tip
    /// covered by another tool. If it leads, no other tool takes the lead for up to 5 s.
    pub fn cover(&mut self, track_id: i64, class_index: u32) {
        self.is_covered |= self.leading().is_some_and(|track| track.is_tool(track_id, class_index));
    }

    /// Processes one tick: the reports of all detectors at `capture_ns`, and the camera's pose then (identity if
    /// unknown). Time that goes backwards resets the tracker.
    pub fn step(
        &mut self,
        capture_ns: i64,
        reports: impl Iterator<Item = Report>,
        room_from_camera: &Isometry3<f64>,
        rules: &Rules,
    ) -> Known {
        let is_covered = std::mem::take(&mut self.is_covered);
        let dt_s = self.last_ns.map_or(0.0, |last| passed_s(last, capture_ns));
        if dt_s < 0.0 {
            *self = Self::default();
        }
        let before_ns = self.last_ns.replace(capture_ns).unwrap_or(capture_ns);
        for track in &mut self.tracks {
            track.predict(capture_ns, dt_s, rules);
        }
        self.observations.clear();
        let usable = |report: &Report| {
            report.score >= rules.min_score && report.xyz_mm.z > 0.0 && report.xyz_mm.iter().all(|v| v.is_finite())
        };
        for (index, report) in reports.enumerate().filter(|(_, report)| usable(report)) {
            if self.observations.len() < assign::COLUMNS {
                self.observations.push(Observation::new(index, report, room_from_camera, rules));
            }
        }
        self.assign(before_ns, capture_ns, rules);
        self.drop_old(capture_ns, rules);
        self.select_leader(capture_ns, is_covered, rules)
    }

    /// Assigns observations to tracks, and starts tracks for those left over.
    fn assign(&mut self, before_ns: i64, now_ns: i64, rules: &Rules) {
        let mut costs = [[f64::INFINITY; assign::COLUMNS]; assign::ROWS];
        for (track, row) in self.tracks.iter().zip(&mut costs) {
            for (observation, cost) in self.observations.iter().zip(row.iter_mut()) {
                *cost = track.cost(observation, now_ns, rules);
            }
        }
        let found = assign::assign(&costs, self.tracks.len(), self.observations.len());
        let (tracks, observations) = (&self.tracks, &self.observations);
        let is_fresh = |row: usize| tracks.get(row).is_some_and(|track| track.seen_ns >= before_ns);
        // A hidden tip does not return as the second report of a tip that is in view.
        let is_double = |row: usize, column: usize| {
            let same = |other: usize| found[other].is_some_and(|c| observations[c].is_same_as(&observations[column]));
            !is_fresh(row) && (0..assign::ROWS).any(|other| other != row && is_fresh(other) && same(other))
        };
        let assigned: [Option<usize>; assign::ROWS] =
            std::array::from_fn(|row| found[row].filter(|column| !is_double(row, *column)));
        for (track, column) in self.tracks.iter_mut().zip(assigned) {
            if let Some(observation) = column.and_then(|column| self.observations.get_mut(column)) {
                observation.is_taken = true;
                track.update(observation, now_ns, rules);
            }
        }
        for index in 0..self.observations.len() {
            let observation = self.observations[index];
            // A known number, or a second report of a tip that was just seen, starts no track.
            if observation.is_taken
                || self.tracks.iter().any(|track| track.has_number(&observation) || track.is_at(&observation, now_ns))
            {
                continue;
            }
            if self.tracks.len() == assign::ROWS {
                let leader = self.leader;
                let oldest = self.tracks.iter().enumerate().filter(|(_, track)| Some(track.key) != leader);
                let Some((oldest, _)) = oldest.min_by_key(|(_, track)| track.seen_ns) else { continue };
                self.tracks.swap_remove(oldest);
            }
            if let Some(track) = Track::begin(self.next_key, &observation, now_ns) {
                self.next_key += 1;
                self.tracks.push(track);
            }
        }
    }

    /// Drops tracks other than the leading one that were not seen for long.
    fn drop_old(&mut self, now_ns: i64, rules: &Rules) {
        let (leader, memory_s) = (self.leader, rules.max_gap_s.max(rules.switch_s));
        self.tracks.retain(|track| Some(track.key) == leader || passed_s(track.seen_ns, now_ns) <= memory_s);
    }

    /// Selects the leading track and returns its state.
    fn select_leader(&mut self, now_ns: i64, is_covered: bool, rules: &Rules) -> Known {
        let is_seen = |track: &&Track| track.seen_ns == now_ns;
        let leading = self.leading();
        if let Some(track) = leading.filter(is_seen) {
            let report = track.report;
            self.others_ns = None;
            return Known::Seen(report);
        }
        let none_led = leading.is_none();
        let gap_s = leading.map_or(f64::INFINITY, |track| passed_s(track.seen_ns, now_ns));
        if is_covered && gap_s <= COVERED_S {
            self.others_ns = None;
            return if gap_s <= rules.max_gap_s { Known::Predicted(gap_s) } else { Known::Lost };
        }
        // Next is the one nearest to the centre of the picture that both cameras share.
        let next = self.tracks.iter().filter(is_seen).min_by(|a, b| a.off_axis.total_cmp(&b.off_axis));
        if let Some((key, report)) = next.map(|track| (track.key, track.report)) {
            let waited_s = passed_s(*self.others_ns.get_or_insert(now_ns), now_ns);
            if none_led || waited_s >= rules.switch_s {
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

    /// Position (mm) and velocity (mm/s) in the room; `None` while lost.
    pub fn state(&self) -> Option<(Vector3<f64>, Vector3<f64>)> {
        let filter = self.leading()?.filter?;
        Some((filter.position_mm(), filter.velocity_mm_s()))
    }

    /// Standard deviation of the position, mm; NaN while lost.
    pub fn deviation_mm(&self) -> f64 {
        self.leading().and_then(|track| track.filter).map_or(f64::NAN, |filter| filter.deviation_mm())
    }

    /// Class of the leading tip: the most frequent in its last reports, or [`UNKNOWN_CLASS`].
    pub fn class_index(&self) -> u32 {
        self.leading().map_or(UNKNOWN_CLASS, Track::class_index)
    }

    /// Number of the leading tool; -1 if it has none.
    pub fn track_id(&self) -> i64 {
        self.leading().filter(|track| track.filter.is_some()).map_or(-1, |track| track.number)
    }

    /// Number of tracked tips, the leading one included.
    pub fn count(&self) -> usize {
        self.tracks.iter().filter(|track| track.filter.is_some()).count()
    }
}

#[cfg(test)]
mod tests;
