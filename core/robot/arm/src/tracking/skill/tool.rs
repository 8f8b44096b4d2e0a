//! One tool: turns samples into cells and cells into movements.

use std::collections::VecDeque;

use super::local_fit::{self, State};
use super::measures::{Activity, Measures};
use super::movement::{Meter, Movement, ROUGH_EDGE};
use super::{CELL_S, Sample, Settings};
use crate::tracking::proximity::Hysteresis;

/// Maximum duration of a movement, s; longer ones are measured in parts.
const MAX_S: f64 = 30.0;
/// Maximum number of samples that are kept.
const MAX_SAMPLES: usize = 8192;

/// The middle of a cell, s.
fn middle_s(cell: i64) -> f64 {
    (cell as f64 + 0.5) * CELL_S
}

/// First cell whose middle is not before a time.
fn cell_from(at_s: f64) -> i64 {
    (at_s / CELL_S - 0.5 - 1e-6).ceil() as i64
}

/// A cell that is decided.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
    /// Number of the cell, which lasts from `index * CELL_S` to the next.
    pub index: i64,
    /// Activity of the tool.
    pub activity: Activity,
    /// Position and velocity of the tool.
    pub state: State,
}

/// Receives the results of a tool.
pub struct Sink<'a> {
    pub settings: &'a Settings,
    pub meter: &'a mut Meter,
    pub phase: usize,
    pub cells: Option<&'a mut Vec<Cell>>,
    pub movements: &'a mut VecDeque<Movement>,
}

#[derive(Default)]
pub struct Tool {
    pub key: u64,
    pub name: String,
    pub total: Measures,
    pub phases: Vec<Measures>,
    /// Decided cells that pairs have not compared yet; those out of view are excluded.
    pub waiting: VecDeque<(i64, bool, f32)>,
    /// All cells before this one are decided.
    pub decided: i64,
    samples: Vec<Sample>,
    /// Next cell to decide, while in view.
    next: Option<i64>,
    /// Whether it has left the view.
    left: bool,
    /// Slow cells that do not yet last long enough to count as idle.
    slow: VecDeque<(i64, State)>,
    is_idle: bool,
    /// First cell of the movement.
    first: i64,
    speeds: Vec<f32>,
    touch: Hysteresis,
    touched_s: f64,
}

impl Tool {
    pub fn new(key: u64, name: String, phases: usize) -> Self {
        Self { key, name, phases: vec![Measures::default(); phases], ..Self::default() }
    }

    fn both(&mut self, phase: usize, mut with: impl FnMut(&mut Measures)) {
        with(&mut self.total);
        if let Some(measures) = self.phases.get_mut(phase) {
            with(measures);
        }
    }

    /// Adds a sample; one that is not newer than the last, or has no position, is ignored.
    pub fn observe(&mut self, sample: Sample, sink: &mut Sink<'_>) {
        let is_place = sample.place_mm.iter().all(|v| v.is_finite()) && sample.at_s.is_finite();
        if !is_place || self.samples.last().is_some_and(|last| sample.at_s <= last.at_s) {
            return;
        }
        let depth_mm = if sample.depth_mm.is_finite() { sample.depth_mm } else { 0.0 };
        self.advance(sample.at_s, sink);
        let cell = cell_from(sample.at_s);
        if self.next.is_none() {
            // Cells since it left are out of view.
            if !self.total.is_empty() {
                self.be_unseen(cell, sink.phase);
            }
            self.samples.clear();
            (self.next, self.decided, self.left, self.is_idle) = (Some(cell), cell, false, false);
        }
        self.samples.push(Sample { depth_mm, ..sample });
        self.touch(&sample, sink);
        self.work(sample.at_s - sink.settings.window_s, sink);
    }

    fn touch(&mut self, sample: &Sample, sink: &Sink<'_>) {
        if !sample.tissue_mm.is_finite() {
            return;
        }
        let (was, since_s) = (self.touch.is_on(), self.touch.leans_since_s());
        let is = self.touch.step(sample.at_s, sample.tissue_mm, &sink.settings.touch_rule());
        // From where it began until it ends, not until that is certain.
        let lasted_s = match self.touch.leans_since_s() {
            _ if is && !was => sample.at_s - since_s.unwrap_or(sample.at_s),
            None if is => sample.at_s - self.touched_s,
            Some(since) if is && since >= sample.at_s => sample.at_s - self.touched_s,
            _ => 0.0,
        };
        self.touched_s = sample.at_s;
        self.both(sink.phase, |m| m.contact(is && !was, lasted_s));
    }

    /// Advances to a time without samples; after the maximum gap the tool is out of view.
    pub fn advance(&mut self, now_s: f64, sink: &mut Sink<'_>) {
        if self.next.is_some() {
            if self.samples.last().is_some_and(|last| now_s - last.at_s > sink.settings.max_gap_s + 1e-9) {
                self.leave(sink);
            }
            return;
        }
        if self.left {
            self.be_unseen(cell_from(now_s), sink.phase);
        }
    }

