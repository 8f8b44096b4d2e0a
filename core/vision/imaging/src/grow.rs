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
    weight: Vec<u8>,
    /// The same for vectors: whole groups of four columns.
    fours: Vec<Four>,
}

/// The bytes of four columns: for each the byte of the left pixel and of the right one. A column begins at most one pixel
/// behind the one before it, so that all of them are within [`PADDING`] bytes.
#[derive(Debug, Clone, Copy, Default)]
struct Four {
    /// First byte of the first column's left pixel.
    start: u32,
    /// Positions behind `start`: eight bytes of the target in 16, four in the next 8.
    places: [[u8; 2]; 16],
    /// Weights of both bytes.
    weights: [[u8; 2]; 16],
}

impl Columns {
    fn set(&mut self, columns: usize, target: usize, source: usize) {
        let places = || (0..columns).map(|column| between(column, target, source));
        self.first.clear();
        self.first.extend(places().map(|(left, _)| 3 * left as u32));
        self.weight.clear();
        self.weight.extend(places().map(|(_, weight)| weight as u8));
        self.fours.clear();
        let fours = self.first.as_chunks::<4>().0.iter().zip(self.weight.as_chunks::<4>().0);
        self.fours.extend(fours.map(|(first, weight)| {
            let mut four = Four { start: first[0], ..Four::default() };
            for byte in 0..12 {
                let (column, channel) = (byte / 3, byte % 3);
                let left = (first[column] - first[0]) as u8 + channel as u8;
                four.places[byte] = [left, left + 3];
                four.weights[byte] = [ONE as u8 - weight[column], weight[column]];
            }
            four
        }));
    }
}

/// Bytes behind a row: so many are read from each pixel on.
const PADDING: usize = 16;

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
        self.columns.set(right - x, width, picture.width);
        self.row.clear();
        self.row.resize(3 * picture.width + PADDING, 0);
        for row in y..bottom {
            let (first, weight) = between(row - y, height, picture.height);
            let (above, below) = (picture.row(first), picture.row((first + 1).min(picture.height - 1)));
            mix_rows(simd, &mut self.row, above, below, weight as u8);
            widen(simd, &self.row, &self.columns, &mut out.row_mut(row)[x * 3..right * 3]);
        }
    }
}

/// The row between `above` and `below`, which have at most as many bytes as `row`; `weight` is that of `below`.
fn mix_rows(simd: Simd, row: &mut [u8], above: &[u8], below: &[u8], weight: u8) {
    #[cfg(target_arch = "x86_64")]
    // SAFETY: `Simd` allows AVX2 only where the processor has it.
    let done = if simd.avx2() { unsafe { mix_rows_avx2(row, above, below, weight) } } else { 0 };
    #[cfg(not(target_arch = "x86_64"))]
    let done = 0;
    let _ = simd;
    let [keep, weight] = [ONE as u16 - u16::from(weight), u16::from(weight)];
    let bytes = above.iter().zip(below).skip(done);
    for (value, (a, b)) in row.iter_mut().skip(done).zip(bytes) {
        *value = ((u16::from(*a) * keep + u16::from(*b) * weight + 64) >> 7) as u8;
    }
}

/// The first bytes of [`mix_rows`], 32 at a time; returns how many.
///
/// # Safety
/// The processor has AVX2.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
unsafe fn mix_rows_avx2(row: &mut [u8], above: &[u8], below: &[u8], weight: u8) -> usize {
    use std::arch::x86_64::*;
    let weights = _mm256_set1_epi16(i16::from_le_bytes([ONE as u8 - weight, weight]));
    let rows = row.as_chunks_mut::<32>().0.iter_mut().zip(above.as_chunks::<32>().0).zip(below.as_chunks::<32>().0);
    let mut done = 0;
    for ((row, above), below) in rows {
        // SAFETY: arrays of 32 bytes.
        unsafe {
            let (a, b) = (_mm256_loadu_si256(above.as_ptr().cast()), _mm256_loadu_si256(below.as_ptr().cast()));
            let (low, high) = (_mm256_unpacklo_epi8(a, b), _mm256_unpackhi_epi8(a, b));
            let bytes = _mm256_packus_epi16(weighted(low, weights), weighted(high, weights));
            _mm256_storeu_si256(row.as_mut_ptr().cast(), bytes);
        }
        done += 32;
    }
    done
}

/// Rounded sums of each two bytes with their weights, which add up to [`ONE`], divided by it.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn weighted(bytes: std::arch::x86_64::__m256i, weights: std::arch::x86_64::__m256i) -> std::arch::x86_64::__m256i {
    use std::arch::x86_64::*;
    // A weight of 128 is no signed byte, so that the bytes are the signed ones: less 128 each, which 128 * 128 makes good.
    let sums = _mm256_maddubs_epi16(weights, _mm256_xor_si256(bytes, _mm256_set1_epi8(-128)));
    _mm256_srli_epi16::<7>(_mm256_add_epi16(sums, _mm256_set1_epi16(64 + 128 * 128)))
}

/// The pixels of `target` from those of `row`, which has [`PADDING`] bytes behind its pixels.
fn widen(simd: Simd, row: &[u8], columns: &Columns, target: &mut [u8]) {
    #[cfg(target_arch = "x86_64")]
    // SAFETY: `Simd` allows AVX2 only where the processor has it; each column begins at a pixel, and the row has `PADDING` bytes from there on.
    let done = if simd.avx2() { unsafe { widen_avx2(row, columns, target) } } else { 0 };
    #[cfg(not(target_arch = "x86_64"))]
    let done = 0;
    let _ = simd;
    let word =
        |at: usize| row.get(at..at + 4).and_then(|four| four.first_chunk()).map_or(0, |four| u32::from_le_bytes(*four));
    let places = columns.first.iter().zip(&columns.weight).skip(done);
    for (pixel, (at, weight)) in target.as_chunks_mut::<3>().0.iter_mut().skip(done).zip(places) {
        // Behind the last pixel are zeros, which have no weight.
        let [b, g, r, _] = mix(word(*at as usize), word(*at as usize + 3), u32::from(*weight)).to_le_bytes();
        *pixel = [b, g, r];
    }
}

/// The first pixels of [`widen`], four at a time; returns how many.
///
/// # Safety
/// The processor has AVX2, and `row` has [`PADDING`] bytes from each column's first one on.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
unsafe fn widen_avx2(row: &[u8], columns: &Columns, target: &mut [u8]) -> usize {
    use std::arch::x86_64::*;
    let mut done = 0;
    for four in &columns.fours {
        // Four bytes behind the four pixels are written too; the next ones replace them.
        let Some(pixels) = target.get_mut(3 * done..3 * done + 16) else { break };
        // SAFETY: the caller promised the bytes that are read; the arrays have 32 bytes, and `pixels` has 16.
        unsafe {
            let source = _mm_loadu_si128(row.as_ptr().add(four.start as usize).cast());
            let places = _mm256_loadu_si256(four.places.as_ptr().cast());
            let pairs = _mm256_shuffle_epi8(_mm256_broadcastsi128_si256(source), places);
            let values = weighted(pairs, _mm256_loadu_si256(four.weights.as_ptr().cast()));
            let bytes = _mm_packus_epi16(_mm256_castsi256_si128(values), _mm256_extracti128_si256::<1>(values));
            _mm_storeu_si128(pixels.as_mut_ptr().cast(), bytes);
        }
        done += 4;
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
