//! The bilateral grid: pixels that are near in place and in luminance share a vertex.
//!
//! Only occupied vertices are kept, in the order row, column, luminance; the work of a frame then
//! depends on the picture's content, not on the grid's volume.

use crate::{Parallel, Rect, SharedMut, View};

/// Largest side of a cell, px.
pub(crate) const MAX_SIGMA_XY: usize = 128;
/// Columns of cells whose pixels are added in turn.
const AT_ONCE: usize = 4;

/// Sums over the pixels of each vertex, and its neighbours.
#[derive(Debug, Default)]
pub(crate) struct BilateralGrid {
    /// Cells along columns, rows and luminance.
    pub cells: [usize; 3],
    pub sigma_xy: usize,
    /// Dense cell of each pixel of the ROI, within its grid row.
    pixel_cell: Vec<u32>,
    /// Vertex of each dense cell plus one, 0 when empty.
    pub vertex_of_cell: Vec<u32>,
    /// Pixels, confidence, confidence times value, nothing: four numbers are added at once.
    dense: Vec<[f32; 4]>,
    row_start: Vec<usize>,
    /// Pixels of each vertex. Index 0 is a vertex that does not exist: all its values stay 0.
    pub mass: Vec<f32>,
    /// Sum of confidence.
    pub confidence: Vec<f32>,
    /// Sum of confidence times value.
    pub weighted: Vec<f32>,
    /// Neighbours below and above along luminance, columns and rows; 0 where there is none.
    pub neighbours: Vec<[u32; 6]>,
    /// Dense cell of each vertex.
    pub cell_of_vertex: Vec<u32>,
}

