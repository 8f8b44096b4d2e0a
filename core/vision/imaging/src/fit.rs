//! Scales images into rectangles of other images.

use crate::grow::Grow;
use crate::{Simd, View, ViewMut};

/// Scales images into others; reuses its buffers.
#[derive(Debug, Default)]
pub struct Fit {
    simd: Simd,
    columns: Columns,
    /// Average of the source rows under one row.
    row: Vec<u8>,
    /// Sum of the source rows under one row.
    sums: Vec<u16>,
    grow: Grow,
}

impl Fit {
    /// Scales `picture` (1 channel gray, 3 BGR, 4 RGBA) to `width` x `height` at `(x, y)` of a BGR image: the mean of
    /// the source pixels under each pixel when it shrinks, between the nearest ones when an image in colour grows in
    /// both directions. Parts outside `out` are clipped.
    pub fn place(
        &mut self,
        out: &mut ViewMut<'_, u8>,
        picture: &View<'_, u8>,
        (x, y): (usize, usize),
        (width, height): (usize, usize),
    ) {
        let same = (width, height) == (picture.width, picture.height);
        let colored = picture.channels == 3 && out.channels == 3 && picture.width > 0 && picture.height > 0;
        // Sums of more rows than that could leave 16 bits.
        if same || !colored || picture.height > 256 * height {
            place(out, picture, x, y, width, height);
            return;
        }
        if width >= picture.width && height >= picture.height {
            self.grow.place(self.simd, out, picture, (x, y), (width, height));
            return;
        }
        let span = |at: usize, target: usize, source: usize| {
            let first = at * source / target;
            (first, ((at + 1) * source / target).max(first + 1) - 1)
        };
        let (right, bottom) = ((x + width).min(out.width).max(x), (y + height).min(out.height));
        self.columns.set((0..right - x).map(|at| span(at, width, picture.width)));
        let at_most_two = picture.width <= 2 * width && picture.height <= 2 * height;
        let mut held = None;
        for row in y..bottom {
            let (top, end) = span(row - y, height, picture.height);
            if held == Some((top, end)) {
                // A picture that grows shows the same row again.
                let above = (row - 1) * out.stride + x * 3;
                out.data.copy_within(above..above + (right - x) * 3, above + out.stride);
                continue;
            }
            held = Some((top, end));
            let target = &mut out.row_mut(row)[x * 3..right * 3];
            if at_most_two {
                self.average(picture.row(top), picture.row(end));
                pairs(self.simd, &self.row, &self.columns, target);
            } else {
                self.add(picture, top, end);
                means(self.simd, &self.sums, &self.columns, target, end + 1 - top);
            }
        }
    }

    fn average(&mut self, above: &[u8], below: &[u8]) {
        // One byte more: pixels are read as four bytes.
        self.row.resize(above.len() + 1, 0);
        for (mean, (&a, &b)) in self.row.iter_mut().zip(above.iter().zip(below)) {
            *mean = u16::midpoint(u16::from(a), u16::from(b) + 1) as u8;
        }
    }

    fn add(&mut self, picture: &View<'_, u8>, top: usize, end: usize) {
        let wide = |v: &u8| u16::from(*v);
        self.sums.clear();
        let first = picture.row(top);
        // Two or three rows at once: the usual shrinking, without a sum that is stored and read again.
        let next = match end - top {
            0 => {
                self.sums.extend(first.iter().map(wide));
                top + 1
            }
            1 => {
                let rows = first.iter().zip(picture.row(top + 1));
                self.sums.extend(rows.map(|(a, b)| wide(a) + wide(b)));
                top + 2
            }
            _ => {
                let rows = first.iter().zip(picture.row(top + 1)).zip(picture.row(top + 2));
                self.sums.extend(rows.map(|((a, b), c)| wide(a) + wide(b) + wide(c)));
                top + 3
            }
        };
        for row in next..=end {
            self.sums.iter_mut().zip(picture.row(row)).for_each(|(sum, v)| *sum += wide(v));
        }
        // Pixels are read as four values, and as many as three of them for each column.
        self.sums.extend([0; PADDING]);
    }
}

