//! Positions in the other view of points that both views see, per cell of the reference view.

use super::super::rectified_view::RectifiedView;
use crate::geometry::length;
use crate::{Parallel, SharedMut, View, pieces};

/// Rows of cells per chunk.
const ROWS: usize = 4;
/// Maximum number of samples of a cell per direction.
const MAX_SAMPLES: usize = 8;
/// Share of a cell's samples that must agree on a disparity.
const MIN_SHARE: f32 = 0.3;
/// Spread of the agreeing disparities around their plane at which an observation has half of its weight, px.
const HALF_SPREAD_PX: f32 = 0.7;
/// Disparities further from the median of their cell are not used for its plane, px: steeper slopes in a cell are
/// edges.
const MAX_CLIMB_PX: f32 = 8.0;
/// Regularises slopes if samples are in a line or a corner, px^2.
const FLAT_PX2: f32 = 2.0;
/// Disparities of neighbouring cells change by at most this much per px where they lie on one surface, and by
/// [`ONE_STEP_PX`] more for their noise.
const ONE_SLOPE: f64 = 0.8;
const ONE_STEP_PX: f64 = 1.0;

/// The matched pixels of a cell that agree; with weight 0 if there are too few.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Observation {
    /// Their mean position in the reference image, px.
    pub at: [f64; 2],
    /// The same point in the other image, px.
    pub source: [f64; 2],
    /// 0 if unknown, up to 1; negative if there are too few matches, which can only show small objects in front.
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
        let sampling = sampling.bounded();
        let cell_px = sampling.cell_px;
        let (columns, rows) = (disparity.width.div_ceil(cell_px), disparity.height.div_ceil(cell_px));
        (self.cell_px, self.columns, self.rows) = (cell_px, columns, rows);
        self.cells.clear();
        self.cells.resize(columns * rows, Observation::default());
        let [left_is_straight, right_is_straight] = [left, right].map(RectifiedView::is_straight);
        let cells = SharedMut::new(&mut self.cells);
        pool.run(rows.div_ceil(ROWS), &|chunk| {
            for row in chunk * ROWS..(chunk * ROWS + ROWS).min(rows) {
                // SAFETY: each row of cells belongs to one chunk.
                let out = unsafe { cells.part(row * columns, columns) };
                for (column, out) in out.iter_mut().enumerate() {
                    let Some(found) = cell(disparity, column, row, &sampling) else { continue };
                    let [along_x, along_y] = sampling.along;
                    let at = [found.x, found.y];
                    let source = [found.x - along_x * found.disparity, found.y - along_y * found.disparity];
                    let at = if left_is_straight { at } else { left.unrectify(at) };
                    let source = if right_is_straight { source } else { right.unrectify(source) };
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

    /// Drops the observations of surfaces with fewer than `least` cells: without overlap, matches agree by chance, but
    /// only over few cells.
    pub fn keep_patches(&mut self, least: usize) {
        if least < 2 {
            return;
        }
        let size = (self.columns, self.rows);
        self.is_visited.clear();
        self.is_visited.extend(self.cells.iter().map(|cell| cell.weight <= 0.0));
        for start in 0..self.cells.len() {
            if self.is_visited[start] {
                continue;
            }
            let cells = &self.cells;
            pieces::grow(start, size, &mut self.is_visited, &mut self.patch, |from, to| {
                cells[from].is_one_surface_with(&cells[to])
            });
            if self.patch.len() < least {
                for cell in &self.patch {
                    self.cells[*cell].weight *= -1.0;
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
        length(step) <= ONE_SLOPE * length(here) + ONE_STEP_PX
    }
}

/// Parameters for reading a disparity map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sampling {
    /// Side of a cell, px.
    pub cell_px: usize,
    /// Spacing of the disparities that are read.
    pub step_px: usize,
    /// Maximum distance from a plane of the disparities of agreeing pixels.
    pub agree_px: f32,
    /// Position of the other camera, in units of the disparity's baseline: a point at `(x, y)` is at `(x, y) -
    /// disparity * along` in its view.
    pub along: [f64; 2],
}

impl Sampling {
    /// With cells and steps that fit each other.
    fn bounded(&self) -> Self {
        let cell_px = self.cell_px.max(2);
        Self { cell_px, step_px: self.step_px.max(cell_px.div_ceil(MAX_SAMPLES)), ..*self }
    }

    /// Columns and rows of a map that are read.
    pub fn pixels(&self, size: (usize, usize)) -> [Vec<u32>; 2] {
        let Self { cell_px, step_px, .. } = self.bounded();
        [size.0, size.1].map(|length| {
            let cells = (0..length).step_by(cell_px);
            let in_cell = |from: usize| (from + step_px / 2..(from + cell_px).min(length)).step_by(step_px);
            cells.flat_map(in_cell).map(|at| at as u32).collect()
        })
    }
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
    let mut samples = [[0.0f32; 3]; MAX_SAMPLES * MAX_SAMPLES];
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
                samples[count] = [d, (x - x0) as f32, (y - y0) as f32];
                count += 1;
            }
        }
    }
    if total == 0 || (count as f32) < MIN_SHARE * total as f32 {
        return None;
    }
    let samples = &mut samples[..count];
    let middle = count / 2;
    let median = samples.select_nth_unstable_by(middle, |a, b| a[0].total_cmp(&b[0])).1[0];
    let plane = Plane::of(samples, median);
    let (mut sum_x, mut sum_y, mut sum_off, mut squares, mut agreed) = (0.0f32, 0.0, 0.0, 0.0, 0.0);
    for sample in samples.iter() {
        let rest = plane.rest(sample, median);
        // Without a branch: which samples agree cannot be foreseen.
        let counts = f32::from(u8::from(rest.abs() <= agree_px));
        sum_x += counts * sample[1];
        sum_y += counts * sample[2];
        sum_off += counts * (sample[0] - median);
        squares += counts * rest * rest;
        agreed += counts;
    }
    let share = agreed / total as f32;
    if share < MIN_SHARE {
        return None;
    }
    let mean = |sum: f32| f64::from(sum / agreed);
    let spread = squares / (agreed * HALF_SPREAD_PX * HALF_SPREAD_PX);
    Some(Agreed {
        x: x0 as f64 + mean(sum_x),
        y: y0 as f64 + mean(sum_y),
        disparity: f64::from(median) + mean(sum_off),
        weight: share / (1.0 + spread),
    })
}

/// Disparity of a pixel, and its position in the cell.
type Sample = [f32; 3];

/// The slope of the disparities in a cell, so that disparities of steep tissue agree too.
struct Plane {
    middle: [f32; 2],
    /// At the middle, from the median.
    off: f32,
    slope: [f32; 2],
}

impl Plane {
    /// Least squares over the samples near the median; at least one is required.
    fn of(samples: &[Sample], median: f32) -> Self {
        let (mut count, mut x, mut y, mut d) = (0.0f32, 0.0, 0.0, 0.0);
        let (mut xx, mut xy, mut yy, mut xd, mut yd) = (0.0f32, 0.0, 0.0, 0.0, 0.0);
        for [value, column, row] in samples {
            let off = value - median;
            let counts = f32::from(u8::from(off.abs() <= MAX_CLIMB_PX));
            let (cx, cy, cd) = (counts * column, counts * row, counts * off);
            count += counts;
            (x, y, d) = (x + cx, y + cy, d + cd);
            (xx, xy, yy) = (xx + cx * column, xy + cx * row, yy + cy * row);
            (xd, yd) = (xd + cd * column, yd + cd * row);
        }
        let one = 1.0 / count.max(1.0);
        let (x, y, d) = (x * one, y * one, d * one);
        let (xx, xy, yy) = (xx * one - x * x + FLAT_PX2, xy * one - x * y, yy * one - y * y + FLAT_PX2);
        let (xd, yd) = (xd * one - x * d, yd * one - y * d);
        let determinant = xx * yy - xy * xy;
        let slope = [(xd * yy - yd * xy) / determinant, (yd * xx - xd * xy) / determinant];
        Self { middle: [x, y], off: d, slope }
    }

    /// Distance of a disparity from the plane, px.
    fn rest(&self, [d, x, y]: &Sample, median: f32) -> f32 {
        let climb = self.slope[0] * (x - self.middle[0]) + self.slope[1] * (y - self.middle[1]);
        d - median - self.off - climb
    }
}
