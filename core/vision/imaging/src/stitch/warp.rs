//! Perspective warp, bilinear, in blocks of output pixels.
//!
//! By a matrix, coordinates are f32 relative to an f64 start every 64 pixels (error below 1/1000 px); by a mesh, steps
//! of 1/65536 px from each vertex on (error below 1/500 px). Positions are rounded to 1/64 px. The portable and the
//! AVX2 path give the same bytes.

mod line;

use crate::View;
pub use line::{Line, NODES, locate_line};

/// Output pixels per block, enough to amortise the preparation of a block.
pub const BLOCK: usize = 256;
/// Output pixels between two exact evaluations of a perspective.
const REACH: usize = 64;
/// Output pixels located per step.
pub const GROUP: usize = 8;
/// Size of a block's arrays; a group may begin anywhere in the block.
const ROOM: usize = BLOCK + GROUP;

/// Gain of one per channel for [`sample`] (Q14).
pub const UNIT_GAIN: [i16; 4] = [16384, 16384, 16384, 0];

/// Source positions of a block of output pixels.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub struct Block {
    /// Byte offset of the upper left neighbour. Entries after the last pixel are undefined.
    pub(super) offset: [u32; ROOM],
    /// Weights, from the low byte on: of the left and of the right column in 1/64, and of the lower row in Q14, two
    /// bytes.
    pub(super) weights: [u32; ROOM],
    /// Pixels that are located, in whole groups.
    located: usize,
    /// Upper bound of their offsets.
    farthest: usize,
}

impl Block {
    /// Clears the located pixels.
    pub(super) fn clear(&mut self) {
        (self.located, self.farthest) = (0, 0);
    }

    /// Counts pixels `first .. end`, which follow the previous ones and whose positions are on a line: both ends bound
    /// the rows between them, up to rounding by one, and a column is less than a stride.
    fn reaches(&mut self, first: usize, end: usize, stride: usize) {
        if first < end {
            let ends = self.offset[first].max(self.offset[end - 1]) as usize;
            self.farthest = self.farthest.max(ends + 2 * stride);
            self.located = end;
        }
    }

    /// Counts any pixels that follow the previous ones.
    fn reaches_any(&mut self, first: usize, end: usize) {
        let farthest = self.offset[first..end].iter().fold(0, |most, offset| most.max(*offset));
        self.farthest = self.farthest.max(farthest as usize);
        self.located = end;
    }
}

impl Default for Block {
    fn default() -> Self {
        Self { offset: [0; ROOM], weights: [64; ROOM], located: 0, farthest: 0 }
    }
}

/// Pixels of a block, B G R and a zero each.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub struct Pixels(pub [u8; 4 * BLOCK]);

impl Default for Pixels {
    fn default() -> Self {
        Self([0; 4 * BLOCK])
    }
}

/// Fills `block` for the output pixels `(x .. x + count, y)`, count at most [`BLOCK`]; `source_from_output` maps output
/// pixels to those of a `width` x `height` BGR view with `stride`. Positions outside are clamped to the border.
pub fn locate(
    source_from_output: &[f64; 9],
    x: usize,
    y: usize,
    width: usize,
    height: usize,
    stride: usize,
    count: usize,
    block: &mut Block,
    avx2: bool,
) {
    let m = source_from_output;
    let source = Source::new(width, height, stride);
    let count = count.min(BLOCK).div_ceil(GROUP) * GROUP;
    block.clear();
    for first in (0..count).step_by(REACH) {
        let (x, y) = ((x + first) as f64, y as f64);
        let along = |r: usize| (m[r] * x + m[r + 1] * y + m[r + 2]) as f32;
        let start = [along(0), along(3), along(6)];
        let step = [m[0] as f32, m[3] as f32, m[6] as f32];
        let pixels = (first, (count - first).min(REACH));
        #[cfg(target_arch = "x86_64")]
        if avx2 {
            // SAFETY: the caller found AVX2 on this CPU; whole groups inside the block.
            unsafe { locate_avx2(start, step, &source, pixels, block) };
            block.reaches(first, first + pixels.1, stride);
            continue;
        }
        locate_body(start, step, &source, pixels, block);
        block.reaches(first, first + pixels.1, stride);
    }
    let _ = avx2;
}

