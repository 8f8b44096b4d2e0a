//! Blending in the zone around the seam (Burt and Adelson 1983), on the difference of the two images.
//!
//! With D = first - second, blending both pyramids with weights W and 1 - W equals second + collapse(W_l * D_l): one
//! pyramid instead of two, and none where only one image is shown.

use super::pyramid::{self, LANES, PAD};
use super::warp::Pixels;
use crate::{Parallel, SharedMut};

/// Maximum number of chunks of a level's rows. Independent of the number of threads.
const CHUNKS: usize = 16;

/// Receives a zone row: its index, the blended values and the differences.
pub type WriteRow<'a> = dyn Fn(usize, &[i16], &[i16]) + Sync + 'a;

/// Rows that share one active range.
pub const RANGE_ROWS: usize = 16;

/// Columns of a zone, per block of [`RANGE_ROWS`] rows, in which weights can differ from zero and one.
///
/// Level 0 is processed only inside these columns; the coarser levels outside repeat the border values.
#[derive(Clone, Debug, Default)]
pub struct Ranges {
    width: usize,
    list: Vec<(usize, usize)>,
}

impl Ranges {
    /// Reserves memory for zones of up to `rows` rows.
    pub fn reserve(&mut self, rows: usize) {
        self.list.reserve(rows.div_ceil(RANGE_ROWS).saturating_sub(self.list.len()));
    }

    /// Sets the ranges of a zone of `width` columns and `rows` rows; `active` gives the columns of the rows
    /// `start..end`, or `None` for all.
    pub fn set(&mut self, width: usize, rows: usize, active: impl Fn(usize, usize) -> Option<(usize, usize)>) {
        self.width = width;
        self.list.clear();
        for block in 0..rows.div_ceil(RANGE_ROWS) {
            let (a, b) = active(block * RANGE_ROWS, (block * RANGE_ROWS + RANGE_ROWS).min(rows)).unwrap_or((0, width));
            // Even borders: a coarser pixel is never cut in two.
            let (a, b) = (a / 8 * 8, (b.div_ceil(8) * 8).min(width));
            self.list.push(if a < b { (a, b) } else { (0, width) });
        }
    }

    /// Columns of row `y` that are blended.
    pub fn active(&self, y: usize) -> (usize, usize) {
        self.list[y / RANGE_ROWS]
    }

    /// Columns of row `y` whose differences must be known, for the filters of this and the neighbouring blocks.
    pub fn needed(&self, y: usize) -> (usize, usize) {
        let block = y / RANGE_ROWS;
        let near = &self.list[block.saturating_sub(1)..(block + 2).min(self.list.len())];
        let (a, b) = near.iter().fold((self.width, 0), |(a, b), r| (a.min(r.0), b.max(r.1)));
        (a.saturating_sub(2 * PAD), (b + 2 * PAD).min(self.width))
    }
}

/// Pyramids of one blend zone.
#[derive(Debug, Default)]
pub struct Blender {
    sizes: Vec<(usize, usize)>,
    fine: Vec<Vec<i16>>,
    blended: Vec<Vec<i16>>,
    /// Weights of level 0 in one lane, where only they are blurred; so are those of the levels above.
    weights: Vec<i16>,
    scratch: Vec<i16>,
    scratch_row: usize,
}

fn split(rows: usize) -> (usize, usize) {
    let per = rows.div_ceil(CHUNKS).max(8);
    (rows.div_ceil(per), per)
}

/// Grows a work buffer; existing elements are unchanged.
fn at_least<T: Copy + Default>(buffer: &mut Vec<T>, len: usize) {
    if buffer.len() < len {
        buffer.resize(len, T::default());
    }
}

