//! Meshes of images that are larger than their disparity map: computed at the size of the map, and enlarged.

use super::super::coarse::{map_factor, shrunk};
use super::super::rectified_view::RectifiedView;
use super::{Lattice, Mesh, MeshFollower, MeshReport};
use crate::geometry::{Homography, Point};
use crate::shrink::{enlarged_px, shrunk_px};
use crate::{Parallel, View};

/// Meshes between large images, made from those of the follower.
#[derive(Clone, Debug, Default)]
pub(super) struct Scaled {
    /// By how much the last map was smaller than the images; 0 before the first.
    factor: usize,
    /// Enlarged, unless the factor is 1: the mesh, and that of the reference view.
    meshes: [Mesh; 2],
}

impl Scaled {
    /// By how much the map is smaller than the images.
    pub fn factor(&self) -> usize {
        self.factor.max(1)
    }

    /// Forgets the meshes.
    pub fn clear(&mut self) {
        self.meshes.iter_mut().for_each(|mesh| mesh.source.clear());
    }
}

impl MeshFollower {
    /// The mesh of the last frame; `None` before the first good one.
    pub fn mesh(&self) -> Option<&Mesh> {
        self.published(0)
    }

    /// The mesh that warps the reference view to match the other one where that leaves the reference view's plane;
    /// `None` if the reference view is unchanged.
    pub fn reference_mesh(&self) -> Option<&Mesh> {
        self.published(1)
    }

    fn published(&self, which: usize) -> Option<&Mesh> {
        let mesh = if self.scaled.factor() > 1 { &self.scaled.meshes[which] } else { self.of_map()[which] };
        mesh.given()
    }

    /// Columns and rows, ascending, that [`Self::update`] reads of a map of `size`.
    pub fn pixels(&self, size: (usize, usize), left: &RectifiedView, right: &RectifiedView) -> [Vec<u32>; 2] {
        let factor = map_factor(size, left.size).unwrap_or(1);
        self.pixels_of_map(size, if factor == 1 { right.size } else { right.shrunk(factor).size })
    }

    /// Updates the mesh with a frame that has a good homography; without one the last mesh is kept.
    ///
    /// `disparity`: px of the left rectified view, NaN where unmatched. It has the size of the images, or is smaller
    /// by a whole factor, see [`map_factor`]. The mesh maps the left image to the right one, and its doubt is in
    /// pixels of the map.
    pub fn update(
        &mut self,
        disparity: View<'_, f32>,
        left: &RectifiedView,
        right: &RectifiedView,
        left_from_right: &Homography,
        pool: &dyn Parallel,
    ) -> MeshReport {
        let factor = map_factor((disparity.width, disparity.height), left.size).unwrap_or(1);
        if factor != self.scaled.factor {
            self.reset();
            self.scaled.factor = factor;
        }
        if factor == 1 {
            return self.update_map(disparity, left, right, left_from_right, pool);
        }
        let [left, right] = [left, right].map(|view| view.shrunk(factor));
        let found = self.update_map(disparity, &left, &right, &shrunk(left_from_right, factor), pool);
        let mut meshes = std::mem::take(&mut self.scaled.meshes);
        for (large, small) in meshes.iter_mut().zip(self.of_map()) {
            large.enlarge(small, factor);
        }
        self.scaled.meshes = meshes;
        let px = factor as f64;
        MeshReport { residual_px: found.residual_px * px, motion_px: found.motion_px * px, ..found }
    }
}

impl Mesh {
    /// Becomes the mesh between images that are larger than those of `small` by a factor. The doubt stays in pixels of
    /// the small ones.
    fn enlarge(&mut self, small: &Self, factor: usize) {
        let Lattice { cell_px, first, columns, rows } = small.lattice;
        self.lattice = Lattice { cell_px: cell_px * factor, first, columns, rows };
        self.source.clear();
        self.kept.clear();
        if small.source.is_empty() {
            return;
        }
        // Both lattices begin at the origin, which is the middle of the first pixel: a vertex lies a part of a small pixel before the small one.
        let back = -shrunk_px(0.0, factor) / cell_px as f64;
        let before = |index: usize| if index > 0 { (index - 1, 1.0 - back) } else { (0, -back) };
        for row in 0..rows {
            for column in 0..columns {
                let ((x, s), (y, t)) = (before(column), before(row));
                let at: Point = small.lattice.interpolate(|vertex| small.source[vertex].map(f64::from), (x, y), [s, t]);
                self.source.push(at.map(|at| enlarged_px(at, factor) as f32));
            }
        }
        self.doubt.enlarge(&small.doubt, factor);
        self.kept.enlarge(&small.kept, factor);
    }
}