/// Source pixels of three bytes under each column.
#[derive(Debug, Default)]
struct Columns {
    /// First byte of the first pixel under each column, and of the last one.
    first: Vec<u32>,
    last: Vec<u32>,
    /// Maximum start of a pixel.
    latest: u32,
    /// Maximum number of pixels under one column.
    most: u32,
}

impl Columns {
    /// From the first and the last pixel under each column.
    fn set(&mut self, spans: impl Iterator<Item = (usize, usize)>) {
        self.first.clear();
        self.last.clear();
        (self.latest, self.most) = (0, 0);
        for (first, last) in spans {
            self.most = self.most.max((last - first) as u32 + 1);
            let [first, last] = [first, last].map(|pixel| 3 * pixel as u32);
            self.first.push(first);
            self.last.push(last);
            self.latest = self.latest.max(first).max(last);
        }
    }

    fn all(&self) -> impl Iterator<Item = (&u32, &u32)> {
        self.first.iter().zip(&self.last)
    }
}

/// The mean of one or two pixels of `row` under each column; it has one byte more than its pixels.
fn pairs(simd: Simd, row: &[u8], columns: &Columns, target: &mut [u8]) {
    #[cfg(target_arch = "x86_64")]
    let done = {
        let is_inside = columns.latest as usize + 4 <= row.len();
        // SAFETY: `Simd` allows AVX2 only where the processor has it, and four bytes at each position lie in the row.
        if simd.avx2() && is_inside { unsafe { pairs_avx2(row, columns, target) } } else { 0 }
    };
    #[cfg(not(target_arch = "x86_64"))]
    let done = 0;
    let _ = simd;
    let word = |at: u32| row[at as usize..].first_chunk().map_or(0, |four| u32::from_le_bytes(*four));
    let pixels = target.as_chunks_mut::<3>().0.iter_mut().skip(done);
    for (pixel, (first, last)) in pixels.zip(columns.all().skip(done)) {
        let (a, b) = (word(*first), word(*last));
        // The rounded mean of each byte.
        let mean = ((a | b) - (((a ^ b) >> 1) & 0x7f7f_7f7f)).to_le_bytes();
        *pixel = [mean[0], mean[1], mean[2]];
    }
}

/// The first pixels of [`pairs`], eight at a time; returns how many.
///
/// # Safety
/// The processor has AVX2, and `row` has four bytes at `columns.latest`.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
unsafe fn pairs_avx2(row: &[u8], columns: &Columns, target: &mut [u8]) -> usize {
    use std::arch::x86_64::*;
    let three_of_four =
        _mm256_broadcastsi128_si256(_mm_setr_epi8(0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, -1, -1, -1, -1));
    let mut done = 0;
    let eights = columns.first.as_chunks::<8>().0.iter().zip(columns.last.as_chunks::<8>().0);
    for (first, last) in eights {
        // Four bytes behind the eight pixels are written too; the next ones replace them.
        let Some(pixels) = target.get_mut(3 * done..3 * done + 28) else { break };
        // SAFETY: the arrays have eight positions, none later than `latest`, and `pixels` has 28 bytes.
        unsafe {
            let at = |positions: &[u32; 8]| {
                let positions = _mm256_loadu_si256(positions.as_ptr().cast());
                _mm256_i32gather_epi32::<1>(row.as_ptr().cast(), positions)
            };
            let mean = _mm256_shuffle_epi8(_mm256_avg_epu8(at(first), at(last)), three_of_four);
            _mm_storeu_si128(pixels.as_mut_ptr().cast(), _mm256_castsi256_si128(mean));
            _mm_storeu_si128(pixels.as_mut_ptr().add(12).cast(), _mm256_extracti128_si256::<1>(mean));
        }
        done += 8;
    }
    done
}

