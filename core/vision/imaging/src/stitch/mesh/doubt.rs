//! Regions where a mesh and the measurements differ, which a seam must avoid.

use crate::geometry::length;

/// Doubt of a position without an observation, px.
const UNKNOWN_PX: f32 = 1.0;
/// Largest doubt, px.
const MAX_PX: f64 = 16.0;
/// Doubt from which on the views show different content, px.
const WRONG_PX: f32 = 3.0;

/// Distance between a mesh and the observations, on a grid of cells over the reference view.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Doubt {
    cell_px: usize,
    columns: usize,
    rows: usize,
    /// Px of the other view, row after row.
    px: Vec<f32>,
    line: Vec<f32>,
}

impl Doubt {
    /// The value at a position of the reference plane; 0 outside the reference view.
    pub fn at(&self, [x, y]: [f32; 2]) -> f32 {
        if self.cell_px == 0 || x < 0.0 || y < 0.0 {
            return 0.0;
        }
        let (column, row) = (x as usize / self.cell_px, y as usize / self.cell_px);
        if column >= self.columns || row >= self.rows { 0.0 } else { self.px[row * self.columns + column] }
    }

    /// Copies another one into the existing memory.
    pub fn copy_from(&mut self, other: &Self) {
        (self.cell_px, self.columns, self.rows) = (other.cell_px, other.columns, other.rows);
        self.px.clone_from(&other.px);
    }

    /// Becomes the doubt on images that are larger by a factor, in pixels of the small ones.
    pub fn enlarge(&mut self, small: &Self, factor: usize) {
        self.copy_from(small);
        self.cell_px *= factor;
    }

    /// Forgets all observations.
    pub fn reset(&mut self, cell_px: usize, columns: usize, rows: usize) {
        (self.cell_px, self.columns, self.rows) = (cell_px, columns, rows);
        self.px.clear();
        self.px.resize(columns * rows, UNKNOWN_PX);
    }

    /// Adds an observation in a cell that is `off` px of the other view from its position in the mesh.
    ///
    /// The other view draws it displaced by as much, so all cells in between are in doubt.
    pub fn mark(&mut self, cell: usize, off: [f64; 2]) {
        let length = length(off);
        let level = length.min(MAX_PX) as f32;
        let own = &mut self.px[cell];
        *own = if *own <= UNKNOWN_PX { level } else { own.max(level) };
        if level < WRONG_PX {
            return;
        }
        let cell_px = self.cell_px as f64;
        let start = [(cell % self.columns) as f64, (cell / self.columns) as f64];
        let steps = (length / cell_px).ceil();
        for step in 1..=steps as usize {
            let [x, y] = [0, 1].map(|k| (start[k] + off[k] / cell_px * step as f64 / steps).round());
            if x >= 0.0 && y >= 0.0 && (x as usize) < self.columns && (y as usize) < self.rows {
                let passed = &mut self.px[y as usize * self.columns + x as usize];
                *passed = passed.max(level);
            }
        }
    }

    /// Extends wrong regions by `reach_px`, because a nearby transition shows them too.
    pub fn spread(&mut self, reach_px: f64) {
        let reach = (reach_px / self.cell_px.max(1) as f64).round() as usize;
        let mut line = std::mem::take(&mut self.line);
        for (lines, count, apart, along) in
            [(self.rows, self.columns, self.columns, 1), (self.columns, self.rows, 1, self.columns)]
        {
            for index in 0..lines {
                let place = |i: usize| index * apart + i * along;
                line.clear();
                line.extend((0..count).map(|i| self.px[place(i)]));
                for (i, wrong) in line.iter().enumerate().filter(|(_, px)| **px >= WRONG_PX) {
                    for near in i.saturating_sub(reach)..(i + reach + 1).min(count) {
                        let px = &mut self.px[place(near)];
                        *px = px.max(*wrong);
                    }
                }
            }
        }
        self.line = line;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_lies_in_front_is_doubtful_where_either_view_shows_it() {
        let mut doubt = Doubt::default();
        doubt.reset(10, 20, 10);
        for cell in 0..200 {
            doubt.mark(cell, [0.2, 0.0]);
        }
        // Drawn 40 px further left.
        doubt.mark(5 * 20 + 12, [-40.0, 0.0]);
        let row = |doubt: &Doubt, y: f32| -> Vec<usize> {
            (0..20).filter(|x| doubt.at([*x as f32 * 10.0 + 5.0, y]) > 3.0).collect()
        };
        assert_eq!(row(&doubt, 55.0), [8, 9, 10, 11, 12]);
        assert!((doubt.at([5.0, 5.0]) - 0.2).abs() < 1e-6);
        doubt.spread(20.0);
        assert_eq!(row(&doubt, 55.0), (6..=14).collect::<Vec<_>>());
        assert_eq!(row(&doubt, 35.0), (6..=14).collect::<Vec<_>>());
        assert!(row(&doubt, 25.0).is_empty() && row(&doubt, 85.0).is_empty());
        assert_eq!((doubt.at([-1.0, 5.0]), doubt.at([5.0, 101.0])), (0.0, 0.0));
    }
}
