//! Measurements of a follower: unobserved regions, motion of the views, distance of the mesh from the observations.

use super::super::instruments::nearer_px;
use super::super::observe::Observations;
use super::MeshFollower;
use crate::Rect;
use crate::geometry::{Point, length, median};

/// Cells of observations per block, each way, in which motion is separated from noise.
const BLOCK_CELLS: usize = 4;
/// Minimum number of observations of a block for motion.
const MIN_BLOCK: f64 = 4.0;

impl MeshFollower {
    /// Computes [`MeshReport::blind`].
    pub(super) fn blind(&mut self, overlap: Rect) -> f64 {
        let Observations { cell_px, columns, rows, .. } = self.observations;
        let by_rows = self.params.along[0] != 0.0;
        let (count, first_px, size_px) =
            if by_rows { (rows, overlap.y, overlap.height) } else { (columns, overlap.x, overlap.width) };
        self.is_seen.clear();
        self.is_seen.resize(count, false);
        for seen in &self.located {
            self.is_seen[if by_rows { seen.index / columns } else { seen.index % columns }] = true;
        }
        let lines = first_px.div_ceil(cell_px)..((first_px + size_px) / cell_px).min(count);
        let shared = self.is_seen.get(lines).unwrap_or_default();
        let seen = shared.iter().filter(|is_seen| **is_seen).count();
        1.0 - seen as f64 / shared.len().max(1) as f64
    }

    /// Motion of the observations against the mesh of the frame before: the median over blocks of observations of their
    /// mean distance from it, px, and their common displacement. Noise of matching averages out in a block, motion does
    /// not.
    pub(super) fn motion(&mut self) -> (f64, Point) {
        let columns = self.observations.columns.div_ceil(BLOCK_CELLS);
        let rows = self.observations.rows.div_ceil(BLOCK_CELLS);
        self.blocks.clear();
        self.blocks.resize(columns * rows, [0.0; 3]);
        let (before, base) = (&self.before, &self.base);
        for seen in &self.located {
            let difference = |vertex: usize| [before[vertex][0] - base[vertex][0], before[vertex][1] - base[vertex][1]];
            let old = self.lattice.interpolate(difference, seen.cell, seen.t);
            let (x, y) = (seen.index % self.observations.columns, seen.index / self.observations.columns);
            let block = &mut self.blocks[y / BLOCK_CELLS * columns + x / BLOCK_CELLS];
            for (sum, value) in block.iter_mut().zip([seen.shift[0] - old[0], seen.shift[1] - old[1], 1.0]) {
                *sum += value;
            }
        }
        let mut of_full = |value: fn([f64; 2]) -> f64| {
            self.sorted.clear();
            let full = self.blocks.iter().filter(|block| block[2] >= MIN_BLOCK);
            self.sorted.extend(full.map(|[x, y, count]| value([x / count, y / count])));
            median(&mut self.sorted)
        };
        (of_full(length), [of_full(|[x, _]| x), of_full(|[_, y]| y)])
    }

    /// Marks where the mesh and the observations differ. Returns the median distance, px.
    pub(super) fn judge(&mut self) -> f64 {
        let Observations { cell_px, columns, rows, .. } = self.observations;
        let doubt = &mut self.mesh.doubt;
        doubt.reset(cell_px, columns, rows);
        if self.params.keeps_instruments {
            self.instruments.begin(cell_px, columns, rows);
        }
        self.sorted.clear();
        for seen in &self.located {
            let (drawn, base, shift) = (&self.drawn, &self.base, &self.shift);
            // Where the reference view is drawn along, what counts is whether both views still fit.
            let of = |vertex: usize| match self.params.moves_reference {
                true => shift[vertex],
                false => [drawn[vertex][0] - base[vertex][0], drawn[vertex][1] - base[vertex][1]],
            };
            let at = self.lattice.interpolate(of, seen.cell, seen.t);
            let off = [seen.shift[0] - at[0], seen.shift[1] - at[1]];
            doubt.mark(seen.index, off);
            self.sorted.push(length(off));
            if self.params.keeps_instruments {
                self.instruments.set(seen.index, nearer_px(self.params.along, off));
            }
        }
        let scale = self.lattice.cell_px as f64 / self.params.cell_px;
        doubt.spread(self.params.margin_px * scale);
        median(&mut self.sorted)
    }
}
