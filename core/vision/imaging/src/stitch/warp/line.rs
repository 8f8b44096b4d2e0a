//! Rows of output pixels across a mesh: positions change evenly from vertex to vertex.

use super::{BLOCK, Block, GROUP, Source, put, weights};

#[cfg(target_arch = "x86_64")]
use super::store;

/// Maximum number of mesh vertices along a row of output pixels.
pub const NODES: usize = 8;

/// A row of output pixels across a mesh: between neighbouring vertices positions in the view change evenly.
#[derive(Clone, Copy, Debug)]
pub struct Line {
    /// Columns and rows of the vertices in the view, px.
    pub nodes: [[f32; NODES]; 2],
    /// The last cell between two vertices, at most `NODES - 2`.
    pub last: usize,
    /// Position of output pixel 0 of the block, in cells from the first vertex.
    pub start: f32,
    /// Cells per output pixel.
    pub step: f32,
}

impl Line {
    /// Position in the view of output pixel `i` of the block.
    #[inline(always)]
    fn at(&self, i: usize) -> [f32; 2] {
        let along = self.start + self.step * i as f32;
        let cell = along.max(0.0).min(self.last as f32) as usize;
        let t = along - cell as f32;
        self.nodes.map(|nodes| nodes[cell] + (nodes[cell + 1] - nodes[cell]) * t)
    }

    /// The output pixel at which `cell` ends, from `first` to `end`.
    #[inline(always)]
    fn end_of_cell(&self, cell: usize, per_cell: f32, (first, end): (usize, usize)) -> usize {
        if cell == self.last {
            return end;
        }
        // A pixel that rounding puts into the cell beside its own lies on the vertex between them.
        let to = ((cell + 1) as f32 - self.start) * per_cell;
        (to.max(0.0) as usize + 1).clamp(first, end)
    }

    /// Output pixels `first .. end`, all in `cell`; `None` if some are outside the view.
    #[inline(always)]
    fn run(&self, cell: usize, (first, end): (usize, usize), source: &Source) -> Option<Run> {
        let t = self.start + self.step * first as f32 - cell as f32;
        let (mut at, mut step) = ([0; 2], [0; 2]);
        for k in 0..2 {
            let (from, change) = (self.nodes[k][cell], self.nodes[k][cell + 1] - self.nodes[k][cell]);
            let first_px = from + change * t;
            let last_px = first_px + change * (self.step * (end - 1 - first) as f32);
            let limit = source.last[k] as f32;
            // False for NaN too.
            let is_inside = first_px >= 0.0 && first_px <= limit && last_px >= 0.0 && last_px <= limit;
            if !is_inside {
                return None;
            }
            // What the conversions leave out is less than half of 1/64 px, so that positions stay inside.
            at[k] = (first_px * RUN_UNITS) as i32 + RUN_HALF;
            let units = change * self.step * RUN_UNITS;
            step[k] = (units + if units < 0.0 { -0.5 } else { 0.5 }) as i32;
        }
        Some(Run { at, step, stride: source.stride })
    }
}

/// Units of a run's positions per pixel, and half of 1/64 px in them.
const RUN_UNITS: f32 = 65536.0;
const RUN_HALF: i32 = 512;

/// Positions that change evenly and lie inside a view whose offsets are small.
#[derive(Clone, Copy, Debug)]
struct Run {
    /// Column and row of the first position, rounded by [`RUN_HALF`], in 1/65536 px.
    at: [i32; 2],
    /// Step from one position to the next.
    step: [i32; 2],
    /// Bytes from one row of the view to the next.
    stride: i32,
}

impl Run {
    /// Records the positions of output pixels `first .. end`.
    fn put(&self, (first, end): (usize, usize), block: &mut Block) {
        let [mut u, mut v] = self.at;
        for i in first..end {
            block.offset[i] = ((v >> 16) * self.stride + (u >> 16) * 3) as u32;
            block.weights[i] = weights((u >> 10) & 63, (v >> 10) & 63);
            (u, v) = (u.wrapping_add(self.step[0]), v.wrapping_add(self.step[1]));
        }
    }

    /// Records the positions of output pixels `first .. end`, at most [`BLOCK`].
    #[inline]
    fn note(&self, (first, end): (usize, usize), block: &mut Block, avx2: bool) {
        #[cfg(target_arch = "x86_64")]
        if avx2 {
            assert!(end <= BLOCK);
            // SAFETY: the caller found AVX2 on this CPU; the end was just checked.
            unsafe { self.put_avx2((first, end), block) };
            return;
        }
        let _ = avx2;
        self.put((first, end), block);
    }

