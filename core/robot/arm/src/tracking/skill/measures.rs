//! Sums of a tool in a phase, and the measures computed from them.
//!
//! Oropesa et al. 2013 define time, path, speed, depth and volume for laparoscopic instruments; D'Angelo et al. 2015
//! idle time.

use super::CELL_S;
use super::local_fit::State;
use super::movement::Movement;
use super::workspace::Workspace;

/// Mean and deviation of values that are added one at a time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mean {
    count: u64,
    mean: f64,
    squares: f64,
}

impl Mean {
    /// Adds a value.
    pub fn add(&mut self, value: f64) {
        self.count += 1;
        let before = value - self.mean;
        self.mean += before / self.count as f64;
        self.squares += before * (value - self.mean);
    }

    /// Values added.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Mean; NaN without values.
    pub fn mean(&self) -> f64 {
        if self.count == 0 { f64::NAN } else { self.mean }
    }

    /// Standard deviation; NaN with fewer than two values.
    pub fn deviation(&self) -> f64 {
        if self.count < 2 { f64::NAN } else { (self.squares / (self.count - 1) as f64).sqrt() }
    }
}

/// Activity of a tool during a time cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activity {
    /// Out of view.
    Unseen,
    /// Rests for at least the minimum time.
    Idle,
    /// Moves.
    Moving,
}

/// Measures of one tool in one phase, or in all. Times begin when the tool is first seen.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Measures {
    seen: u64,
    idle: u64,
    unseen: u64,
    departures: u64,
    path_mm: f64,
    depth_path_mm: f64,
    peak_mm_s: f64,
    depth: Option<(f64, f64)>,
    space: Workspace,
    chord_mm: f64,
    chord_path_mm: f64,
    squared_jerk: f64,
    measured_s: f64,
    movements: u64,
    /// Log dimensionless jerk of movements.
    pub ldlj: Mean,
    /// Spectral arc length of movements.
    pub sparc: Mean,
    contacts: Option<u64>,
    contact_s: f64,
}

fn share(part: f64, of: f64) -> f64 {
    if of > 0.0 { part / of } else { f64::NAN }
}

impl Measures {
    pub(super) fn cell(&mut self, activity: Activity, state: &State) {
        let [x, y, z, depth] = state.place;
        match activity {
            Activity::Unseen => {
                self.unseen += 1;
                return;
            }
            Activity::Idle => self.idle += 1,
            // Rest adds no path: what a tracker trembles there would grow with time.
            Activity::Moving => {
                self.path_mm += state.speed() * CELL_S;
                self.depth_path_mm += state.velocity[3].abs() * CELL_S;
                self.peak_mm_s = self.peak_mm_s.max(state.speed());
            }
        }
        self.seen += 1;
        self.space.add([x, y, z]);
        if depth.is_finite() {
            let (low, high) = self.depth.unwrap_or((depth, depth));
            self.depth = Some((low.min(depth), high.max(depth)));
        }
    }

    pub(super) fn depart(&mut self) {
        self.departures += 1;
    }

    pub(super) fn contact(&mut self, is_new: bool, lasted_s: f64) {
        *self.contacts.get_or_insert(0) += u64::from(is_new);
        self.contact_s += lasted_s;
    }

    pub(super) fn movement(&mut self, movement: &Movement) {
        self.movements += 1;
        self.chord_mm += movement.chord_mm;
        self.chord_path_mm += movement.path_mm;
        self.squared_jerk += movement.squared_jerk;
        self.measured_s += movement.duration_s;
        if let Some(value) = movement.ldlj {
            self.ldlj.add(value);
        }
        if let Some(value) = movement.sparc {
            self.sparc.add(value);
        }
    }

    /// Whether anything was added.
    pub fn is_empty(&self) -> bool {
        self.seen + self.unseen == 0
    }

    /// Time since the tool was first seen, s.
    pub fn time_s(&self) -> f64 {
        (self.seen + self.unseen) as f64 * CELL_S
    }

    /// Time in view, s.
    pub fn seen_s(&self) -> f64 {
        self.seen as f64 * CELL_S
    }

    /// Time out of view, s.
    pub fn out_of_view_s(&self) -> f64 {
        self.unseen as f64 * CELL_S
    }

    /// Number of times that it left the view.
    pub fn departures(&self) -> u64 {
        self.departures
    }

    /// Time in view in which it moved, s.
    pub fn moving_s(&self) -> f64 {
        (self.seen - self.idle) as f64 * CELL_S
    }