impl Blender {
    /// Reserves memory for zones of up to `width` x `height` pixels, so that a seam that moves allocates nothing.
    pub fn reserve(&mut self, width: usize, height: usize, levels: usize) {
        let (mut w, mut h) = (width, height);
        for level in 0..=levels {
            if self.fine.len() <= level {
                self.fine.push(Vec::new());
                self.blended.push(Vec::new());
            }
            let (fine, blended) = (&mut self.fine[level], &mut self.blended[level]);
            fine.reserve((w * h * LANES).saturating_sub(fine.len()));
            if level > 0 {
                blended.reserve((w * h * LANES).saturating_sub(blended.len()));
            }
            (w, h) = (w.div_ceil(2), h.div_ceil(2));
        }
        self.weights.reserve((width * height).saturating_sub(self.weights.len()));
        self.sizes.reserve((levels + 1).saturating_sub(self.sizes.len()));
        let scratch = CHUNKS * 3 * (width + 2 * PAD + 2) * LANES;
        self.scratch.reserve(scratch.saturating_sub(self.scratch.len()));
    }

    /// Prepares buffers for a zone of `width` x `height` pixels and `levels` halvings.
    pub fn reset(&mut self, width: usize, height: usize, levels: usize) {
        self.sizes.clear();
        let (mut w, mut h) = (width, height);
        for level in 0..=levels {
            self.sizes.push((w, h));
            if self.fine.len() <= level {
                self.fine.push(Vec::new());
                self.blended.push(Vec::new());
            }
            at_least(&mut self.fine[level], w * h * LANES);
            if level > 0 {
                at_least(&mut self.blended[level], w * h * LANES);
            }
            (w, h) = (w.div_ceil(2), h.div_ceil(2));
        }
        self.scratch_row = (width + 2 * PAD + 2) * LANES;
        at_least(&mut self.scratch, CHUNKS * 3 * self.scratch_row);
    }

    /// Level 0: four lanes per pixel, rows without padding. To be filled before [`Blender::build`].
    pub fn differences(&mut self) -> &mut [i16] {
        let (w, h) = self.sizes[0];
        &mut self.fine[0][..w * h * LANES]
    }

    /// As [`Blender::differences`], with a row of work memory.
    pub fn differences_and_row(&mut self) -> (&mut [i16], &mut [i16]) {
        let (w, h) = self.sizes[0];
        (&mut self.fine[0][..w * h * LANES], &mut self.scratch[..w * LANES])
    }

    /// Builds the levels, and collapses them down to level 1. With `bands == false` only the weights are blurred
    /// (feather).
    pub fn build(&mut self, bands: bool, ranges: &Ranges, pool: &dyn Parallel, avx2: bool) {
        if self.sizes.len() == 1 {
            return;
        }
        if bands {
            self.build_of::<LANES>(ranges, pool, avx2);
        } else {
            self.take_weights(ranges, pool, avx2);
            self.build_of::<1>(ranges, pool, avx2);
        }
    }

    /// Fills `weights` where the filters read them.
    fn take_weights(&mut self, ranges: &Ranges, pool: &dyn Parallel, avx2: bool) {
        let (w, h) = self.sizes[0];
        at_least(&mut self.weights, w * h);
        let (source, target) = (&self.fine[0], SharedMut::new(&mut self.weights));
        let (chunks, per) = split(h);
        pool.run(chunks, &|chunk| {
            for y in chunk * per..(chunk * per + per).min(h) {
                let (a, b) = ranges.needed(y);
                // SAFETY: row y belongs to this chunk alone.
                let out = unsafe { target.part(y * w + a, b - a) };
                pyramid::weights_of(&source[(y * w + a) * LANES..(y * w + b) * LANES], out, avx2);
            }
        });
    }

    /// Builds the levels of `N` lanes: all of them, or the weights alone.
    fn build_of<const N: usize>(&mut self, ranges: &Ranges, pool: &dyn Parallel, avx2: bool) {
        let top = self.sizes.len() - 1;
        for level in 0..top {
            self.down::<N>(level, (level == 0).then_some(ranges), pool, avx2);
        }
        let (w, h) = self.sizes[top];
        let (fine, blended) = (&self.fine[top][..w * h * N], &mut self.blended[top][..w * h * N]);
        if N == LANES {
            pyramid::weigh(fine, fine, blended, avx2);
        } else {
            blended.copy_from_slice(fine);
        }
        for level in (1..top).rev() {
            self.up::<N>(level, pool, avx2);
        }
    }