/// The mean of all pixels under each column, from the sums of `rows` rows, which have [`PADDING`] values behind the
/// last pixel.
fn means(simd: Simd, sums: &[u16], columns: &Columns, target: &mut [u8], rows: usize) {
    // Reciprocals of the usual counts of pixels.
    let shares = [1, 2, 3].map(|columns| share(rows * columns));
    #[cfg(target_arch = "x86_64")]
    let done = {
        let is_inside = columns.latest as usize + 3 + PADDING <= sums.len();
        let is_narrow = columns.most <= 3 && rows * columns.most as usize <= LANE_PIXELS;
        // SAFETY: `Simd` allows AVX2 only where the processor has it; three pixels behind each first one lie in the sums and their padding.
        if simd.avx2() && is_inside && is_narrow { unsafe { means_avx2(sums, columns, target, shares) } } else { 0 }
    };
    #[cfg(not(target_arch = "x86_64"))]
    let done = 0;
    let _ = simd;
    let pixels = target.as_chunks_mut::<3>().0.iter_mut().skip(done);
    for (pixel, (first, last)) in pixels.zip(columns.all().skip(done)) {
        let under = &sums[*first as usize..*last as usize + 4];
        let columns = under.len() / 3;
        if rows * columns > LANE_PIXELS {
            *pixel = wide_mean(under, rows);
            continue;
        }
        let share = shares.get(columns - 1).copied().unwrap_or_else(|| share(rows * columns));
        *pixel = packed_sum(under).map(|sum| ((sum * share + (1 << (SHARE_BITS - 1))) >> SHARE_BITS) as u8);
    }
}

/// The first pixels of [`means`], four at a time; returns how many.
///
/// # Safety
/// The processor has AVX2. At most three pixels lie under a column, their sums have 16 bits, and from the first one of
/// each column on `sums` has ten values.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
unsafe fn means_avx2(sums: &[u16], columns: &Columns, target: &mut [u8], shares: [u32; 3]) -> usize {
    use std::arch::x86_64::*;
    let three_of_four = _mm_setr_epi8(0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, -1, -1, -1, -1);
    let half = _mm256_set1_epi32(1 << (SHARE_BITS - 1));
    let [one, two, three] = shares.map(|share| _mm256_set1_epi64x(i64::from(share) << 32 | i64::from(share)));
    let mut done = 0;
    for (first, last) in columns.first.as_chunks::<4>().0.iter().zip(columns.last.as_chunks::<4>().0) {
        // Four bytes behind the four pixels are written too; the next ones replace them.
        let Some(pixels) = target.get_mut(3 * done..3 * done + 16) else { break };
        // SAFETY: arrays of four numbers; the caller promised the values that are read.
        let (first, last, pixel) = unsafe {
            let first = _mm_loadu_si128(first.as_ptr().cast());
            let last = _mm_loadu_si128(last.as_ptr().cast());
            let pixel = |n: i32| {
                let at = _mm_add_epi32(first, _mm_set1_epi32(3 * n));
                _mm256_i32gather_epi64::<2>(sums.as_ptr().cast(), at)
            };
            (first, last, [pixel(0), pixel(1), pixel(2)])
        };
        let beyond = _mm256_cvtepi32_epi64(_mm_sub_epi32(last, first));
        let (has_two, has_three) =
            (_mm256_cmpgt_epi64(beyond, _mm256_setzero_si256()), _mm256_cmpgt_epi64(beyond, _mm256_set1_epi64x(3)));
        let sum = _mm256_add_epi16(pixel[0], _mm256_and_si256(pixel[1], has_two));
        let sum = _mm256_add_epi16(sum, _mm256_and_si256(pixel[2], has_three));
        let share = _mm256_blendv_epi8(_mm256_blendv_epi8(one, two, has_two), three, has_three);
        let mean = |sum: __m256i, share: __m256i| {
            _mm256_srli_epi32::<{ SHARE_BITS as i32 }>(_mm256_add_epi32(_mm256_mullo_epi32(sum, share), half))
        };
        // Pixels 0 and 2, and 1 and 3; each takes four lanes.
        let low = mean(_mm256_unpacklo_epi16(sum, _mm256_setzero_si256()), _mm256_unpacklo_epi64(share, share));
        let high = mean(_mm256_unpackhi_epi16(sum, _mm256_setzero_si256()), _mm256_unpackhi_epi64(share, share));
        let words = _mm256_packus_epi32(low, high);
        let bytes = _mm_packus_epi16(_mm256_castsi256_si128(words), _mm256_extracti128_si256::<1>(words));
        // SAFETY: `pixels` has 16 bytes.
        unsafe { _mm_storeu_si128(pixels.as_mut_ptr().cast(), _mm_shuffle_epi8(bytes, three_of_four)) };
        done += 4;
    }
    done
}

