//! Where the points that both views see lie in the other view, cell by cell of the reference view.

use super::super::grid::RectifiedView;
use crate::{Parallel, SharedMut, View};

/// Rows of cells per chunk.
const ROWS: usize = 4;
/// Samples of a cell, each way, at most.
const MOST_SAMPLES: usize = 8;
/// Share of a cell's samples that must agree on a disparity.
const LEAST_SHARE: f32 = 0.3;
/// Spread of the agreeing disparities at which an observation counts half, px.
const HALF_SPREAD_PX: f32 = 0.7;

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
}

/// How a disparity map is read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sampling {
    /// Side of a cell, px.
    pub cell_px: usize,
    /// Spacing of the disparities that are read.
    pub step_px: usize,
    /// Pixels of a cell agree when they lie within this of its median disparity.
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
    let (mut sum, mut agreed) = ([0.0f64; 4], 0usize);
    for (d, x, y) in samples.iter().filter(|s| (s.0 - median).abs() <= agree_px) {
        let off = f64::from(d - median);
        for (sum, v) in sum.iter_mut().zip([f64::from(*x), f64::from(*y), off, off * off]) {
            *sum += v;
        }
        agreed += 1;
    }
    let share = agreed as f32 / total as f32;
    if share < LEAST_SHARE {
        return None;
    }
    let [x, y, off, square] = sum.map(|v| v / agreed as f64);
    let spread = ((square - off * off).max(0.0) as f32).sqrt() / HALF_SPREAD_PX;
    Some(Agreed { x, y, disparity: f64::from(median) + off, weight: share / (1.0 + spread * spread) })
}