impl BilateralGrid {
    /// Rebuilds the grid for the pixels of `roi` in `guide` and `value`; `confidence` counts its pixels from `origin` on. A value that
    /// is not finite, or whose confidence is not above 0, counts nothing; more confidence than 1 counts as 1.
    pub fn splat(
        &mut self,
        guide: View<'_, u8>,
        roi: Rect,
        (sigma_xy, sigma_luma): (usize, usize),
        value: View<'_, f32>,
        (confidence, origin): (View<'_, f32>, (usize, usize)),
        avx2: bool,
        pool: &dyn Parallel,
    ) {
        let cells = [roi.width.div_ceil(sigma_xy), roi.height.div_ceil(sigma_xy), 255 / sigma_luma + 1];
        self.cells = cells;
        self.sigma_xy = sigma_xy;
        let row_cells = cells[0] * cells[2];
        self.pixel_cell.resize(roi.width * roi.height, 0);
        self.vertex_of_cell.resize(row_cells * cells[1], 0);
        self.dense.resize(row_cells * cells[1], [0.0; 4]);
        self.row_start.clear();
        self.row_start.resize(cells[1] + 1, 0);

        // `luma * step >> 16` is `luma / sigma_luma` for all 256 levels.
        let luma_step = (1u32 << 16).div_ceil(sigma_luma as u32);
        let pixel_cell = SharedMut::new(&mut self.pixel_cell);
        let dense = SharedMut::new(&mut self.dense);
        let row_start = SharedMut::new(&mut self.row_start);
        pool.run(cells[1], &|grid_row| {
            // SAFETY: grid rows, and the pixel rows under them, belong to one chunk each.
            let dense = unsafe { dense.part(grid_row * row_cells, row_cells) };
            dense.fill([0.0; 4]);
            for row in grid_row * sigma_xy..((grid_row + 1) * sigma_xy).min(roi.height) {
                let at = row * roi.width..(row + 1) * roi.width;
                // SAFETY: pixel row `row` is under grid row `grid_row`, which belongs to this chunk alone.
                let ids = unsafe { pixel_cell.part(at.start, roi.width) };
                let channels = guide.channels;
                let pixels = &guide.row(roi.y + row)[roi.x * channels..(roi.x + roi.width) * channels];
                let value = &value.row(roi.y + row)[roi.x..roi.x + roi.width];
                let confidence = &confidence.row(origin.1 + row)[origin.0..origin.0 + roi.width];
                let lumas = cells[2] as u32;
                let dense = &mut *dense;
                PixelRow { guide: pixels, channels, sigma_xy, lumas, luma_step, value, confidence, ids, dense }
                    .add(avx2);
            }
            let count = dense.iter().filter(|sums| sums[0] > 0.0).count();
            // SAFETY: entry `grid_row + 1` is this chunk's own.
            unsafe { row_start.part(grid_row + 1, 1)[0] = count };
        });
        for row in 0..cells[1] {
            self.row_start[row + 1] += self.row_start[row];
        }
        let count = self.row_start[cells[1]] + 1;
        for plane in [&mut self.mass, &mut self.confidence, &mut self.weighted] {
            plane.resize(count, 0.0);
            plane[0] = 0.0;
        }
        self.cell_of_vertex.resize(count, 0);
        self.neighbours.resize(count, [0; 6]);
        self.neighbours[0] = [0; 6];
        self.number(row_cells, pool);
        self.connect(row_cells, pool);
    }

    /// Gives each occupied cell its vertex, in order.
    fn number(&mut self, row_cells: usize, pool: &dyn Parallel) {
        let (dense, row_start) = (&self.dense, &self.row_start);
        let vertex_of_cell = SharedMut::new(&mut self.vertex_of_cell);
        let cell_of_vertex = SharedMut::new(&mut self.cell_of_vertex);
        let mass = SharedMut::new(&mut self.mass);
        let confidence = SharedMut::new(&mut self.confidence);
        let weighted = SharedMut::new(&mut self.weighted);
        pool.run(self.cells[1], &|row| {
            let (start, count) = (row_start[row] + 1, row_start[row + 1] - row_start[row]);
            let base = row * row_cells;
            // SAFETY: cells and vertices of one grid row belong to one chunk.
            let (ids, back, mass, confidence, weighted) = unsafe {
                (
                    vertex_of_cell.part(base, row_cells),
                    cell_of_vertex.part(start, count),
                    mass.part(start, count),
                    confidence.part(start, count),
                    weighted.part(start, count),
                )
            };
            let mut next = 0;
            for (cell, sums) in dense[base..base + row_cells].iter().enumerate() {
                ids[cell] = 0;
                if sums[0] > 0.0 {
                    ids[cell] = (start + next) as u32;
                    back[next] = (base + cell) as u32;
                    [mass[next], confidence[next], weighted[next], _] = *sums;
                    next += 1;
                }
            }
        });
    }

    fn connect(&mut self, row_cells: usize, pool: &dyn Parallel) {
        let [columns, rows, lumas] = self.cells;
        let (ids, row_start, cells) = (&self.vertex_of_cell, &self.row_start, &self.cell_of_vertex);
        let neighbours = SharedMut::new(&mut self.neighbours);
        pool.run(rows, &|row| {
            let (start, count) = (row_start[row] + 1, row_start[row + 1] - row_start[row]);
            // SAFETY: vertices of one grid row belong to one chunk.
            let neighbours = unsafe { neighbours.part(start, count) };
            for (neighbours, cell) in neighbours.iter_mut().zip(&cells[start..start + count]) {
                let cell = *cell as usize;
                let within = cell - row * row_cells;
                let (column, luma) = (within / lumas, within % lumas);
                let take = |there: bool, cell: usize| if there { ids[cell] } else { 0 };
                *neighbours = [
                    take(luma > 0, cell.wrapping_sub(1)),
                    take(luma + 1 < lumas, cell + 1),
                    take(column > 0, cell.wrapping_sub(lumas)),
                    take(column + 1 < columns, cell + lumas),
                    take(row > 0, cell.wrapping_sub(row_cells)),
                    take(row + 1 < rows, cell + row_cells),
                ];
            }
        });
    }

    /// Vertices, the empty one at 0 included.
    pub fn len(&self) -> usize {
        self.mass.len()
    }

    /// Sum of the six neighbours of vertex `v`.
    ///
    /// # Safety
    /// `v < len()` and `values.len() == len()`.
    #[inline(always)]
    pub unsafe fn around(&self, values: &[f32], v: usize) -> f32 {
        debug_assert_eq!(values.len(), self.mass.len());
        // SAFETY: the caller promises `v < len()`, and `neighbours` has one entry per vertex.
        let [a, b, c, d, e, f] = *unsafe { self.neighbours.get_unchecked(v) };
        // SAFETY: `connect` writes only vertex numbers into `neighbours`, and the caller promises a value per vertex.
        let at = |index: u32| unsafe { *values.get_unchecked(index as usize) };
        ((at(a) + at(b)) + (at(c) + at(d))) + (at(e) + at(f))
    }

    /// Dense cells of the pixels of one ROI row, counted within their grid row.
    pub fn row_cells(&self, row: usize, width: usize) -> &[u32] {
        &self.pixel_cell[row * width..(row + 1) * width]
    }

    /// Vertices (0 = none) of the dense cells of one grid row.
    pub fn grid_row(&self, grid_row: usize) -> &[u32] {
        let row_cells = self.cells[0] * self.cells[2];
        &self.vertex_of_cell[grid_row * row_cells..(grid_row + 1) * row_cells]
    }
}

/// Cells of one row of pixels, which are added to the cells of their grid row.
struct PixelRow<'a> {
    guide: &'a [u8],
    channels: usize,
    sigma_xy: usize,
    lumas: u32,
    luma_step: u32,
    value: &'a [f32],
    confidence: &'a [f32],
    ids: &'a mut [u32],
    dense: &'a mut [[f32; 4]],
}