    fn down<const N: usize>(&mut self, level: usize, ranges: Option<&Ranges>, pool: &dyn Parallel, avx2: bool) {
        let ((w, h), (cw, ch)) = (self.sizes[level], self.sizes[level + 1]);
        let (head, tail) = self.fine.split_at_mut(level + 1);
        let source = if N == 1 && level == 0 { &self.weights } else { &head[level] };
        let target = SharedMut::new(&mut tail[0]);
        let halve = if N == 1 { pyramid::horizontal_down_one } else { pyramid::horizontal_down };
        let scratch = SharedMut::new(&mut self.scratch);
        let row_len = self.scratch_row;
        let (chunks, per) = split(ch);
        pool.run(chunks, &|chunk| {
            // SAFETY: each chunk has its own scratch rows.
            let tmp = unsafe { scratch.part(chunk * 3 * row_len, row_len) };
            for y in chunk * per..(chunk * per + per).min(ch) {
                let (a, b) = ranges.map_or((0, w), |r| r.active(2 * y));
                let (low, high) = (a.saturating_sub(PAD), (b + PAD).min(w));
                let row = |d: isize| {
                    let y = (2 * y as isize + d).clamp(0, h as isize - 1) as usize;
                    &source[(y * w + low) * N..(y * w + high) * N]
                };
                let rows = [row(-2), row(-1), row(0), row(1), row(2)];
                pyramid::vertical_down(rows, &mut tmp[(PAD + low) * N..(PAD + high) * N], avx2);
                pyramid::pad_row::<N>(tmp, low, high, w);
                // SAFETY: row y belongs to this chunk alone.
                let out = unsafe { target.part(y * cw * N, cw * N) };
                let (a, b) = (a / 2, b.div_ceil(2));
                halve(&tmp[2 * a * N..], &mut out[a * N..b * N], avx2);
                let out = out.as_chunks_mut::<N>().0;
                let (first, last) = (out[a], out[b - 1]);
                out[..a].fill(first);
                out[b..].fill(last);
            }
        });
    }

    fn up<const N: usize>(&mut self, level: usize, pool: &dyn Parallel, avx2: bool) {
        let (w, h) = self.sizes[level];
        let (head, tail) = self.blended.split_at_mut(level + 1);
        let (target, coarse_blended) = (SharedMut::new(&mut head[level]), &tail[0]);
        let (fine, coarse) = (&self.fine[level], &self.fine[level + 1]);
        let coarse_size = self.sizes[level + 1];
        let scratch = SharedMut::new(&mut self.scratch);
        let row_len = self.scratch_row;
        let (chunks, per) = split(h);
        pool.run(chunks, &|chunk| {
            // SAFETY: each chunk has its own scratch rows.
            let tmp = unsafe { scratch.part(chunk * 3 * row_len, 2 * row_len) };
            let (tmp, wide) = tmp.split_at_mut(row_len);
            for y in chunk * per..(chunk * per + per).min(h) {
                // SAFETY: row y belongs to this chunk alone.
                let out = unsafe { target.part(y * w * N, w * N) };
                expand::<N>(coarse_blended, coarse_size, y, 0, tmp, out, avx2);
                if N == LANES {
                    let wide = &mut wide[..w * N];
                    expand::<N>(coarse, coarse_size, y, 0, tmp, wide, avx2);
                    pyramid::add_band(&fine[y * w * N..(y + 1) * w * N], wide, out, avx2);
                }
            }
        });
    }

