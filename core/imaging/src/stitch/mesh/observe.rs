//! Where the points that both views see lie in the other view, cell by cell of the reference view.

use super::super::grid::RectifiedView;
use crate::{Parallel, SharedMut, View};

/// Rows of cells per chunk.
const ROWS: usize = 4;
/// Samples of a cell, each way, at most.
const MOST_SAMPLES: usize = 8;
/// Share of a cell's samples that must agree on a disparity.
const LEAST_SHARE: f32 = 0.3;
/// Spread of the agreeing disparities around their plane at which an observation counts half, px.
const HALF_SPREAD_PX: f64 = 0.7;
/// Disparities further from the median of their cell do not determine its plane, px: slopes steeper than this in a cell are edges.
const MOST_CLIMB_PX: f32 = 8.0;
/// Keeps slopes small where samples lie in a line or a corner, px^2.
const FLAT_PX2: f64 = 2.0;
/// Disparities of neighbouring cells change by at most this much per px where they lie on one surface, and by [`ONE_STEP_PX`] more for their noise.
const ONE_SLOPE: f64 = 0.8;
const ONE_STEP_PX: f64 = 1.0;

/// The matched pixels of a cell that agree; without weight when there are too few.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Observation {
    /// Their middle in the reference picture, px.
    pub at: [f64; 2],
    /// The same point in the other picture, px.
    pub source: [f64; 2],
    /// 0 where nothing is known, up to 1.
    pub weight: f32,
}

/// Observations on a grid of cells.
#[derive(Clone, Debug, Default)]
pub struct Observations {
    /// Side of a cell, px of the left rectified view.
    pub cell_px: usize,
    /// Cells per row.
    pub columns: usize,
    /// Rows of cells.
    pub rows: usize,
    /// Row after row.
    pub cells: Vec<Observation>,
    /// Memory of [`keep_patches`](Self::keep_patches).
    is_visited: Vec<bool>,
    patch: Vec<usize>,
}

impl Observations {
    /// Reads a disparity map: px of the left rectified view at full size, NaN where unmatched.
    ///
    pub fn gather(
        &mut self,
        disparity: View<'_, f32>,
        [left, right]: [&RectifiedView; 2],
        sampling: &Sampling,
        pool: &dyn Parallel,
    ) {
        let cell_px = sampling.cell_px.max(2);
        let step_px = sampling.step_px.max(cell_px.div_ceil(MOST_SAMPLES));
        let sampling = Sampling { cell_px, step_px, ..*sampling };
        let (columns, rows) = (disparity.width.div_ceil(cell_px), disparity.height.div_ceil(cell_px));
        (self.cell_px, self.columns, self.rows) = (cell_px, columns, rows);
        self.cells.clear();
        self.cells.resize(columns * rows, Observation::default());
        let cells = SharedMut::new(&mut self.cells);
        pool.run(rows.div_ceil(ROWS), &|chunk| {
            for row in chunk * ROWS..(chunk * ROWS + ROWS).min(rows) {
                // SAFETY: each row of cells belongs to one chunk.
                let out = unsafe { cells.part(row * columns, columns) };
                for (column, out) in out.iter_mut().enumerate() {
                    let Some(found) = cell(disparity, column, row, &sampling) else { continue };
                    let at = left.unrectify([found.x, found.y]);
                    let [along_x, along_y] = sampling.along;
                    let source =
                        right.unrectify([found.x - along_x * found.disparity, found.y - along_y * found.disparity]);
                    // A rim pixel is compared with less of its surroundings, and its neighbours cannot correct it.
                    let rim = row == 0 || row + 1 == rows || column == 0 || column + 1 == columns;
                    let weight = found.weight * if rim { 0.25 } else { 1.0 };
                    if at.iter().chain(&source).all(|v| v.is_finite()) {
                        *out = Observation { at, source, weight };
                    }
                }
            }
        });
    }

    /// Drops the observations of surfaces with fewer than `least` cells: where the views share nothing, matches agree by chance, but not for long.
    pub fn keep_patches(&mut self, least: usize) {
        if least < 2 {
            return;
        }
        let (columns, rows) = (self.columns, self.rows);
        self.is_visited.clear();
        self.is_visited.extend(self.cells.iter().map(|cell| cell.weight <= 0.0));
        for start in 0..self.cells.len() {
            if self.is_visited[start] {
                continue;
            }
            self.is_visited[start] = true;
            self.patch.clear();
            self.patch.push(start);
            let mut next = 0;
            while let Some(&from) = self.patch.get(next) {
                next += 1;
                let (column, row) = (from % columns, from / columns);
                let around = [
                    (column > 0).then(|| from - 1),
                    (column + 1 < columns).then(|| from + 1),
                    (row > 0).then(|| from - columns),
                    (row + 1 < rows).then(|| from + columns),
                ];
                for to in around.into_iter().flatten() {
                    if !self.is_visited[to] && self.cells[from].is_one_surface_with(&self.cells[to]) {
                        self.is_visited[to] = true;
                        self.patch.push(to);
                    }
                }
            }
            if self.patch.len() < least {
                for cell in &self.patch {
                    self.cells[*cell].weight = 0.0;
                }
            }
        }
    }
}