/// Values behind the last pixel of sums.
const PADDING: usize = 7;

/// The reciprocal of a count of pixels.
fn share(count: usize) -> u32 {
    ((1 << SHARE_BITS) + count as u32 / 2) / count as u32
}

/// Binary places of the reciprocal of a count of pixels.
const SHARE_BITS: u32 = 20;
/// Number of 8-bit pixels whose sum fits into 16 bits.
const LANE_PIXELS: usize = 257;

/// Sums of the three channels of at most [`LANE_PIXELS`] pixels, one value behind them: all channels in one addition.
fn packed_sum(pixels: &[u16]) -> [u32; 3] {
    let mut sum = 0u64;
    for four in pixels.windows(4).step_by(3) {
        let word = four.iter().rev().fold(0, |word, v| word << 16 | u64::from(*v));
        sum = sum.wrapping_add(word);
    }
    [0, 16, 32].map(|shift| (sum >> shift) as u32 & 0xffff)
}

/// Means of the three channels of any number of columns that hold sums of `rows` pixels.
fn wide_mean(columns: &[u16], rows: usize) -> [u8; 3] {
    let columns = columns.as_chunks::<3>().0;
    let mut sum = [0u32; 3];
    for three in columns {
        sum.iter_mut().zip(three).for_each(|(s, v)| *s += u32::from(*v));
    }
    let share = 1.0 / (rows * columns.len()) as f32;
    sum.map(|s| (s as f32 * share + 0.5) as u8)
}

