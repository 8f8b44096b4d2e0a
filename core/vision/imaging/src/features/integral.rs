//! Integral images (summed-area tables; Viola and Jones 2001, used by SURF, Bay et al. 2008, section 3.1).

use crate::simd::{dispatch, grow};
use crate::{Parallel, SharedMut, Simd, View};

/// Rows per chunk.
const BAND_ROWS: usize = 32;

/// Sums of all pixels above and to the left: `at(x, y)` covers columns `0..x` and rows `0..y`.
///
/// Sums wrap at 2^32. Differences of four corners are still correct while one box sums to less than 2^32, so any image
/// size works.
#[derive(Clone, Debug, Default)]
pub struct Integral {
    data: Vec<u32>,
    carry: Vec<u32>,
    width: usize,
    height: usize,
    stride: usize,
}

impl Integral {
    /// An empty table.
    pub fn new() -> Self {
        Self::default()
    }

    /// Columns of the image (the table has one more).
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows of the image (the table has one more).
    pub fn height(&self) -> usize {
        self.height
    }

    /// The table's row `y` in `0..=height`: `width + 1` sums.
    pub fn row(&self, y: usize) -> &[u32] {
        &self.data[y * self.stride..y * self.stride + self.width + 1]
    }

    /// Sum of the pixels in columns `x0..x1`, rows `y0..y1`.
    ///
    /// # Panics
    /// When the box leaves the image.
    pub fn box_sum(&self, x0: usize, y0: usize, x1: usize, y1: usize) -> u32 {
        let (top, bottom) = (self.row(y0), self.row(y1));
        bottom[x1].wrapping_sub(bottom[x0]).wrapping_sub(top[x1]).wrapping_add(top[x0])
    }

    /// Fills the table from a gray image; memory is reused.
    pub fn compute(&mut self, image: View<'_, u8>, pool: &dyn Parallel) {
        self.compute_with(Simd::detect(), image, pool);
    }

    pub(crate) fn compute_with(&mut self, simd: Simd, image: View<'_, u8>, pool: &dyn Parallel) {
        let (width, height) = (image.width, image.height);
        let stride = (width + 1).next_multiple_of(8);
        (self.width, self.height, self.stride) = (width, height, stride);
        grow(&mut self.data, stride * (height + 1));
        self.data[..stride].fill(0);
        let bands = height.div_ceil(BAND_ROWS);
        grow(&mut self.carry, stride * bands.max(1));
        // Each band sums from its own first row; what lies above is added in the second loop.
        let table = SharedMut::new(&mut self.data[..stride * (height + 1)]);
        pool.run(bands, &|band| {
            let first = band * BAND_ROWS;
            let last = (first + BAND_ROWS).min(height);
            // SAFETY: bands own disjoint table rows `first + 1..=last`.
            let rows = unsafe { table.part((first + 1) * stride, (last - first) * stride) };
            for y in first..last {
                let (above, below) = rows.split_at_mut((y - first) * stride);
                let above = above.len().checked_sub(stride).map(|start| &above[start..start + width + 1]);
                sum_row(simd, image.row(y), image.channels, above, &mut below[..width + 1]);
            }
        });
        if bands < 2 {
            return;
        }
        for band in 1..bands {
            let (done, rest) = self.carry.split_at_mut(band * stride);
            let last = &self.data[band * BAND_ROWS * stride..][..width + 1];
            let target = &mut rest[..width + 1];
            if band == 1 {
                target.copy_from_slice(last);
            } else {
                let previous = &done[(band - 1) * stride..][..width + 1];
                for (sum, (&a, &b)) in target.iter_mut().zip(previous.iter().zip(last)) {
                    *sum = a.wrapping_add(b);
                }
            }
        }
        let table = SharedMut::new(&mut self.data[..stride * (height + 1)]);
        let carry = &self.carry;
        pool.run(bands - 1, &|index| {
            let band = index + 1;
            let first = band * BAND_ROWS;
            let base = &carry[band * stride..][..width + 1];
            for y in first..(first + BAND_ROWS).min(height) {
                // SAFETY: every table row belongs to one band.
                let row = unsafe { table.part((y + 1) * stride, width + 1) };
                dispatch!(simd, add_base(base: &[u32], row: &mut [u32]));
            }
        });
    }
}

#[inline(always)]
fn add_base(base: &[u32], row: &mut [u32]) {
    for (sum, &above) in row.iter_mut().zip(base) {
        *sum = sum.wrapping_add(above);
    }
}

fn sum_row(simd: Simd, pixels: &[u8], channels: usize, above: Option<&[u32]>, row: &mut [u32]) {
    row[0] = 0;
    let (mut sum, mut x) = (0u32, 0);
    let count = row.len() - 1;
    #[cfg(target_arch = "x86_64")]
    if simd.avx2() && channels == 1 {
        // SAFETY: `Simd` allows AVX2 only where the processor has it.
        (sum, x) = unsafe { sum_row_avx2(pixels, above, row) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = simd;
    while x < count {
        sum = sum.wrapping_add(u32::from(pixels[x * channels]));
        row[x + 1] = above.map_or(sum, |above| above[x + 1].wrapping_add(sum));
        x += 1;
    }
}

/// Sums whole vectors of 8 pixels; returns the row's sum so far and the pixels done.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn sum_row_avx2(pixels: &[u8], above: Option<&[u32]>, row: &mut [u32]) -> (u32, usize) {
    use std::arch::x86_64::*;
    let count = row.len() - 1;
    let mut carry = _mm256_setzero_si256();
    let mut x = 0;
    while x + 8 <= count {
        let source = pixels[x..x + 8].as_ptr();
        // SAFETY: 8 bytes of the slice just taken.
        let bytes = unsafe { _mm_loadl_epi64(source.cast()) };
        let mut sums = _mm256_cvtepu8_epi32(bytes);
        sums = _mm256_add_epi32(sums, _mm256_slli_si256::<4>(sums));
        sums = _mm256_add_epi32(sums, _mm256_slli_si256::<8>(sums));
        // The lower lane's total goes to every element of the upper lane.
        let low = _mm256_shuffle_epi32::<0xff>(_mm256_permute2x128_si256::<0x08>(sums, sums));
        let local = _mm256_add_epi32(sums, low);
        let total = _mm256_add_epi32(local, carry);
        carry = _mm256_add_epi32(carry, _mm256_permutevar8x32_epi32(local, _mm256_set1_epi32(7)));
        let result = match above {
            Some(above) => {
                let above = above[x + 1..x + 9].as_ptr();
                // SAFETY: 8 elements of the slice just taken.
                _mm256_add_epi32(total, unsafe { _mm256_loadu_si256(above.cast()) })
            }
            None => total,
        };
        let target = row[x + 1..x + 9].as_mut_ptr();
        // SAFETY: 8 elements of the slice just taken.
        unsafe { _mm256_storeu_si256(target.cast(), result) };
        x += 8;
    }
    (_mm256_cvtsi256_si32(carry) as u32, x)
}
