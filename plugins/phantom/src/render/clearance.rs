//! True distances of the instruments' tips from the tissue.

use panoscope_imaging::Parallel;

use super::phantom::Phantom;
use super::relief::NODES;

/// Rounds of refinement: each halves the step, which starts at half a node.
const ROUNDS: usize = 12;

/// A periodic height field.
struct Heights<'a> {
    z_mm: &'a [f32],
    cell_mm: f64,
}

impl Heights<'_> {
    fn node(&self, column: i64, row: i64) -> f64 {
        let wrap = |k: i64| k.rem_euclid(NODES as i64) as usize;
        f64::from(self.z_mm[wrap(row) * NODES + wrap(column)])
    }

    /// Height at a position, mm: bilinear between nodes, as the surface is defined.
    fn at(&self, x: f64, y: f64) -> f64 {
        let (gx, gy) = (x / self.cell_mm, y / self.cell_mm);
        let (column, row) = (gx.floor(), gy.floor());
        let (u, v) = (gx - column, gy - row);
        let (column, row) = (column as i64, row as i64);
        let (a, b) = (self.node(column, row), self.node(column + 1, row));
        let (c, d) = (self.node(column, row + 1), self.node(column + 1, row + 1));
        (a + (b - a) * u) * (1.0 - v) + (c + (d - c) * u) * v
    }

    /// Distance to the nearest point of the surface, mm; below 0 behind it.
    fn clearance(&self, [x, y, z]: [f64; 3]) -> f64 {
        let below = self.at(x, y) - z;
        let square = |px: f64, py: f64, pz: f64| (px - x) * (px - x) + (py - y) * (py - y) + (pz - z) * (pz - z);
        // Nothing farther aside than the surface lies straight ahead can be nearer.
        let reach = (below.abs() / self.cell_mm).ceil() as i64 + 1;
        let (column, row) = ((x / self.cell_mm).round() as i64, (y / self.cell_mm).round() as i64);
        let (mut best, mut at) = (square(x, y, z + below), (x, y));
        for j in row - reach..=row + reach {
            for i in column - reach..=column + reach {
                let (px, py) = (i as f64 * self.cell_mm, j as f64 * self.cell_mm);
                let found = square(px, py, self.node(i, j));
                if found < best {
                    (best, at) = (found, (px, py));
                }
            }
        }
        let mut step = self.cell_mm / 2.0;
        for _ in 0..ROUNDS {
            let middle = at;
            for k in 0..25 {
                let (px, py) = (middle.0 + f64::from(k % 5 - 2) * step, middle.1 + f64::from(k / 5 - 2) * step);
                let found = square(px, py, self.at(px, py));
                if found < best {
                    (best, at) = (found, (px, py));
                }
            }
            step *= 0.5;
        }
        best.sqrt() * if below < 0.0 { -1.0 } else { 1.0 }
    }
}

impl Phantom {
    /// Distance of each instrument's tip to the nearest point of the tissue at a frame, mm, in order of identity; below 0 inside the tissue.
    pub fn clearances(&mut self, frame: u64, pool: &dyn Parallel, out: &mut Vec<f64>) {
        self.breathe(frame, pool);
        let field = self.field();
        let heights = Heights { z_mm: field.z_mm, cell_mm: f64::from(self.relief.cell_mm()) };
        let seconds = frame as f64 / self.params.fps;
        out.clear();
        out.extend(self.tools.iter().map(|tool| heights.clearance(tool.at(seconds).tip)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_to_a_slope_and_to_a_ridge_are_those_of_geometry() {
        let cell_mm = 0.25;
        let place = |k: usize| k as f64 * cell_mm;
        let slope: Vec<f32> = (0..NODES * NODES).map(|k| (50.0 + 0.5 * place(k % NODES)) as f32).collect();
        let heights = Heights { z_mm: &slope, cell_mm };
        // A plane z = 50 + x / 2, away from where it repeats.
        for (x, y, before) in [(40.0, 30.1, 6.0), (55.13, 60.0, 0.4), (61.0, 61.0, -3.0)] {
            let clearance = heights.clearance([x, y, 50.0 + 0.5 * x - before]);
            assert!((clearance - before / 1.25_f64.sqrt()).abs() < 1e-3, "{clearance} {before}");
        }
        let ridge: Vec<f32> =
            (0..NODES * NODES).map(|k| (50.0 + 2.0 * (place(k % NODES) - 64.0).abs()) as f32).collect();
        let heights = Heights { z_mm: &ridge, cell_mm };
        assert!((heights.clearance([64.0, 10.0, 45.0]) - 5.0).abs() < 1e-3);
        // Aside of the ridge its flank is nearer than what lies straight ahead.
        let flank = heights.clearance([70.0, 10.0, 57.0]);
        assert!((flank - 5.0 / 5.0_f64.sqrt()).abs() < 1e-3, "{flank}");
    }
}