/// # Safety
/// The processor has AVX2, and `count` pixels from `first` on are whole groups inside the block.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
unsafe fn locate_avx2(s: [f32; 3], d: [f32; 3], source: &Source, (first, count): (usize, usize), block: &mut Block) {
    use std::arch::x86_64::*;
    let one = _mm256_set1_ps(1.0);
    let s = [_mm256_set1_ps(s[0]), _mm256_set1_ps(s[1]), _mm256_set1_ps(s[2])];
    let d = [_mm256_set1_ps(d[0]), _mm256_set1_ps(d[1]), _mm256_set1_ps(d[2])];
    let lanes = _mm256_setr_ps(0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0);
    for i in (0..count).step_by(GROUP) {
        let t = _mm256_add_ps(lanes, _mm256_set1_ps(i as f32));
        // Multiply and add stay apart, so that the portable path gives the same bits.
        let along = |k: usize| _mm256_add_ps(s[k], _mm256_mul_ps(d[k], t));
        let scale = _mm256_div_ps(one, along(2));
        let at = [_mm256_mul_ps(along(0), scale), _mm256_mul_ps(along(1), scale)];
        // SAFETY: the group lies inside the block, by the caller's promise.
        unsafe { store(block, first + i, at, source.limit, source.last, source.stride) };
    }
}

#[inline]
fn locate_body(s: [f32; 3], d: [f32; 3], source: &Source, (first, count): (usize, usize), block: &mut Block) {
    for i in 0..count {
        let t = i as f32;
        let scale = 1.0 / (s[2] + d[2] * t);
        let u = (s[0] + d[0] * t) * scale;
        let v = (s[1] + d[1] * t) * scale;
        put(block, first + i, [u, v], source.limit, source.last, source.stride);
    }
}

/// Records the source position of output pixel `i`: position `at`, clamped to the view.
#[inline(always)]
fn put(block: &mut Block, i: usize, at: [f32; 2], limit: [f32; 2], last: [i32; 2], stride: i32) {
    (block.offset[i], block.weights[i]) = located(at, limit, last, stride);
}

/// Offset and weights of a position, see [`Block`].
#[inline(always)]
fn located([u, v]: [f32; 2], limit: [f32; 2], last: [i32; 2], stride: i32) -> (u32, u32) {
    // NaN falls to zero here, so that the conversions below always see a number in range.
    let u = if u > 0.0 { u } else { 0.0 };
    let v = if v > 0.0 { v } else { 0.0 };
    let u = if u < limit[0] { u } else { limit[0] };
    let v = if v < limit[1] { v } else { limit[1] };
    // SAFETY: 0 <= u, v <= limit, and limit * 64 is far below 2^31 for any image that fits in memory as BGR rows
    // of less than 2^25 pixels, which `compose` checks.
    let (u, v): (i32, i32) = unsafe { ((u * 64.0 + 0.5).to_int_unchecked(), (v * 64.0 + 0.5).to_int_unchecked()) };
    let column = (u >> 6).min(last[0]);
    let row = (v >> 6).min(last[1]);
    ((row * stride + column * 3) as u32, weights(u - (column << 6), v - (row << 6)))
}

/// Weights of a pixel between four: `fx` and `fy` are its distances from the upper left one in 1/64.
#[inline(always)]
fn weights(fx: i32, fy: i32) -> u32 {
    ((64 - fx) | (fx << 8) | (fy << 24)) as u32
}

/// The view that a block reads.
#[derive(Clone, Copy, Debug)]
pub struct Source {
    limit: [f32; 2],
    last: [i32; 2],
    stride: i32,
}

impl Source {
    /// A `width` x `height` BGR view with `stride`.
    pub fn new(width: usize, height: usize, stride: usize) -> Self {
        Self {
            limit: [(width - 1) as f32, (height - 1) as f32],
            last: [width as i32 - 2, height as i32 - 2],
            stride: stride as i32,
        }
    }

    /// Whether offsets can be computed from 16-bit products.
    fn is_small(&self) -> bool {
        self.stride.max(self.last[0]).max(self.last[1]) <= i32::from(i16::MAX)
    }
}

/// As [`put`] for eight output pixels: `at` are their columns and rows.
///
/// # Safety
/// `i` is at most [`BLOCK`].
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
#[inline]
unsafe fn store(
    block: &mut Block,
    i: usize,
    at: [std::arch::x86_64::__m256; 2],
    limit: [f32; 2],
    last: [i32; 2],
    stride: i32,
) {
    use std::arch::x86_64::*;
    let place = |k: usize| {
        let v = _mm256_min_ps(_mm256_max_ps(at[k], _mm256_setzero_ps()), _mm256_set1_ps(limit[k]));
        let v = _mm256_cvttps_epi32(_mm256_add_ps(_mm256_mul_ps(v, _mm256_set1_ps(64.0)), _mm256_set1_ps(0.5)));
        let whole = _mm256_min_epi32(_mm256_srai_epi32(v, 6), _mm256_set1_epi32(last[k]));
        (whole, _mm256_sub_epi32(v, _mm256_slli_epi32(whole, 6)))
    };
    let ((column, fx), (row, fy)) = (place(0), place(1));
    let down = _mm256_mullo_epi32(row, _mm256_set1_epi32(stride));
    let offset = _mm256_add_epi32(down, _mm256_mullo_epi32(column, _mm256_set1_epi32(3)));
    let horizontal = _mm256_add_epi32(_mm256_sub_epi32(_mm256_slli_epi32(fx, 8), fx), _mm256_set1_epi32(64));
    let weights = _mm256_or_si256(horizontal, _mm256_slli_epi32(fy, 24));
    // SAFETY: the arrays have room for a group after each pixel of the block, by the caller's promise.
    unsafe {
        _mm256_storeu_si256(block.offset.as_mut_ptr().add(i).cast(), offset);
        _mm256_storeu_si256(block.weights.as_mut_ptr().add(i).cast(), weights);
    }
}

