//! Fast-Hessian detector: box-filter responses over octaves and their 3x3x3 maxima.
//!
//! H. Bay, A. Ess, T. Tuytelaars, L. Van Gool, "Speeded-Up Robust Features (SURF)", CVIU 110 (2008),
//! sections 3.2 and 3.3. Filter sizes 9, 15, 21, 27 | 15, 27, 39, 51 | 27, 51, 75, 99 | 51, 99, 147, 195;
//! the sampling step doubles with every octave. Sizes shared by two octaves are computed once.

use super::integral::Integral;
use crate::simd::{dispatch, grow};
use crate::{Parallel, SharedMut, Simd};

/// Grid rows per chunk; a multiple of every octave's step, so that shared rows have one writer.
const BAND_ROWS: usize = 16;
/// Maximum number of octaves: bands of 16 rows can serve three coarser octaves.
pub(crate) const MAX_OCTAVES: usize = 4;
/// Relative weight of Dxy in the determinant, squared (0.9, Bay et al. 2008, equation 4).
const XY_WEIGHT: f32 = 0.81;

/// A maximum of the determinant in space and scale.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Extremum {
    /// Column, in pixels of the image searched.
    pub x: f32,
    /// Row, in pixels of the image searched.
    pub y: f32,
    /// Filter size, in pixels of the image searched.
    pub size: f32,
    /// Determinant of the Hessian.
    pub response: f32,
    /// Value by which keypoints are ranked.
    pub rank: f32,
    /// Sign of the trace: 1 for dark blobs on bright ground, -1 for bright ones on dark ground.
    pub laplacian: i8,
}

#[derive(Clone, Copy, Debug, Default)]
struct Layer {
    size: usize,
    /// Start of the layer's plane in `responses`.
    start: usize,
    /// Whether this octave computes the layer; otherwise the finer octave writes it.
    own: bool,
}

#[derive(Clone, Debug, Default)]
struct Octave {
    step: usize,
    cols: usize,
    rows: usize,
    stride: usize,
    layers: Vec<Layer>,
}

/// Responses and maxima of one image, with memory that is reused.
#[derive(Clone, Debug, Default)]
pub(crate) struct HessianDetector {
    octaves: Vec<Octave>,
    octaves_used: usize,
    responses: Vec<f32>,
    scratch: Vec<i32>,
    jobs: Vec<(usize, usize)>,
    found: Vec<Vec<Extremum>>,
    shape: (usize, usize, usize, usize),
}

/// Size of filter `index` of `octave`, in pixels.
pub(crate) fn filter_size(octave: usize, index: usize) -> usize {
    3 * ((index + 1) * (2 << octave) + 1)
}

impl HessianDetector {
    fn plan(&mut self, width: usize, height: usize, octaves: usize, layers: usize) {
        let shape = (width, height, octaves, layers);
        if self.shape == shape {
            return;
        }
        self.shape = shape;
        self.octaves.resize_with(octaves.max(self.octaves.len()), Octave::default);
        self.octaves_used = 0;
        self.jobs.clear();
        let mut start = 0;
        for index in 0..octaves {
            // The smallest scale space that can hold a maximum is three layers.
            if filter_size(index, 2) + 2 > width.min(height) {
                break;
            }
            let step = 1 << index;
            let (cols, rows) = (width.div_ceil(step), height.div_ceil(step));
            let stride = cols.next_multiple_of(8) + 8;
            let octave = &mut self.octaves[index];
            (octave.step, octave.cols, octave.rows, octave.stride) = (step, cols, rows, stride);
            octave.layers.clear();
            for layer in 0..layers {
                // Layer i equals layer 2 i + 1 of the finer octave, where that exists.
                let own = index == 0 || 2 * layer + 1 >= layers;
                octave.layers.push(Layer { size: filter_size(index, layer), start, own });
                start += stride * rows;
            }
            self.octaves_used += 1;
            self.jobs.extend((0..rows.div_ceil(BAND_ROWS)).map(|band| (index, band)));
        }
        grow(&mut self.responses, start);
        grow(&mut self.scratch, self.jobs.len() * scratch_len(width));
        self.found.resize_with(self.jobs.len().max(self.found.len()), Vec::new);
        for (slot, &(index, _)) in self.found.iter_mut().zip(&self.jobs) {
            // Two maxima of one layer are never neighbours: at most one in each 2x2 block.
            let most = (self.octaves[index].cols.div_ceil(2) * BAND_ROWS.div_ceil(2)) * (layers - 2);
            slot.clear();
            slot.reserve(most);
        }
    }

