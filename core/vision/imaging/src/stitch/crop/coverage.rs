//! Cells of the reference plane that are covered by lit parts of views, and for how long.

use crate::Rect;
use crate::stitch::canvas::Bounds;
use crate::stitch::params::{Canvas, MAX_VIEWS};
use crate::stitch::warp::Span;

/// Spare cells around the views, so that the grid rarely moves.
const SPARE_CELLS: i32 = 8;

/// Cells of `cell_px` at the multiples of that length on the reference plane.
#[derive(Debug, Default)]
pub(super) struct Coverage {
    cell_px: usize,
    /// Column and row of the first cell, in cells from the origin of the plane.
    first: [i32; 2],
    columns: usize,
    rows: usize,
    /// Number of consecutive updates in which a cell was covered.
    looks: Vec<u8>,
    old: Vec<u8>,
    /// Rows of pixels in which the cells of a row are covered.
    full_rows: Vec<usize>,
    /// Whether the next update is the first.
    is_new: bool,
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

    /// Number of consecutive updates in which a cell was covered, at most 255; cells of the first update count as long
    /// covered.
    pub fn looks(&self, cell: usize) -> u8 {
        self.looks[cell]
    }

    /// Fits the grid to views within `bounds`, and returns its canvas.
    pub fn canvas(&mut self, bounds: Bounds, cell_px: usize) -> Canvas {
        self.is_new |= self.columns == 0 || self.cell_px != cell_px;
        self.cell_px = cell_px;
        self.fit(bounds, self.is_new);
        let [left, top] = self.first.map(|first| -first * cell_px as i32);
        Canvas { width: self.columns * cell_px, height: self.rows * cell_px, left, top }
    }

    /// Updates the cells with a frame whose views cover `spans[view][row]` of the grid's canvas.
    pub fn look(&mut self, spans: &[Vec<Span>]) {
        let (columns, cell_px, is_first) = (self.columns, self.cell_px, std::mem::take(&mut self.is_new));
        for (row, cells) in self.looks.chunks_exact_mut(columns).enumerate() {
            self.full_rows.clear();
            self.full_rows.resize(columns, 0);
            for y in row * cell_px..(row + 1) * cell_px {
                each_run(spans, y, |start, end| {
                    let (first, last) = (start.div_ceil(cell_px), (end / cell_px).min(columns));
                    if first < last {
                        self.full_rows[first..last].iter_mut().for_each(|rows| *rows += 1);
                    }
                });
            }
            for (looks, full_rows) in cells.iter_mut().zip(&self.full_rows) {
                *looks = match *full_rows == cell_px {
                    false => 0,
                    true if is_first => u8::MAX,
                    true => looks.saturating_add(1),
                };
            }
        }
    }

    /// Moves the grid when the views lie outside it; cells in both grids keep their state.
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

/// Calls `run` with the first column and one past the last of what the views cover together in a row, from left to
/// right.
fn each_run(spans: &[Vec<Span>], y: usize, mut run: impl FnMut(usize, usize)) {
    let mut row = [Span::default(); MAX_VIEWS];
    let mut count = 0;
    for span in spans.iter().filter_map(|view| view.get(y)).filter(|span| !span.is_empty()).take(MAX_VIEWS) {
        row[count] = *span;
        count += 1;
    }
    row[..count].sort_unstable_by_key(|span| span.start);
    let mut joined: Option<Span> = None;
    for span in &row[..count] {
        match &mut joined {
            Some(so_far) if span.start <= so_far.end => so_far.end = so_far.end.max(span.end),
            _ => {
                if let Some(before) = joined.replace(*span) {
                    run(before.start as usize, before.end as usize);
                }
            }
        }
    }
    if let Some(last) = joined {
        run(last.start as usize, last.end as usize);
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

    /// Maximum distance between corresponding sides of two rectangles, cells.
    pub fn distance(&self, other: &Self) -> i32 {
        let sides = [self.x0 - other.x0, self.y0 - other.y0, self.x1 - other.x1, self.y1 - other.y1];
        sides.map(i32::abs).into_iter().fold(0, i32::max)
    }
}
