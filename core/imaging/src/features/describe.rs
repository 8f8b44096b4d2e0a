//! SURF descriptor of one keypoint, from samples of the image pyramid.
//!
//! Bay et al. 2008, section 4.2: Haar responses of side 2 s in a Gaussian-weighted window of 20 s give sums of dx, dy, |dx|, |dy|
//! over 4 x 4 sub-regions. Neighbouring sub-regions overlap (Agrawal, Konolige, Blas, "CenSurE",
//! ECCV 2008, section 3.4), so that a sample near a border does not jump between two of them.

use super::pyramid::{Level, Pyramid};
use super::simd::Simd;
use super::upright;

/// Elements of a descriptor.
pub const DESCRIPTOR_LEN: usize = 64;

/// A descriptor of unit length (all zero where the image is flat), aligned to a cache line.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(64))]
pub struct Descriptor(pub [f32; DESCRIPTOR_LEN]);

impl Default for Descriptor {
    fn default() -> Self {
        Self([0.0; DESCRIPTOR_LEN])
    }
}

/// Samples of a descriptor patch along each side (differences of neighbours: one fewer).
pub(super) const PATCH: usize = 21;
const WINDOW: usize = PATCH - 1;
/// Padded row length of every table and patch.
pub(crate) const ROW: usize = 32;
/// Elements of a row that carry a sample, rounded up to vectors.
const USED: usize = 24;

/// Samples of one keypoint's surroundings; work memory.
pub(super) type Patch = [[f32; ROW]; PATCH];

/// Weights that do not depend on the keypoint.
#[derive(Clone, Debug)]
pub(crate) struct Tables {
    /// Weight of sample i for sub-region r along one axis.
    region: [[f32; USED]; 4],
    /// First and past-the-last sample with weight, by sub-region.
    span: [(usize, usize); 4],
}

impl Tables {
    pub(crate) fn new() -> Self {
        let mut tables = Self { region: [[0.0; USED]; 4], span: [(0, 0); 4] };
        for (r, (weights, span)) in tables.region.iter_mut().zip(&mut tables.span).enumerate() {
            let centre = r as f64 * 5.0 + 2.0;
            let mut last = 0;
            let mut first = WINDOW;
            for (i, weight) in weights.iter_mut().enumerate().take(WINDOW) {
                let offset = i as f64 - (WINDOW as f64 - 1.0) / 2.0;
                let distance = (i as f64 - centre).abs();
                let window = (-offset * offset / (2.0 * WINDOW_SIGMA * WINDOW_SIGMA)).exp();
                let membership = (-distance * distance / (2.0 * REGION_SIGMA * REGION_SIGMA)).exp();
                if distance <= REGION_REACH {
                    *weight = (window * membership) as f32;
                    first = first.min(i);
                    last = i + 1;
                }
            }
            *span = (first, last);
        }
        tables
    }
}

/// Gaussian over the window, in samples. Wider than the 3.3 s of Bay et al.: with overlapping sub-regions the
/// outer ones tell more matches apart than they blur (measured on the Graffiti pair).
const WINDOW_SIGMA: f64 = 6.0;
/// Gaussian over one sub-region, and how far it reaches, in samples.
const REGION_SIGMA: f64 = 2.0;
const REGION_REACH: f64 = 3.0;
/// Windows of the extended descriptor over the usual one. On Graffiti and on fourteen warped photographs every pair of windows
/// with a narrow one of 0.5 to 0.8 and a wide one two to four times that gave more right matches than 64 elements; these lie in
/// the middle. Sums split by the sign of the other derivative (SURF-128 of Bay et al.) gave fewer.
const NARROW: f32 = 0.6;
const WIDE: f32 = 1.8;
/// The pyramid level is the one on which s is at least this many pixels.
const LEAST_STEP: f32 = 1.0;

/// Where a patch lies on a pyramid level.
#[derive(Clone, Copy)]
pub(crate) struct Grid {
    /// Place of the patch's centre, in pixels of the level.
    x: f32,
    y: f32,
    /// Step along a row of the patch, in pixels of the level; a column's step is at right angles.
    ux: f32,
    uy: f32,
}

impl Grid {
    /// A patch around `(x, y)` with samples `step` apart, on the level that suits scale `scale`.
    pub(crate) fn on(pyramid: &Pyramid, x: f32, y: f32, scale: f32, step: f32, angle: f32) -> (&Level, Grid) {
        let wanted = (scale / LEAST_STEP).max(1.0).log2() as usize;
        let (level, index) = pyramid.level(wanted);
        let shrink = 1.0 / (1u32 << index) as f32;
        let (sin, cos) = angle.sin_cos();
        let step = step * shrink;
        let grid = Grid { x: (x + 0.5) * shrink - 0.5, y: (y + 0.5) * shrink - 0.5, ux: cos * step, uy: sin * step };
        (level, grid)
    }
}