    /// Appends the maxima above `threshold` to `out`, in an order that depends on the image only.
    pub(crate) fn detect(
        &mut self,
        simd: Simd,
        integral: &Integral,
        octaves: usize,
        layers: usize,
        threshold: f32,
        pool: &dyn Parallel,
        out: &mut Vec<Extremum>,
    ) {
        let (width, height) = (integral.width(), integral.height());
        self.plan(width, height, octaves.min(MAX_OCTAVES), layers.max(3));
        if self.jobs.is_empty() {
            return;
        }
        let (octaves, jobs) = (&self.octaves[..self.octaves_used], &self.jobs);
        let per_job = scratch_len(width);
        let scratch = SharedMut::new(&mut self.scratch);
        let responses = SharedMut::new(&mut self.responses);
        let found = SharedMut::new(&mut self.found);
        pool.run(jobs.len(), &|job| {
            // SAFETY: every job has its own part and its own list.
            let (scratch, found) = unsafe { (scratch.part(job * per_job, per_job), &mut found.part(job, 1)[0]) };
            found.clear();
            let (index, band) = jobs[job];
            compute_band(simd, integral, octaves, index, band, &responses, scratch);
            // The finest octave owns all its layers: what lies inside the band is looked at while it is in a near cache.
            if index == 0 {
                let octave = &octaves[0];
                let line = |layer: usize, row: usize| {
                    let start = octave.layers[layer].start + row * octave.stride;
                    // SAFETY: inside the plane, and a row of this band: `plan` made room for it, no other job writes it, and
                    // this one has done so above.
                    unsafe { std::slice::from_raw_parts(responses.address(start).cast_const(), octave.cols) }
                };
                find_maxima(simd, integral, octave, inner(octave, band), line, threshold, found);
            }
        });
        let responses = &self.responses;
        let found = SharedMut::new(&mut self.found);
        pool.run(jobs.len(), &|job| {
            // SAFETY: every job has its own list.
            let found = unsafe { &mut found.part(job, 1)[0] };
            let (index, band) = jobs[job];
            let octave = &octaves[index];
            let line = |layer: usize, row: usize| {
                let start = octave.layers[layer].start + row * octave.stride;
                &responses[start..start + octave.cols]
            };
            let (whole, inner) = (rows_of(octave, band), inner(octave, band));
            let rest = if index == 0 { [whole.start..inner.start, inner.end..whole.end] } else { [whole, 0..0] };
            for rows in rest {
                find_maxima(simd, integral, octave, rows, line, threshold, found);
            }
        });
        for found in &self.found[..jobs.len()] {
            out.extend_from_slice(found);
        }
    }
}

/// Grid rows of a band.
fn rows_of(octave: &Octave, band: usize) -> std::ops::Range<usize> {
    let first = band * BAND_ROWS;
    first..(first + BAND_ROWS).min(octave.rows)
}

/// Rows of a band whose neighbours lie in it too.
fn inner(octave: &Octave, band: usize) -> std::ops::Range<usize> {
    let rows = rows_of(octave, band);
    let first = (rows.start + 1).min(rows.end);
    first..(rows.end - 1).max(first)
}

fn scratch_len(width: usize) -> usize {
    4 * (width + 1).next_multiple_of(16)
}

fn compute_band(
    simd: Simd,
    integral: &Integral,
    octaves: &[Octave],
    index: usize,
    band: usize,
    responses: &SharedMut<'_, f32>,
    scratch: &mut [i32],
) {
    let octave = &octaves[index];
    let first = band * BAND_ROWS;
    for (number, layer) in octave.layers.iter().enumerate().filter(|(_, layer)| layer.own) {
        for row in first..(first + BAND_ROWS).min(octave.rows) {
            // SAFETY: this job alone computes these rows of the layers its octave owns.
            let out = unsafe { responses.part(layer.start + row * octave.stride, octave.stride) };
            compute_row(simd, integral, layer.size, octave.step, row, octave.cols, out, scratch);
            // The same filter, seen by the coarser octaves on their grids.
            let (mut coarser, mut number, mut row, mut ratio) = (index + 1, number, row, 2);
            while coarser < octaves.len() && number % 2 == 1 && row % 2 == 0 {
                (number, row) = (number / 2, row / 2);
                let target = &octaves[coarser];
                if target.layers[number].own {
                    break;
                }
                // SAFETY: even rows of this job map to rows that no other job writes.
                let copy = unsafe { responses.part(target.layers[number].start + row * target.stride, target.stride) };
                let (source, kept) = (&*out, &mut copy[..target.cols]);
                dispatch!(simd, take_every(source: &[f32], ratio: usize, kept: &mut [f32]));
                copy[target.cols..].fill(0.0);
                (coarser, ratio) = (coarser + 1, ratio * 2);
            }
        }
    }
}

