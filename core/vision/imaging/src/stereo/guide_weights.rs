//! Edge weights of a guide image: how strongly two neighbouring pixels hold together.

use crate::View;

/// Squared colour distance between `a` and `b`, pixel by pixel. One and three channels.
pub(crate) fn squared_distance(a: &[u8], b: &[u8], channels: usize, avx2: bool, out: &mut [f32]) {
    let mut done = 0;
    #[cfg(target_arch = "x86_64")]
    if avx2 {
        // SAFETY: the caller found AVX2.
        done = unsafe {
            if channels == 3 { avx2::squared_distance_bgr(a, b, out) } else { avx2::squared_distance_gray(a, b, out) }
        };
    }
    let _ = avx2;
    for x in done..out.len() {
        let mut sum = 0;
        for c in 0..channels {
            let d = i32::from(a[x * channels + c].abs_diff(b[x * channels + c]));
            sum += d * d;
        }
        out[x] = sum as f32;
    }
}

/// Turns squared distances into `exp(-distance / sigma)`, in place.
pub(crate) fn exponentials(values: &mut [f32], sigma: f32, avx2: bool) {
    #[cfg(target_arch = "x86_64")]
    if avx2 {
        // SAFETY: the caller found AVX2.
        unsafe { avx2::exponentials(values, sigma) };
        return;
    }
    let _ = avx2;
    exponentials_body(values, sigma);
}

#[inline(always)]
fn exponentials_body(values: &mut [f32], sigma: f32) {
    let factor = -std::f32::consts::LOG2_E / sigma;
    for value in values {
        *value = exp2_of_negative(value.sqrt() * factor);
    }
}

/// `2^x` for `x <= 0`, relative error below 1e-5; 0 below 2^-100. Plain multiplications and additions,
/// so that every instruction set gives the same bits.
#[inline(always)]
pub(crate) fn exp2_of_negative(x: f32) -> f32 {
    let x = x.max(-100.0);
    // SAFETY: `x` lies in -100..=0 (a NaN became -100 in `max`).
    let whole: i32 = unsafe { x.to_int_unchecked() };
    let t = (x - whole as f32) * std::f32::consts::LN_2;
    let series =
        1.0 + t * (1.0 + t * (0.5 + t * (1.0 / 6.0 + t * (1.0 / 24.0 + t * (1.0 / 120.0 + t * (1.0 / 720.0))))));
    let power = f32::from_bits(((whole + 127) << 23) as u32);
    series * power
}

/// Weights to the right and to the lower neighbour of every pixel of a rectangle, row-major; the last
/// column's and the last row's are 0.
pub(crate) fn weights_row(
    guide: View<'_, u8>,
    (x0, y, width): (usize, usize, usize),
    last_row: bool,
    sigma: f32,
    avx2: bool,
    right: &mut [f32],
    down: &mut [f32],
) {
    let channels = guide.channels;
    let row = &guide.row(y)[x0 * channels..(x0 + width) * channels];
    let n = width - 1;
    squared_distance(&row[..n * channels], &row[channels..], channels, avx2, &mut right[..n]);
    exponentials(&mut right[..n], sigma, avx2);
    right[n] = 0.0;
    if last_row {
        down.fill(0.0);
    } else {
        let below = &guide.row(y + 1)[x0 * channels..(x0 + width) * channels];
        squared_distance(row, below, channels, avx2, down);
        exponentials(down, sigma, avx2);
    }
}

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use std::arch::x86_64::*;

    #[target_feature(enable = "avx2")]
    pub(super) fn exponentials(values: &mut [f32], sigma: f32) {
        super::exponentials_body(values, sigma);
    }

    #[target_feature(enable = "avx2")]
    pub(super) fn squared_distance_gray(a: &[u8], b: &[u8], out: &mut [f32]) -> usize {
        for ((a, b), out) in a.iter().zip(b).zip(out.iter_mut()) {
            let d = i32::from(*a) - i32::from(*b);
            *out = (d * d) as f32;
        }
        out.len()
    }

    /// # Safety
    /// Needs AVX2.
    #[target_feature(enable = "avx2")]
    pub(super) unsafe fn squared_distance_bgr(a: &[u8], b: &[u8], out: &mut [f32]) -> usize {
        let bytes = a.len().min(b.len());
        let mut x = 0;
        let order = _mm256_broadcastsi128_si256(_mm_setr_epi8(0, 1, 2, -1, 3, 4, 5, -1, 6, 7, 8, -1, 9, 10, 11, -1));
        let zero = _mm256_setzero_si256();
        // Each group reads 28 bytes for its 24.
        while x + 8 <= out.len() && 3 * x + 28 <= bytes {
            let load = |source: &[u8]| {
                // SAFETY: bytes `3 x .. 3 x + 28` are inside both slices.
                let (low, high) = unsafe {
                    (
                        _mm_loadu_si128(source.as_ptr().add(3 * x).cast()),
                        _mm_loadu_si128(source.as_ptr().add(3 * x + 12).cast()),
                    )
                };
                _mm256_shuffle_epi8(_mm256_set_m128i(high, low), order)
            };
            let (p, q) = (load(a), load(b));
            let d = _mm256_or_si256(_mm256_subs_epu8(p, q), _mm256_subs_epu8(q, p));
            let low = _mm256_unpacklo_epi8(d, zero);
            let high = _mm256_unpackhi_epi8(d, zero);
            let sum = _mm256_hadd_epi32(_mm256_madd_epi16(low, low), _mm256_madd_epi16(high, high));
            // SAFETY: `x + 8 <= out.len()`.
            unsafe { _mm256_storeu_ps(out.as_mut_ptr().add(x), _mm256_cvtepi32_ps(sum)) };
            x += 8;
        }
        x
    }
}
