//! Inner loops of semi-global matching: the cost of a row, and its aggregation along paths.
//!
//! Costs and path costs are bytes, lanes in ascending memory order (lane `k` is disparity
//! `min + lanes - 1 - k`). A path's costs of one pixel lie in a slot with room on both sides, so that
//! neighbouring lanes can be read at an offset of one byte.

/// Bytes before and after the lanes of a slot; they stay 255.
pub(crate) const RIM: usize = 32;

/// Largest number of lanes.
pub(crate) const MAX_LANES: usize = 512;

/// Bytes of a slot.
pub(crate) fn slot_bytes(lanes: usize) -> usize {
    lanes + 2 * RIM
}

/// Penalties of a change of disparity along a path.
#[derive(Clone, Copy)]
pub(crate) struct Penalties {
    pub small: u8,
    pub large: u8,
}

/// Absolute differences of one row, summed over `columns`' rows and `2 radius + 1` columns, as bytes.
pub(crate) struct CostRow<'a> {
    pub lanes: usize,
    pub count: usize,
    pub radius: usize,
    /// Right shift that brings a window's sum near a byte; larger sums saturate.
    pub shift: i32,
    pub new_left: &'a [u8],
    pub new_right: &'a [u8],
    pub old_left: &'a [u8],
    pub old_right: &'a [u8],
    /// 255 where a right pixel is outside, from the first output pixel's lane 0 on.
    pub outside: &'a [u8],
    pub columns: &'a mut [u16],
    pub out: &'a mut [u8],
}

/// One row's aggregation. `before` and `after` hold, for each downward path, `count + 2` slots of the
/// row above and of this row; slot `i + 1` is output pixel `i`; `least` holds their minima.
pub(crate) struct Paths<'a> {
    pub lanes: usize,
    pub count: usize,
    pub penalties: Penalties,
    pub cost: &'a [u8],
    /// Column offsets of the downward paths' previous pixels: -1, 0 or 1.
    pub offsets: &'a [isize],
    pub before: &'a [u8],
    pub after: &'a mut [u8],
    pub min_before: &'a [u8],
    pub min_after: &'a mut [u8],
    /// Sums over paths, `count * lanes`, in the matcher's lane order.
    pub sums: &'a mut [u16],
}

pub(crate) fn cost_row(row: CostRow<'_>, avx2: bool) {
    #[cfg(target_arch = "x86_64")]
    if avx2 {
        // SAFETY: the caller found AVX2; lengths are checked inside.
        unsafe { avx2::cost_row(row) };
        return;
    }
    let _ = avx2;
    let CostRow { lanes, count, radius, shift, .. } = row;
    let mut window = [0u16; MAX_LANES];
    for c in 0..count + 2 * radius {
        let (new, old) = (row.new_left[c], row.old_left[c]);
        let at = (c + 1) * lanes;
        for k in 0..lanes {
            let entering = u16::from(new.abs_diff(row.new_right[c + k]));
            let leaving = u16::from(old.abs_diff(row.old_right[c + k]));
            row.columns[at + k] = row.columns[at + k].wrapping_add(entering).wrapping_sub(leaving);
            window[k] = window[k].wrapping_add(row.columns[at + k]);
        }
        if c < 2 * radius {
            continue;
        }
        let i = c - 2 * radius;
        for k in 0..lanes {
            window[k] = window[k].wrapping_sub(row.columns[i * lanes + k]);
            row.out[i * lanes + k] = (window[k] >> shift).min(255) as u8 | row.outside[i + k];
        }
    }
}

pub(crate) fn aggregate(paths: Paths<'_>, avx2: bool) {
    #[cfg(target_arch = "x86_64")]
    if avx2 {
        // SAFETY: the caller found AVX2; lengths are checked inside.
        unsafe { if paths.offsets.len() == 3 { by_lanes::<3>(paths) } else { by_lanes::<1>(paths) } }
        return;
    }
    let _ = avx2;
    portable(paths);
}

/// # Safety
/// Needs AVX2.
#[cfg(target_arch = "x86_64")]
unsafe fn by_lanes<const DOWN: usize>(paths: Paths<'_>) {
    // SAFETY: as promised by the caller.
    unsafe {
        match paths.lanes {
            32 => avx2::aggregate::<DOWN, 1, 1>(paths),
            64 => avx2::aggregate::<DOWN, 2, 2>(paths),
            96 => avx2::aggregate::<DOWN, 3, 3>(paths),
            128 => avx2::aggregate::<DOWN, 4, 4>(paths),
            160 => avx2::aggregate::<DOWN, 5, 5>(paths),
            192 => avx2::aggregate::<DOWN, 6, 6>(paths),
            224 => avx2::aggregate::<DOWN, 7, 7>(paths),
            256 => avx2::aggregate::<DOWN, 8, 8>(paths),
            _ => avx2::aggregate::<DOWN, 0, { MAX_LANES / 32 }>(paths),
        }
    }
}