/// Rows and columns of the filter relative to its centre.
#[derive(Clone, Copy)]
struct Filter {
    /// Side of a lobe: a third of the size.
    lobe: usize,
    /// Half the size, rounded down.
    half: usize,
}

/// Responses of one filter along one grid row; zero where the filter leaves the image.
fn compute_row(
    simd: Simd,
    integral: &Integral,
    size: usize,
    step: usize,
    row: usize,
    cols: usize,
    out: &mut [f32],
    scratch: &mut [i32],
) {
    let (width, height) = (integral.width(), integral.height());
    let filter = Filter { lobe: size / 3, half: size / 2 };
    let (y, half) = (row * step, filter.half);
    if y < half || y + half + 1 > height || size > width {
        out.fill(0.0);
        return;
    }
    let len = (width + 1).next_multiple_of(16);
    let (band, rest) = scratch.split_at_mut(len);
    let (lobes, rest) = rest.split_at_mut(len);
    let (cross, line) = rest.split_at_mut(len);
    let count = width + 1;
    let (band, lobes, cross) = (&mut band[..count], &mut lobes[..count], &mut cross[..count]);
    dispatch!(simd, combine_rows(integral: &Integral, y: usize, filter: Filter, band: &mut [i32], lobes: &mut [i32], cross: &mut [i32]));
    let (band, lobes, cross) = (&*band, &*lobes, &*cross);
    let valid = width - 2 * half;
    let area = (filter.lobe * filter.lobe) as f32 * (5.0 / 3.0);
    let scale = 1.0 / area;
    match step {
        1 => {
            out[..half].fill(0.0);
            out[half + valid..].fill(0.0);
            let target = &mut out[half..half + valid];
            dispatch!(simd, combine_columns(band: &[i32], lobes: &[i32], cross: &[i32], filter: Filter, scale: f32, target: &mut [f32]));
        }
        _ => {
            // Coarser grids take every second column of a full row; still coarser ones column by column.
            out.fill(0.0);
            let first = half.div_ceil(step);
            let last = ((half + valid - 1) / step + 1).min(cols);
            if step == 2 {
                let full = &mut line[..valid];
                // The scratch is i32; the same bits hold the f32 responses for a moment.
                dispatch!(simd, combine_columns_bits(band: &[i32], lobes: &[i32], cross: &[i32], filter: Filter, scale: f32, full: &mut [i32]));
                let full = &full[first * 2 - half..];
                let target = &mut out[first..last];
                dispatch!(simd, take_even(full: &[i32], target: &mut [f32]));
            } else {
                for column in first..last {
                    out[column] = response_at(band, lobes, cross, column * step - half, filter, scale);
                }
            }
        }
    }
}

/// Vertical sums at every column: the band of Dxx, the lobes of Dyy, the crossed pair of Dxy.
#[inline(always)]
fn combine_rows(integral: &Integral, y: usize, filter: Filter, band: &mut [i32], lobes: &mut [i32], cross: &mut [i32]) {
    let Filter { lobe, half } = filter;
    let count = band.len();
    let row = |y: usize| &integral.row(y)[..count];
    let (band_low, band_high) = (row(y + lobe), row(y + 1 - lobe));
    let (all_low, all_high) = (row(y + half + 1), row(y - half));
    let (mid_low, mid_high) = (row(y + lobe / 2 + 1), row(y - lobe / 2));
    let (up_low, up_high) = (row(y), row(y - lobe));
    let (down_low, down_high) = (row(y + lobe + 1), row(y + 1));
    let (lobes, cross) = (&mut lobes[..count], &mut cross[..count]);
    for x in 0..count {
        band[x] = band_low[x].wrapping_sub(band_high[x]) as i32;
        let middle = mid_low[x].wrapping_sub(mid_high[x]) as i32;
        let all = all_low[x].wrapping_sub(all_high[x]) as i32;
        lobes[x] = all.wrapping_sub(middle.wrapping_add(middle).wrapping_add(middle));
        let up = up_low[x].wrapping_sub(up_high[x]) as i32;
        let down = down_low[x].wrapping_sub(down_high[x]) as i32;
        cross[x] = up.wrapping_sub(down);
    }
}