impl Observation {
    fn is_one_surface_with(&self, other: &Self) -> bool {
        let apart = |a: [f64; 2], b: [f64; 2]| [a[0] - b[0], a[1] - b[1]];
        let (here, there) = (apart(self.at, other.at), apart(self.source, other.source));
        let step = apart(here, there);
        step[0].hypot(step[1]) <= ONE_SLOPE * here[0].hypot(here[1]) + ONE_STEP_PX
    }
}

/// How a disparity map is read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sampling {
    /// Side of a cell, px.
    pub cell_px: usize,
    /// Spacing of the disparities that are read.
    pub step_px: usize,
    /// Pixels of a cell agree when their disparities lie within this of a plane.
    pub agree_px: f32,
    /// Where the other camera stands, in units of the baseline of the disparity: a point at `(x, y)` lies at `(x, y) - disparity * along` there.
    pub along: [f64; 2],
}

struct Agreed {
    x: f64,
    y: f64,
    disparity: f64,
    weight: f32,
}

fn cell(map: View<'_, f32>, column: usize, row: usize, sampling: &Sampling) -> Option<Agreed> {
    let Sampling { cell_px, step_px: step, agree_px, along } = *sampling;
    let along = along.map(|v| v as f32);
    let (x0, y0) = (column * cell_px, row * cell_px);
    let (x1, y1) = ((x0 + cell_px).min(map.width), (y0 + cell_px).min(map.height));
    let mut samples = [(0.0f32, 0u32, 0u32); MOST_SAMPLES * MOST_SAMPLES];
    let (mut count, mut total) = (0, 0usize);
    for y in (y0 + step / 2..y1).step_by(step) {
        let line = map.row(y);
        for x in (x0 + step / 2..x1).step_by(step) {
            total += 1;
            let d = line[x];
            let (u, v) = (x as f32 - d * along[0], y as f32 - d * along[1]);
            // NaN fails; what lies outside the other view is not matched.
            let is_inside = u >= 0.0 && v >= 0.0 && u < map.width as f32 && v < map.height as f32;
            if is_inside && count < samples.len() {
                samples[count] = (d, x as u32, y as u32);
                count += 1;
            }
        }
    }
    if total == 0 || (count as f32) < LEAST_SHARE * total as f32 {
        return None;
    }
    let samples = &mut samples[..count];
    let middle = count / 2;
    let median = samples.select_nth_unstable_by(middle, |a, b| a.0.total_cmp(&b.0)).1.0;
    let plane = Plane::of(samples, median);
    let (mut sum, mut agreed) = ([0.0f64; 4], 0usize);
    for sample in samples.iter() {
        let (off, rest) = (f64::from(sample.0 - median), plane.rest(sample, median));
        if rest.abs() > f64::from(agree_px) {
            continue;
        }
        for (sum, v) in sum.iter_mut().zip([f64::from(sample.1), f64::from(sample.2), off, rest * rest]) {
            *sum += v;
        }
        agreed += 1;
    }
    let share = agreed as f32 / total as f32;
    if share < LEAST_SHARE {
        return None;
    }
    let [x, y, off, square] = sum.map(|v| v / agreed as f64);
    let spread = square / (HALF_SPREAD_PX * HALF_SPREAD_PX);
    Some(Agreed { x, y, disparity: f64::from(median) + off, weight: share / (1.0 + spread) as f32 })
}

/// Disparity and position of a pixel.
type Sample = (f32, u32, u32);

/// The slope of the disparities in a cell, so that those of steep tissue agree as well.
struct Plane {
    middle: [f64; 2],
    /// At the middle, from the median.
    off: f64,
    slope: [f64; 2],
}

impl Plane {
    /// Least squares over the samples near the median; there is one at least.
    fn of(samples: &[Sample], median: f32) -> Self {
        let (mut count, mut sums) = (0.0, [0.0f64; 8]);
        // Counted from a sample, so that sums of squares stay small.
        let [x0, y0] = samples.first().map_or([0.0; 2], |sample| [sample.1, sample.2].map(f64::from));
        for (d, x, y) in samples.iter().filter(|sample| (sample.0 - median).abs() <= MOST_CLIMB_PX) {
            let (x, y, d) = (f64::from(*x) - x0, f64::from(*y) - y0, f64::from(d - median));
            for (sum, v) in sums.iter_mut().zip([x, y, d, x * x, x * y, y * y, x * d, y * d]) {
                *sum += v;
            }
            count += 1.0;
        }
        let [x, y, d, xx, xy, yy, xd, yd] = sums.map(|sum| sum / f64::max(count, 1.0));
        let (xx, xy, yy) = (xx - x * x + FLAT_PX2, xy - x * y, yy - y * y + FLAT_PX2);
        let (xd, yd) = (xd - x * d, yd - y * d);
        let determinant = xx * yy - xy * xy;
        let slope = [(xd * yy - yd * xy) / determinant, (yd * xx - xd * xy) / determinant];
        Self { middle: [x0 + x, y0 + y], off: d, slope }
    }

    /// Distance of a disparity from the plane, px.
    fn rest(&self, (d, x, y): &Sample, median: f32) -> f64 {
        let climb = self.slope[0] * (f64::from(*x) - self.middle[0]) + self.slope[1] * (f64::from(*y) - self.middle[1]);
        f64::from(d - median) - self.off - climb
    }
}
