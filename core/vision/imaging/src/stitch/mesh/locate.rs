//! Sampling positions of output pixels, by a homography or by a mesh.

use super::super::warp::{self, BLOCK, Block, GROUP, Line, NODES, Source, Span};
use super::Mesh;
use crate::Rect;

/// A mesh relative to an output image, whose pixel `(x, y)` is at `origin + step * (x, y)` on the reference plane.
#[derive(Clone, Copy, Debug)]
pub struct MeshGrid<'a> {
    /// The mesh whose triangles are searched.
    pub mesh: &'a Mesh,
    /// Position of pixel `(0, 0)` on the reference plane, px.
    pub origin: [f32; 2],
    /// Distance of neighbouring pixels there, px.
    pub step: f32,
}

/// Mapping from output pixels to a view.
#[derive(Clone, Copy, Debug)]
pub enum Mapping<'a> {
    /// By a matrix from output pixels to the view's; its third row is positive inside the view.
    Plane(&'a [f64; 9]),
    /// By a mesh.
    Mesh(MeshGrid<'a>),
}

impl Mapping<'_> {
    /// As [`warp::locate`].
    pub fn locate(
        &self,
        (x, y): (usize, usize),
        (width, height, stride): (usize, usize, usize),
        count: usize,
        block: &mut Block,
        avx2: bool,
    ) {
        match self {
            Self::Plane(matrix) => warp::locate(matrix, x, y, width, height, stride, count, block, avx2),
            Self::Mesh(grid) => grid.locate((x, y), (width, height, stride), count, block, avx2),
        }
    }

    /// As [`warp::coverage`].
    pub fn coverage(&self, view: (usize, usize), columns: usize, rows: usize, spans: &mut Vec<Span>) {
        match self {
            Self::Plane(matrix) => warp::coverage(matrix, view, columns, rows, spans),
            Self::Mesh(grid) => grid.coverage(view, columns, rows, spans),
        }
    }
}

impl MeshGrid<'_> {
    /// Row of cells that the output row lies in, and how far down, 0..=1.
    fn row(&self, y: usize) -> (usize, f32) {
        let mesh = self.mesh;
        let g = (self.origin[1] + self.step * y as f32) / mesh.lattice.cell_px as f32 - mesh.lattice.first[1] as f32;
        let row = (g.max(0.0) as usize).min(mesh.lattice.rows - 2);
        (row, (g - row as f32).clamp(0.0, 1.0))
    }

    /// Source position where the output row crosses the mesh's column of vertices.
    fn node(&self, column: usize, (row, t): (usize, f32)) -> [f32; 2] {
        let at = row * self.mesh.lattice.columns + column;
        let (above, below) = (self.mesh.source[at], self.mesh.source[at + self.mesh.lattice.columns]);
        [above[0] + t * (below[0] - above[0]), above[1] + t * (below[1] - above[1])]
    }

    fn locate(
        &self,
        (x, y): (usize, usize),
        (width, height, stride): (usize, usize, usize),
        count: usize,
        block: &mut Block,
        avx2: bool,
    ) {
        let lattice = &self.mesh.lattice;
        let count = count.min(BLOCK).div_ceil(GROUP) * GROUP;
        let source = Source::new(width, height, stride);
        block.clear();
        let along = self.row(y);
        let step = self.step / lattice.cell_px as f32;
        let start = (self.origin[0] + self.step * x as f32) / lattice.cell_px as f32 - lattice.first[0] as f32;
        let mut i = 0;
        while i < count {
            let at = start + step * i as f32;
            let first = (at.max(0.0) as usize).min(lattice.columns - 2);
            // The vertices around the rest of the block.
            let wanted = (step * (count - i) as f32).ceil() as usize + 2;
            let held = wanted.min(NODES).min(lattice.columns - first);
            let mut nodes = [[0.0; NODES]; 2];
            for n in 0..held {
                [nodes[0][n], nodes[1][n]] = self.node(first + n, along);
            }
            // Whole groups as far as these vertices reach; one at least, for cells smaller than a few pixels.
            let is_last = first + held == lattice.columns;
            let reach = ((first + held - 1) as f32 - at) / step;
            let groups = if is_last { count } else { (reach as usize / GROUP).max(1) * GROUP };
            let end = count.min(i + groups);
            let line = Line { nodes, last: held - 2, start: start - first as f32, step };
            warp::locate_line(&line, (i, end), &source, block, avx2);
            i = end;
        }
    }

    /// Columns of each output row, inside the bounds `moved`, of cells with a displaced vertex.
    pub fn moved_spans(&self, (columns, rows): (usize, usize), moved: Rect, spans: &mut Vec<Span>) {
        let lattice = &self.mesh.lattice;
        let cell = lattice.cell_px as f32;
        spans.clear();
        spans.resize(rows, Span::default());
        // The first and the last moved vertex of the rows of vertices above and below the output row.
        let (mut known, mut ends) = (usize::MAX, None);
        for (y, span) in spans.iter_mut().enumerate().skip(moved.y).take(moved.height) {
            let (row, _) = self.row(y);
            if row != known {
                let is_moved = |column: &usize| [row, row + 1].iter().any(|row| self.mesh.is_moved(*column, *row));
                let first = (0..lattice.columns).find(is_moved);
                ends = first.zip((0..lattice.columns).rev().find(is_moved));
                known = row;
            }
            let Some((first, last)) = ends else { continue };
            let at = |column: f32| {
                let x = ((column + lattice.first[0] as f32) * cell - self.origin[0]) / self.step;
                x.clamp(0.0, columns as f32)
            };
            let (start, end) = (at(first as f32 - 1.0).floor() as u32, at(last as f32 + 1.0).ceil() as u32);
            // Beyond the lattice its outermost cells go on.
            *span = Span {
                start: if first <= 1 { moved.x as u32 } else { start },
                end: if last + 2 >= lattice.columns { (moved.x + moved.width) as u32 } else { end },
            };
        }
    }

    fn coverage(&self, view: (usize, usize), columns: usize, rows: usize, spans: &mut Vec<Span>) {
        let mesh = self.mesh;
        let (width, height) = ((view.0 - 1) as f32, (view.1 - 1) as f32);
        let per_cell = mesh.lattice.cell_px as f32 / self.step;
        let first = (mesh.lattice.first[0] as f32 * mesh.lattice.cell_px as f32 - self.origin[0]) / self.step;
        let top = (mesh.lattice.first[1] as f32 * mesh.lattice.cell_px as f32 - self.origin[1]) / self.step;
        let bottom = top + (mesh.lattice.rows - 1) as f32 * per_cell;
        spans.clear();
        for y in 0..rows {
            let (mut low, mut high) = (f32::MAX, f32::MIN);
            if (y as f32) >= top && y as f32 <= bottom {
                let along = self.row(y);
                // The first cell from either side that the view covers has the end of the span.
                let mut covered = |column: usize| {
                    let limit = [width, height];
                    let (from, to) = inside(self.node(column, along), self.node(column + 1, along), limit)?;
                    let at = |t: f32| first + (column as f32 + t) * per_cell;
                    (low, high) = (low.min(at(from)), high.max(at(to)));
                    Some(())
                };
                let mut cells = 0..mesh.lattice.columns - 1;
                if cells.find_map(&mut covered).is_some() {
                    let _ = cells.rev().find_map(covered);
                }
            }
            let (start, end) = ((low - 1e-3).ceil().max(0.0), ((high + 1e-3).floor() + 1.0).min(columns as f32));
            spans.push(if start < end { Span { start: start as u32, end: end as u32 } } else { Span::default() });
        }
    }
}