/// Determinant at column `half + x`, from the vertical sums.
#[inline(always)]
fn response_at(band: &[i32], lobes: &[i32], cross: &[i32], x: usize, filter: Filter, scale: f32) -> f32 {
    let Filter { lobe, half } = filter;
    let centre = x + half;
    let all = band[centre + half + 1].wrapping_sub(band[centre - half]);
    let middle = band[centre + lobe / 2 + 1].wrapping_sub(band[centre - lobe / 2]);
    let xx = all.wrapping_sub(middle.wrapping_add(middle).wrapping_add(middle));
    let yy = lobes[centre + lobe].wrapping_sub(lobes[centre + 1 - lobe]);
    let left = cross[centre].wrapping_sub(cross[centre - lobe]);
    let right = cross[centre + lobe + 1].wrapping_sub(cross[centre + 1]);
    let xy = left.wrapping_sub(right);
    determinant(xx, yy, xy, scale)
}

#[inline(always)]
fn determinant(xx: i32, yy: i32, xy: i32, scale: f32) -> f32 {
    let (xx, yy, xy) = (xx as f32 * scale, yy as f32 * scale, xy as f32 * scale);
    xx * yy - XY_WEIGHT * (xy * xy)
}

#[inline(always)]
fn columns(
    band: &[i32],
    lobes: &[i32],
    cross: &[i32],
    filter: Filter,
    scale: f32,
    count: usize,
    mut put: impl FnMut(usize, f32),
) {
    let Filter { lobe, half } = filter;
    let (all_right, all_left) = (&band[2 * half + 1..][..count], &band[..count]);
    let (mid_right, mid_left) = (&band[half + lobe / 2 + 1..][..count], &band[half - lobe / 2..][..count]);
    let (yy_right, yy_left) = (&lobes[half + lobe..][..count], &lobes[half + 1 - lobe..][..count]);
    let (left_right, left_left) = (&cross[half..][..count], &cross[half - lobe..][..count]);
    let (right_right, right_left) = (&cross[half + lobe + 1..][..count], &cross[half + 1..][..count]);
    for x in 0..count {
        let all = all_right[x].wrapping_sub(all_left[x]);
        let middle = mid_right[x].wrapping_sub(mid_left[x]);
        let xx = all.wrapping_sub(middle.wrapping_add(middle).wrapping_add(middle));
        let yy = yy_right[x].wrapping_sub(yy_left[x]);
        let left = left_right[x].wrapping_sub(left_left[x]);
        let right = right_right[x].wrapping_sub(right_left[x]);
        put(x, determinant(xx, yy, left.wrapping_sub(right), scale));
    }
}

#[inline(always)]
fn combine_columns(band: &[i32], lobes: &[i32], cross: &[i32], filter: Filter, scale: f32, out: &mut [f32]) {
    columns(band, lobes, cross, filter, scale, out.len(), |x, value| out[x] = value);
}

#[inline(always)]
fn combine_columns_bits(band: &[i32], lobes: &[i32], cross: &[i32], filter: Filter, scale: f32, out: &mut [i32]) {
    columns(band, lobes, cross, filter, scale, out.len(), |x, value| out[x] = value.to_bits() as i32);
}

/// Every `ratio`-th element; `source` is long enough for all of `out`.
#[inline(always)]
fn take_every(source: &[f32], ratio: usize, out: &mut [f32]) {
    match ratio {
        2 => out.iter_mut().zip(source.as_chunks::<2>().0).for_each(|(value, [first, ..])| *value = *first),
        4 => out.iter_mut().zip(source.as_chunks::<4>().0).for_each(|(value, [first, ..])| *value = *first),
        _ => out.iter_mut().zip(source.iter().step_by(ratio)).for_each(|(value, first)| *value = *first),
    }
}

#[inline(always)]
fn take_even(full: &[i32], out: &mut [f32]) {
    for (value, &bits) in out.iter_mut().zip(full.iter().step_by(2)) {
        *value = f32::from_bits(bits as u32);
    }
}