/// [`Fit::place`] for any number of channels and any scale.
fn place(out: &mut ViewMut<'_, u8>, picture: &View<'_, u8>, x: usize, y: usize, width: usize, height: usize) {
    if picture.width == 0 || picture.height == 0 || out.channels != 3 {
        return;
    }
    let (right, bottom) = ((x + width).min(out.width), (y + height).min(out.height));
    let same = (width, height) == (picture.width, picture.height);
    let order: [usize; 3] = match picture.channels {
        1 => [0, 0, 0],
        3 => [0, 1, 2],
        4 => [2, 1, 0],
        _ => return,
    };
    let channels = picture.channels;
    let span = |at: usize, target: usize, source: usize| {
        let start = at * source / target;
        (start, ((at + 1) * source / target).max(start + 1))
    };
    for row in y..bottom {
        let (top, end) = span(row - y, height, picture.height);
        let target = &mut out.row_mut(row)[x * 3..right.max(x) * 3];
        if same && channels == 3 {
            target.copy_from_slice(&picture.row(top)[..target.len()]);
            continue;
        }
        // Where a column's pixels begin, without a division for each: quotient and remainder step on together.
        let (whole, rest) = (picture.width / width, picture.width % width);
        let (mut left, mut over) = (0, 0);
        for pixel in target.as_chunks_mut::<3>().0 {
            let (mut next, mut next_over) = (left + whole, over + rest);
            if next_over >= width {
                (next, next_over) = (next + 1, next_over - width);
            }
            let stop = next.max(left + 1);
            let count = ((end - top) * (stop - left)) as u32;
            if count == 1 {
                let source = &picture.row(top)[left * channels..stop * channels];
                *pixel = order.map(|o| source[o]);
            } else {
                let mut sum = [0_u32; 3];
                for source_row in top..end {
                    for source in picture.row(source_row)[left * channels..stop * channels].chunks_exact(channels) {
                        for (s, o) in sum.iter_mut().zip(order) {
                            *s += u32::from(source[o]);
                        }
                    }
                }
                *pixel = match count {
                    2 => sum.map(|s| ((s + 1) >> 1) as u8),
                    4 => sum.map(|s| ((s + 2) >> 2) as u8),
                    _ => sum.map(|s| ((s + count / 2) / count) as u8),
                };
            }
            (left, over) = (next, next_over);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_base::random;

    #[test]
    fn shrinking_takes_the_mean() {
        let source = [0, 100, 50, 50];
        let mut out = [9; 2 * 2 * 3];
        place(&mut ViewMut::new(&mut out, 2, 2, 3), &View::new(&source, 2, 2, 1), 1, 1, 1, 1);
        assert_eq!(out[9..], [50, 50, 50]);
        assert_eq!(out[..9], [9; 9]);
        // RGBA becomes BGR, and what leaves the picture is cut.
        place(&mut ViewMut::new(&mut out, 2, 2, 3), &View::new(&[1, 2, 3, 255], 1, 1, 4), 1, 0, 5, 5);
        assert_eq!(out[3..6], [3, 2, 1]);
        assert_eq!(out[0..3], [9; 3]);
    }

    #[test]
    fn rows_and_columns_one_after_the_other_give_the_same_picture() {
        let source: Vec<u8> = (0..37 * 23 * 3).map(|i| random::mix(i) as u8).collect();
        let source = View::new(&source, 37, 23, 3);
        for (width, height) in [(37, 20), (30, 23), (19, 12), (50, 20), (36, 22), (17, 11), (9, 7), (40, 5), (1, 1)] {
            for simd in [Simd::detect(), Simd::portable()] {
                let mut outs = [vec![7u8; 60 * 50 * 3], vec![7u8; 60 * 50 * 3]];
                place(&mut ViewMut::new(&mut outs[0], 60, 50, 3), &source, 15, 13, width, height);
                let mut fit = Fit { simd, ..Fit::default() };
                fit.place(&mut ViewMut::new(&mut outs[1], 60, 50, 3), &source, (15, 13), (width, height));
                let apart = outs[0].iter().zip(&outs[1]).map(|(a, b)| a.abs_diff(*b)).max();
                assert!(apart <= Some(1), "{width}x{height}: {apart:?}");
            }
        }
    }

    #[test]
    fn both_paths_give_the_same_bytes() {
        let source: Vec<u8> = (0..61 * 23 * 3).map(|i| random::mix(i) as u8).collect();
        let source = View::new(&source, 61, 23, 3);
        for (x, (width, height)) in
            [(61, 20), (50, 40), (31, 12), (90, 23), (64, 30), (29, 11), (25, 9), (21, 20), (61, 8), (15, 5)]
                .into_iter()
                .enumerate()
        {
            // The last columns and rows leave the picture.
            let [vectors, plain] = [Simd::detect(), Simd::portable()].map(|simd| {
                let mut out = vec![7u8; 70 * 33 * 3];
                let mut fit = Fit { simd, ..Fit::default() };
                fit.place(&mut ViewMut::new(&mut out, 70, 33, 3), &source, (x, 2), (width, height));
                out
            });
            assert_eq!(vectors, plain, "{width}x{height}");
        }
    }
}