    fn be_unseen(&mut self, until: i64, phase: usize) {
        for _ in self.decided..until {
            self.both(phase, |m| m.cell(Activity::Unseen, &State::default()));
        }
        self.decided = self.decided.max(until);
    }

    /// Ends a stretch in view.
    fn leave(&mut self, sink: &mut Sink<'_>) {
        self.cut(sink);
        (self.next, self.left) = (None, true);
        self.touch = Hysteresis::default();
        self.both(sink.phase, Measures::depart);
    }

    /// Decides all cells up to the last sample and ends the movement; later samples belong to another phase or stretch.
    pub fn cut(&mut self, sink: &mut Sink<'_>) {
        let Some(last) = self.samples.last().filter(|_| self.next.is_some()) else { return };
        self.work(last.at_s + 1e-9, sink);
        while let Some((cell, state)) = self.slow.pop_front() {
            self.decide(cell, Activity::Moving, state, sink);
        }
        self.end_movement(sink);
    }

    /// Decides cells whose middle is not after a time.
    fn work(&mut self, until_s: f64, sink: &mut Sink<'_>) {
        while let Some(cell) = self.next.filter(|cell| middle_s(*cell) <= until_s) {
            self.next = Some(cell + 1);
            let Some(state) = local_fit::fit(&self.samples, middle_s(cell), sink.settings.window_s) else { continue };
            self.take(cell, state, sink);
        }
        // What neither a window nor the movement needs goes.
        let Some(next) = self.next else { return };
        let is_moving = !self.speeds.is_empty() || !self.slow.is_empty();
        let since = if is_moving && !self.speeds.is_empty() { self.first } else { next };
        let since_s = middle_s(since.min(next)) - sink.settings.window_s.max(CELL_S) - CELL_S;
        let spare = self.samples.partition_point(|s| s.at_s < since_s);
        // Fits of sparse samples reach farther back; and moving memory about for each sample would cost more than it saves.
        let spare = spare.saturating_sub(local_fit::MIN_SAMPLES);
        if spare > self.samples.len() / 2 || self.samples.len() > MAX_SAMPLES {
            self.samples.drain(..spare);
        }
    }

    fn take(&mut self, cell: i64, state: State, sink: &mut Sink<'_>) {
        let rest_cells = (sink.settings.rest_s / CELL_S).round().max(1.0) as usize;
        if state.speed() < sink.settings.rest_mm_s {
            if self.is_idle {
                self.decide(cell, Activity::Idle, state, sink);
                return;
            }
            self.slow.push_back((cell, state));
            if self.slow.len() >= rest_cells {
                self.end_movement(sink);
                self.is_idle = true;
                while let Some((cell, state)) = self.slow.pop_front() {
                    self.decide(cell, Activity::Idle, state, sink);
                }
            }
            return;
        }
        self.is_idle = false;
        while let Some((cell, state)) = self.slow.pop_front() {
            self.decide(cell, Activity::Moving, state, sink);
        }
        self.decide(cell, Activity::Moving, state, sink);
    }

    fn decide(&mut self, cell: i64, activity: Activity, state: State, sink: &mut Sink<'_>) {
        self.both(sink.phase, |m| m.cell(activity, &state));
        self.waiting.push_back((cell, activity == Activity::Moving, state.speed() as f32));
        self.decided = cell + 1;
        if let Some(cells) = sink.cells.as_deref_mut() {
            cells.push(Cell { index: cell, activity, state });
        }
        if activity == Activity::Moving {
            if self.speeds.is_empty() {
                self.first = cell;
            }
            self.speeds.push(state.speed() as f32);
            if self.speeds.len() as f64 * CELL_S >= MAX_S || self.samples.len() >= MAX_SAMPLES {
                self.end_movement(sink);
            }
        }
    }

    fn end_movement(&mut self, sink: &mut Sink<'_>) {
        let peak = self.speeds.iter().copied().fold(0.0, f32::max);
        let is_fast = |v: &f32| *v >= ROUGH_EDGE as f32 * peak && *v as f64 >= sink.settings.rest_mm_s;
        let (from, to) = (self.speeds.iter().position(is_fast), self.speeds.iter().rposition(is_fast));
        if let (Some(from), Some(to), Some(first), Some(last)) = (from, to, self.samples.first(), self.samples.last()) {
            // A movement that is cut off by the end of a stretch begins or ends with it.
            // A cell more on both sides: the meter finds the edges exactly.
            let start_s = ((self.first + from as i64 - 1) as f64 * CELL_S).max(first.at_s);
            let end_s = ((self.first + to as i64 + 2) as f64 * CELL_S).min(last.at_s);
            let Settings { knot_s, rest_mm_s, .. } = *sink.settings;
            if let Some(movement) = sink.meter.measure(&self.samples, start_s, end_s, knot_s, rest_mm_s) {
                self.both(sink.phase, |m| m.movement(&movement));
                if sink.movements.len() == sink.movements.capacity() {
                    sink.movements.pop_front();
                }
                sink.movements.push_back(movement);
            }
        }
        self.speeds.clear();
    }
}