/// Appends the maxima of the grid rows `rows`; `line` gives a row of a layer.
fn find_maxima<'a>(
    simd: Simd,
    integral: &Integral,
    octave: &Octave,
    rows: std::ops::Range<usize>,
    line: impl Fn(usize, usize) -> &'a [f32] + Copy,
    threshold: f32,
    found: &mut Vec<Extremum>,
) {
    for index in 1..octave.layers.len() - 1 {
        let size_above = octave.layers[index + 1].size;
        // The layer above must be whole at the neighbours too, or its zeros would look like a fall.
        let margin = (size_above / 2).div_ceil(octave.step) + 1;
        let end = |extent: usize, grid: usize| {
            ((extent.saturating_sub(size_above / 2 + 1)) / octave.step).min(grid.saturating_sub(1))
        };
        let (end_x, end_y) = (end(integral.width(), octave.cols), end(integral.height(), octave.rows));
        for row in rows.start.max(margin)..rows.end.min(end_y) {
            let cross = Cross {
                middle: line(index, row),
                before: [line(index - 1, row), line(index, row - 1)],
                after: [line(index, row + 1), line(index + 1, row)],
            };
            scan_row(simd, &cross, margin, end_x, threshold, |column| {
                if let Some(extremum) = refine(integral, octave, index, row, column, line) {
                    found.push(extremum);
                }
            });
        }
    }
}

