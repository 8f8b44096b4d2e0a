//! Colour images shrunk by a whole factor.

use crate::simd::dispatch;
use crate::{Parallel, SharedMut, Simd, View, ViewMut};

/// Rows of the small image per chunk.
const ROWS: usize = 16;
/// Values of a row that are summed per step; their sums are on the stack.
const TILE: usize = 3072;

/// Largest factor: sums of more pixels leave 16 bits.
pub const MAX_FACTOR: usize = 16;

/// A coordinate of a shrunk image in pixels of the large one: the middle of a block of pixels is that of the small
/// pixel.
pub fn enlarged_px(at: f64, factor: usize) -> f64 {
    (at + 0.5) * factor as f64 - 0.5
}

/// The inverse of [`enlarged_px`].
pub fn shrunk_px(at: f64, factor: usize) -> f64 {
    (at + 0.5) / factor as f64 - 0.5
}

/// Mean of every `factor` x `factor` block of an image, rounded, for each channel. Remainders at the right and at the
/// bottom are dropped.
///
/// # Panics
/// When `factor` is not in `1..=MAX_FACTOR`, or `out` has not the image's size divided by it and its channels.
pub fn shrink(picture: View<'_, u8>, factor: usize, out: ViewMut<'_, u8>, pool: &dyn Parallel) {
    shrink_with(Simd::detect(), picture, factor, out, pool);
}

fn shrink_with(simd: Simd, picture: View<'_, u8>, factor: usize, out: ViewMut<'_, u8>, pool: &dyn Parallel) {
    assert!((1..=MAX_FACTOR).contains(&factor), "a factor of {factor}");
    let (width, height, channels, stride) = (out.width, out.height, out.channels, out.stride);
    let fits = (width, height) == (picture.width / factor, picture.height / factor) && channels == picture.channels;
    assert!(fits, "{width}x{height} is not {}x{} / {factor}", picture.width, picture.height);
    let target = SharedMut::new(out.data);
    pool.run(height.div_ceil(ROWS), &|chunk| {
        for y in chunk * ROWS..(chunk * ROWS + ROWS).min(height) {
            // SAFETY: every row belongs to one chunk.
            let row = unsafe { target.part(y * stride, width * channels) };
            let rows = |dy: usize| picture.row(y * factor + dy);
            shrink_row(simd, &rows, factor, channels, row);
        }
    });
}

fn shrink_row<'p>(simd: Simd, rows: &dyn Fn(usize) -> &'p [u8], factor: usize, channels: usize, row: &mut [u8]) {
    let mut sums = [0_u16; TILE];
    let mut means = [0_u8; TILE];
    let block = factor * channels;
    let per_tile = TILE / block * channels;
    for (at, target) in row.chunks_mut(per_tile).enumerate() {
        let span = target.len() * factor;
        let source = at * per_tile * factor..at * per_tile * factor + span;
        let (sums, means) = (&mut sums[..span], &mut means[..span]);
        let line = |dy: usize| &rows(dy)[source.clone()];
        match factor {
            2 => {
                let lines = [line(0), line(1)];
                dispatch!(simd, two(lines: [&[u8]; 2], channels: usize, sums: &mut [u16], means: &mut [u8]));
            }
            3 => {
                let lines = [line(0), line(1), line(2)];
                dispatch!(simd, three(lines: [&[u8]; 3], channels: usize, sums: &mut [u16], means: &mut [u8]));
            }
            4 => {
                let lines = [line(0), line(1), line(2), line(3)];
                dispatch!(simd, four(lines: [&[u8]; 4], channels: usize, sums: &mut [u16], means: &mut [u8]));
            }
            _ => {
                sums.fill(0);
                for dy in 0..factor {
                    let line = line(dy);
                    dispatch!(simd, add(line: &[u8], sums: &mut [u16]));
                }
                let sums = &*sums;
                dispatch!(simd, mean(sums: &[u16], factor: usize, channels: usize, means: &mut [u8]));
            }
        }
        match channels {
            3 => pick::<3>(means, block, target),
            _ => (0..channels).for_each(|channel| {
                let means = means[channel..].iter().step_by(block);
                target[channel..].iter_mut().step_by(channels).zip(means).for_each(|(to, mean)| *to = *mean);
            }),
        }
    }
}

/// The pixel at the beginning of each block of `means`.
fn pick<const CHANNELS: usize>(means: &[u8], block: usize, target: &mut [u8]) {
    for (pixel, means) in target.as_chunks_mut::<CHANNELS>().0.iter_mut().zip(means.chunks_exact(block)) {
        if let Some(mean) = means.first_chunk() {
            *pixel = *mean;
        }
    }
}

