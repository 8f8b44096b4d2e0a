//! SURF descriptor of one keypoint, from samples of the image pyramid.
//!
//! Bay et al. 2008, section 4.2: Haar responses of side 2 s in a Gaussian-weighted window of 20 s give sums of dx, dy,
//! |dx|, |dy| over 4 x 4 sub-regions. Neighbouring sub-regions overlap (Agrawal, Konolige, Blas, "CenSurE", ECCV 2008,
//! section 3.4), so that a sample near a border does not jump between two of them.

use super::patch::{Grid, PATCH, Patch};
use super::pyramid::Pyramid;
use super::sampling::sample;
use crate::Simd;

/// Elements of a descriptor.
pub const DESCRIPTOR_LEN: usize = 64;

/// A descriptor of unit length (all zero if the image is flat), aligned to a cache line.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(64))]
pub struct Descriptor(pub [f32; DESCRIPTOR_LEN]);

impl Default for Descriptor {
    fn default() -> Self {
        Self([0.0; DESCRIPTOR_LEN])
    }
}

const WINDOW: usize = PATCH - 1;
/// Elements of a row that carry a sample, rounded up to vectors.
const USED: usize = 24;

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
/// outer ones distinguish more matches than they blur (measured on the Graffiti pair).
const WINDOW_SIGMA: f64 = 6.0;
/// Gaussian over one sub-region, and how far it reaches, in samples.
const REGION_SIGMA: f64 = 2.0;
const REGION_REACH: f64 = 3.0;
/// Relative size of the narrow window of the extended descriptor. On Graffiti and on fourteen warped photographs all
/// pairs of a narrow window of 0.5 to 0.8 and a wide one two to four times that gave more correct matches than 64
/// elements; these values are in the middle. Sums split by the sign of the other derivative (SURF-128 of Bay et al.)
/// gave fewer.
const NARROW: f32 = 0.6;
const WIDE: f32 = 1.8;
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
        // SAFETY: `Simd` allows AVX2 only where the processor has it.
        unsafe { summarise_avx2(tables, patch, out) };
        return;
    }
    summarise(tables, patch, out);
}

/// Extended descriptor of 128 elements: one of a narrow window, one of a wide one, together of unit length.
///
/// The narrow window distinguishes details and tolerates changes of viewpoint, the wide one distinguishes repeated
/// details by their surroundings. If one window is flat, only the other is used.
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

/// First sample in the vector of sub-region `r`, whose samples fit into eight lanes.
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

/// Factor that brings a descriptor with this sum of squares to unit length.
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