/// A row of responses and its nearest neighbours in space and scale, in scan order.
struct Cross<'a> {
    middle: &'a [f32],
    before: [&'a [f32]; 2],
    after: [&'a [f32]; 2],
}

/// Calls `hit` for the columns of `start..end` above the threshold that exceed their six nearest neighbours.
///
/// On a plateau the first element in scan order wins: larger than those before, not smaller than those after.
fn scan_row(simd: Simd, cross: &Cross<'_>, start: usize, end: usize, threshold: f32, mut hit: impl FnMut(usize)) {
    let line = cross.middle;
    let mut x = start.max(1);
    let end = end.min(line.len().saturating_sub(1));
    #[cfg(target_arch = "x86_64")]
    if simd.avx2() {
        // SAFETY: `Simd` allows AVX2 only where the processor has it.
        x = unsafe { scan_row_avx2(cross, x, end, threshold, &mut hit) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = simd;
    while x < end {
        let value = line[x];
        if value > threshold
            && value > line[x - 1]
            && value >= line[x + 1]
            && cross.before.iter().all(|other| value > other[x])
            && cross.after.iter().all(|other| value >= other[x])
        {
            hit(x);
        }
        x += 1;
    }
}

/// Scans whole vectors from `x` on and returns the first column left over.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn scan_row_avx2(cross: &Cross<'_>, mut x: usize, end: usize, threshold: f32, hit: &mut dyn FnMut(usize)) -> usize {
    use std::arch::x86_64::*;
    // SAFETY: the slice holds eight elements, which the indexing checks.
    let load = |line: &[f32], x: usize| unsafe { _mm256_loadu_ps(line[x..x + 8].as_ptr()) };
    let least = _mm256_set1_ps(threshold);
    while x + 8 <= end {
        // One branch for all six neighbours: the first ones alone let too many pass to be foreseen.
        let middle = load(cross.middle, x);
        let before = _mm256_max_ps(load(cross.before[0], x), load(cross.before[1], x));
        let before = _mm256_max_ps(before, _mm256_max_ps(least, load(cross.middle, x - 1)));
        let after = _mm256_max_ps(load(cross.after[0], x), load(cross.after[1], x));
        let after = _mm256_max_ps(after, load(cross.middle, x + 1));
        let above = _mm256_cmp_ps::<_CMP_GT_OQ>(middle, before);
        let inner = _mm256_and_ps(above, _mm256_cmp_ps::<_CMP_GE_OQ>(middle, after));
        let mut mask = _mm256_movemask_ps(inner) as u32;
        while mask != 0 {
            hit(x + mask.trailing_zeros() as usize);
            mask &= mask - 1;
        }
        x += 8;
    }
    x
}

/// Tests the 26 neighbours and fits a quadratic (Brown and Lowe 2002) for the exact position and size.
fn refine<'a>(
    integral: &Integral,
    octave: &Octave,
    index: usize,
    row: usize,
    column: usize,
    line: impl Fn(usize, usize) -> &'a [f32],
) -> Option<Extremum> {
    let mut cube = [[[0.0f32; 3]; 3]; 3];
    for (ds, plane) in cube.iter_mut().enumerate() {
        for (dy, three) in plane.iter_mut().enumerate() {
            three.copy_from_slice(&line(index + ds - 1, row + dy - 1)[column - 1..column + 2]);
        }
    }
    let centre = cube[1][1][1];
    // On a plateau the first element in scan order wins, so that exactly one is kept.
    for place in 0..27 {
        let value = cube[place / 9][place / 3 % 3][place % 3];
        if (place < 13 && value >= centre) || (place > 13 && value > centre) {
            return None;
        }
    }
    let c = |s: usize, y: usize, x: usize| f64::from(cube[s][y][x]);
    let gradient = [(c(1, 1, 2) - c(1, 1, 0)) * 0.5, (c(1, 2, 1) - c(1, 0, 1)) * 0.5, (c(2, 1, 1) - c(0, 1, 1)) * 0.5];
    let twice = 2.0 * c(1, 1, 1);
    let xx = c(1, 1, 2) + c(1, 1, 0) - twice;
    let yy = c(1, 2, 1) + c(1, 0, 1) - twice;
    let ss = c(2, 1, 1) + c(0, 1, 1) - twice;
    let xy = (c(1, 2, 2) - c(1, 2, 0) - c(1, 0, 2) + c(1, 0, 0)) * 0.25;
    let xs = (c(2, 1, 2) - c(2, 1, 0) - c(0, 1, 2) + c(0, 1, 0)) * 0.25;
    let ys = (c(2, 2, 1) - c(2, 0, 1) - c(0, 2, 1) + c(0, 0, 1)) * 0.25;
    let (c00, c01, c02) = (yy * ss - ys * ys, ys * xs - xy * ss, xy * ys - yy * xs);
    let det = xx * c00 + xy * c01 + xs * c02;
    if det == 0.0 || !det.is_finite() {
        return None;
    }
    let (c11, c12, c22) = (xx * ss - xs * xs, xy * xs - xx * ys, xx * yy - xy * xy);
    let [gx, gy, gs] = gradient;
    let dx = -(c00 * gx + c01 * gy + c02 * gs) / det;
    let dy = -(c01 * gx + c11 * gy + c12 * gs) / det;
    let ds = -(c02 * gx + c12 * gy + c22 * gs) / det;
    if dx.abs() > 1.0 || dy.abs() > 1.0 || ds.abs() > 1.0 || (dx + dy + ds).is_nan() {
        return None;
    }
    let layer = octave.layers[index];
    let growth = (octave.layers[index + 1].size - layer.size) as f64;
    Some(Extremum {
        x: ((column as f64 + dx) * octave.step as f64) as f32,
        y: ((row as f64 + dy) * octave.step as f64) as f32,
        size: (layer.size as f64 + ds * growth) as f32,
        response: centre,
        rank: centre,
        laplacian: trace_sign(integral, layer.size, column * octave.step, row * octave.step),
    })
}

/// Sign of Dxx + Dyy at a position where the filter is inside the image.
fn trace_sign(integral: &Integral, size: usize, x: usize, y: usize) -> i8 {
    let (lobe, half) = (size / 3, size / 2);
    // Sum of the columns `x - half..=x + half` less three times the middle ones, and the same with rows and columns exchanged;
    // like the responses they fit 32 bits.
    let (top, bottom) = (integral.row(y + 1 - lobe), integral.row(y + lobe));
    let band = |x: usize| bottom[x].wrapping_sub(top[x]) as i32;
    let pair = |low: usize, high: usize| {
        let (low, high) = (integral.row(low), integral.row(high));
        let at = |x: usize| high[x].wrapping_sub(low[x]);
        at(x + lobe).wrapping_sub(at(x + 1 - lobe)) as i32
    };
    let all = band(x + half + 1).wrapping_sub(band(x - half));
    let middle = band(x + lobe / 2 + 1).wrapping_sub(band(x - lobe / 2));
    let xx = all.wrapping_sub(middle.wrapping_mul(3));
    let yy = pair(y - half, y + half + 1).wrapping_sub(pair(y - lobe / 2, y + lobe / 2 + 1).wrapping_mul(3));
    if xx.wrapping_add(yy) >= 0 { 1 } else { -1 }
}
