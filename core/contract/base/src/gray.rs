//! Gray from colour, bit-identical to OpenCV's 8-bit `COLOR_BGR2GRAY`.

use crate::{Simd, View, ViewMut};

/// BT.601 luma in 15-bit fixed point, rounded, as OpenCV's `COLOR_BGR2GRAY` computes it.
const LUMA_B: u32 = 3735;
const LUMA_G: u32 = 19235;
const LUMA_R: u32 = 9798;

/// Converts BGR (3 channels) to gray, or copies gray (1 channel), into an image of the same size, on the calling
/// thread.
///
/// # Panics
/// When the sizes differ or `out` has more than one channel.
pub fn bgr_to_gray(image: &View<'_, u8>, out: &mut ViewMut<'_, u8>) {
    assert!(image.width == out.width && image.height == out.height && out.channels == 1, "sizes differ");
    let simd = Simd::detect();
    for y in 0..image.height {
        convert_row(simd, image.row(y), image.channels, out.row_mut(y));
    }
}

/// One row of [`bgr_to_gray`].
///
/// `source` holds `channels` bytes per pixel of `row`: one is copied, of two the first is gray, three and more start
/// with blue, green, red.
///
/// # Panics
/// With one channel when the lengths differ; with three when `source` is shorter than the row.
pub fn convert_row(simd: Simd, source: &[u8], channels: usize, row: &mut [u8]) {
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

/// Brightness of a colour (BT.601).
#[inline]
pub fn luma(b: u8, g: u8, r: u8) -> u8 {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_path_gives_the_same_gray() {
        let mut random = crate::random::SplitMix64(3);
        for width in [0, 1, 31, 32, 33, 35, 64, 97, 640] {
            let bgr: Vec<u8> = (0..width * 3).map(|_| random.below(256) as u8).collect();
            let expected: Vec<u8> = bgr.chunks_exact(3).map(|p| luma(p[0], p[1], p[2])).collect();
            for simd in [Simd::portable(), Simd::detect()] {
                let mut row = vec![0; width];
                convert_row(simd, &bgr, 3, &mut row);
                assert_eq!(row, expected, "{width} px, {simd:?}");
            }
        }
        assert_eq!((luma(0, 0, 0), luma(255, 255, 255), luma(255, 0, 0), luma(0, 0, 255)), (0, 255, 29, 76));
    }
}
