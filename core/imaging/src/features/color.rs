//! Gray images for feature detection: colour conversion and area-average shrinking.

use super::simd::{Simd, dispatch, grow};
use crate::{Parallel, SharedMut, View, ViewMut};

/// Rows per chunk of the loops of this file.
const BAND_ROWS: usize = 32;

/// BT.601 luma in 15-bit fixed point, rounded, as OpenCV's `COLOR_BGR2GRAY` computes it.
const LUMA_B: u32 = 3735;
const LUMA_G: u32 = 19235;
const LUMA_R: u32 = 9798;

/// A gray image with its own memory, reused from frame to frame.
#[derive(Clone, Debug, Default)]
pub struct GrayBuffer {
    data: Vec<u8>,
    width: usize,
    height: usize,
}

impl GrayBuffer {
    /// An empty image.
    pub fn new() -> Self {
        Self::default()
    }

    /// The image (1 channel, no row padding).
    pub fn view(&self) -> View<'_, u8> {
        View::new(&self.data[..self.width * self.height], self.width, self.height, 1)
    }

    fn resize(&mut self, width: usize, height: usize) {
        grow(&mut self.data, width * height);
        self.width = width;
        self.height = height;
    }
}

/// Converts BGR (3 channels) or copies gray (1 channel) into `out`.
///
/// Fixed-point BT.601, bit-identical to OpenCV's 8-bit `COLOR_BGR2GRAY`. Other channel counts
/// take the first three channels as B, G, R (two channels: the first as gray).
pub fn gray_from(image: View<'_, u8>, out: &mut GrayBuffer, pool: &dyn Parallel) {
    gray_from_with(Simd::detect(), image, out, pool);
}

pub(crate) fn gray_from_with(simd: Simd, image: View<'_, u8>, out: &mut GrayBuffer, pool: &dyn Parallel) {
    let (width, height) = (image.width, image.height);
    out.resize(width, height);
    if width == 0 || height == 0 {
        return;
    }
    let shared = SharedMut::new(&mut out.data[..width * height]);
    pool.run(height.div_ceil(BAND_ROWS), &|band| {
        let first = band * BAND_ROWS;
        for y in first..(first + BAND_ROWS).min(height) {
            // SAFETY: every row is written by one band only.
            let row = unsafe { shared.part(y * width, width) };
            gray_row(simd, image.row(y), image.channels, row);
        }
    });
}

/// Converts BGR (3 channels) to gray, or copies gray (1 channel), into an image of the same size, on the calling thread.
///
/// # Panics
/// When the sizes differ or `out` has more than one channel.
pub fn bgr_to_gray(image: &View<'_, u8>, out: &mut ViewMut<'_, u8>) {
    assert!(image.width == out.width && image.height == out.height && out.channels == 1, "sizes differ");
    let simd = Simd::detect();
    for y in 0..image.height {
        gray_row(simd, image.row(y), image.channels, out.row_mut(y));
    }
}

fn gray_row(simd: Simd, source: &[u8], channels: usize, row: &mut [u8]) {
    match channels {
        1 => row.copy_from_slice(source),
        3 => {
            #[cfg(target_arch = "x86_64")]
            let done = if simd.avx2() {
                // SAFETY: `Simd` allows AVX2 only where the processor has it.
                unsafe { gray_row_avx2(source, row) }
            } else {
                0
            };
            #[cfg(not(target_arch = "x86_64"))]
            let done = {
                let _ = simd;
                0
            };
            for (pixel, bgr) in row[done..].iter_mut().zip(source[done * 3..].chunks_exact(3)) {
                *pixel = luma(bgr[0], bgr[1], bgr[2]);
            }
        }
        _ => {
            for (pixel, values) in row.iter_mut().zip(source.chunks_exact(channels.max(1))) {
                *pixel = if values.len() >= 3 { luma(values[0], values[1], values[2]) } else { values[0] };
            }
        }
    }
}

fn luma(b: u8, g: u8, r: u8) -> u8 {
    ((u32::from(b) * LUMA_B + u32::from(g) * LUMA_G + u32::from(r) * LUMA_R + (1 << 14)) >> 15) as u8
}

