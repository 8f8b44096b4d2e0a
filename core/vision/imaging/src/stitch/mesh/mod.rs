//! Warps that follow the disparity: a mesh over the reference plane maps each of its points to the other view.
//!
//! One homography cannot join two views with parallax. [`MeshFollower`] measures where the points that both views see
//! lie in the other view, fits a smooth mesh to them, and extrapolates it where only one view is visible so that
//! lengths are preserved. A [`Compositor`](super::Compositor) draws a view by a [`Mesh`] instead of its homography.
//!
//! F. Liu et al., "Content-preserving warps for 3D video stabilization", ACM TOG 28 (2009), use the same idea for one
//! moving camera.

mod band;
mod border;
mod choice;
mod doubt;
mod energy;
mod fitted;
mod follow;
mod hints;
#[cfg(test)]
mod instrument_tests;
mod instruments;
mod kept;
mod locate;
mod observe;
mod relax;
mod rigid;
mod scaled;
#[cfg(test)]
mod tests;
mod track;

pub use follow::{MeshFollower, MeshParams, MeshReport};
pub use hints::InstrumentHints;
pub use kept::{Keep, Kept};
pub(super) use locate::{Mapping, MeshGrid};

use crate::geometry::Point;
use doubt::Doubt;
use kept::KeptCells;

/// Displacement below which a vertex counts as not displaced, px.
const MIN_MOVE_PX: f64 = 1e-3;

/// Vertices at the multiples of `cell_px`, in a rectangle of the reference plane.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Lattice {
    /// Side of a cell, px of the reference plane.
    pub cell_px: usize,
    /// Column and row of the first vertex, in cells from the origin of the reference plane.
    pub first: [i32; 2],
    /// Vertices per row.
    pub columns: usize,
    /// Rows of vertices.
    pub rows: usize,
}

impl Lattice {
    /// Number of vertices.
    pub fn len(&self) -> usize {
        self.columns * self.rows
    }

    /// Whether there are no vertices.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Position of a vertex, px of the reference plane.
    pub fn position(&self, column: usize, row: usize) -> Point {
        let at = |first: i32, index: usize| (f64::from(first) + index as f64) * self.cell_px as f64;
        [at(self.first[0], column), at(self.first[1], row)]
    }

    /// Column and row of the cell that a point lies in, and its position there, 0..=1 each way; `None` outside.
    fn cell_of(&self, at: Point) -> Option<((usize, usize), [f64; 2])> {
        let along = |k: usize, count: usize| {
            let g = at[k] / self.cell_px as f64 - f64::from(self.first[k]);
            // NaN is not inside.
            let is_inside = g >= 0.0 && g <= count as f64 - 1.0 && count > 1;
            is_inside.then(|| {
                let cell = (g as usize).min(count - 2);
                (cell, g - cell as f64)
            })
        };
        let ((column, s), (row, t)) = (along(0, self.columns)?, along(1, self.rows)?);
        Some(((column, row), [s, t]))
    }

    /// Bilinear value inside a cell, of a value per vertex.
    fn interpolate(&self, values: impl Fn(usize) -> Point, (column, row): (usize, usize), [s, t]: [f64; 2]) -> Point {
        let vertex = row * self.columns + column;
        let [a, b, c, d] = [vertex, vertex + 1, vertex + self.columns, vertex + self.columns + 1].map(values);
        std::array::from_fn(|k| {
            let (above, below) = (a[k] + s * (b[k] - a[k]), c[k] + s * (d[k] - c[k]));
            above + t * (below - above)
        })
    }
}

/// A map from the reference plane to another view, bilinear in square cells.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    lattice: Lattice,
    /// Position of each vertex in the other view, px, row after row.
    source: Vec<[f32; 2]>,
    /// Distance of the mesh from the measurements.
    doubt: Doubt,
    /// Positions of instruments that one view must show.
    kept: KeptCells,
}

impl Mesh {
    /// A mesh from the positions of its vertices in the other view, row after row.
    ///
    /// `None` for fewer than 2 x 2 vertices, an empty cell, another number of positions, or one that is not finite.
    pub fn of_vertices(lattice: Lattice, source: Vec<[f32; 2]>) -> Option<Self> {
        let fits = lattice.cell_px > 0 && lattice.columns > 1 && lattice.rows > 1 && lattice.len() == source.len();
        let finite = source.iter().flatten().all(|v| v.is_finite());
        (fits && finite).then(|| Self { lattice, source, ..Self::default() })
    }

