//! Samples of a patch that is not turned: its columns lie at the same positions in every row.
//!
//! Sixteen pixels of two image rows are first blended into one line; eight samples are then picked from it by permuting
//! vectors. That needs no gather, which costs as much as a load for each element.

use super::patch::{Grid, ROW, Start};
use super::pyramid::Level;

/// Largest step, in pixels: eight samples and their neighbours then lie within sixteen pixels.
pub(super) const STEP_LIMIT: f32 = 2.0;

/// Row of a level at or above a place, and the share of the row below.
#[inline(always)]
fn row_of(start: &Start) -> (usize, f32) {
    let y = start.y.min(start.limit_y).max(0.0);
    let row = y as usize;
    (row, y - row as f32)
}

/// One row of samples without vectors.
pub(super) fn sample_line(level: &Level, start: Start, vectors: usize, line: &mut [f32; ROW]) {
    let (row, fy) = row_of(&start);
    let index = row * level.stride;
    for (i, value) in line.iter_mut().enumerate().take(vectors * 8) {
        let x = (start.x + i as f32 * start.ux).min(start.limit_x).max(0.0);
        let column = x as usize;
        let fx = x - column as f32;
        let blend = |place: usize| {
            let (upper, lower) = (f32::from(level.data[place]), f32::from(level.data[place + level.stride]));
            upper + (lower - upper) * fy
        };
        let (a, b) = (blend(index + column), blend(index + column + 1));
        *value = a + (b - a) * fx;
    }
}

/// All rows of samples.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
pub(super) fn sample_avx2(level: &Level, grid: Grid, half: f32, vectors: usize, out: &mut [[f32; ROW]]) {
    use std::arch::x86_64::*;
    const MAX_COUNT: usize = ROW / 8;
    assert!(vectors > 0 && vectors <= MAX_COUNT && level.width > 0 && level.height > 0);
    let first = Start::of(level, grid, half, 0);
    let ramp = _mm256_setr_ps(0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0);
    let (x0, ux) = (_mm256_set1_ps(first.x), _mm256_set1_ps(first.ux));
    // Of each vector of samples: its first pixel, pixels relative to that one, shares of the pixel to the right.
    let mut base = [0usize; MAX_COUNT];
    let mut pick = [_mm256_setzero_si256(); MAX_COUNT];
    let mut share = [_mm256_setzero_ps(); MAX_COUNT];
    for vector in 0..vectors {
        let i = _mm256_add_ps(ramp, _mm256_set1_ps((vector * 8) as f32));
        let x = _mm256_add_ps(x0, _mm256_mul_ps(i, ux));
        let x = _mm256_max_ps(_mm256_min_ps(x, _mm256_set1_ps(first.limit_x)), _mm256_setzero_ps());
        let column = _mm256_cvttps_epi32(x);
        let start = _mm256_cvtsi256_si32(column);
        base[vector] = start as usize;
        pick[vector] = _mm256_sub_epi32(column, _mm256_set1_epi32(start));
        share[vector] = _mm256_sub_ps(x, _mm256_cvtepi32_ps(column));
    }
    let (one, seven) = (_mm256_set1_epi32(1), _mm256_set1_epi32(7));
    for (j, samples) in out.iter_mut().enumerate() {
        let (row, fy) = row_of(&Start::of(level, grid, half, j));
        let fy = _mm256_set1_ps(fy);
        let begin = row * level.stride;
        let (upper, lower) = (&level.data[begin..], &level.data[begin + level.stride..]);
        for vector in 0..vectors {
            // Sixteen pixels, blended from two rows, hold eight samples and their neighbours to the right.
            let window = base[vector]..base[vector] + 16;
            let (upper, lower) = (&upper[window.clone()], &lower[window]);
            let blend = |k: usize| {
                let wide = |row: &[u16]| {
                    // SAFETY: eight 16-bit values of the slice just taken.
                    let values = unsafe { _mm_loadu_si128(row[k..k + 8].as_ptr().cast()) };
                    _mm256_cvtepi32_ps(_mm256_cvtepu16_epi32(values))
                };
                let (upper, lower) = (wide(upper), wide(lower));
                _mm256_add_ps(upper, _mm256_mul_ps(_mm256_sub_ps(lower, upper), fy))
            };
            let (near, next) = (blend(0), blend(8));
            let take = |pick: __m256i| {
                // A permutation looks at the low three bits of an index only.
                let far = _mm256_castsi256_ps(_mm256_cmpgt_epi32(pick, seven));
                let (near, next) = (_mm256_permutevar8x32_ps(near, pick), _mm256_permutevar8x32_ps(next, pick));
                _mm256_blendv_ps(near, next, far)
            };
            let (a, b) = (take(pick[vector]), take(_mm256_add_epi32(pick[vector], one)));
            let value = _mm256_add_ps(a, _mm256_mul_ps(_mm256_sub_ps(b, a), share[vector]));
            // SAFETY: eight elements of the slice just taken.
            unsafe { _mm256_storeu_ps(samples[vector * 8..vector * 8 + 8].as_mut_ptr(), value) };
        }
    }
}