    /// Time in view in which it rested, s.
    pub fn idle_s(&self) -> f64 {
        self.idle as f64 * CELL_S
    }

    /// Share of the time in view in which it rested.
    pub fn idle_share(&self) -> f64 {
        share(self.idle as f64, self.seen as f64)
    }

    /// Length of the path while it moved, mm.
    pub fn path_mm(&self) -> f64 {
        self.path_mm
    }

    /// Path over time of movement, mm/s.
    pub fn mean_speed_mm_s(&self) -> f64 {
        share(self.path_mm, self.moving_s())
    }

    /// Highest speed, mm/s.
    pub fn peak_speed_mm_s(&self) -> f64 {
        self.peak_mm_s
    }

    /// Movements that were measured.
    pub fn movements(&self) -> u64 {
        self.movements
    }

    /// Straight distances of movements divided by their path lengths; 1 is straight.
    pub fn economy(&self) -> f64 {
        share(self.chord_mm, self.chord_path_mm)
    }

    /// Root mean square of the jerk during movements, mm/s^3.
    pub fn jerk_rms(&self) -> f64 {
        share(self.squared_jerk, self.measured_s).sqrt()
    }

    /// The workspace.
    pub fn space(&self) -> &Workspace {
        &self.space
    }

    /// Difference of greatest and least depth, mm.
    pub fn depth_range_mm(&self) -> f64 {
        self.depth.map_or(f64::NAN, |(low, high)| high - low)
    }

    /// Path along the view, mm: total distance moved towards and away from the camera.
    pub fn depth_path_mm(&self) -> f64 {
        self.depth_path_mm
    }

    /// Touches of the tissue; `None` if distances are not known. Each touch that lasts counts as a grasp, whether the
    /// jaws close or not, because tracks of tips do not show it.
    pub fn contacts(&self) -> Option<u64> {
        self.contacts
    }

    /// Time of touch, s.
    pub fn contact_s(&self) -> f64 {
        self.contact_s
    }
}

/// A named measure.
#[derive(Clone, Copy)]
pub struct Figure {
    /// Name with its unit, as in tables and JSON.
    pub name: &'static str,
    /// Title for display, with its unit.
    pub title: &'static str,
    /// Its value; NaN if unknown.
    pub of: fn(&Measures) -> f64,
}

macro_rules! figures {
    ($($name:literal, $title:literal, $of:expr;)*) => { [$(Figure { name: $name, title: $title, of: $of },)*] };
}

/// All measures, in the order in which they are shown.
pub const FIGURES: [Figure; 25] = figures! {
    "time_s", "time since first seen, s", Measures::time_s;
    "seen_s", "in view, s", Measures::seen_s;
    "out_of_view_s", "out of view, s", Measures::out_of_view_s;
    "departures", "departures from view", |m| m.departures as f64;
    "moving_s", "moving, s", Measures::moving_s;
    "idle_share", "idle share of the time in view", Measures::idle_share;
    "path_mm", "path, mm", Measures::path_mm;
    "mean_speed_mm_s", "mean speed while moving, mm/s", Measures::mean_speed_mm_s;
    "peak_speed_mm_s", "peak speed, mm/s", Measures::peak_speed_mm_s;
    "movements", "movements", |m| m.movements as f64;
    "economy", "economy of motion", Measures::economy;
    "jerk_rms_mm_s3", "jerk, root mean square, mm/s^3", Measures::jerk_rms;
    "ldlj", "log dimensionless jerk, mean", |m| m.ldlj.mean();
    "ldlj_deviation", "its deviation", |m| m.ldlj.deviation();
    "sparc", "spectral arc length, mean", |m| m.sparc.mean();
    "sparc_deviation", "its deviation", |m| m.sparc.deviation();
    "box_x_mm", "working box across, mm", |m| m.space.box_mm()[0];
    "box_y_mm", "working box down, mm", |m| m.space.box_mm()[1];
    "box_z_mm", "working box away, mm", |m| m.space.box_mm()[2];
    "box_cm3", "working box, cm^3", |m| m.space.box_cm3();
    "ellipsoid_cm3", "95 % ellipsoid, cm^3", |m| m.space.ellipsoid_cm3();
    "depth_range_mm", "range of depth, mm", Measures::depth_range_mm;
    "depth_path_mm", "path along the view, mm", Measures::depth_path_mm;
    "contacts", "touches of tissue", |m| m.contacts.map_or(f64::NAN, |n| n as f64);
    "contact_s", "time of touch, s", |m| if m.contacts.is_some() { m.contact_s } else { f64::NAN };
};