#[inline(always)]
fn add(line: &[u8], sums: &mut [u16]) {
    for (sum, &value) in sums.iter_mut().zip(line) {
        *sum += u16::from(value);
    }
}

/// The mean of the block that begins at each value; only those at the beginning of a block are used.
#[inline(always)]
fn mean(sums: &[u16], factor: usize, channels: usize, means: &mut [u8]) {
    let block = factor * channels;
    let starts = sums.len() - block + channels;
    let area = (factor * factor) as f32;
    for (at, mean) in means[..starts].iter_mut().enumerate() {
        let sum: u16 = (0..factor).map(|dx| sums[at + dx * channels]).sum();
        // Exact: a quotient that is not a whole number is at least 1/256 away from one.
        *mean = ((f32::from(sum) + (area * 0.5).floor()) / area) as u8;
    }
}

#[inline(always)]
fn two(lines: [&[u8]; 2], channels: usize, sums: &mut [u16], means: &mut [u8]) {
    blocks(lines, channels, sums, means);
}

#[inline(always)]
fn three(lines: [&[u8]; 3], channels: usize, sums: &mut [u16], means: &mut [u8]) {
    blocks(lines, channels, sums, means);
}

#[inline(always)]
fn four(lines: [&[u8]; 4], channels: usize, sums: &mut [u16], means: &mut [u8]) {
    blocks(lines, channels, sums, means);
}

/// As [`add`] for all rows and then [`mean`], where the compiler knows the factor: many values at once, and no
/// division.
#[inline(always)]
fn blocks<const N: usize>(lines: [&[u8]; N], channels: usize, sums: &mut [u16], means: &mut [u8]) {
    const { assert!(N >= 2 && N <= 4, "beyond 4 the product below is not exact") }
    let count = sums.len();
    let lines = lines.map(|line| &line[..count]);
    for (at, sum) in sums.iter_mut().enumerate() {
        *sum = lines.iter().map(|line| u16::from(line[at])).sum();
    }
    let starts = count - (N - 1) * channels;
    let parts: [&[u16]; N] = std::array::from_fn(|dx| &sums[dx * channels..][..starts]);
    let (half, reciprocal) = ((N * N / 2) as u16, 65_536_u32.div_ceil((N * N) as u32));
    for (at, mean) in means[..starts].iter_mut().enumerate() {
        let sum: u16 = parts.iter().map(|part| part[at]).sum();
        *mean = ((u32::from(sum + half) * reciprocal) >> 16) as u8;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Serial;

    fn picture(width: usize, height: usize, channels: usize) -> Vec<u8> {
        (0..width * height * channels)
            .map(|i| (i as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15).to_le_bytes()[6])
            .collect()
    }

    #[test]
    fn each_pixel_is_the_rounded_mean_of_its_block() {
        for (width, height) in [(64, 33), (1920, 12), (37, 19)] {
            for channels in [1, 3, 4] {
                let data = picture(width, height, channels);
                let view = View::new(&data[..], width, height, channels);
                for factor in 1..=8 {
                    let (w, h) = (width / factor, height / factor);
                    let mut portable = vec![0; w * h * channels];
                    let mut chosen = portable.clone();
                    let out = |data| ViewMut::new(data, w, h, channels);
                    shrink_with(Simd::portable(), view, factor, out(&mut portable), &Serial);
                    shrink(view, factor, out(&mut chosen), &Serial);
                    assert!(portable == chosen, "{width}x{height}, {channels} channels, factor {factor}");
                    for (at, &mean) in chosen.iter().enumerate() {
                        let (x, y, c) = (at / channels % w, at / channels / w, at % channels);
                        let block = (0..factor * factor).map(|i| (x * factor + i % factor, y * factor + i / factor));
                        let sum: usize = block.map(|(x, y)| usize::from(view.row(y)[x * channels + c])).sum();
                        let area = factor * factor;
                        assert_eq!(usize::from(mean), (sum + area / 2) / area, "({x}, {y}) of factor {factor}");
                    }
                }
            }
        }
    }

    #[test]
    fn white_stays_white_at_the_largest_factor() {
        let data = [255; 48 * 48 * 3];
        let mut out = [0; 3 * 3 * 3];
        shrink(View::new(&data[..], 48, 48, 3), MAX_FACTOR, ViewMut::new(&mut out, 3, 3, 3), &Serial);
        assert_eq!(out, [255; 27]);
    }
}
