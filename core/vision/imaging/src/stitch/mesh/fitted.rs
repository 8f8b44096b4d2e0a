//! The inverse of the fitted mesh: the point of the reference view that the other view shows at a position.

use super::{Lattice, MIN_MOVE_PX};
use crate::geometry::{Homography, Point, length};

/// Steps of the search. Each reduces the error to at most 0.6 of it if the disparity changes by 0.6 px per px.
const STEPS: usize = 16;
/// A search ends when a step is shorter, px.
const DONE_PX: f64 = 0.01;
/// Maximum displacement of a vertex in cells; beyond it the mesh is folded.
const MAX_CELLS: f64 = 3.0;

/// The mesh that fits the observations: from the reference view to the other one.
#[derive(Clone, Copy, Debug)]
pub struct Fitted<'a> {
    /// The vertices.
    pub lattice: &'a Lattice,
    /// Positions by the homography, px of the other view.
    pub base: &'a [Point],
    /// Their displacement against it.
    pub shift: &'a [Point],
    /// The homography, from the other view to the reference plane.
    pub there: &'a Homography,
}

impl Fitted<'_> {
    /// For each vertex the point of the reference view that the other view shows at `drawn`; leaves `out` empty if that
    /// is the vertex itself everywhere. Beyond the mesh the displacement of its rim is continued.
    pub fn find(&self, drawn: &[Point], out: &mut Vec<Point>) {
        out.clear();
        let mut is_moved = false;
        for (index, (wanted, (base, shift))) in drawn.iter().zip(self.base.iter().zip(self.shift)).enumerate() {
            let at = self.lattice.position(index % self.lattice.columns, index / self.lattice.columns);
            let off = length([wanted[0] - base[0] - shift[0], wanted[1] - base[1] - shift[1]]);
            let shown = if off < MIN_MOVE_PX { at } else { self.search(at, *wanted) };
            is_moved |= shown != at;
            out.push(shown);
        }
        if !is_moved {
            out.clear();
        }
    }

    /// Fixed-point iteration on the reference plane.
    fn search(&self, start: Point, wanted: Point) -> Point {
        let goal = self.there.map(wanted);
        let most = MAX_CELLS * self.lattice.cell_px as f64;
        let mut at = start;
        for _ in 0..STEPS {
            let Some(there) = self.at(at) else { break };
            let step = [goal[0] - there[0], goal[1] - there[1]];
            at = [0, 1].map(|k| (at[k] + step[k]).clamp(start[k] - most, start[k] + most));
            if length(step) < DONE_PX {
                break;
            }
        }
        at
    }

    /// Position at which the homography draws a point of the reference view from its position in the other view; `None`
    /// outside the mesh.
    fn at(&self, at: Point) -> Option<Point> {
        let (cell, t) = self.lattice.cell_of(at)?;
        let of = |vertex: usize| {
            [self.base[vertex][0] + self.shift[vertex][0], self.base[vertex][1] + self.shift[vertex][1]]
        };
        Some(self.there.map(self.lattice.interpolate(of, cell, t)))
    }
}
