//! Which cells of the reference plane the views cover with light, and for how long they have done so.

use super::rim::Rim;
use crate::Rect;
use crate::geometry::{Homography, Point};
use crate::stitch::canvas::Bounds;
use crate::stitch::mesh::Mesh;

/// Cells around the views that the grid has in reserve, so that it seldom moves.
const SPARE_CELLS: i32 = 8;

/// A view as it lies on the reference plane.
#[derive(Debug)]
pub(super) struct PlacedView<'a> {
    /// Columns and rows, px.
    pub size: (usize, usize),
    /// From the reference plane to the view; weights are positive where the view lies.
    pub view_from_plane: Homography,
    /// Drawn by a mesh instead.
    pub mesh: Option<&'a Mesh>,
    /// Its dark rim.
    pub rim: &'a Rim,
    /// The reference view stays where it is beside its mesh.
    pub is_reference: bool,
}

impl PlacedView<'_> {
    /// Whether the view shows a point of the reference plane.
    fn covers(&self, at: Point) -> bool {
        let mapped = match self.mesh {
            Some(mesh) => mesh.map(at),
            // What lies behind the horizon is not seen.
            None => (self.view_from_plane.weight(at) > 0.0).then(|| self.view_from_plane.map(at)),
        };
        let Some([x, y]) = mapped.or(self.is_reference.then_some(at)) else { return false };
        // Corners of cells are those of pixels, half a pixel from the centres that a view ends at; rounding needs a little more.
        let room = 0.501;
        let (right, bottom) = ((self.size.0 - 1) as f64, (self.size.1 - 1) as f64);
        // NaN is not inside.
        let is_inside = x >= -room && y >= -room && x <= right + room && y <= bottom + room;
        is_inside && self.rim.is_lit(x.clamp(0.0, right) as usize, y.clamp(0.0, bottom) as usize)
    }
}

/// Cells of `cell_px` at the multiples of that length on the reference plane.
#[derive(Debug, Default)]
pub(super) struct Coverage {
    cell_px: usize,
    /// Column and row of the first cell, in cells from the origin of the plane.
    first: [i32; 2],
    columns: usize,
    rows: usize,
    /// Looks in a row that found a cell covered.
    looks: Vec<u8>,
    old: Vec<u8>,
    /// Whether the corners above and below a row of cells are covered.
    corners: [Vec<bool>; 2],
}

impl Coverage {
    /// Forgets all cells.
    pub fn forget(&mut self) {
        (self.columns, self.rows) = (0, 0);
    }

    /// Side of a cell, px.
    pub fn cell_px(&self) -> usize {
        self.cell_px
    }

    /// Columns and rows.
    pub fn size(&self) -> (usize, usize) {
        (self.columns, self.rows)
    }

    /// Looks in a row that found a cell covered, at most 255; those of the first look count as long known.
    pub fn looks(&self, cell: usize) -> u8 {
        self.looks[cell]
    }

    /// Brings the cells up to a frame whose views lie within `bounds`. A cell counts as covered when its four corners are.
    pub fn look(&mut self, views: &[Option<PlacedView<'_>>], bounds: Bounds, cell_px: usize) {
        let is_first = self.columns == 0 || self.cell_px != cell_px;
        self.cell_px = cell_px;
        self.fit(bounds, is_first);
        let (columns, first, side) = (self.columns, self.first, cell_px as f64);
        let fill = |corners: &mut Vec<bool>, row: usize| {
            let y = (f64::from(first[1]) + row as f64) * side - 0.5;
            corners.clear();
            corners.extend((0..=columns).map(|column| {
                let at = [(f64::from(first[0]) + column as f64) * side - 0.5, y];
                views.iter().flatten().any(|view| view.covers(at))
            }));
        };
        fill(&mut self.corners[0], 0);
        for (row, cells) in self.looks.chunks_exact_mut(columns).enumerate() {
            let [above, below] = &mut self.corners;
            fill(below, row + 1);
            for (column, looks) in cells.iter_mut().enumerate() {
                let is_covered = above[column] && above[column + 1] && below[column] && below[column + 1];
                *looks = match is_covered {
                    false => 0,
                    true if is_first => u8::MAX,
                    true => looks.saturating_add(1),
                };
            }
            self.corners.swap(0, 1);
        }
    }

    /// Moves the grid when the views lie outside it; cells that both grids have keep what is known of them.
    fn fit(&mut self, bounds: Bounds, is_first: bool) {
        let cell = |at: f64| (at / self.cell_px as f64).floor() as i32;
        let (low, high) = ([cell(bounds.x0), cell(bounds.y0)], [cell(bounds.x1) + 1, cell(bounds.y1) + 1]);
        let end = [self.first[0] + self.columns as i32, self.first[1] + self.rows as i32];
        if !is_first && (0..2).all(|k| low[k] >= self.first[k] && high[k] <= end[k]) {
            return;
        }
        let (first, columns, rows) = (self.first, self.columns, self.rows);
        self.first = low.map(|at| at - SPARE_CELLS);
        [self.columns, self.rows] = [0, 1].map(|k| (high[k] + SPARE_CELLS - self.first[k]).max(1) as usize);
        std::mem::swap(&mut self.looks, &mut self.old);
        self.looks.clear();
        self.looks.resize(self.columns * self.rows, 0);
        if is_first {
            return;
        }
        for (cell, looks) in self.looks.iter_mut().enumerate() {
            let (x, y) = ((cell % self.columns) as i32, (cell / self.columns) as i32);
            let (x, y) = (x + self.first[0] - first[0], y + self.first[1] - first[1]);
            if (0..columns as i32).contains(&x) && (0..rows as i32).contains(&y) {
                *looks = self.old[y as usize * columns + x as usize];
            }
        }
    }

    /// Numbers of the cells of a rectangle that lie in the grid.
    pub fn cells(&self, rect: CellRect) -> impl Iterator<Item = usize> {
        let (columns, rows, first) = (self.columns as i32, self.rows as i32, self.first);
        let along = |from: i32, to: i32, k: usize, count: i32| {
            (from - first[k]).clamp(0, count)..(to - first[k]).clamp(0, count)
        };
        let across = along(rect.x0, rect.x1, 0, columns);
        along(rect.y0, rect.y1, 1, rows)
            .flat_map(move |row| across.clone().map(move |column| (row * columns + column) as usize))
    }

    /// A rectangle of the grid on the plane.
    pub fn on_plane(&self, rect: Rect) -> CellRect {
        let (x0, y0) = (self.first[0] + rect.x as i32, self.first[1] + rect.y as i32);
        CellRect { x0, y0, x1: x0 + rect.width as i32, y1: y0 + rect.height as i32 }
    }
}

/// A rectangle of cells on the reference plane; the ends are excluded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct CellRect {
    pub x0: i32,
    pub y0: i32,
    pub x1: i32,
    pub y1: i32,
}

impl CellRect {
    /// Number of cells.
    pub fn area(&self) -> usize {
        ((self.x1 - self.x0).max(0) * (self.y1 - self.y0).max(0)) as usize
    }

    /// Largest distance between a side and that of another, cells.
    pub fn distance(&self, other: &Self) -> i32 {
        let sides = [self.x0 - other.x0, self.y0 - other.y0, self.x1 - other.x1, self.y1 - other.y1];
        sides.map(i32::abs).into_iter().fold(0, i32::max)
    }
}
