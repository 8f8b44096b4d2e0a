//! Data for plots of a tool, in bounded memory.

use panoscope_arm_core::tracking::skill::measures::Activity;
use panoscope_arm_core::tracking::skill::{CELL_S, Cell, Movement};

/// Maximum number of time parts; beyond it pairs are merged.
const MAX_PARTS: usize = 1200;
/// Maximum number of path positions and of movements; beyond it they are thinned.
const MAX_PLACES: usize = 4000;
const MAX_MOVEMENTS: usize = 4000;

/// A part of time.
#[derive(Clone, Copy, Debug, Default)]
pub struct Part {
    pub cells: u32,
    pub moving: u32,
    pub speed_sum: f64,
    pub speed_max: f64,
}

/// Data for plots of one tool; see the module.
#[derive(Debug, Default)]
pub struct Trace {
    /// Cells per part: 1, 2, 4 and so on.
    pub per_part: i64,
    /// First cell of the first part.
    pub first: i64,
    pub parts: Vec<Part>,
    /// Positions, mm, and whether the tool stayed in view since the previous one.
    pub places: Vec<([f64; 3], bool)>,
    per_place: i64,
    last_cell: i64,
    was_broken: bool,
    pub movements: Vec<Movement>,
    per_movement: usize,
    skipped: usize,
}

impl Trace {
    /// Adds a cell; cells must be in order.
    pub fn cell(&mut self, cell: &Cell) {
        if self.per_part == 0 {
            (self.per_part, self.per_place, self.first) = (1, 1, cell.index);
            (self.last_cell, self.was_broken) = (cell.index, true);
        }
        while (cell.index - self.first) / self.per_part >= MAX_PARTS as i64 {
            let pairs = self.parts.chunks(2).map(|two| {
                two.iter().fold(Part::default(), |sum, part| Part {
                    cells: sum.cells + part.cells,
                    moving: sum.moving + part.moving,
                    speed_sum: sum.speed_sum + part.speed_sum,
                    speed_max: sum.speed_max.max(part.speed_max),
                })
            });
            self.parts = pairs.collect();
            self.per_part *= 2;
        }
        let at = ((cell.index - self.first) / self.per_part) as usize;
        if self.parts.len() <= at {
            self.parts.resize(at + 1, Part::default());
        }
        let (part, speed) = (&mut self.parts[at], cell.state.speed());
        part.cells += 1;
        part.moving += u32::from(cell.activity == Activity::Moving);
        part.speed_sum += speed;
        part.speed_max = part.speed_max.max(speed);
        self.was_broken |= cell.index > self.last_cell + 1;
        self.last_cell = cell.index;
        if cell.index % self.per_place == 0 {
            let [x, y, z, _] = cell.state.place;
            self.places.push(([x, y, z], !self.was_broken));
            self.was_broken = false;
            if self.places.len() > MAX_PLACES {
                let kept = self.places.chunks(2).map(|two| (two[0].0, two.iter().all(|(_, is_joined)| *is_joined)));
                self.places = kept.collect();
                self.per_place *= 2;
            }
        }
    }

    /// Adds a movement.
    pub fn movement(&mut self, movement: &Movement) {
        self.per_movement = self.per_movement.max(1);
        self.skipped += 1;
        if self.skipped < self.per_movement {
            return;
        }
        self.skipped = 0;
        self.movements.push(*movement);
        if self.movements.len() > MAX_MOVEMENTS {
            let mut index = 0;
            self.movements.retain(|_| {
                index += 1;
                index % 2 == 0
            });
            self.per_movement *= 2;
        }
    }

    /// Middle of a part, s.
    pub fn part_s(&self, part: usize) -> f64 {
        (self.first as f64 + (part as f64 + 0.5) * self.per_part as f64) * CELL_S
    }
}

#[cfg(test)]
mod tests {
    use panoscope_arm_core::tracking::skill::local_fit::State;

    use super::*;

    #[test]
    fn an_hour_keeps_its_highest_speed_and_its_shares_in_few_parts() {
        let mut trace = Trace::default();
        for index in 0..360_000 {
            let speed = if index == 123_456 { 90.0 } else { 10.0 };
            let activity = if index % 4 == 0 { Activity::Idle } else { Activity::Moving };
            let state = State { place: [index as f64, 0.0, 0.0, 0.0], velocity: [speed, 0.0, 0.0, 0.0] };
            trace.cell(&Cell { index, activity, state });
        }
        assert!((MAX_PARTS / 2..=MAX_PARTS).contains(&trace.parts.len()), "{}", trace.parts.len());
        assert!(trace.places.len() <= MAX_PLACES && trace.places.iter().skip(1).all(|(_, is_joined)| *is_joined));
        let peak = trace.parts.iter().map(|p| p.speed_max).fold(0.0, f64::max);
        let (cells, moving) = trace.parts.iter().fold((0, 0), |(c, m), p| (c + p.cells, m + p.moving));
        assert_eq!((peak, cells, moving), (90.0, 360_000, 270_000));
    }
}