impl PixelRow<'_> {
    fn add(self, avx2: bool) {
        #[cfg(target_arch = "x86_64")]
        if avx2 {
            // SAFETY: the caller found AVX2.
            unsafe { self.add_avx2() };
            return;
        }
        let _ = avx2;
        self.add_body();
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn add_avx2(self) {
        self.add_body();
    }

    #[inline(always)]
    fn add_body(self) {
        let Self { guide, channels, sigma_xy, lumas, luma_step, value, confidence, ids, dense } = self;
        fill_ids(guide, channels, sigma_xy, lumas, luma_step, ids);
        // Neighbours fall into one cell, and each addition would wait for the one before: pixels of `AT_ONCE` columns of cells are
        // taken in turn.
        let (mut trusts, mut products) = ([0.0; AT_ONCE * MAX_SIGMA_XY], [0.0; AT_ONCE * MAX_SIGMA_XY]);
        let group = AT_ONCE * sigma_xy;
        for ((ids, value), confidence) in ids.chunks(group).zip(value.chunks(group)).zip(confidence.chunks(group)) {
            let n = ids.len();
            let (trusts, products) = (&mut trusts[..n], &mut products[..n]);
            for (((trust, product), value), confidence) in
                trusts.iter_mut().zip(products.iter_mut()).zip(value).zip(confidence)
            {
                // NaN fails both.
                let known = (*confidence > 0.0) & (value.abs() < f32::INFINITY);
                *trust = if known { confidence.min(1.0) } else { 0.0 };
                *product = if known { *trust * value } else { 0.0 };
            }
            let mut add = |i: usize| {
                let sums = &mut dense[ids[i] as usize];
                for (sum, more) in sums.iter_mut().zip([1.0, trusts[i], products[i], 0.0]) {
                    *sum += more;
                }
            };
            if n == group {
                for step in 0..sigma_xy {
                    for column in 0..AT_ONCE {
                        add(column * sigma_xy + step);
                    }
                }
            } else {
                (0..n).for_each(add);
            }
        }
    }
}

/// Cell of each pixel within its grid row.
#[inline(always)]
fn fill_ids(pixels: &[u8], channels: usize, sigma_xy: usize, lumas: u32, luma_step: u32, ids: &mut [u32]) {
    for (column, (ids, pixels)) in ids.chunks_mut(sigma_xy).zip(pixels.chunks(sigma_xy * channels)).enumerate() {
        let base = column as u32 * lumas;
        if channels == 1 {
            for (id, luma) in ids.iter_mut().zip(pixels) {
                *id = base + ((u32::from(*luma) * luma_step) >> 16);
            }
        } else {
            for (id, pixel) in ids.iter_mut().zip(pixels.chunks_exact(3)) {
                let luma = (29 * u32::from(pixel[0]) + 150 * u32::from(pixel[1]) + 77 * u32::from(pixel[2])) >> 8;
                *id = base + ((luma * luma_step) >> 16);
            }
        }
    }
}
