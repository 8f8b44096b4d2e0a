//! Smoothing lines: `(I + strength * A) u = f` for every row, then for every column, of two planes at once.
//!
//! `A` is the Laplacian of one line, weighted by the guide. Each line is a tridiagonal system, solved
//! exactly by one sweep forward and one back; two right-hand sides share the factors.

use crate::{Parallel, SharedMut};

/// Columns that one chunk of the vertical pass owns; 64 keep a 480-row strip in the L2 cache.
const STRIP: usize = 64;
/// Rows that one chunk of the horizontal pass owns: two vectors of eight, whose chains overlap.
const ROWS: usize = 16;

/// The planes of a solve, all `width * height`, row-major.
pub(crate) struct Planes<'a> {
    pub width: usize,
    pub height: usize,
    pub first: &'a mut [f32],
    pub second: &'a mut [f32],
    /// Room for the factors.
    pub factors: &'a mut [f32],
}

/// Solves along columns.
pub(crate) fn vertical(planes: &mut Planes<'_>, down: &[f32], strength: f32, avx2: bool, pool: &dyn Parallel) {
    let (width, height) = (planes.width, planes.height);
    let first = SharedMut::new(planes.first);
    let second = SharedMut::new(planes.second);
    let factors = SharedMut::new(planes.factors);
    pool.run(width.div_ceil(STRIP), &|chunk| {
        let x = chunk * STRIP;
        let n = STRIP.min(width - x);
        fn part<'a>(plane: &SharedMut<'a, f32>, start: usize, n: usize) -> &'a mut [f32] {
            // SAFETY: each chunk takes parts of its own columns only, each row once at a time.
            unsafe { plane.part(start, n) }
        }
        let row = |y: usize| y * width + x;
        let mut before = [0.0; STRIP];
        for y in 0..height {
            let previous = y.saturating_sub(1);
            let weights = &down[y * width + x..y * width + x + n];
            let (f0, f1) = (if y > 0 { part(&first, row(previous), n) } else { &mut [] }, part(&first, row(y), n));
            let (s0, s1) = (if y > 0 { part(&second, row(previous), n) } else { &mut [] }, part(&second, row(y), n));
            let (c0, c1) = (if y > 0 { part(&factors, row(previous), n) } else { &mut [] }, part(&factors, row(y), n));
            let step = Forward { strength, weights, f0, s0, c0, f1, s1, c1, before: &mut before[..n] };
            forward(step, avx2);
        }
        for y in (0..height.saturating_sub(1)).rev() {
            let (f0, s0) = (part(&first, row(y + 1), n), part(&second, row(y + 1), n));
            backward(part(&factors, row(y), n), f0, s0, part(&first, row(y), n), part(&second, row(y), n), avx2);
        }
    });
}

struct Forward<'a> {
    strength: f32,
    weights: &'a [f32],
    f0: &'a [f32],
    s0: &'a [f32],
    c0: &'a [f32],
    f1: &'a mut [f32],
    s1: &'a mut [f32],
    c1: &'a mut [f32],
    /// Coupling to the row before, kept from step to step.
    before: &'a mut [f32],
}

