//! The least-squares problem whose solution is the mesh.
//!
//! The unknowns are the displacements of the vertices from the homography, px of the other view. Terms: observations
//! between vertices; second differences, which keep the mesh smooth; first differences, which let it fade into the
//! (shifted) homography without observations; and positions of the previous frame.

use super::band::BandMatrix;
use crate::Simd;

/// Weights of the terms relative to observations, whose weight is at most 1.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Stiffness {
    /// Second differences.
    pub bend: f64,
    /// First differences.
    pub slope: f64,
    /// Displacements.
    pub place: f64,
}

impl Stiffness {
    /// The stiffness multiplied by `factor`.
    pub fn times(&self, factor: f64) -> Self {
        let Self { bend, slope, place } = *self;
        Self { bend: bend * factor, slope: slope * factor, place }
    }
}

/// Equations of a lattice, with the memory to solve them.
#[derive(Clone, Debug, Default)]
pub struct Energy {
    columns: usize,
    rows: usize,
    stiffness: Stiffness,
    /// The terms that do not depend on the frame.
    fixed: BandMatrix,
    matrix: BandMatrix,
    right: Vec<[f64; 2]>,
}

impl Energy {
    /// Sets the lattice; does nothing if it is unchanged.
    pub fn reset(&mut self, columns: usize, rows: usize, stiffness: Stiffness) {
        if (self.columns, self.rows, self.stiffness) == (columns, rows, stiffness) {
            return;
        }
        (self.columns, self.rows, self.stiffness) = (columns, rows, stiffness);
        let mut fixed = std::mem::take(&mut self.fixed);
        // Two lines on either side of the shorter one.
        fixed.reset(columns * rows, 2 * columns.min(rows));
        let Stiffness { bend, slope, place } = stiffness;
        for row in 0..rows {
            for column in 0..columns {
                let at = |dx: usize, dy: usize| {
                    (column + dx < columns && row + dy < rows).then(|| self.index(column + dx, row + dy))
                };
                let here = self.index(column, row);
                fixed.add(here, here, place);
                for (dx, dy) in [(1, 0), (0, 1)] {
                    let Some(next) = at(dx, dy) else { continue };
                    add_square(&mut fixed, &[(here, -1.0), (next, 1.0)], slope);
                    if let Some(after) = at(2 * dx, 2 * dy) {
                        add_square(&mut fixed, &[(here, 1.0), (next, -2.0), (after, 1.0)], bend);
                    }
                }
                if let (Some(right), Some(below), Some(across)) = (at(1, 0), at(0, 1), at(1, 1)) {
                    let twist = [(here, 1.0), (right, -1.0), (below, -1.0), (across, 1.0)];
                    add_square(&mut fixed, &twist, 2.0 * bend);
                }
            }
        }
        self.fixed = fixed;
    }

    /// Neighbours along the shorter side follow each other, for a narrow band.
    fn index(&self, column: usize, row: usize) -> usize {
        if self.rows <= self.columns { column * self.rows + row } else { row * self.columns + column }
    }

    /// Starts a frame: no observations.
    pub fn begin(&mut self) {
        self.matrix.copy_from(&self.fixed);
        self.right.clear();
        self.right.resize(self.columns * self.rows, [0.0; 2]);
    }

    /// An observed displacement at a position inside the cell whose first vertex is `(column, row)`.
    pub fn observe(&mut self, (column, row): (usize, usize), [s, t]: [f64; 2], target: [f64; 2], weight: f64) {
        let terms = [
            (self.index(column, row), (1.0 - s) * (1.0 - t)),
            (self.index(column + 1, row), s * (1.0 - t)),
            (self.index(column, row + 1), (1.0 - s) * t),
            (self.index(column + 1, row + 1), s * t),
        ];
        add_square(&mut self.matrix, &terms, weight);
        for (index, c) in terms {
            for k in 0..2 {
                self.right[index][k] += weight * c * target[k];
            }
        }
    }

    /// Pulls a vertex to a displacement.
    pub fn pull(&mut self, column: usize, row: usize, target: [f64; 2], weight: f64) {
        let index = self.index(column, row);
        self.matrix.add(index, index, weight);
        for k in 0..2 {
            self.right[index][k] += weight * target[k];
        }
    }

    /// Writes the displacements that fit best, row after row. `false` if there is no unique solution.
    pub fn solve(&mut self, out: &mut [[f64; 2]], simd: Simd) -> bool {
        if !self.matrix.factor(simd) {
            return false;
        }
        self.matrix.solve(&mut self.right);
        for row in 0..self.rows {
            for column in 0..self.columns {
                out[row * self.columns + column] = self.right[self.index(column, row)];
            }
        }
        out.iter().flatten().all(|v| v.is_finite())
    }
}

/// Adds `weight * (sum of coefficient * unknown)^2`.
fn add_square(matrix: &mut BandMatrix, terms: &[(usize, f64)], weight: f64) {
    for (n, (i, a)) in terms.iter().enumerate() {
        for (j, b) in &terms[..=n] {
            matrix.add(*i, *j, weight * a * b);
        }
    }
}
