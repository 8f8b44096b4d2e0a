//! Counts the stitched frames of a run.

use crate::error::Result;
use crate::packets::Table;
use crate::registration::{FRESH, WRONG, is_right};

/// The rule by which a frame counts as stitched, as a note below tables.
pub fn rule() -> String {
    let (times, more_px) = WRONG;
    format!(
        "A frame counts as stitched when its own registration was believed and, by the truth, is off by at most {times} times what the best plane leaves, plus \
         {more_px} px. One that is believed and further off counts as wrong; one that is held or lost counts as neither."
    )
}

/// Score of a method in one run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StitchScore {
    /// Evaluated frames.
    pub frames: usize,
    /// Frames that count as stitched.
    pub stitched: usize,
    /// Frames with an accepted registration that is wrong.
    pub wrong: usize,
    /// Sum of squares of the alignment error of the stitched frames, px^2, and their number.
    pub squares: (f64, usize),
}

impl StitchScore {
    /// Reads the table of an evaluating node; frames from `settle` on count.
    ///
    /// `floors_px`: alignment error of the best plane in each tick; NaN where it is unknown, and such a tick is not
    /// evaluated.
    pub fn of(rows: &Table, floors_px: &[f64], settle: usize) -> Result<Self> {
        let column = |name: &str| rows.required("the table", name);
        let (state, align) = (column("state")?, column("align_px")?);
        let mut tally = Self::default();
        for tick in settle..state.len() {
            let floor_px = floors_px.get(tick).copied().unwrap_or(f64::NAN);
            if !floor_px.is_finite() {
                continue;
            }
            tally.frames += 1;
            if state[tick] != FRESH {
                continue;
            }
            let right = is_right(align[tick], floor_px);
            tally.stitched += usize::from(right);
            tally.wrong += usize::from(!right);
            if right {
                tally.squares.0 += align[tick] * align[tick];
                tally.squares.1 += 1;
            }
        }
        Ok(tally)
    }

    /// Score of both runs together.
    pub fn and(&self, other: &Self) -> Self {
        Self {
            frames: self.frames + other.frames,
            stitched: self.stitched + other.stitched,
            wrong: self.wrong + other.wrong,
            squares: (self.squares.0 + other.squares.0, self.squares.1 + other.squares.1),
        }
    }

    fn pct(&self, count: usize) -> f64 {
        if self.frames == 0 { f64::NAN } else { 100.0 * count as f64 / self.frames as f64 }
    }

    /// Share of frames that count as stitched.
    pub fn stitched_pct(&self) -> f64 {
        self.pct(self.stitched)
    }

    /// Share of frames with an accepted registration that is wrong.
    pub fn wrong_pct(&self) -> f64 {
        self.pct(self.wrong)
    }

    /// Root mean square alignment error of the stitched frames, px; NaN if there are none.
    pub fn align_px(&self) -> f64 {
        if self.squares.1 == 0 { f64::NAN } else { (self.squares.0 / self.squares.1 as f64).sqrt() }
    }
}

/// Alignment error of the best plane in each tick, from the first evaluating node of the same images that has it.
pub fn floors(tables: &[&Table]) -> Vec<f64> {
    let columns: Vec<Vec<f64>> = tables.iter().filter_map(|rows| rows.column("floor_px")).collect();
    let ticks = columns.iter().map(Vec::len).max().unwrap_or(0);
    let first = |tick: usize| columns.iter().filter_map(|c| c.get(tick)).copied().find(|v| v.is_finite());
    (0..ticks).map(|tick| first(tick).unwrap_or(f64::NAN)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(state: &[f64], align: &[f64], floor: &[f64]) -> Table {
        let names = ["state", "align_px", "floor_px"].map(str::to_owned).to_vec();
        let rows = state.iter().zip(align).zip(floor).map(|((s, a), f)| vec![*s, *a, *f]).collect();
        Table { names, rows }
    }

    #[test]
    fn a_believed_frame_that_is_far_off_is_wrong_and_a_held_one_neither() {
        const NONE: f64 = f64::NAN;
        // Right, right at the limit of 2 x 1 + 6 px, beyond it, unknown, held, lost.
        let table = rows(&[0.0, 0.0, 0.0, 0.0, 1.0, 2.0], &[6.0, 8.0, 8.1, NONE, 1.0, NONE], &[1.0; 6]);
        let tally = StitchScore::of(&table, &floors(&[&table]), 0).unwrap();
        assert_eq!((tally.frames, tally.stitched, tally.wrong), (6, 2, 2));
        assert!((tally.align_px() - 50f64.sqrt()).abs() < 1e-9);
        assert!((tally.stitched_pct() - 100.0 / 3.0).abs() < 1e-9);
        let settled = StitchScore::of(&table, &floors(&[&table]), 2).unwrap();
        assert_eq!((settled.frames, settled.stitched, settled.wrong), (4, 0, 2));
        assert!(settled.align_px().is_nan());
        let both = tally.and(&settled);
        assert_eq!((both.frames, both.stitched, both.wrong, both.align_px()), (10, 2, 4, tally.align_px()));
    }

    #[test]
    fn the_best_plane_is_known_where_any_judge_knows_it() {
        const NONE: f64 = f64::NAN;
        let (a, b) =
            (rows(&[2.0, 0.0, 2.0], &[NONE; 3], &[NONE, 2.0, NONE]), rows(&[0.0; 3], &[1.0; 3], &[3.0, 2.0, NONE]));
        let floors = floors(&[&a, &b]);
        assert_eq!((floors[0], floors[1], floors[2].is_nan()), (3.0, 2.0, true));
        // A tick that no judge knows is not judged; one that another knows is lost by this one.
        let tally = StitchScore::of(&a, &floors, 0).unwrap();
        assert_eq!((tally.frames, tally.stitched, tally.wrong), (2, 0, 1));
    }
}
