//! Enlarges images by bilinear interpolation.

use crate::{Simd, View, ViewMut};

/// Unit of weights, so that products of bytes and weights fit into 16 bits.
const ONE: u32 = 128;
const HALVES: u32 = 0x0040_0040;
const EVEN: u32 = 0x00ff_00ff;

/// Enlarges images of three bytes per pixel; reuses its buffers.
#[derive(Debug, Default)]
pub struct Grow {
    columns: Columns,
    /// One row between two of the source, and [`PADDING`] bytes behind it.
    row: Vec<u8>,
}

/// Positions of the columns between pixels of the source.
#[derive(Debug, Default)]
struct Columns {
    /// For each column the first byte of the pixel to its left.
    first: Vec<u32>,
    /// The weight of the pixel to its right.
    weight: Vec<u32>,
}

/// Bytes behind a row: four are read at each pixel and at the one behind it.
const PADDING: usize = 4;

/// The source pixel before the centre of pixel `at`, and the weight of the next one, for `source` pixels scaled to
/// `target`.
fn between(at: usize, target: usize, source: usize) -> (usize, u32) {
    // In 256ths of a source pixel, measured from the first one's middle.
    let place = ((2 * at + 1) * source * 128 / target).saturating_sub(128);
    let (first, weight) = (place / 256, (place % 256) as u32 / 2);
    if first + 1 < source { (first, weight) } else { (source - 1, 0) }
}

/// Interpolates four bytes between `a` and `b`.
fn mix(a: u32, b: u32, weight: u32) -> u32 {
    let even = ((a & EVEN) * (ONE - weight) + (b & EVEN) * weight + HALVES) >> 7 & EVEN;
    let odd = (((a >> 8) & EVEN) * (ONE - weight) + ((b >> 8) & EVEN) * weight + HALVES) >> 7 & EVEN;
    even | odd << 8
}

impl Grow {
    /// Puts `picture` at `(x, y)` of `out` as `width` x `height` pixels, at least its own size. Parts outside `out` are
    /// clipped.
    pub fn place(
        &mut self,
        simd: Simd,
        out: &mut ViewMut<'_, u8>,
        picture: &View<'_, u8>,
        (x, y): (usize, usize),
        (width, height): (usize, usize),
    ) {
        let (right, bottom) = ((x + width).min(out.width).max(x), (y + height).min(out.height));
        let Columns { first, weight } = &mut self.columns;
        first.clear();
        weight.clear();
        for column in 0..right - x {
            let (left, share) = between(column, width, picture.width);
            first.push(3 * left as u32);
            weight.push(share);
        }
        self.row.clear();
        self.row.resize(3 * picture.width + PADDING, 0);
        for row in y..bottom {
            let (first, weight) = between(row - y, height, picture.height);
            let (above, below) = (picture.row(first), picture.row((first + 1).min(picture.height - 1)));
            let [keep, weight] = [ONE - weight, weight].map(|weight| weight as u16);
            for (value, (a, b)) in self.row.iter_mut().zip(above.iter().zip(below)) {
                *value = ((u16::from(*a) * keep + u16::from(*b) * weight + 64) >> 7) as u8;
            }
            widen(simd, &self.row, &self.columns, &mut out.row_mut(row)[x * 3..right * 3]);
        }
    }
}

/// The pixels of `target` from those of `row`, which has [`PADDING`] bytes behind its pixels.
fn widen(simd: Simd, row: &[u8], columns: &Columns, target: &mut [u8]) {
    #[cfg(target_arch = "x86_64")]
    // SAFETY: `Simd` allows AVX2 only where the processor has it; each column begins at a pixel, and seven bytes from there on lie in the row: the pixel
    // and the padding.
    let done = if simd.avx2() { unsafe { widen_avx2(row, columns, target) } } else { 0 };
    #[cfg(not(target_arch = "x86_64"))]
    let done = 0;
    let _ = simd;
    let word =
        |at: usize| row.get(at..at + 4).and_then(|four| four.first_chunk()).map_or(0, |four| u32::from_le_bytes(*four));
    let places = columns.first.iter().zip(&columns.weight).skip(done);
    for (pixel, (at, weight)) in target.as_chunks_mut::<3>().0.iter_mut().skip(done).zip(places) {
        // Behind the last pixel are zeros, which have no weight.
        let [b, g, r, _] = mix(word(*at as usize), word(*at as usize + 3), *weight).to_le_bytes();
        *pixel = [b, g, r];
    }
}

