//! Sampling positions of output pixels, by a homography or by a mesh.

use super::super::warp::{self, BLOCK, Block, GROUP, Source, Span};
use super::Mesh;

/// A mesh seen from an output picture: pixel `(x, y)` of it lies at `origin + step * (x, y)` on the reference plane.
#[derive(Clone, Copy, Debug)]
pub struct MeshGrid<'a> {
    /// The mesh.
    pub mesh: &'a Mesh,
    /// Position of pixel `(0, 0)` on the reference plane, px.
    pub origin: [f32; 2],
    /// Distance of neighbouring pixels there, px.
    pub step: f32,
}

/// Where output pixels read a view.
#[derive(Clone, Copy, Debug)]
pub enum Mapping<'a> {
    /// By a matrix from output pixels to the view's; its third row is positive where the view lies.
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

    fn locate(&self, at: (usize, usize), view: (usize, usize, usize), count: usize, block: &mut Block, avx2: bool) {
        #[cfg(target_arch = "x86_64")]
        {
            #[target_feature(enable = "avx2")]
            fn with_avx2(
                grid: &MeshGrid<'_>,
                at: (usize, usize),
                view: (usize, usize, usize),
                count: usize,
                block: &mut Block,
            ) {
                grid.locate_body(at, view, count, block, |block, i, first, slope, source| {
                    warp::put_group_avx2(block, i, first, slope, source);
                });
            }
            if avx2 {
                // SAFETY: the caller found AVX2 on this CPU.
                unsafe { with_avx2(self, at, view, count, block) };
                return;
            }
        }
        let _ = avx2;
        self.locate_body(at, view, count, block, warp::put_group);
    }

    #[inline(always)]
    fn locate_body(
        &self,
        (x, y): (usize, usize),
        (width, height, stride): (usize, usize, usize),
        count: usize,
        block: &mut Block,
        put: impl Fn(&mut Block, usize, [f32; 2], [f32; 2], &Source),
    ) {
        let mesh = self.mesh;
        let count = count.min(BLOCK).div_ceil(GROUP) * GROUP;
        let source = Source::new(width, height, stride);
        block.is_line = false;
        let along = self.row(y);
        let per_pixel = self.step / mesh.lattice.cell_px as f32;
        let pixels = mesh.lattice.cell_px as f32 / self.step;
        let start =
            (self.origin[0] + self.step * x as f32) / mesh.lattice.cell_px as f32 - mesh.lattice.first[0] as f32;
        let mut column = (start.max(0.0) as usize).min(mesh.lattice.columns - 2);
        let (mut i, mut a) = (0, self.node(column, along));
        while i < count {
            let g = start + per_pixel * i as f32;
            let b = self.node(column + 1, along);
            let is_last = column + 2 == mesh.lattice.columns;
            let left = ((column + 1) as f32 - g) * pixels;
            let end = if is_last { count } else { count.min(i + round_up(left.max(0.0)).max(1)) };
            let slope = [0, 1].map(|k| (b[k] - a[k]) * per_pixel);
            let mut first = [0, 1].map(|k| a[k] + (b[k] - a[k]) * (g - column as f32));
            // Whole groups: what lies beyond the cell is located again for the next one.
            while i < end {
                put(block, i, first, slope, &source);
                first = [0, 1].map(|k| first[k] + slope[k] * GROUP as f32);
                i += GROUP;
            }
            (i, a) = (end, b);
            if !is_last {
                column += 1;
            }
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

/// The smallest whole number that is not below a positive one: without a call where the target has no such instruction.
fn round_up(value: f32) -> usize {
    let whole = value as usize;
    whole + usize::from((whole as f32) < value)
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