    /// Collapses level 0 row by row: `write(y, blended, differences)` gets the active columns of zone row `y`, four
    /// lanes per pixel.
    pub fn finish(&mut self, bands: bool, ranges: &Ranges, pool: &dyn Parallel, avx2: bool, write: &WriteRow) {
        let (w, h) = self.sizes[0];
        let top = self.sizes.len() - 1;
        let (fine, coarse, blended, coarse_size) = if top == 0 {
            (&self.fine[0], &self.fine[0], &self.fine[0], (w, h))
        } else {
            (&self.fine[0], &self.fine[1], &self.blended[1], self.sizes[1])
        };
        let scratch = SharedMut::new(&mut self.scratch);
        let row_len = self.scratch_row;
        let (chunks, per) = split(h);
        pool.run(chunks, &|chunk| {
            // SAFETY: each chunk has its own scratch rows.
            let part = unsafe { scratch.part(chunk * 3 * row_len, 3 * row_len) };
            let (tmp, rest) = part.split_at_mut(row_len);
            let (wide, out) = rest.split_at_mut(row_len);
            for y in chunk * per..(chunk * per + per).min(h) {
                let (a, b) = ranges.active(y);
                let out = &mut out[..(b - a) * LANES];
                let row = &fine[(y * w + a) * LANES..(y * w + b) * LANES];
                if top == 0 {
                    pyramid::weigh(row, row, out, avx2);
                } else if bands {
                    let wide = &mut wide[..(b - a) * LANES];
                    expand::<LANES>(blended, coarse_size, y, a, tmp, out, avx2);
                    expand::<LANES>(coarse, coarse_size, y, a, tmp, wide, avx2);
                    pyramid::add_band(row, wide, out, avx2);
                } else {
                    let wide = &mut wide[..b - a];
                    expand::<1>(blended, coarse_size, y, a, tmp, wide, avx2);
                    pyramid::weigh_by_one(row, wide, out, avx2);
                }
                write(y, out, row);
            }
        });
    }
}

/// Row `y` of the level below `coarse`, doubled in both directions, from column `from` (even) on.
fn expand<const N: usize>(
    coarse: &[i16],
    (w, h): (usize, usize),
    y: usize,
    from: usize,
    tmp: &mut [i16],
    out: &mut [i16],
    avx2: bool,
) {
    let first = from / 2;
    let (low, high) = (first.saturating_sub(PAD), (first + (out.len() / N).div_ceil(2) + PAD).min(w));
    let row = |y: usize| &coarse[(y * w + low) * N..(y * w + high) * N];
    let (c, n) = (y / 2, (y / 2 + 1).min(h - 1));
    let centre = &mut tmp[(PAD + low) * N..(PAD + high) * N];
    if y.is_multiple_of(2) {
        pyramid::vertical_even(row(c.saturating_sub(1)), row(c), row(n), centre, avx2);
    } else {
        pyramid::vertical_odd(row(c), row(n), centre, avx2);
    }
    pyramid::pad_row::<N>(tmp, low, high, w);
    let double = if N == 1 { pyramid::horizontal_up_one } else { pyramid::horizontal_up };
    double(&tmp[first * N..], out, avx2);
}

/// Writes `8 * (base - pixels)` and the weight; `base` is BGR and gives the number of pixels.
pub fn difference(base: &[u8], pixels: &Pixels, weight: i16, out: &mut [i16], avx2: bool) {
    let count = base.len() / 3;
    let mut i = 0;
    #[cfg(target_arch = "x86_64")]
    if avx2 {
        assert!(count * LANES <= out.len() && count * 4 <= pixels.0.len());
        // SAFETY: the caller found AVX2 on this CPU; the lengths were checked at the start of this function.
        i = unsafe { difference_avx2(base, pixels, weight, out) };
    }
    let _ = avx2;
    while i < count {
        for c in 0..3 {
            out[LANES * i + c] = (i16::from(base[3 * i + c]) - i16::from(pixels.0[4 * i + c])) * 8;
        }
        out[LANES * i + 3] = weight;
        i += 1;
    }
}

/// # Safety
/// `out` and `pixels` must hold `base.len() / 3` pixels.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
unsafe fn difference_avx2(base: &[u8], pixels: &Pixels, weight: i16, out: &mut [i16]) -> usize {
    use std::arch::x86_64::*;
    let widen = _mm_setr_epi8(0, 1, 2, -1, 3, 4, 5, -1, 6, 7, 8, -1, 9, 10, 11, -1);
    // Lane 3 of the pixels' difference is zero on both sides.
    let weight = _mm256_set1_epi64x(i64::from(weight) << 48);
    let mut i = 0;
    while 3 * i + 16 <= base.len() {
        // SAFETY: 16 bytes of `base` from 3 i on exist, so pixels i..i+4 do in the others.
        unsafe {
            let a = _mm_shuffle_epi8(_mm_loadu_si128(base.as_ptr().add(3 * i).cast()), widen);
            let b = _mm_loadu_si128(pixels.0.as_ptr().add(4 * i).cast());
            let d = _mm256_sub_epi16(_mm256_cvtepu8_epi16(a), _mm256_cvtepu8_epi16(b));
            let d = _mm256_or_si256(_mm256_slli_epi16(d, 3), weight);
            _mm256_storeu_si256(out.as_mut_ptr().add(LANES * i).cast(), d);
        }
        i += 4;
    }
    i
}