#[inline(always)]
fn round_multiply(a: i32, b: i32) -> i32 {
    (a * b + 0x4000) >> 15
}

/// Samples the first `count` positions of `block` from a BGR view, times `gain` (Q14), into `out`.
///
/// Up to seven pixels past `count` are written with undefined values.
pub fn sample(view: &View<u8>, block: &Block, count: usize, gain: &[i16; 4], out: &mut Pixels, avx2: bool) {
    let count = count.min(BLOCK);
    #[cfg(target_arch = "x86_64")]
    if avx2 && view.data.len() >= view.stride + 8 {
        let padded = count.div_ceil(8) * 8;
        let fits = |far: usize| far + view.stride + 8 <= view.data.len();
        let farthest = || block.offset[..padded].iter().fold(0, |most, offset| most.max(*offset)) as usize;
        // Each neighbour pair is loaded as 8 bytes: the last two pixels of a view without padding go the slow way.
        if padded <= block.located && (fits(block.farthest) || fits(farthest())) {
            // SAFETY: the caller found AVX2 on this CPU; every load is inside the view, as just checked.
            unsafe { sample_avx2(view.data.as_ptr(), view.stride, block, padded, gain, out) };
            return;
        }
    }
    let _ = avx2;
    for i in 0..count {
        let at = block.offset[i] as usize;
        let top = &view.data[at..at + 6];
        let bottom = &view.data[at + view.stride..at + view.stride + 6];
        let [left, right, _, _] = block.weights[i].to_le_bytes().map(i32::from);
        let lower = (block.weights[i] >> 16) as i32;
        for c in 0..3 {
            let t = i32::from(top[c]) * left + i32::from(top[c + 3]) * right;
            let b = i32::from(bottom[c]) * left + i32::from(bottom[c + 3]) * right;
            let value = t + round_multiply((b - t) * 2, lower);
            out.0[4 * i + c] = ((round_multiply(value, i32::from(gain[c])) + 16) >> 5).clamp(0, 255) as u8;
        }
        out.0[4 * i + 3] = 0;
    }
}

/// # Safety
/// For each of the first `count` offsets (a multiple of 8, at most [`BLOCK`]), `offset + stride + 8` bytes must be
/// readable.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
unsafe fn sample_avx2(
    source: *const u8,
    stride: usize,
    block: &Block,
    count: usize,
    gain: &[i16; 4],
    out: &mut Pixels,
) {
    use std::arch::x86_64::*;
    let pairs = _mm256_broadcastsi128_si256(_mm_setr_epi8(0, 3, 1, 4, 2, 5, -1, -1, 8, 11, 9, 12, 10, 13, -1, -1));
    let across = _mm256_setr_epi8(
        0, 1, 0, 1, 0, 1, 0, 1, 4, 5, 4, 5, 4, 5, 4, 5, 8, 9, 8, 9, 8, 9, 8, 9, 12, 13, 12, 13, 12, 13, 12, 13,
    );
    let down = _mm256_add_epi8(across, _mm256_set1_epi8(2));
    // SAFETY: `gain` is 8 bytes.
    let gain = _mm256_set1_epi64x(unsafe { gain.as_ptr().cast::<i64>().read_unaligned() });
    let half = _mm256_set1_epi16(16);
    // Four loads of 8 bytes: each to all lanes, which needs no port of the shuffles, then blended.
    let all = |at: *const u8| {
        // SAFETY: the load lies inside the view, by the caller's promise.
        _mm256_set1_epi64x(unsafe { at.cast::<i64>().read_unaligned() })
    };
    let blended = |p: [*const u8; 4]| {
        let low = _mm256_blend_epi32(all(p[0]), all(p[1]), 0b0000_1100);
        let high = _mm256_blend_epi32(all(p[2]), all(p[3]), 0b1100_0000);
        _mm256_blend_epi32(low, high, 0b1111_0000)
    };
    let four = |i: usize| {
        // SAFETY: offsets lie inside the view (caller's promise); four of the block.
        unsafe {
            let o = block.offset.as_ptr().add(i);
            let p = [0, 1, 2, 3].map(|k| source.add(*o.add(k) as usize));
            let (top, bottom) = (blended(p), blended(p.map(|p| p.add(stride))));
            let weights = _mm256_broadcastsi128_si256(_mm_loadu_si128(block.weights.as_ptr().add(i).cast()));
            let (h, v) = (_mm256_shuffle_epi8(weights, across), _mm256_shuffle_epi8(weights, down));
            let top = _mm256_maddubs_epi16(_mm256_shuffle_epi8(top, pairs), h);
            let bottom = _mm256_maddubs_epi16(_mm256_shuffle_epi8(bottom, pairs), h);
            let difference = _mm256_slli_epi16(_mm256_sub_epi16(bottom, top), 1);
            let value = _mm256_add_epi16(top, _mm256_mulhrs_epi16(difference, v));
            _mm256_srai_epi16(_mm256_add_epi16(_mm256_mulhrs_epi16(value, gain), half), 5)
        }
    };
    let mut i = 0;
    while i < count {
        let packed = _mm256_permute4x64_epi64(_mm256_packus_epi16(four(i), four(i + 4)), 0xD8);
        // SAFETY: eight pixels of the block, 4 bytes each.
        unsafe { _mm256_storeu_si256(out.0.as_mut_ptr().add(4 * i).cast(), packed) };
        i += 8;
    }
}