    /// A mesh from its vertices: `source(x, y)` is the position in the other view of the point `(x, y)` of the
    /// reference plane.
    ///
    /// `None` for fewer than 2 x 2 vertices, an empty cell, or a position that is not finite.
    pub fn new(lattice: Lattice, source: impl Fn(Point) -> Point) -> Option<Self> {
        let vertices = (0..lattice.len()).map(|i| lattice.position(i % lattice.columns, i / lattice.columns));
        Self::of_vertices(lattice, vertices.map(|at| source(at).map(|v| v as f32)).collect())
    }

    /// The vertices' positions on the reference plane.
    pub fn lattice(&self) -> &Lattice {
        &self.lattice
    }

    /// The vertices' positions in the other view, px, row after row.
    pub fn source(&self) -> &[[f32; 2]] {
        &self.source
    }

    /// Position in the other view of a point of the reference plane; `None` outside the mesh.
    pub fn map(&self, at: Point) -> Option<Point> {
        let (cell, t) = self.lattice.cell_of(at)?;
        Some(self.lattice.interpolate(|vertex| self.source[vertex].map(f64::from), cell, t))
    }

    /// Distance of the mesh from the measurements at a point of the reference plane, px; 0 outside the reference view.
    pub fn doubt_px(&self, at: [f32; 2]) -> f32 {
        self.doubt.at(at)
    }

    /// The view that must show a point of the reference plane, so that an instrument is shown completely.
    pub fn kept_at(&self, at: [f32; 2]) -> Keep {
        self.kept.at(at)
    }

    /// Whether a view is prescribed anywhere.
    pub fn keeps_any(&self) -> bool {
        !self.kept.is_empty()
    }

    /// The mesh, unless it is empty.
    pub(super) fn given(&self) -> Option<&Self> {
        (!self.source.is_empty()).then_some(self)
    }

    /// Copies another mesh into the existing memory. Returns whether a position changed.
    pub(super) fn copy_from(&mut self, other: &Self) -> bool {
        self.doubt.copy_from(&other.doubt);
        self.kept.copy_from(&other.kept);
        if self.lattice == other.lattice && self.source == other.source {
            return false;
        }
        self.lattice = other.lattice;
        self.source.clone_from(&other.source);
        true
    }

    /// Whether a vertex is displaced in the view.
    fn is_moved(&self, column: usize, row: usize) -> bool {
        let (at, source) = (self.lattice.position(column, row), self.source[row * self.lattice.columns + column]);
        (0..2).any(|k| (f64::from(source[k]) - at[k]).abs() >= MIN_MOVE_PX)
    }

    /// Bounds on the reference plane of the cells with displaced vertices; `None` if there are none.
    pub(super) fn moved(&self) -> Option<[Point; 2]> {
        let cell = self.lattice.cell_px as f64;
        let mut bounds: Option<[Point; 2]> = None;
        for (column, row) in (0..self.lattice.len()).map(|i| (i % self.lattice.columns, i / self.lattice.columns)) {
            if !self.is_moved(column, row) {
                continue;
            }
            let at = self.lattice.position(column, row);
            let [low, high] = bounds.unwrap_or([at; 2]);
            bounds = Some([[0, 1].map(|k| low[k].min(at[k] - cell)), [0, 1].map(|k| high[k].max(at[k] + cell))]);
        }
        bounds
    }

    /// Removes all vertices. Returns whether there were any.
    pub(super) fn clear(&mut self) -> bool {
        let was_given = !self.source.is_empty();
        self.source.clear();
        self.kept.clear();
        was_given
    }

    /// Bounds on the reference plane of the area that a view of this size covers, aligned to cells.
    pub(super) fn footprint(&self, (width, height): (usize, usize)) -> Option<[Point; 2]> {
        let Lattice { columns, rows, .. } = self.lattice;
        let limit = [width as f32 - 1.0, height as f32 - 1.0];
        let mut bounds: Option<[Point; 2]> = None;
        for (column, row) in (0..rows).flat_map(|row| (0..columns).map(move |column| (column, row))) {
            let here = self.source[row * columns + column];
            for (dx, dy) in [(1, 0), (0, 1)] {
                if column + dx >= columns || row + dy >= rows {
                    continue;
                }
                let next = self.source[(row + dy) * columns + column + dx];
                let Some((from, to)) = locate::inside(here, next, limit) else { continue };
                let ([x0, y0], [x1, y1]) =
                    (self.lattice.position(column, row), self.lattice.position(column + dx, row + dy));
                for t in [f64::from(from), f64::from(to)] {
                    let (x, y) = (x0 + t * (x1 - x0), y0 + t * (y1 - y0));
                    let [a, b] = bounds.unwrap_or([[x, y]; 2]);
                    bounds = Some([[a[0].min(x), a[1].min(y)], [b[0].max(x), b[1].max(y)]]);
                }
            }
        }
        bounds
    }
}