/// The part of a line from `a` to `b`, as shares of its length, whose points have coordinates within `0..=limit`.
pub(super) fn inside(a: [f32; 2], b: [f32; 2], limit: [f32; 2]) -> Option<(f32, f32)> {
    let (mut from, mut to) = (0.0f32, 1.0f32);
    for k in 0..2 {
        let slope = b[k] - a[k];
        for (rest, slope) in [(a[k], slope), (limit[k] - a[k], -slope)] {
            // The coordinate's distance from the limit, `rest + slope * t`, must not be negative.
            if slope > 0.0 {
                from = from.max(-rest / slope);
            } else if slope < 0.0 {
                to = to.min(-rest / slope);
            } else if rest < 0.0 {
                return None;
            }
        }
    }
    (from <= to).then_some((from, to))
}

#[cfg(test)]
mod tests {
    use super::super::Lattice;
    use super::*;
    use panoscope_base::random::lattice as random;

    #[test]
    fn pixels_lie_between_their_vertices_on_both_paths() {
        // The last view is too wide for 16-bit products.
        let cases = [
            (20, 13, 1.0f32, 400),
            (9, 30, 1.0, 400),
            (40, 7, 0.9, 400),
            (8, 40, 2.5, 400),
            (20, 2, 1.0, 400),
            (120, 4, 1.0, 400),
            (120, 4, 1.0, 11_000),
        ];
        for (cell_px, columns, step, width) in cases {
            let lattice = Lattice { cell_px, first: [-1, -1], columns, rows: 5 };
            let source = (0..5 * columns).map(|n| {
                let [x, y] = lattice.position(n % columns, n / columns);
                [
                    x as f32 + 40.0 + 6.0 * random(n as i64, 0, 1) as f32,
                    y as f32 + 30.0 + 5.0 * random(n as i64, 1, 1) as f32,
                ]
            });
            let mesh = Mesh { lattice, source: source.collect(), ..Mesh::default() };
            let grid = MeshGrid { mesh: &mesh, origin: [-12.3, -4.6], step };
            for (x, y, count) in [(0, 0, 64), (64, 7, 61), (5, 20, 9)] {
                let blocks = [false, std::arch::is_x86_feature_detected!("avx2")].map(|avx2| {
                    let mut block = Block::default();
                    grid.locate((x, y), (width, 300, 3 * width), count, &mut block, avx2);
                    block
                });
                for i in 0..count {
                    assert_eq!(blocks[0].offset[i], blocks[1].offset[i], "{cell_px} {x} {i}");
                    assert_eq!(blocks[0].weights[i], blocks[1].weights[i], "{cell_px} {x} {i}");
                    let along = (f64::from(grid.origin[0]) + f64::from(step) * (x + i) as f64) / cell_px as f64 + 1.0;
                    let cell = (along.max(0.0) as usize).min(columns - 2);
                    let t = (along - cell as f64) as f32;
                    let [a, b] = [cell, cell + 1].map(|column| grid.node(column, grid.row(y)));
                    let expected = (a[0] + (b[0] - a[0]) * t).clamp(0.0, width as f32 - 1.0);
                    let found = (blocks[0].offset[i] % (3 * width as u32) / 3) as f32
                        + (blocks[0].weights[i] >> 8 & 255) as f32 / 64.0;
                    assert!((found - expected).abs() < 0.012, "{cell_px} px, pixel {i}: {found} for {expected}");
                }
            }
        }
    }
}
