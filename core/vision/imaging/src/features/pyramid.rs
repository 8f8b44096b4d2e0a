//! Image pyramid from which orientation and descriptor patches are sampled.
//!
//! SURF samples box filters of side `s` on the integral image. A pyramid level whose pixels are about
//! that large, read with bilinear interpolation, gives the same smoothed samples at any angle and
//! sub-pixel position for two gathers per eight samples.

use crate::simd::{dispatch, grow};
use crate::{Parallel, SharedMut, Simd, View};

const BAND_ROWS: usize = 32;
/// Levels: pixel sides of 1, 2, 4, 8 and 16 pixels.
pub(crate) const LEVELS: usize = 5;
/// Level values are gray levels times this.
pub(crate) const VALUE_SCALE: f32 = 16.0;

/// One level: 16-bit values, rows padded so that a vector load may exceed the end.
#[derive(Clone, Debug, Default)]
pub(crate) struct Level {
    pub data: Vec<u16>,
    pub width: usize,
    pub height: usize,
    pub stride: usize,
}

impl Level {
    fn resize(&mut self, width: usize, height: usize) {
        (self.width, self.height, self.stride) = (width, height, width + 2);
        // One more row: a sample on the last row reads the next one with weight zero. What sixteen pixels from its last one reach.
        grow(&mut self.data, self.stride * (height + 1) + 16);
    }
}

/// The levels of one image, with memory that is reused.
#[derive(Clone, Debug, Default)]
pub(crate) struct Pyramid {
    levels: [Level; LEVELS],
    used: usize,
}

impl Pyramid {
    /// Level `index`, or the coarsest there is.
    pub(crate) fn level(&self, index: usize) -> (&Level, usize) {
        let index = index.min(self.used.saturating_sub(1));
        (&self.levels[index], index)
    }

    /// Builds the levels of a gray image: binomial 3x3 at full size, then averages of 2x2.
    pub(crate) fn build(&mut self, simd: Simd, image: View<'_, u8>, pool: &dyn Parallel) {
        let (width, height) = (image.width, image.height);
        self.used = 0;
        if width == 0 || height == 0 {
            return;
        }
        self.levels[0].resize(width, height);
        let stride = self.levels[0].stride;
        let shared = SharedMut::new(&mut self.levels[0].data);
        pool.run(height.div_ceil(BAND_ROWS), &|band| {
            let first = band * BAND_ROWS;
            for y in first..(first + BAND_ROWS).min(height) {
                // SAFETY: every row is written by one band only.
                let out = unsafe { shared.part(y * stride, width) };
                let above = image.row(y.saturating_sub(1));
                let middle = image.row(y);
                let below = image.row((y + 1).min(height - 1));
                smooth_row(simd, above, middle, below, out);
            }
        });
        self.used = 1;
        while self.used < LEVELS {
            let (done, rest) = self.levels.split_at_mut(self.used);
            let (fine, coarse) = (&done[self.used - 1], &mut rest[0]);
            let (width, height) = (fine.width / 2, fine.height / 2);
            if width < 4 || height < 4 {
                break;
            }
            coarse.resize(width, height);
            let stride = coarse.stride;
            let shared = SharedMut::new(&mut coarse.data);
            pool.run(height.div_ceil(BAND_ROWS), &|band| {
                let first = band * BAND_ROWS;
                for y in first..(first + BAND_ROWS).min(height) {
                    // SAFETY: every row is written by one band only.
                    let out = unsafe { shared.part(y * stride, width) };
                    let above = &fine.data[2 * y * fine.stride..][..2 * width];
                    let below = &fine.data[(2 * y + 1) * fine.stride..][..2 * width];
                    dispatch!(simd, halve_row(above: &[u16], below: &[u16], out: &mut [u16]));
                }
            });
            self.used += 1;
        }
    }
}

fn smooth_row(simd: Simd, above: &[u8], middle: &[u8], below: &[u8], out: &mut [u16]) {
    let count = out.len();
    let (above, middle, below) = (&above[..count], &middle[..count], &below[..count]);
    let column = |x: usize| u16::from(above[x]) + 2 * u16::from(middle[x]) + u16::from(below[x]);
    if count == 1 {
        out[0] = column(0) * 4;
        return;
    }
    out[0] = column(0) * 3 + column(1);
    out[count - 1] = column(count - 1) * 3 + column(count - 2);
    #[cfg(target_arch = "x86_64")]
    let first = if simd.avx2() {
        // SAFETY: `Simd` allows AVX2 only where the processor has it.
        unsafe { smooth_row_avx2(above, middle, below, out) }
    } else {
        1
    };
    #[cfg(not(target_arch = "x86_64"))]
    let first = {
        let _ = simd;
        1
    };
    for x in first..count - 1 {
        out[x] = column(x - 1) + 2 * column(x) + column(x + 1);
    }
}

/// Smooths whole vectors of pixels from the second one on; returns the first pixel left over.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn smooth_row_avx2(above: &[u8], middle: &[u8], below: &[u8], out: &mut [u16]) -> usize {
    use std::arch::x86_64::*;
    let load = |line: &[u8], x: usize| {
        // SAFETY: sixteen bytes of the slice just taken.
        _mm256_cvtepu8_epi16(unsafe { _mm_loadu_si128(line[x..x + 16].as_ptr().cast()) })
    };
    let column = |x: usize| {
        let middle = load(middle, x);
        let outer = _mm256_add_epi16(load(above, x), load(below, x));
        _mm256_add_epi16(outer, _mm256_add_epi16(middle, middle))
    };
    let mut x = 1;
    while x + 17 <= out.len() {
        let centre = column(x);
        let sum = _mm256_add_epi16(_mm256_add_epi16(column(x - 1), column(x + 1)), _mm256_add_epi16(centre, centre));
        // SAFETY: sixteen elements of the slice just taken.
        unsafe { _mm256_storeu_si256(out[x..x + 16].as_mut_ptr().cast(), sum) };
        x += 16;
    }
    x
}

#[inline(always)]
fn halve_row(above: &[u16], below: &[u16], out: &mut [u16]) {
    for ((value, above), below) in out.iter_mut().zip(above.chunks_exact(2)).zip(below.chunks_exact(2)) {
        *value = (above[0] + above[1] + below[0] + below[1] + 2) >> 2;
    }
}