fn forward(step: Forward<'_>, avx2: bool) {
    #[cfg(target_arch = "x86_64")]
    if avx2 {
        // SAFETY: the caller found AVX2.
        unsafe { forward_avx2(step) };
        return;
    }
    let _ = avx2;
    forward_body(step);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn forward_avx2(step: Forward<'_>) {
    forward_body(step);
}

#[inline(always)]
fn forward_body(step: Forward<'_>) {
    let n = step.weights.len();
    let (f1, s1, c1, before) = (&mut step.f1[..n], &mut step.s1[..n], &mut step.c1[..n], &mut step.before[..n]);
    let weights = &step.weights[..n];
    if step.f0.is_empty() {
        for x in 0..n {
            let next = step.strength * weights[x];
            let inverse = 1.0 / (1.0 + next);
            c1[x] = next * inverse;
            f1[x] *= inverse;
            s1[x] *= inverse;
            before[x] = next;
        }
        return;
    }
    let (f0, s0, c0) = (&step.f0[..n], &step.s0[..n], &step.c0[..n]);
    for x in 0..n {
        (c1[x], f1[x], s1[x], before[x]) =
            eliminate(before[x], step.strength * weights[x], c0[x], f0[x], s0[x], f1[x], s1[x]);
    }
}

/// One step of the elimination: factor, both right-hand sides, and the coupling to carry on.
#[inline(always)]
fn eliminate(before: f32, next: f32, c0: f32, f0: f32, s0: f32, f1: f32, s1: f32) -> (f32, f32, f32, f32) {
    let inverse = 1.0 / (1.0 + next + before - before * c0);
    (next * inverse, (f1 + before * f0) * inverse, (s1 + before * s0) * inverse, next)
}

fn backward(factors: &[f32], f0: &[f32], s0: &[f32], f1: &mut [f32], s1: &mut [f32], avx2: bool) {
    #[cfg(target_arch = "x86_64")]
    if avx2 {
        // SAFETY: the caller found AVX2.
        unsafe { backward_avx2(factors, f0, s0, f1, s1) };
        return;
    }
    let _ = avx2;
    backward_body(factors, f0, s0, f1, s1);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn backward_avx2(factors: &[f32], f0: &[f32], s0: &[f32], f1: &mut [f32], s1: &mut [f32]) {
    backward_body(factors, f0, s0, f1, s1);
}

#[inline(always)]
fn backward_body(factors: &[f32], f0: &[f32], s0: &[f32], f1: &mut [f32], s1: &mut [f32]) {
    let n = factors.len();
    let (f0, s0, f1, s1) = (&f0[..n], &s0[..n], &mut f1[..n], &mut s1[..n]);
    for x in 0..n {
        f1[x] += factors[x] * f0[x];
        s1[x] += factors[x] * s0[x];
    }
}

/// Solves along rows. `factors` of the planes serves as room for the transposed lines.
pub(crate) fn horizontal(
    planes: &mut Planes<'_>,
    right: &[f32],
    strength: f32,
    scratch: &mut Vec<f32>,
    avx2: bool,
    pool: &dyn Parallel,
) {
    let (width, height) = (planes.width, planes.height);
    let chunks = height.div_ceil(ROWS);
    let room = 3 * ROWS * width;
    scratch.resize(chunks * room, 0.0);
    let scratch = SharedMut::new(scratch);
    let first = SharedMut::new(planes.first);
    let second = SharedMut::new(planes.second);
    pool.run(chunks, &|chunk| {
        let y = chunk * ROWS;
        let rows = ROWS.min(height - y);
        // SAFETY: each chunk owns its rows and its room.
        let (f, s, room) = unsafe {
            (
                first.part(y * width, rows * width),
                second.part(y * width, rows * width),
                scratch.part(chunk * room, room),
            )
        };
        let weights = &right[y * width..(y + rows) * width];
        #[cfg(target_arch = "x86_64")]
        if avx2 && rows == ROWS && width >= 8 {
            // SAFETY: the caller found AVX2; lengths are `ROWS * width`.
            unsafe { avx2::rows(f, s, weights, strength, width, room) };
            return;
        }
        let _ = avx2;
        for row in 0..rows {
            let at = row * width..(row + 1) * width;
            solve_row(&mut f[at.clone()], &mut s[at.clone()], &weights[at], strength, &mut room[..width]);
        }
    });
}

fn solve_row(f: &mut [f32], s: &mut [f32], weights: &[f32], strength: f32, factors: &mut [f32]) {
    let n = f.len();
    let mut before = strength * weights[0];
    let inverse = 1.0 / (1.0 + before);
    factors[0] = before * inverse;
    f[0] *= inverse;
    s[0] *= inverse;
    for x in 1..n {
        (factors[x], f[x], s[x], before) =
            eliminate(before, strength * weights[x], factors[x - 1], f[x - 1], s[x - 1], f[x], s[x]);
    }
    for x in (0..n - 1).rev() {
        f[x] += factors[x] * f[x + 1];
        s[x] += factors[x] * s[x + 1];
    }
}

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use super::ROWS;
    use std::arch::x86_64::*;

    /// Loads eight columns of eight rows, one vector per column.
    #[target_feature(enable = "avx2")]
    #[inline]
    unsafe fn load_columns(base: *const f32, stride: usize) -> [__m256; 8] {
        // SAFETY: the caller has eight rows of eight values from `base` on.
        transpose(std::array::from_fn(|row| unsafe { _mm256_loadu_ps(base.add(row * stride)) }))
    }

    #[target_feature(enable = "avx2")]
    #[inline]
    fn transpose(r: [__m256; 8]) -> [__m256; 8] {
        let t: [__m256; 8] = [
            _mm256_unpacklo_ps(r[0], r[1]),
            _mm256_unpackhi_ps(r[0], r[1]),
            _mm256_unpacklo_ps(r[2], r[3]),
            _mm256_unpackhi_ps(r[2], r[3]),
            _mm256_unpacklo_ps(r[4], r[5]),
            _mm256_unpackhi_ps(r[4], r[5]),
            _mm256_unpacklo_ps(r[6], r[7]),
            _mm256_unpackhi_ps(r[6], r[7]),
        ];
        let u = [
            _mm256_shuffle_ps::<0x44>(t[0], t[2]),
            _mm256_shuffle_ps::<0xee>(t[0], t[2]),
            _mm256_shuffle_ps::<0x44>(t[1], t[3]),
            _mm256_shuffle_ps::<0xee>(t[1], t[3]),
            _mm256_shuffle_ps::<0x44>(t[4], t[6]),
            _mm256_shuffle_ps::<0xee>(t[4], t[6]),
            _mm256_shuffle_ps::<0x44>(t[5], t[7]),
            _mm256_shuffle_ps::<0xee>(t[5], t[7]),
        ];
        [
            _mm256_permute2f128_ps::<0x20>(u[0], u[4]),
            _mm256_permute2f128_ps::<0x20>(u[1], u[5]),
            _mm256_permute2f128_ps::<0x20>(u[2], u[6]),
            _mm256_permute2f128_ps::<0x20>(u[3], u[7]),
            _mm256_permute2f128_ps::<0x31>(u[0], u[4]),
            _mm256_permute2f128_ps::<0x31>(u[1], u[5]),
            _mm256_permute2f128_ps::<0x31>(u[2], u[6]),
            _mm256_permute2f128_ps::<0x31>(u[3], u[7]),
        ]
    }

    /// State of the elimination in eight rows.
    #[derive(Clone, Copy)]
    struct Chain {
        before: __m256,
        c: __m256,
        f: __m256,
        s: __m256,
    }

    /// Solves sixteen rows: two groups of eight, side by side, so that one's division hides the other's.
    ///
    /// # Safety
    /// Needs AVX2; `f`, `s`, `weights` hold `ROWS * width` values, `room` three times that; `width >= 8`.
    #[target_feature(enable = "avx2")]
    pub(super) unsafe fn rows(
        f: &mut [f32],
        s: &mut [f32],
        weights: &[f32],
        strength: f32,
        width: usize,
        room: &mut [f32],
    ) {
        assert!(width >= 8 && f.len() >= ROWS * width && s.len() >= ROWS * width);
        assert!(weights.len() >= ROWS * width && room.len() >= 3 * ROWS * width);
        let (f, s, w) = (f.as_mut_ptr(), s.as_mut_ptr(), weights.as_ptr());
        let room = room.as_mut_ptr();
        let zero = _mm256_setzero_ps();
        let one = _mm256_set1_ps(1.0);
        let strength = _mm256_set1_ps(strength);
        let mut chains = [Chain { before: zero, c: zero, f: zero, s: zero }; 2];
        // The last group may overlap the one before it; columns done already are skipped.
        let groups = width.div_ceil(8);
        // SAFETY: rows are `width` apart and there are sixteen; columns stay below `width`.
        unsafe {
            for group in 0..groups {
                let x0 = (group * 8).min(width - 8);
                let skip = group * 8 - x0;
                let mut loaded = [[[zero; 8]; 3]; 2];
                for (half, planes) in loaded.iter_mut().enumerate() {
                    let at = half * 8 * width + x0;
                    *planes = [
                        load_columns(f.add(at), width),
                        load_columns(s.add(at), width),
                        load_columns(w.add(at), width),
                    ];
                }
                for column in skip..8 {
                    for half in 0..2 {
                        let chain = chains[half];
                        let next = _mm256_mul_ps(strength, loaded[half][2][column]);
                        // The same operations in the same order as `eliminate`.
                        let mut bottom = _mm256_add_ps(one, next);
                        bottom = _mm256_add_ps(bottom, chain.before);
                        bottom = _mm256_sub_ps(bottom, _mm256_mul_ps(chain.before, chain.c));
                        let inverse = _mm256_div_ps(one, bottom);
                        let value_f = _mm256_add_ps(loaded[half][0][column], _mm256_mul_ps(chain.before, chain.f));
                        let value_s = _mm256_add_ps(loaded[half][1][column], _mm256_mul_ps(chain.before, chain.s));
                        let chain = Chain {
                            before: next,
                            c: _mm256_mul_ps(next, inverse),
                            f: _mm256_mul_ps(value_f, inverse),
                            s: _mm256_mul_ps(value_s, inverse),
                        };
                        let to = room.add((x0 + column) * 48 + half * 24);
                        _mm256_storeu_ps(to, chain.c);
                        _mm256_storeu_ps(to.add(8), chain.f);
                        _mm256_storeu_ps(to.add(16), chain.s);
                        chains[half] = chain;
                    }
                }
            }
            let mut later = [[zero; 2]; 2];
            for group in (0..groups).rev() {
                let x0 = group * 8;
                let columns = 8.min(width - x0);
                let mut solved = [[[zero; 8]; 2]; 2];
                for column in (0..columns).rev() {
                    for half in 0..2 {
                        let from = room.add((x0 + column) * 48 + half * 24);
                        let c = _mm256_loadu_ps(from);
                        let value_f = _mm256_add_ps(_mm256_loadu_ps(from.add(8)), _mm256_mul_ps(c, later[half][0]));
                        let value_s = _mm256_add_ps(_mm256_loadu_ps(from.add(16)), _mm256_mul_ps(c, later[half][1]));
                        later[half] = [value_f, value_s];
                        solved[half][0][column] = value_f;
                        solved[half][1][column] = value_s;
                    }
                }
                for half in 0..2 {
                    for (plane, values) in [f, s].into_iter().zip(solved[half]) {
                        for (row, values) in transpose(values).into_iter().enumerate() {
                            let to = plane.add((half * 8 + row) * width + x0);
                            if columns == 8 {
                                _mm256_storeu_ps(to, values);
                            } else {
                                let mut part = [0.0; 8];
                                _mm256_storeu_ps(part.as_mut_ptr(), values);
                                std::ptr::copy_nonoverlapping(part.as_ptr(), to, columns);
                            }
                        }
                    }
                }
            }
        }
    }
}
