//! Sampling positions of output pixels, by a homography or by a mesh.

use super::super::warp::{self, BLOCK, Block, Span};
use super::Mesh;

/// 0, 1, 2 and so on: a table, because whole numbers of 64 bits are converted one by one.
const STEPS: [f32; BLOCK] = {
    let mut steps = [0.0; BLOCK];
    let mut n = 0;
    while n < BLOCK {
        steps[n] = n as f32;
        n += 1;
    }
    steps
};

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

    fn locate(
        &self,
        (x, y): (usize, usize),
        (width, height, stride): (usize, usize, usize),
        count: usize,
        block: &mut Block,
        avx2: bool,
    ) {
        let mesh = self.mesh;
        let count = count.min(BLOCK).div_ceil(8) * 8;
        let mut positions = [[0.0f32; BLOCK]; 2];
        let along = self.row(y);
        let per_pixel = self.step / mesh.lattice.cell_px as f32;
        let start =
            (self.origin[0] + self.step * x as f32) / mesh.lattice.cell_px as f32 - mesh.lattice.first[0] as f32;
        let mut i = 0;
        while i < count {
            let g = start + per_pixel * i as f32;
            let column = (g.max(0.0) as usize).min(mesh.lattice.columns - 2);
            let left = ((column + 1) as f32 - g) / per_pixel;
            let end = if column + 2 == mesh.lattice.columns { count } else { count.min(i + round_up(left).max(1)) };
            let (a, b) = (self.node(column, along), self.node(column + 1, along));
            for (k, positions) in positions.iter_mut().enumerate() {
                let slope = (b[k] - a[k]) * per_pixel;
                let first = a[k] + (b[k] - a[k]) * (g - column as f32);
                for (position, n) in positions[i..end].iter_mut().zip(&STEPS) {
                    *position = first + slope * n;
                }
            }
            i = end;
        }
        warp::locate_each(&positions, (width, height, stride), count, block, avx2);
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
                let mut a = self.node(0, along);
                for column in 0..mesh.lattice.columns - 1 {
                    let b = self.node(column + 1, along);
                    if let Some((from, to)) = inside(a, b, [width, height]) {
                        let at = |t: f32| first + (column as f32 + t) * per_cell;
                        (low, high) = (low.min(at(from)), high.max(at(to)));
                    }
                    a = b;
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