/// Converts as many pixels as whole vectors allow and returns how many.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn gray_row_avx2(source: &[u8], row: &mut [u8]) -> usize {
    use std::arch::x86_64::*;
    // Per 128-bit lane: 4 pixels of 3 bytes become 16-bit pairs (b, g) and (r, 1).
    let pick_bg = _mm256_broadcastsi128_si256(_mm_setr_epi8(0, -1, 1, -1, 3, -1, 4, -1, 6, -1, 7, -1, 9, -1, 10, -1));
    let pick_r =
        _mm256_broadcastsi128_si256(_mm_setr_epi8(2, -1, -1, -1, 5, -1, -1, -1, 8, -1, -1, -1, 11, -1, -1, -1));
    let one = _mm256_set1_epi32(1 << 16);
    let weight_bg = _mm256_set1_epi32((LUMA_B | (LUMA_G << 16)) as i32);
    let weight_r = _mm256_set1_epi32((LUMA_R | ((1 << 14) << 16)) as i32);
    let mut x = 0;
    // The last lane of a step reads 16 bytes from pixel 28, so 100 bytes must lie there.
    while x + 32 <= row.len() && (x * 3) + 100 <= source.len() {
        let base = source[x * 3..x * 3 + 100].as_ptr();
        let convert = |low: usize| {
            // SAFETY: low <= 12, so the reads end at byte (12 + 16) * 3 + 16 = 100 of the checked slice.
            let (near, far) = unsafe {
                (_mm_loadu_si128(base.add(low * 3).cast()), _mm_loadu_si128(base.add((low + 16) * 3).cast()))
            };
            let both = _mm256_set_m128i(far, near);
            let bg = _mm256_madd_epi16(_mm256_shuffle_epi8(both, pick_bg), weight_bg);
            let r = _mm256_madd_epi16(_mm256_or_si256(_mm256_shuffle_epi8(both, pick_r), one), weight_r);
            _mm256_srli_epi32::<15>(_mm256_add_epi32(bg, r))
        };
        let first = _mm256_packus_epi32(convert(0), convert(4));
        let second = _mm256_packus_epi32(convert(8), convert(12));
        let packed = _mm256_packus_epi16(first, second);
        let target = row[x..x + 32].as_mut_ptr();
        // SAFETY: 32 bytes of the slice just taken.
        unsafe { _mm256_storeu_si256(target.cast(), packed) };
        x += 32;
    }
    x
}

/// Area average of every `factor` x `factor` block of a gray image, rounded; remainders are dropped.
///
/// A view of 3 channels is converted to gray on the way. A factor of 0 counts as 1.
pub fn shrink_gray(image: View<'_, u8>, factor: usize, out: &mut GrayBuffer, pool: &dyn Parallel) {
    shrink_gray_with(Simd::detect(), image, factor, out, pool);
}

pub(crate) fn shrink_gray_with(
    simd: Simd,
    image: View<'_, u8>,
    factor: usize,
    out: &mut GrayBuffer,
    pool: &dyn Parallel,
) {
    if factor <= 1 {
        return gray_from_with(simd, image, out, pool);
    }
    let (width, height) = (image.width / factor, image.height / factor);
    out.resize(width, height);
    if width == 0 || height == 0 {
        return;
    }
    let shared = SharedMut::new(&mut out.data[..width * height]);
    pool.run(height.div_ceil(BAND_ROWS / 2), &|band| {
        let first = band * (BAND_ROWS / 2);
        for y in first..(first + BAND_ROWS / 2).min(height) {
            // SAFETY: every row is written by one band only.
            let row = unsafe { shared.part(y * width, width) };
            shrink_row(simd, image, y * factor, factor, row);
        }
    });
}

fn shrink_row(simd: Simd, image: View<'_, u8>, y: usize, factor: usize, row: &mut [u8]) {
    // Column sums of a tile live on the stack, so that no thread needs work memory.
    const TILE: usize = 512;
    let mut sums = [0u32; TILE];
    let mut gray = [0u8; TILE];
    let per_tile = (TILE / factor).max(1);
    let area = (factor * factor) as u32;
    for x in (0..row.len()).step_by(per_tile) {
        let count = per_tile.min(row.len() - x);
        if factor > TILE {
            // Blocks wider than a tile: plain sums.
            let sum: u64 = (0..factor)
                .flat_map(|dy| (0..factor).map(move |dx| (dx, dy)))
                .map(|(dx, dy)| u64::from(pixel(image, x * factor + dx, y + dy)))
                .sum();
            let area = (factor * factor) as u64;
            row[x] = ((sum + area / 2) / area) as u8;
            continue;
        }
        let span = count * factor;
        sums[..span].fill(0);
        for dy in 0..factor {
            let source = &image.row(y + dy)[x * factor * image.channels..(x * factor + span) * image.channels];
            let line = if image.channels == 1 {
                source
            } else {
                gray_row(simd, source, image.channels, &mut gray[..span]);
                &gray[..span]
            };
            let sums = &mut sums[..span];
            dispatch!(simd, add_row(line: &[u8], sums: &mut [u32]));
        }
        let (sums, target) = (&sums[..span], &mut row[x..x + count]);
        if factor == 2 {
            dispatch!(simd, mean_pairs(sums: &[u32], target: &mut [u8]));
        } else {
            for (pixel, block) in target.iter_mut().zip(sums.chunks_exact(factor)) {
                *pixel = ((block.iter().sum::<u32>() + area / 2) / area) as u8;
            }
        }
    }
}

fn pixel(image: View<'_, u8>, x: usize, y: usize) -> u8 {
    let start = x * image.channels;
    let values = &image.row(y)[start..start + image.channels];
    if values.len() >= 3 { luma(values[0], values[1], values[2]) } else { values[0] }
}

#[inline(always)]
fn add_row(line: &[u8], sums: &mut [u32]) {
    for (sum, &value) in sums.iter_mut().zip(line) {
        *sum += u32::from(value);
    }
}

#[inline(always)]
fn mean_pairs(sums: &[u32], target: &mut [u8]) {
    for (pixel, pair) in target.iter_mut().zip(sums.chunks_exact(2)) {
        *pixel = ((pair[0] + pair[1] + 2) >> 2) as u8;
    }
}