/// Writes the first pixels of `pixels` as packed BGR; `out` gives their number (3 bytes each).
pub fn pack_bgr(pixels: &Pixels, out: &mut [u8], avx2: bool) {
    let count = out.len() / 3;
    let mut i = 0;
    #[cfg(target_arch = "x86_64")]
    if avx2 {
        // SAFETY: the caller found AVX2 on this CPU.
        i = unsafe { pack_bgr_avx2(pixels, out) };
    }
    let _ = avx2;
    while i < count {
        out[3 * i..3 * i + 3].copy_from_slice(&pixels.0[4 * i..4 * i + 3]);
        i += 1;
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn pack_bgr_avx2(pixels: &Pixels, out: &mut [u8]) -> usize {
    use std::arch::x86_64::*;
    let squeeze = _mm_setr_epi8(0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, -1, -1, -1, -1);
    let mut i = 0;
    while 3 * i + 16 <= out.len() {
        // SAFETY: 16 bytes are readable (out.len() / 3 pixels of the block) and writable (loop condition).
        unsafe {
            let four = _mm_loadu_si128(pixels.0.as_ptr().add(4 * i).cast());
            _mm_storeu_si128(out.as_mut_ptr().add(3 * i).cast(), _mm_shuffle_epi8(four, squeeze));
        }
        i += 4;
    }
    i
}

/// Columns of one row that a view covers, end excluded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Span {
    /// First column.
    pub start: u32,
    /// One past the last column; not above `start` when the row is empty.
    pub end: u32,
}

impl Span {
    /// True when no column is covered.
    pub fn is_empty(&self) -> bool {
        self.end <= self.start
    }

    /// True when the column lies in the span.
    pub fn contains(&self, x: u32) -> bool {
        x >= self.start && x < self.end
    }
}

/// The columns of each of `rows` output rows whose source position is inside the view.
///
/// `source_from_output` must be scaled so that its third row is positive inside the view.
pub fn coverage(
    source_from_output: &[f64; 9],
    view: (usize, usize),
    columns: usize,
    rows: usize,
    spans: &mut Vec<Span>,
) {
    let m = source_from_output;
    let (w, h) = ((view.0 - 1) as f64, (view.1 - 1) as f64);
    // Each border of the view is a half plane a x + b y + c >= 0 of the output.
    let planes = [
        [m[0], m[1], m[2]],
        [m[3], m[4], m[5]],
        [w * m[6] - m[0], w * m[7] - m[1], w * m[8] - m[2]],
        [h * m[6] - m[3], h * m[7] - m[4], h * m[8] - m[5]],
        [m[6], m[7], m[8]],
    ];
    spans.clear();
    for y in 0..rows {
        let (mut low, mut high) = (0.0f64, columns as f64 - 1.0);
        for [a, b, c] in planes {
            let rest = b * y as f64 + c;
            let slack = 1e-9 * (1.0 + rest.abs());
            if a > 0.0 {
                low = low.max((-rest - slack) / a);
            } else if a < 0.0 {
                high = high.min((rest + slack) / -a);
            } else if rest < -slack {
                high = -1.0;
            }
        }
        let (start, end) = ((low - 1e-6).ceil(), (high + 1e-6).floor() + 1.0);
        let empty = end <= start;
        spans.push(if empty { Span::default() } else { Span { start: start.max(0.0) as u32, end: end as u32 } });
    }
}