    /// As [`Run::put`]; up to seven pixels from `end` on get undefined values.
    ///
    /// # Safety
    /// The processor has AVX2, and `end` is at most [`BLOCK`].
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    unsafe fn put_avx2(&self, (first, end): (usize, usize), block: &mut Block) {
        use std::arch::x86_64::*;
        let lanes = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
        let start = |k: usize| {
            let step = _mm256_set1_epi32(self.step[k]);
            _mm256_add_epi32(_mm256_set1_epi32(self.at[k]), _mm256_mullo_epi32(step, lanes))
        };
        let (mut u, mut v) = (start(0), start(1));
        let step = self.step.map(|step| _mm256_set1_epi32(step.wrapping_mul(GROUP as i32)));
        // Row times stride plus column times 3.
        let bytes = _mm256_set1_epi32(self.stride | 3 << 16);
        // `fx * 255 + 64` is both horizontal weights, `fy * 256` the vertical one.
        let (times, plus) = (_mm256_set1_epi32(256 << 16 | 255), _mm256_set1_epi32(64));
        for i in (first..end).step_by(GROUP) {
            let whole = _mm256_blend_epi16(_mm256_srli_epi32(v, 16), u, 0xAA);
            let part = _mm256_srli_epi16(_mm256_blend_epi16(u, _mm256_slli_epi32(v, 16), 0xAA), 10);
            let weights = _mm256_add_epi16(_mm256_mullo_epi16(part, times), plus);
            // SAFETY: the arrays have room for a group after each pixel of the block, by the caller's promise.
            unsafe {
                _mm256_storeu_si256(block.offset.as_mut_ptr().add(i).cast(), _mm256_madd_epi16(whole, bytes));
                _mm256_storeu_si256(block.weights.as_mut_ptr().add(i).cast(), weights);
            }
            (u, v) = (_mm256_add_epi32(u, step[0]), _mm256_add_epi32(v, step[1]));
        }
    }
}

/// Records the source positions of output pixels `first .. end`, clamped to the view; whole groups of [`GROUP`] inside
/// the block.
pub fn locate_line(line: &Line, (first, end): (usize, usize), source: &Source, block: &mut Block, avx2: bool) {
    assert!(
        line.last + 2 <= NODES && end <= BLOCK && (end - first).is_multiple_of(GROUP),
        "the line fits into the block"
    );
    let (is_small, per_cell) = (source.is_small(), 1.0 / line.step);
    let mut i = first;
    let mut cell = (line.start + line.step * first as f32).max(0.0).min(line.last as f32) as usize;
    while i < end {
        let to = line.end_of_cell(cell, per_cell, (i, end));
        match line.run(cell, (i, to), source).filter(|_| is_small && to > i) {
            Some(run) => {
                run.note((i, to), block, avx2);
                block.reaches(i, to, source.stride as usize);
            }
            None => {
                locate_any(line, (i, to), source, block, avx2);
                block.reaches_any(i, to);
            }
        }
        i = to;
        cell = (cell + 1).min(line.last);
    }
}

/// Records the source positions of output pixels `first .. end`, unclamped; `end` is at most [`BLOCK`].
#[inline]
fn locate_any(line: &Line, (first, end): (usize, usize), source: &Source, block: &mut Block, avx2: bool) {
    #[cfg(target_arch = "x86_64")]
    if avx2 {
        assert!(end <= BLOCK);
        // SAFETY: the caller found AVX2 on this CPU; the end was just checked.
        unsafe { locate_any_avx2(line, (first, end), source, block) };
        return;
    }
    let _ = avx2;
    for i in first..end {
        put(block, i, line.at(i), source.limit, source.last, source.stride);
    }
}

/// Up to seven pixels from `end` on get undefined values.
///
/// # Safety
/// The processor has AVX2, and `end` is at most [`BLOCK`].
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
unsafe fn locate_any_avx2(line: &Line, (first, end): (usize, usize), source: &Source, block: &mut Block) {
    use std::arch::x86_64::*;
    // SAFETY: arrays of eight numbers.
    let nodes = line.nodes.map(|nodes| unsafe { _mm256_loadu_ps(nodes.as_ptr()) });
    let (start, step, last) = (_mm256_set1_ps(line.start), _mm256_set1_ps(line.step), _mm256_set1_ps(line.last as f32));
    let lanes = _mm256_setr_ps(0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0);
    for i in (first..end).step_by(GROUP) {
        // Multiply and add stay apart, so that the portable path gives the same bits.
        let steps = _mm256_mul_ps(step, _mm256_add_ps(lanes, _mm256_set1_ps(i as f32)));
        let along = _mm256_add_ps(start, steps);
        let cell = _mm256_cvttps_epi32(_mm256_min_ps(_mm256_max_ps(along, _mm256_setzero_ps()), last));
        let t = _mm256_sub_ps(along, _mm256_cvtepi32_ps(cell));
        let next = _mm256_add_epi32(cell, _mm256_set1_epi32(1));
        let at = nodes.map(|nodes| {
            let (a, b) = (_mm256_permutevar8x32_ps(nodes, cell), _mm256_permutevar8x32_ps(nodes, next));
            _mm256_add_ps(a, _mm256_mul_ps(_mm256_sub_ps(b, a), t))
        });
        // SAFETY: the group begins inside the block, by the caller's promise.
        unsafe { store(block, i, at, source.limit, source.last, source.stride) };
    }
}
