//! Instruments in front of the tissue: the view that shows each, and where the mesh must be rigid.

use super::super::fitted::Fitted;
use super::super::instruments::{Arrangement, nearer_px};
use super::MeshFollower;
use crate::Rect;
use crate::geometry::Homography;

/// Maximum parallax of unfollowed observations that show an instrument, px of a view of 640 columns.
const LOOSE_PX: f64 = 8.0;
const MAX_NEARER_PX: f64 = 240.0;

impl MeshFollower {
    /// Finds the instruments in front of the mesh, and where it must be rigid.
    pub(super) fn keep_instruments(&mut self, overlap: Rect, is_new: bool) {
        if !self.params.keeps_instruments {
            self.mesh.kept.clear();
            return;
        }
        let scale = self.lattice.cell_px as f64 / self.params.cell_px;
        for seen in &self.loose {
            let at = self.lattice.interpolate(|vertex| self.shift[vertex], seen.cell, seen.t);
            let nearer = nearer_px(self.params.along, [seen.shift[0] - at[0], seen.shift[1] - at[1]]);
            // What lies behind the tissue, or on it, is a wrong match.
            if nearer > LOOSE_PX * scale && nearer < MAX_NEARER_PX * scale {
                self.instruments.set(seen.index, nearer);
            }
        }
        let cell_px = self.observations.cell_px.max(1);
        let cells = |low: usize, size: usize| [low / cell_px, (low + size).saturating_sub(1) / cell_px];
        let how = Arrangement {
            along: self.params.along,
            scale,
            shared: [cells(overlap.x, overlap.width), cells(overlap.y, overlap.height)],
            factor: self.scaled.factor(),
            margin_px: self.params.margin_px * scale,
        };
        self.instruments.find(&self.observations, &how, &self.hints, &mut self.mesh.kept);
        self.rigid.update(&mut self.instruments, &how, &self.lattice, [&self.drawn, &self.base], is_new);
    }

    /// Makes the mesh rigid at instruments, and sets the shown positions of the reference view.
    pub(super) fn show(&mut self, left_from_right: &Homography) {
        self.rigid.straighten(&mut self.drawn, &self.base);
        if !self.params.moves_reference {
            return;
        }
        let fitted = Fitted { lattice: &self.lattice, base: &self.base, shift: &self.shift, there: left_from_right };
        fitted.find(&self.drawn, &mut self.shown);
        self.rigid.keep_reference(&mut self.shown, &self.lattice);
    }
}