/// Reads `rows` rows of `vectors` x 8 samples; sample (i, j) lies `(i - half, j - half)` steps off the centre.
pub(crate) fn sample(
    simd: Simd,
    level: &Level,
    grid: Grid,
    half: f32,
    rows: usize,
    vectors: usize,
    out: &mut [[f32; ROW]],
) {
    let out = &mut out[..rows];
    let upright = grid.uy == 0.0 && grid.ux > 0.0 && grid.ux < upright::STEP_LIMIT;
    #[cfg(target_arch = "x86_64")]
    if simd.avx2() {
        // SAFETY: AVX2 is there.
        unsafe {
            if upright {
                upright::sample_avx2(level, grid, half, vectors, out);
            } else {
                sample_avx2(level, grid, half, vectors, out);
            }
        }
        return;
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = simd;
    for (j, line) in out.iter_mut().enumerate() {
        let start = Start::of(level, grid, half, j);
        if upright {
            upright::sample_line(level, start, vectors, line);
        } else {
            sample_line(level, start, vectors, line);
        }
    }
}

/// First sample of a row, step to the next, and the level's last pixel.
#[derive(Clone, Copy)]
pub(super) struct Start {
    pub x: f32,
    pub y: f32,
    pub ux: f32,
    pub uy: f32,
    pub limit_x: f32,
    pub limit_y: f32,
}

impl Start {
    #[inline(always)]
    pub(super) fn of(level: &Level, grid: Grid, half: f32, row: usize) -> Self {
        let down = row as f32 - half;
        Self {
            x: grid.x - down * grid.uy - half * grid.ux,
            y: grid.y + down * grid.ux - half * grid.uy,
            ux: grid.ux,
            uy: grid.uy,
            limit_x: level.width as f32 - 1.0,
            limit_y: level.height as f32 - 1.0,
        }
    }
}

fn sample_line(level: &Level, start: Start, vectors: usize, line: &mut [f32; ROW]) {
    for (i, value) in line.iter_mut().enumerate().take(vectors * 8) {
        let x = (start.x + i as f32 * start.ux).min(start.limit_x).max(0.0);
        let y = (start.y + i as f32 * start.uy).min(start.limit_y).max(0.0);
        let (column, row) = (x as usize, y as usize);
        let (fx, fy) = (x - column as f32, y - row as f32);
        let index = row * level.stride + column;
        let pair = |index: usize| {
            let (a, b) = (f32::from(level.data[index]), f32::from(level.data[index + 1]));
            a + (b - a) * fx
        };
        let (upper, lower) = (pair(index), pair(index + level.stride));
        *value = upper + (lower - upper) * fy;
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn sample_avx2(level: &Level, grid: Grid, half: f32, vectors: usize, out: &mut [[f32; ROW]]) {
    use std::arch::x86_64::*;
    // What the gathers may touch: two elements from (limit_y + 1) * stride + limit_x.
    assert!(level.width > 0 && level.height > 0 && level.data.len() > level.stride * (level.height + 1));
    assert!(level.stride > level.width && vectors * 8 <= ROW && level.data.len() < i32::MAX as usize);
    let ramp = _mm256_setr_ps(0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0);
    let (ux, uy) = (_mm256_set1_ps(grid.ux), _mm256_set1_ps(grid.uy));
    let first = Start::of(level, grid, half, 0);
    let (limit_x, limit_y) = (_mm256_set1_ps(first.limit_x), _mm256_set1_ps(first.limit_y));
    let stride = _mm256_set1_epi32(level.stride as i32);
    let zero = _mm256_setzero_ps();
    let low = _mm256_set1_epi32(0xffff);
    let upper_base = level.data.as_ptr();
    let lower_base = level.data[level.stride..].as_ptr();
    for (j, line) in out.iter_mut().enumerate() {
        let start = Start::of(level, grid, half, j);
        let (x0, y0) = (_mm256_set1_ps(start.x), _mm256_set1_ps(start.y));
        for vector in 0..vectors {
            let i = _mm256_add_ps(ramp, _mm256_set1_ps((vector * 8) as f32));
            let x = _mm256_max_ps(_mm256_min_ps(_mm256_add_ps(x0, _mm256_mul_ps(i, ux)), limit_x), zero);
            let y = _mm256_max_ps(_mm256_min_ps(_mm256_add_ps(y0, _mm256_mul_ps(i, uy)), limit_y), zero);
            let (column, row) = (_mm256_cvttps_epi32(x), _mm256_cvttps_epi32(y));
            let fx = _mm256_sub_ps(x, _mm256_cvtepi32_ps(column));
            let fy = _mm256_sub_ps(y, _mm256_cvtepi32_ps(row));
            let index = _mm256_add_epi32(_mm256_mullo_epi32(row, stride), column);
            let mut places = [0u32; 8];
            // SAFETY: eight elements of four bytes.
            unsafe { _mm256_storeu_si256(places.as_mut_ptr().cast(), index) };
            // Loads of their own are faster than a gather instruction on processors that run it as microcode.
            let fetch = |base: *const u16| {
                // SAFETY: 0 <= column < width and 0 <= row < height after clamping (a NaN place becomes a
                // limit or 0), and the level holds one padded row more than its height (asserted above).
                let at = |i: usize| unsafe { base.add(places[i] as usize).cast::<i32>().read_unaligned() };
                _mm256_setr_epi32(at(0), at(1), at(2), at(3), at(4), at(5), at(6), at(7))
            };
            let (upper, lower) = (fetch(upper_base), fetch(lower_base));
            let pair = |values: __m256i| {
                let a = _mm256_cvtepi32_ps(_mm256_and_si256(values, low));
                let b = _mm256_cvtepi32_ps(_mm256_srli_epi32::<16>(values));
                _mm256_add_ps(a, _mm256_mul_ps(_mm256_sub_ps(b, a), fx))
            };
            let (upper, lower) = (pair(upper), pair(lower));
            let value = _mm256_add_ps(upper, _mm256_mul_ps(_mm256_sub_ps(lower, upper), fy));
            let target = line[vector * 8..vector * 8 + 8].as_mut_ptr();
            // SAFETY: 8 elements of the slice just taken.
            unsafe { _mm256_storeu_ps(target, value) };
        }
    }
}

/// Descriptor of the keypoint at `(x, y)` with scale `s` (pixels) and angle (radians).
pub(crate) fn describe(
    simd: Simd,
    tables: &Tables,
    pyramid: &Pyramid,
    x: f32,
    y: f32,
    scale: f32,
    angle: f32,
    out: &mut Descriptor,
    patch: &mut Patch,
) {
    let (level, grid) = Grid::on(pyramid, x, y, scale, scale, angle);
    sample(simd, level, grid, (PATCH as f32 - 1.0) / 2.0, PATCH, USED / 8, patch);
    #[cfg(target_arch = "x86_64")]
    if simd.avx2() {
        // SAFETY: AVX2 is there.
        unsafe { summarise_avx2(tables, patch, out) };
        return;
    }
    summarise(tables, patch, out);
}

/// Extended descriptor of 128 elements: one of a narrow window, one of a wide one, together of unit length.
///
/// The narrow window tells details apart and bears changes of viewpoint, the wide one tells repeated details apart by what
/// surrounds them. Where one window is flat, the other counts alone.
pub(crate) fn describe_extended(
    simd: Simd,
    tables: &Tables,
    pyramid: &Pyramid,
    x: f32,
    y: f32,
    scale: f32,
    angle: f32,
    [narrow, wide]: [&mut Descriptor; 2],
    patch: &mut Patch,
) {
    describe(simd, tables, pyramid, x, y, scale * NARROW, angle, narrow, patch);
    describe(simd, tables, pyramid, x, y, scale * WIDE, angle, wide, patch);
    let flat = |descriptor: &Descriptor| descriptor.0.iter().all(|value| *value == 0.0);
    if !flat(narrow) && !flat(wide) {
        for value in narrow.0.iter_mut().chain(&mut wide.0) {
            *value *= std::f32::consts::FRAC_1_SQRT_2;
        }
    }
}

/// Derivatives at sample (i, j): differences of the sums of two neighbouring columns and rows.
#[inline(always)]
fn slopes(patch: &Patch, i: usize, j: usize) -> (f32, f32) {
    let (a, b) = (&patch[j], &patch[j + 1]);
    ((a[i + 1] + b[i + 1]) - (a[i] + b[i]), (b[i + 1] - a[i + 1]) + (b[i] - a[i]))
}

/// First sample that the vector of sub-region `r` holds: its samples fit eight.
const fn first_of(r: usize) -> usize {
    if r == 0 { 0 } else { 5 * r - 1 }
}

fn summarise(tables: &Tables, patch: &Patch, out: &mut Descriptor) {
    let mut squares = [0.0f32; 4];
    for r in 0..4 {
        let mut sums = [[0.0f32; USED]; 4];
        let (first, last) = tables.span[r];
        for j in first..last {
            let weight = tables.region[r][j];
            for i in 0..USED {
                let (x, y) = slopes(patch, i, j);
                let (x, y) = (x * weight, y * weight);
                sums[0][i] += x;
                sums[1][i] += y;
                sums[2][i] += x.abs();
                sums[3][i] += y.abs();
            }
        }
        for c in 0..4 {
            let (weights, start) = (&tables.region[c], first_of(c));
            for (q, sum) in sums.iter().enumerate() {
                let mut lanes = [0.0f32; 8];
                for k in 0..8 {
                    lanes[k] = sum[start + k] * weights[start + k];
                }
                let total =
                    ((lanes[0] + lanes[4]) + (lanes[2] + lanes[6])) + ((lanes[1] + lanes[5]) + (lanes[3] + lanes[7]));
                out.0[(r * 4 + c) * 4 + q] = total;
                squares[q] += total * total;
            }
        }
    }
    let scale = scale_of((squares[0] + squares[2]) + (squares[1] + squares[3]));
    for value in &mut out.0 {
        *value *= scale;
    }
}

/// What brings a descriptor with this sum of squares to unit length.
fn scale_of(squares: f32) -> f32 {
    if squares > 1e-12 { 1.0 / squares.sqrt() } else { 0.0 }
}

/// As [`summarise`], the same operations in the same order.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn summarise_avx2(tables: &Tables, patch: &Patch, out: &mut Descriptor) {
    use std::arch::x86_64::*;
    // SAFETY: the slice holds eight elements, which the indexing checks.
    let load = |line: &[f32], i: usize| unsafe { _mm256_loadu_ps(line[i..i + 8].as_ptr()) };
    let sign = _mm256_set1_ps(-0.0);
    // By sub-region along y: the four sums of every column.
    let mut sums = [[[0.0f32; USED]; 4]; 4];
    for (r, sums) in sums.iter_mut().enumerate() {
        let (first, last) = tables.span[r];
        for i in [0, 8, 16] {
            let mut total = [_mm256_setzero_ps(); 4];
            let mut above = (load(&patch[first], i), load(&patch[first], i + 1));
            for j in first..last {
                let weight = _mm256_set1_ps(tables.region[r][j]);
                let below = (load(&patch[j + 1], i), load(&patch[j + 1], i + 1));
                let x = _mm256_sub_ps(_mm256_add_ps(above.1, below.1), _mm256_add_ps(above.0, below.0));
                let y = _mm256_add_ps(_mm256_sub_ps(below.1, above.1), _mm256_sub_ps(below.0, above.0));
                let (x, y) = (_mm256_mul_ps(x, weight), _mm256_mul_ps(y, weight));
                total[0] = _mm256_add_ps(total[0], x);
                total[1] = _mm256_add_ps(total[1], y);
                total[2] = _mm256_add_ps(total[2], _mm256_andnot_ps(sign, x));
                total[3] = _mm256_add_ps(total[3], _mm256_andnot_ps(sign, y));
                above = below;
            }
            for (sum, total) in sums.iter_mut().zip(total) {
                // SAFETY: eight elements of the slice just taken.
                unsafe { _mm256_storeu_ps(sum[i..i + 8].as_mut_ptr(), total) };
            }
        }
    }
    let mut squares = _mm_setzero_ps();
    let mut totals = [_mm_setzero_ps(); 16];
    for (r, sums) in sums.iter().enumerate() {
        for c in 0..4 {
            let weights = load(&tables.region[c], first_of(c));
            let half = |q: usize| {
                let lanes = _mm256_mul_ps(load(&sums[q], first_of(c)), weights);
                _mm_add_ps(_mm256_castps256_ps128(lanes), _mm256_extractf128_ps::<1>(lanes))
            };
            let pair = |a: __m128, b: __m128| _mm_add_ps(_mm_movelh_ps(a, b), _mm_movehl_ps(b, a));
            let (xy, sizes) = (pair(half(0), half(1)), pair(half(2), half(3)));
            let total = _mm_add_ps(_mm_shuffle_ps::<0x88>(xy, sizes), _mm_shuffle_ps::<0xdd>(xy, sizes));
            squares = _mm_add_ps(squares, _mm_mul_ps(total, total));
            totals[r * 4 + c] = total;
        }
    }
    let halves = _mm_add_ps(squares, _mm_movehl_ps(squares, squares));
    let scale = scale_of(_mm_cvtss_f32(_mm_add_ss(halves, _mm_shuffle_ps::<1>(halves, halves))));
    let scale = _mm_set1_ps(scale);
    for (four, total) in out.0.chunks_exact_mut(4).zip(totals) {
        // SAFETY: four elements of the slice just taken.
        unsafe { _mm_storeu_ps(four.as_mut_ptr(), _mm_mul_ps(total, scale)) };
    }
}
