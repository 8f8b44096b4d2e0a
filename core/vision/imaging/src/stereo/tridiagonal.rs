//! Smoothing lines: `(I + strength * A) u = f` for every row, then for every column, of two planes at once.
//!
//! `A` is the Laplacian of one line, weighted by the guide. Each line is a tridiagonal system, solved
//! exactly by one sweep forward and one back; two right-hand sides share the factors.

use crate::stereo::scratch::Scratch;
use crate::{Parallel, SharedMut};

/// Columns that one chunk of the vertical pass owns: the strip's planes stay in the L2 cache between both sweeps.
const STRIP: usize = 32;
/// Rows that one chunk of the horizontal pass owns: two vectors of eight, whose chains overlap.
const ROWS: usize = 16;

/// The planes of a solve, all `width * height`, row-major.
pub(crate) struct Planes<'a> {
    pub width: usize,
    pub height: usize,
    pub first: &'a mut [f32],
    pub second: &'a mut [f32],
}

/// Solves along columns.
pub(crate) fn vertical(
    planes: &mut Planes<'_>,
    down: &[f32],
    strength: f32,
    scratch: &mut Scratch,
    avx2: bool,
    pool: &dyn Parallel,
) {
    let (width, height) = (planes.width, planes.height);
    let first = SharedMut::new(planes.first);
    let second = SharedMut::new(planes.second);
    let buffers = scratch.lend(STRIP * height, pool);
    pool.run(width.div_ceil(STRIP), &|chunk| {
        let x = chunk * STRIP;
        buffers.with(|factors| {
            let n = STRIP.min(width - x);
            #[cfg(target_arch = "x86_64")]
            if avx2 && n == STRIP {
                // SAFETY: the caller found AVX2; the strip's columns lie inside the planes and are this chunk's own.
                unsafe {
                    avx2::strip(first.address(x), second.address(x), &down[x..], (width, height), strength, factors)
                };
                return;
            }
            let _ = avx2;
            strip_body(Strip { x, n, width, height, first, second, down, strength, factors });
        });
    });
}

/// Columns `x..x + n` of the planes, which nobody else touches.
struct Strip<'a, 'b> {
    x: usize,
    n: usize,
    width: usize,
    height: usize,
    first: SharedMut<'a, f32>,
    second: SharedMut<'a, f32>,
    down: &'a [f32],
    strength: f32,
    /// `STRIP` for each row.
    factors: &'b mut [f32],
}

fn strip_body(strip: Strip<'_, '_>) {
    let Strip { x, n, width, height, first, second, down, strength, factors } = strip;
    #[inline(always)]
    fn part<'a>(plane: &SharedMut<'a, f32>, start: usize, n: usize) -> &'a mut [f32] {
        // SAFETY: the strip's columns are this chunk's own; each row is taken once at a time.
        unsafe { plane.part(start, n) }
    }
    let row = |y: usize| y * width + x;
    let mut before = [0.0; STRIP];
    for y in 0..height {
        let weights = &down[row(y)..row(y) + n];
        let (done, rest) = factors.split_at_mut(y * STRIP);
        let (f1, s1, c1) = (part(&first, row(y), n), part(&second, row(y), n), &mut rest[..n]);
        let none: &mut [f32] = &mut [];
        let (f0, s0, c0) = match y {
            0 => (none, &mut [][..], &[][..]),
            _ => (part(&first, row(y - 1), n), part(&second, row(y - 1), n), &done[(y - 1) * STRIP..][..n]),
        };
        forward(Forward { strength, weights, f0, s0, c0, f1, s1, c1, before: &mut before[..n] });
    }
    for y in (0..height.saturating_sub(1)).rev() {
        let (f0, s0) = (part(&first, row(y + 1), n), part(&second, row(y + 1), n));
        backward(&factors[y * STRIP..][..n], f0, s0, part(&first, row(y), n), part(&second, row(y), n));
    }
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