/// The first pixels of [`widen`], eight at a time; returns how many.
///
/// # Safety
/// The processor has AVX2, and `row` has seven bytes from each column's first one on.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
unsafe fn widen_avx2(row: &[u8], columns: &Columns, target: &mut [u8]) -> usize {
    use std::arch::x86_64::*;
    let three_of_four =
        _mm256_broadcastsi128_si256(_mm_setr_epi8(0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, -1, -1, -1, -1));
    let (one, half, even) = (_mm256_set1_epi16(ONE as i16), _mm256_set1_epi16(64), _mm256_set1_epi16(0xff));
    let mut done = 0;
    for (first, weight) in columns.first.as_chunks::<8>().0.iter().zip(columns.weight.as_chunks::<8>().0) {
        // Four bytes behind the eight pixels are written too; the next ones replace them.
        let Some(pixels) = target.get_mut(3 * done..3 * done + 28) else { break };
        // SAFETY: arrays of eight numbers; the caller promised the bytes that are read, and `pixels` has 28.
        unsafe {
            let at = _mm256_loadu_si256(first.as_ptr().cast());
            let a = _mm256_i32gather_epi32::<1>(row.as_ptr().cast(), at);
            let b = _mm256_i32gather_epi32::<1>(row.as_ptr().cast(), _mm256_add_epi32(at, _mm256_set1_epi32(3)));
            let weight = _mm256_loadu_si256(weight.as_ptr().cast());
            let weight = _mm256_or_si256(weight, _mm256_slli_epi32::<16>(weight));
            let keep = _mm256_sub_epi16(one, weight);
            let mixed = |a: __m256i, b: __m256i| {
                let sum = _mm256_add_epi16(_mm256_mullo_epi16(a, keep), _mm256_mullo_epi16(b, weight));
                _mm256_srli_epi16::<7>(_mm256_add_epi16(sum, half))
            };
            let low = mixed(_mm256_and_si256(a, even), _mm256_and_si256(b, even));
            let high = mixed(_mm256_srli_epi16::<8>(a), _mm256_srli_epi16::<8>(b));
            let bytes = _mm256_shuffle_epi8(_mm256_or_si256(low, _mm256_slli_epi16::<8>(high)), three_of_four);
            _mm_storeu_si128(pixels.as_mut_ptr().cast(), _mm256_castsi256_si128(bytes));
            _mm_storeu_si128(pixels.as_mut_ptr().add(12).cast(), _mm256_extracti128_si256::<1>(bytes));
        }
        done += 8;
    }
    done
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_base::random;

    fn grown(source: &View<'_, u8>, size: (usize, usize)) -> Vec<u8> {
        let mut out = vec![0; size.0 * size.1 * 3];
        Grow::default().place(Simd::detect(), &mut ViewMut::new(&mut out, size.0, size.1, 3), source, (0, 0), size);
        out
    }

    #[test]
    fn a_ramp_stays_a_ramp() {
        let source: Vec<u8> = (0..20 * 10).flat_map(|i| [(10 * (i % 20)) as u8, (20 * (i / 20)) as u8, 77]).collect();
        let out = grown(&View::new(&source, 20, 10, 3), (50, 23));
        for (y, row) in out.chunks_exact(150).enumerate() {
            for (x, pixel) in row.as_chunks::<3>().0.iter().enumerate() {
                let place = |at: usize, target: f32, source: f32| {
                    ((at as f32 + 0.5) * source / target - 0.5).clamp(0.0, source - 1.0)
                };
                let want = [10.0 * place(x, 50.0, 20.0), 20.0 * place(y, 23.0, 10.0), 77.0];
                assert!(
                    pixel.iter().zip(want).all(|(p, w)| (f32::from(*p) - w).abs() < 1.1),
                    "{x} {y}: {pixel:?} {want:?}"
                );
            }
        }
    }

    #[test]
    fn the_same_size_is_the_same_picture_and_what_leaves_the_other_is_cut() {
        let source: Vec<u8> = (0..37 * 23 * 3).map(|i| random::mix(i) as u8).collect();
        let source = View::new(&source, 37, 23, 3);
        assert_eq!(grown(&source, (37, 23)), source.data);
        let whole = grown(&source, (60, 40));
        let mut out = vec![9; 50 * 30 * 3];
        Grow::default().place(Simd::detect(), &mut ViewMut::new(&mut out, 50, 30, 3), &source, (5, 3), (60, 40));
        for y in 0..30 {
            let row = &out[y * 150..(y + 1) * 150];
            assert!(row[..15].iter().all(|v| *v == 9));
            if y >= 3 {
                assert_eq!(row[15..], whole[(y - 3) * 180..(y - 3) * 180 + 135]);
            }
        }
        assert_eq!(grown(&View::new(&[1, 2, 3], 1, 1, 3), (2, 2)), [1, 2, 3].repeat(4));
    }

    #[test]
    fn both_paths_give_the_same_bytes() {
        let source: Vec<u8> = (0..61 * 23 * 3).map(|i| random::mix(i) as u8).collect();
        let source = View::new(&source, 61, 23, 3);
        for size in [(61, 23), (62, 23), (90, 40), (128, 46), (200, 24)] {
            let [vectors, plain] = [Simd::detect(), Simd::portable()].map(|simd| {
                let mut out = vec![7; 150 * 50 * 3];
                Grow::default().place(simd, &mut ViewMut::new(&mut out, 150, 50, 3), &source, (3, 2), size);
                out
            });
            assert_eq!(vectors, plain, "{size:?}");
        }
    }
}