/// Path costs of one pixel from those of the one before: `before` with one byte on either side.
fn follow(cost: &[u8], before: &[u8], least: u8, penalties: Penalties, out: &mut [u8]) -> u8 {
    let jump = least.saturating_add(penalties.large);
    let mut smallest = 255;
    for k in 0..cost.len() {
        let beside = before[k].min(before[k + 2]).saturating_add(penalties.small);
        let best = before[k + 1].min(beside).min(jump);
        out[k] = cost[k].saturating_add(best - least);
        smallest = smallest.min(out[k]);
    }
    smallest
}

fn portable(paths: Paths<'_>) {
    let Paths { lanes, count, penalties, cost, offsets, .. } = paths;
    let slot = slot_bytes(lanes);
    paths.sums[..count * lanes].fill(0);
    for (path, offset) in offsets.iter().enumerate() {
        let base = path * (count + 2);
        for i in 0..count {
            let from = base + (i as isize + 1 + offset) as usize;
            let to = base + i + 1;
            let before = &paths.before[from * slot + RIM - 1..(from + 1) * slot - RIM + 1];
            let out = &mut paths.after[to * slot + RIM..(to + 1) * slot - RIM];
            let cost = &cost[i * lanes..(i + 1) * lanes];
            paths.min_after[to] = follow(cost, before, paths.min_before[from], penalties, out);
            for (sum, value) in paths.sums[i * lanes..(i + 1) * lanes].iter_mut().zip(out) {
                *sum += u16::from(*value);
            }
        }
    }
    for backwards in [false, true] {
        let mut before = [0u8; MAX_LANES + 2];
        before[0] = 255;
        before[lanes + 1] = 255;
        let mut least = 0;
        let mut out = [0u8; MAX_LANES];
        for step in 0..count {
            let i = if backwards { count - 1 - step } else { step };
            let cost = &cost[i * lanes..(i + 1) * lanes];
            least = follow(cost, &before[..lanes + 2], least, penalties, &mut out[..lanes]);
            before[1..=lanes].copy_from_slice(&out[..lanes]);
            for (sum, value) in paths.sums[i * lanes..(i + 1) * lanes].iter_mut().zip(&out) {
                *sum += u16::from(*value);
            }
        }
    }
}

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use super::{CostRow, MAX_LANES, Paths, RIM, slot_bytes};
    use std::arch::x86_64::*;

    /// # Safety
    /// Needs AVX2.
    #[target_feature(enable = "avx2")]
    pub(super) unsafe fn cost_row(row: CostRow<'_>) {
        let CostRow { lanes, count, radius, .. } = row;
        let steps = count + 2 * radius;
        assert!(lanes.is_multiple_of(32) && lanes <= MAX_LANES);
        assert!(row.new_left.len() >= steps && row.old_left.len() >= steps);
        assert!(row.new_right.len() >= steps + lanes && row.old_right.len() >= steps + lanes);
        assert!(row.outside.len() >= count + lanes && row.columns.len() >= (steps + 1) * lanes);
        assert!(row.out.len() >= count * lanes);
        let signs = _mm256_set1_epi16(0xff01u16 as i16);
        let shift = _mm_cvtsi32_si128(row.shift);
        let columns = row.columns.as_mut_ptr();
        // Chunk by chunk, so that a chunk's window stays in two registers all along the row.
        for q in 0..lanes / 32 {
            let mut window = [_mm256_setzero_si256(); 2];
            for c in 0..steps {
                // SAFETY: `c < steps` and `q < lanes / 32`; all lengths were checked above.
                unsafe {
                    let new = _mm256_set1_epi8(*row.new_left.get_unchecked(c) as i8);
                    let old = _mm256_set1_epi8(*row.old_left.get_unchecked(c) as i8);
                    let a = _mm256_loadu_si256(row.new_right.as_ptr().add(c + 32 * q).cast());
                    let b = _mm256_loadu_si256(row.old_right.as_ptr().add(c + 32 * q).cast());
                    let entering = _mm256_or_si256(_mm256_subs_epu8(new, a), _mm256_subs_epu8(a, new));
                    let leaving = _mm256_or_si256(_mm256_subs_epu8(old, b), _mm256_subs_epu8(b, old));
                    let change = [
                        _mm256_maddubs_epi16(_mm256_unpacklo_epi8(entering, leaving), signs),
                        _mm256_maddubs_epi16(_mm256_unpackhi_epi8(entering, leaving), signs),
                    ];
                    let sums = columns.add((c + 1) * lanes + 32 * q).cast::<__m256i>();
                    for half in 0..2 {
                        let sum = _mm256_add_epi16(_mm256_loadu_si256(sums.add(half)), change[half]);
                        _mm256_storeu_si256(sums.add(half), sum);
                        window[half] = _mm256_add_epi16(window[half], sum);
                    }
                    if c >= 2 * radius {
                        let i = c - 2 * radius;
                        let gone = columns.add(i * lanes + 32 * q).cast::<__m256i>();
                        for half in 0..2 {
                            window[half] = _mm256_sub_epi16(window[half], _mm256_loadu_si256(gone.add(half)));
                        }
                        let bytes =
                            _mm256_packus_epi16(_mm256_srl_epi16(window[0], shift), _mm256_srl_epi16(window[1], shift));
                        let outside = _mm256_loadu_si256(row.outside.as_ptr().add(i + 32 * q).cast());
                        let to = row.out.as_mut_ptr().add(i * lanes + 32 * q).cast();
                        _mm256_storeu_si256(to, _mm256_or_si256(bytes, outside));
                    }
                }
            }
        }
    }

    /// Smallest byte.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn min_byte(v: __m256i) -> u8 {
        let half = _mm_min_epu8(_mm256_castsi256_si128(v), _mm256_extracti128_si256::<1>(v));
        let words = _mm_min_epu8(half, _mm_srli_epi16::<8>(half));
        _mm_cvtsi128_si32(_mm_minpos_epu16(words)) as u8
    }

    #[target_feature(enable = "avx2")]
    #[inline]
    unsafe fn add_bytes(sums: *mut __m256i, value: __m256i) {
        let zero = _mm256_setzero_si256();
        let (lo, hi) = (_mm256_unpacklo_epi8(value, zero), _mm256_unpackhi_epi8(value, zero));
        // SAFETY: the caller passes room for two vectors.
        unsafe {
            _mm256_storeu_si256(sums, _mm256_add_epi16(_mm256_loadu_si256(sums), lo));
            _mm256_storeu_si256(sums.add(1), _mm256_add_epi16(_mm256_loadu_si256(sums.add(1)), hi));
        }
    }

    /// # Safety
    /// Needs AVX2. `DOWN` downward paths; `CHUNKS` is `lanes / 32`, or 0 when not known in advance; `VECTORS`
    /// is at least that.
    #[target_feature(enable = "avx2")]
    pub(super) unsafe fn aggregate<const DOWN: usize, const CHUNKS: usize, const VECTORS: usize>(paths: Paths<'_>) {
        let chunks = if CHUNKS == 0 { paths.lanes / 32 } else { CHUNKS };
        let lanes = chunks * 32;
        let Paths { count, penalties, .. } = paths;
        let slot = slot_bytes(lanes);
        let slots = paths.offsets.len() * (count + 2);
        assert!(paths.offsets.len() == DOWN);
        assert!(lanes == paths.lanes && chunks <= VECTORS && lanes <= MAX_LANES && paths.cost.len() >= count * lanes);
        assert!(paths.before.len() >= slots * slot && paths.after.len() >= slots * slot);
        assert!(paths.min_before.len() >= slots && paths.min_after.len() >= slots);
        assert!(paths.sums.len() >= count * lanes && paths.offsets.iter().all(|offset| offset.abs() <= 1));
        let small = _mm256_set1_epi8(penalties.small as i8);
        let ones = _mm256_set1_epi8(-1);
        let zero = _mm256_setzero_si256();
        let cost = paths.cost.as_ptr();
        let sums = paths.sums.as_mut_ptr();
        // SAFETY: slots `0..slots`, pixels `0..count` and lanes `0..lanes` only; lengths checked above;
        // the bytes beside a slot's lanes belong to its rim.
        unsafe {
            let mut before = [_mm256_setzero_si256(); VECTORS];
            let mut least = 0u8;
            for i in 0..count {
                let all = _mm256_set1_epi8(least as i8);
                let jump = _mm256_set1_epi8(least.saturating_add(penalties.large) as i8);
                let mut smallest = ones;
                let mut next = [ones; VECTORS];
                let mut from = [0; DOWN];
                let mut all_down = [ones; DOWN];
                let mut jump_down = [ones; DOWN];
                let mut smallest_down = [ones; DOWN];
                for path in 0..DOWN {
                    let offset = *paths.offsets.get_unchecked(path);
                    from[path] = path * (count + 2) + (i as isize + 1 + offset) as usize;
                    let least = *paths.min_before.get_unchecked(from[path]);
                    all_down[path] = _mm256_set1_epi8(least as i8);
                    jump_down[path] = _mm256_set1_epi8(least.saturating_add(penalties.large) as i8);
                }
                for q in 0..chunks {
                    let cost = _mm256_loadu_si256(cost.add(i * lanes + 32 * q).cast());
                    let value = level(&before, q, chunks, small, all, jump, cost);
                    next[q] = value;
                    smallest = _mm256_min_epu8(smallest, value);
                    let mut lo = _mm256_unpacklo_epi8(value, zero);
                    let mut hi = _mm256_unpackhi_epi8(value, zero);
                    for path in 0..DOWN {
                        let above = paths.before.as_ptr().add(from[path] * slot + RIM + 32 * q);
                        let beside = _mm256_min_epu8(
                            _mm256_loadu_si256(above.sub(1).cast()),
                            _mm256_loadu_si256(above.add(1).cast()),
                        );
                        let best = _mm256_min_epu8(_mm256_loadu_si256(above.cast()), _mm256_adds_epu8(beside, small));
                        let best = _mm256_sub_epi8(_mm256_min_epu8(best, jump_down[path]), all_down[path]);
                        let value = _mm256_adds_epu8(cost, best);
                        let to = (path * (count + 2) + i + 1) * slot + RIM + 32 * q;
                        _mm256_storeu_si256(paths.after.as_mut_ptr().add(to).cast(), value);
                        smallest_down[path] = _mm256_min_epu8(smallest_down[path], value);
                        lo = _mm256_add_epi16(lo, _mm256_unpacklo_epi8(value, zero));
                        hi = _mm256_add_epi16(hi, _mm256_unpackhi_epi8(value, zero));
                    }
                    let sums = sums.add(i * lanes + 32 * q).cast::<__m256i>();
                    _mm256_storeu_si256(sums, lo);
                    _mm256_storeu_si256(sums.add(1), hi);
                }
                before = next;
                least = min_byte(smallest);
                for path in 0..DOWN {
                    *paths.min_after.get_unchecked_mut(path * (count + 2) + i + 1) = min_byte(smallest_down[path]);
                }
            }
            let mut before = [_mm256_setzero_si256(); VECTORS];
            let mut least = 0u8;
            for i in (0..count).rev() {
                let all = _mm256_set1_epi8(least as i8);
                let jump = _mm256_set1_epi8(least.saturating_add(penalties.large) as i8);
                let mut smallest = ones;
                let mut next = [ones; VECTORS];
                for q in 0..chunks {
                    let cost = _mm256_loadu_si256(cost.add(i * lanes + 32 * q).cast());
                    let value = level(&before, q, chunks, small, all, jump, cost);
                    next[q] = value;
                    smallest = _mm256_min_epu8(smallest, value);
                    add_bytes(sums.add(i * lanes + 32 * q).cast(), value);
                }
                before = next;
                least = min_byte(smallest);
            }
        }
    }

    /// Path costs of chunk `q` from those of the pixel before, all in registers.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn level<const VECTORS: usize>(
        before: &[__m256i; VECTORS],
        q: usize,
        chunks: usize,
        small: __m256i,
        all: __m256i,
        jump: __m256i,
        cost: __m256i,
    ) -> __m256i {
        let ones = _mm256_set1_epi8(-1);
        let here = before[q];
        let below = if q > 0 { before[q - 1] } else { ones };
        let above = if q + 1 < chunks { before[q + 1] } else { ones };
        let less = _mm256_alignr_epi8::<15>(here, _mm256_permute2x128_si256::<0x21>(below, here));
        let more = _mm256_alignr_epi8::<1>(_mm256_permute2x128_si256::<0x21>(here, above), here);
        let best = _mm256_min_epu8(here, _mm256_adds_epu8(_mm256_min_epu8(less, more), small));
        _mm256_adds_epu8(cost, _mm256_sub_epi8(_mm256_min_epu8(best, jump), all))
    }
}