#[inline(always)]
fn forward(step: Forward<'_>) {
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

#[inline(always)]
fn backward(factors: &[f32], f0: &[f32], s0: &[f32], f1: &mut [f32], s1: &mut [f32]) {
    let n = factors.len();
    let (f0, s0, f1, s1) = (&f0[..n], &s0[..n], &mut f1[..n], &mut s1[..n]);
    for x in 0..n {
        f1[x] += factors[x] * f0[x];
        s1[x] += factors[x] * s0[x];
    }
}

/// Solves along rows.
pub(crate) fn horizontal(
    planes: &mut Planes<'_>,
    right: &[f32],
    strength: f32,
    scratch: &mut Scratch,
    avx2: bool,
    pool: &dyn Parallel,
) {
    let (width, height) = (planes.width, planes.height);
    let buffers = scratch.lend(3 * ROWS * width, pool);
    let first = SharedMut::new(planes.first);
    let second = SharedMut::new(planes.second);
    pool.run(height.div_ceil(ROWS), &|chunk| {
        let y = chunk * ROWS;
        let rows = ROWS.min(height - y);
        // SAFETY: each chunk owns its rows.
        let (f, s) = unsafe { (first.part(y * width, rows * width), second.part(y * width, rows * width)) };
        let weights = &right[y * width..(y + rows) * width];
        buffers.with(|work| {
            #[cfg(target_arch = "x86_64")]
            if avx2 && rows == ROWS && width >= 8 {
                // SAFETY: the caller found AVX2; lengths are `ROWS * width`.
                unsafe { avx2::rows(f, s, weights, strength, width, work) };
                return;
            }
            let _ = avx2;
            for row in 0..rows {
                let at = row * width..(row + 1) * width;
                solve_row(&mut f[at.clone()], &mut s[at.clone()], &weights[at], strength, &mut work[..width]);
            }
        });
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
    use super::{ROWS, STRIP};
    use std::arch::x86_64::*;

    /// Columns that the horizontal pass fetches ahead.
    const FETCH: usize = 32;
    /// Rows that the vertical pass fetches ahead: a step of a whole row is more than the processor foresees.
    const AHEAD: usize = 6;
    /// Vectors of a strip.
    const WIDE: usize = STRIP / 8;

    /// Solves the columns of one strip. The planes begin at its first column; rows are `width` apart.
    ///
    /// # Safety
    /// Needs AVX2; `STRIP` columns of `height` rows must lie inside both planes and be nobody else's.
    #[target_feature(enable = "avx2")]
    pub(super) unsafe fn strip(
        f: *mut f32,
        s: *mut f32,
        down: &[f32],
        (width, height): (usize, usize),
        strength: f32,
        factors: &mut [f32],
    ) {
        assert!(height > 0 && down.len() >= (height - 1) * width + STRIP && factors.len() >= height * STRIP);
        let (w, c) = (down.as_ptr(), factors.as_mut_ptr());
        let (zero, one, strength) = (_mm256_setzero_ps(), _mm256_set1_ps(1.0), _mm256_set1_ps(strength));
        let mut chains = [Chain { before: zero, c: zero, f: zero, s: zero }; WIDE];
        // SAFETY: rows stay below `height`, columns below `STRIP`; prefetching is a hint.
        unsafe {
            for y in 0..height {
                let ahead = (y + AHEAD).min(height - 1) * width;
                for plane in [f.cast_const(), s.cast_const(), w] {
                    for line in 0..STRIP / 16 {
                        _mm_prefetch::<{ _MM_HINT_T0 }>(plane.add(ahead + line * 16).cast());
                    }
                }
                for (v, chain) in chains.iter_mut().enumerate() {
                    let at = y * width + v * 8;
                    let next = _mm256_mul_ps(strength, _mm256_loadu_ps(w.add(at)));
                    *chain = chain.step(one, next, _mm256_loadu_ps(f.add(at)), _mm256_loadu_ps(s.add(at)));
                    _mm256_storeu_ps(c.add(y * STRIP + v * 8), chain.c);
                    _mm256_storeu_ps(f.add(at), chain.f);
                    _mm256_storeu_ps(s.add(at), chain.s);
                }
            }
            let mut later = chains.map(|chain| [chain.f, chain.s]);
            for y in (0..height - 1).rev() {
                for (v, later) in later.iter_mut().enumerate() {
                    let at = y * width + v * 8;
                    let c = _mm256_loadu_ps(c.add(y * STRIP + v * 8));
                    *later = [
                        _mm256_add_ps(_mm256_loadu_ps(f.add(at)), _mm256_mul_ps(c, later[0])),
                        _mm256_add_ps(_mm256_loadu_ps(s.add(at)), _mm256_mul_ps(c, later[1])),
                    ];
                    _mm256_storeu_ps(f.add(at), later[0]);
                    _mm256_storeu_ps(s.add(at), later[1]);
                }
            }
        }
    }

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

    /// State of the elimination in eight lines.
    #[derive(Clone, Copy)]
    struct Chain {
        before: __m256,
        c: __m256,
        f: __m256,
        s: __m256,
    }

    impl Chain {
        /// The same operations in the same order as `eliminate`.
        #[target_feature(enable = "avx2")]
        #[inline]
        fn step(self, one: __m256, next: __m256, f: __m256, s: __m256) -> Self {
            let bottom = _mm256_add_ps(_mm256_add_ps(one, next), self.before);
            let bottom = _mm256_sub_ps(bottom, _mm256_mul_ps(self.before, self.c));
            let inverse = _mm256_div_ps(one, bottom);
            Self {
                before: next,
                c: _mm256_mul_ps(next, inverse),
                f: _mm256_mul_ps(_mm256_add_ps(f, _mm256_mul_ps(self.before, self.f)), inverse),
                s: _mm256_mul_ps(_mm256_add_ps(s, _mm256_mul_ps(self.before, self.s)), inverse),
            }
        }
    }

    /// Solves sixteen rows: two groups of eight, side by side, so that one's division hides the other's.
    ///
    /// # Safety
    /// Needs AVX2; `f`, `s`, `weights` hold `ROWS * width` values, `work` three times that; `width >= 8`.
    #[target_feature(enable = "avx2")]
    pub(super) unsafe fn rows(
        f: &mut [f32],
        s: &mut [f32],
        weights: &[f32],
        strength: f32,
        width: usize,
        work: &mut [f32],
    ) {
        assert!(width >= 8 && f.len() >= ROWS * width && s.len() >= ROWS * width);
        assert!(weights.len() >= ROWS * width && work.len() >= 3 * ROWS * width);
        let (f, s, w) = (f.as_mut_ptr(), s.as_mut_ptr(), weights.as_ptr());
        let work = work.as_mut_ptr();
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
                // Sixteen rows of three planes are more streams than the processor follows by itself.
                if group % 2 == 0 && x0 + FETCH < width {
                    for plane in [f.cast_const(), s.cast_const(), w] {
                        for row in 0..ROWS {
                            _mm_prefetch::<{ _MM_HINT_T0 }>(plane.add(row * width + x0 + FETCH).cast());
                        }
                    }
                }
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
                        let next = _mm256_mul_ps(strength, loaded[half][2][column]);
                        let chain = chains[half].step(one, next, loaded[half][0][column], loaded[half][1][column]);
                        let to = work.add((x0 + column) * 48 + half * 24);
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
                        let from = work.add((x0 + column) * 48 + half * 24);
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
