//! Gray images for feature detection: colour conversion and area-average shrinking.

use crate::simd::{dispatch, grow};
use crate::{Parallel, SharedMut, Simd, View};
use panoscope_base::gray::{convert_row, luma};

/// Rows per chunk of the loops of this file.
const BAND_ROWS: usize = 32;

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
            convert_row(simd, image.row(y), image.channels, row);
        }
    });
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
                convert_row(simd, source, image.channels, &mut gray[..span]);
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
