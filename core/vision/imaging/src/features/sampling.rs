//! Samples of a patch, at any angle.

use super::patch::{Grid, ROW, Start};
use super::pyramid::Level;
use super::upright;
use crate::Simd;

/// Reads `rows` rows of `vectors` x 8 samples; sample (i, j) is `(i - half, j - half)` steps from the centre.
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
        // SAFETY: `Simd` allows AVX2 only where the processor has it.
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