/// Adds `(blended - differences) / 8` (or `blended / 8` when `subtract` is false) to BGR pixels.
pub fn apply(out: &mut [u8], blended: &[i16], differences: &[i16], subtract: bool, avx2: bool) {
    let count = out.len() / 3;
    assert!(count * LANES <= blended.len() && count * LANES <= differences.len());
    let mut i = 0;
    #[cfg(target_arch = "x86_64")]
    if avx2 {
        // SAFETY: the caller found AVX2 on this CPU; the lengths were checked at the start of this function.
        i = unsafe { apply_avx2(out, blended, differences, subtract) };
    }
    let _ = avx2;
    while i < count {
        for c in 0..3 {
            let d = if subtract { differences[LANES * i + c] } else { 0 };
            let delta = blended[LANES * i + c].wrapping_sub(d).wrapping_add(4) >> 3;
            out[3 * i + c] = (i16::from(out[3 * i + c]) + delta).clamp(0, 255) as u8;
        }
        i += 1;
    }
}

/// # Safety
/// The four-lane rows must hold `out.len() / 3` pixels.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
unsafe fn apply_avx2(out: &mut [u8], blended: &[i16], differences: &[i16], subtract: bool) -> usize {
    use std::arch::x86_64::*;
    let widen = _mm_setr_epi8(0, 1, 2, -1, 3, 4, 5, -1, 6, 7, 8, -1, 9, 10, 11, -1);
    let squeeze = _mm_setr_epi8(0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, -1, -1, -1, -1);
    let tail = _mm_setr_epi8(0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, -1, -1, -1, -1);
    let keep = _mm256_set1_epi16(if subtract { -1 } else { 0 });
    let four = _mm256_set1_epi16(4);
    let mut i = 0;
    while 3 * i + 16 <= out.len() {
        // SAFETY: 16 bytes of `out` from 3 i on exist, so pixels i..i+4 do in the others; the last four bytes are
        // written back as they were.
        unsafe {
            let at = out.as_mut_ptr().add(3 * i).cast::<__m128i>();
            let old = _mm_loadu_si128(at);
            let base = _mm256_cvtepu8_epi16(_mm_shuffle_epi8(old, widen));
            let r = _mm256_loadu_si256(blended.as_ptr().add(LANES * i).cast());
            let d = _mm256_and_si256(_mm256_loadu_si256(differences.as_ptr().add(LANES * i).cast()), keep);
            let delta = _mm256_srai_epi16(_mm256_add_epi16(_mm256_sub_epi16(r, d), four), 3);
            let sum = _mm256_add_epi16(base, delta);
            let bytes = _mm_packus_epi16(_mm256_castsi256_si128(sum), _mm256_extracti128_si256(sum, 1));
            _mm_storeu_si128(at, _mm_blendv_epi8(_mm_shuffle_epi8(bytes, squeeze), old, tail));
        }
        i += 4;
    }
    i
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reserving_again_for_the_same_canvas_allocates_nothing() {
        let mut blender = Blender::default();
        let room = |b: &Blender| {
            let planes = b.fine.iter().chain(&b.blended).map(Vec::capacity).sum::<usize>();
            (b.sizes.capacity(), planes, b.scratch.capacity())
        };
        blender.reserve(400, 300, 4);
        blender.reset(400, 300, 4);
        let first = room(&blender);
        for _ in 0..3 {
            blender.reserve(400, 300, 4);
            blender.reset(390, 200, 4);
        }
        assert_eq!(room(&blender), first);
    }
}
