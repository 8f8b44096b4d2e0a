//! One output row of block matching: slide the window down a row and along it, and let each left
//! and each right pixel take its cheapest disparity.
//!
//! A cell is (left column, lane); lane `k` stands for disparity `min + lanes - 1 - k`, so that the
//! right pixels of one column lie in ascending memory order. Column sums are kept per cell in
//! 16 bits; the window's sum follows by adding the column that enters and taking off the one that leaves.

/// Largest number of lanes (disparities searched).
pub(crate) const MAX_LANES: usize = 512;

/// What a row of matching reads and writes. Columns count from the first left pixel of the window
/// of the first output pixel: column `c` is left pixel `x0 - radius + c`.
pub(crate) struct Row<'a> {
    /// Disparities, a multiple of 32.
    pub lanes: usize,
    /// Output pixels.
    pub count: usize,
    /// Window radius.
    pub radius: usize,
    /// Rows entering the window: left from column 0, right from lane 0 of column 0.
    pub new_left: &'a [u8],
    pub new_right: &'a [u8],
    /// Rows leaving the window.
    pub old_left: &'a [u8],
    pub old_right: &'a [u8],
    /// 255 where the right pixel is outside the right view, laid out as `new_right`, starting at the
    /// first output pixel's lane 0.
    pub outside: &'a [u8],
    /// Output pixels from which on, and up to which, no lane is outside.
    pub inside: std::ops::Range<usize>,
    /// `(count + 2 radius + 1) * lanes` column sums; the first `lanes` stay zero.
    pub columns: &'a mut [u16],
    /// `count * lanes` window sums of this row.
    pub cost: &'a mut [u16],
    /// Cheapest lane of each output pixel, and its cost.
    pub best_lane: &'a mut [u16],
    pub best_cost: &'a mut [u16],
    /// Costs of the lanes above and below the cheapest; its own at the ends. Taken while the pixel's costs are at hand.
    pub less: &'a mut [u16],
    pub more: &'a mut [u16],
    /// Not 0 where another disparity, not next to the best, is as cheap to within `uniqueness_percent`.
    pub ambiguous: &'a mut [u16],
    /// Cheapest output pixel for each right pixel; entry `j` is right pixel
    /// `x0 + j - min - lanes`; `count + lanes` entries; `u16::MAX` cost means never seen.
    pub right_best: &'a mut [u16],
    pub right_cost: &'a mut [u16],
    /// 0 switches the test off.
    pub uniqueness_percent: u32,
}

/// Where lane `k` of a pixel is stored: vectors are kept in the order that byte unpacking leaves.
#[inline(always)]
pub(crate) fn slot_interleaved(k: usize) -> usize {
    (k & !31) | (k & 7) | ((k & 16) >> 1) | ((k & 8) << 1)
}

/// Adds one row to the column sums, without output (fills the first window).
pub(crate) fn add_row(left: &[u8], right: &[u8], lanes: usize, interleaved: bool, columns: &mut [u16]) {
    #[cfg(target_arch = "x86_64")]
    if interleaved {
        // SAFETY: `interleaved` is only asked for where AVX2 was found.
        unsafe { avx2::add_row(left, right, lanes, columns) };
        return;
    }
    debug_assert!(!interleaved);
    for (c, sums) in columns[lanes..].chunks_exact_mut(lanes).enumerate() {
        let value = left[c];
        for (sum, other) in sums.iter_mut().zip(&right[c..c + lanes]) {
            *sum += u16::from(value.abs_diff(*other));
        }
    }
}

/// Runs one row; `interleaved` chooses the AVX2 form (the caller has checked the processor).
pub(crate) fn match_row(row: Row<'_>, interleaved: bool) {
    #[cfg(target_arch = "x86_64")]
    if interleaved {
        // SAFETY: `interleaved` is only asked for where AVX2 was found; the slices' lengths are checked inside.
        unsafe {
            match row.lanes {
                32 => avx2::match_row::<1, true>(row),
                64 => avx2::match_row::<2, true>(row),
                96 => avx2::match_row::<3, true>(row),
                128 => avx2::match_row::<4, true>(row),
                160 => avx2::match_row::<5, true>(row),
                192 => avx2::match_row::<6, true>(row),
                224 => avx2::match_row::<7, true>(row),
                256 => avx2::match_row::<8, true>(row),
                _ => avx2::match_row::<0, true>(row),
            }
        }
        return;
    }
    debug_assert!(!interleaved);
    portable(row, true);
}

/// Takes the winners of a row whose costs are given in `row.cost` (by another method than sums of
/// differences); the entering and leaving rows and the column sums are not looked at.
pub(crate) fn pick_row(row: Row<'_>, interleaved: bool) {
    #[cfg(target_arch = "x86_64")]
    if interleaved {
        // SAFETY: as in `match_row`.
        unsafe {
            match row.lanes {
                32 => avx2::match_row::<1, false>(row),
                64 => avx2::match_row::<2, false>(row),
                96 => avx2::match_row::<3, false>(row),
                128 => avx2::match_row::<4, false>(row),
                160 => avx2::match_row::<5, false>(row),
                192 => avx2::match_row::<6, false>(row),
                224 => avx2::match_row::<7, false>(row),
                256 => avx2::match_row::<8, false>(row),
                _ => avx2::match_row::<0, false>(row),
            }
        }
        return;
    }
    debug_assert!(!interleaved);
    portable(row, false);
}

fn portable(row: Row<'_>, slide: bool) {
    let Row { lanes, count, radius, new_left, new_right, old_left, old_right, outside, inside, .. } = row;
    let mut window = [0u16; MAX_LANES];
    let window = &mut window[..lanes];
    let mut right_cost = [u16::MAX; MAX_LANES + 1];
    let mut right_best = [0u16; MAX_LANES + 1];
    for c in 0..count + 2 * radius {
        for k in 0..if slide { lanes } else { 0 } {
            let (new, old) = (new_left[c], old_left[c]);
            let sums = &mut row.columns[(c + 1) * lanes..(c + 2) * lanes];
            let entering = u16::from(new.abs_diff(new_right[c + k]));
            let leaving = u16::from(old.abs_diff(old_right[c + k]));
            sums[k] = sums[k].wrapping_add(entering).wrapping_sub(leaving);
            window[k] = window[k].wrapping_add(sums[k]);
        }
        if c < 2 * radius {
            continue;
        }
        let i = c - 2 * radius;
        let cost = &mut row.cost[i * lanes..(i + 1) * lanes];
        if slide {
            let gone = &row.columns[(c - 2 * radius) * lanes..(c - 2 * radius + 1) * lanes];
            for k in 0..lanes {
                window[k] = window[k].wrapping_sub(gone[k]);
            }
            cost.copy_from_slice(window);
        } else {
            window.copy_from_slice(cost);
        }
        let blocked = |k: usize| !inside.contains(&i) && outside[i + k] != 0;
        let cost_at = |k: usize| if blocked(k) { u16::MAX } else { window[k] };
        let mut best = (u16::MAX, 0);
        row.right_cost[i] = right_cost[0];
        row.right_best[i] = right_best[0];
        for k in 0..lanes {
            let cost = cost_at(k);
            if cost <= best.0 {
                best = (cost, k);
            }
            right_cost[k] = right_cost[k + 1];
            right_best[k] = right_best[k + 1];
            if cost < right_cost[k] {
                right_cost[k] = cost;
                right_best[k] = i as u16;
            }
        }
        row.best_lane[i] = best.1 as u16;
        row.best_cost[i] = best.0;
        row.less[i] = window[(best.1 + 1).min(lanes - 1)];
        row.more[i] = window[best.1.saturating_sub(1)];
        let limit = limit_cost(best.0, row.uniqueness_percent);
        let rival = row.uniqueness_percent > 0 && (0..lanes).any(|k| k.abs_diff(best.1) > 1 && cost_at(k) <= limit);
        row.ambiguous[i] = u16::from(rival);
    }
    row.right_cost[count..count + lanes].copy_from_slice(&right_cost[..lanes]);
    row.right_best[count..count + lanes].copy_from_slice(&right_best[..lanes]);
}

#[inline(always)]
fn limit_cost(best: u16, percent: u32) -> u16 {
    // One below the maximum, so that blocked lanes never count as rivals.
    (u32::from(best) + u32::from(best) * percent / 100).min(u32::from(u16::MAX) - 1) as u16
}

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use super::{MAX_LANES, Row, limit_cost, slot_interleaved};
    use std::arch::x86_64::*;

    const VECTORS: usize = MAX_LANES / 16;

    /// # Safety
    /// Needs AVX2.
    #[target_feature(enable = "avx2")]
    pub(super) unsafe fn add_row(left: &[u8], right: &[u8], lanes: usize, columns: &mut [u16]) {
        let count = columns.len() / lanes - 1;
        assert!(lanes.is_multiple_of(32) && left.len() >= count && right.len() + 1 >= count + lanes);
        let zero = _mm256_setzero_si256();
        for c in 0..count {
            // SAFETY: `c < count`, so left, right and columns are long enough (checked above).
            unsafe {
                let value = _mm256_set1_epi8(*left.get_unchecked(c) as i8);
                let mut sums = columns.as_mut_ptr().add((c + 1) * lanes).cast::<__m256i>();
                let mut other = right.as_ptr().add(c).cast::<__m256i>();
                for _ in 0..lanes / 32 {
                    let b = _mm256_loadu_si256(other);
                    let d = _mm256_or_si256(_mm256_subs_epu8(value, b), _mm256_subs_epu8(b, value));
                    let lo = _mm256_add_epi16(_mm256_loadu_si256(sums), _mm256_unpacklo_epi8(d, zero));
                    let hi = _mm256_add_epi16(_mm256_loadu_si256(sums.add(1)), _mm256_unpackhi_epi8(d, zero));
                    _mm256_storeu_si256(sums, lo);
                    _mm256_storeu_si256(sums.add(1), hi);
                    sums = sums.add(2);
                    other = other.add(1);
                }
            }
        }
    }

    /// # Safety
    /// Needs AVX2. `CHUNKS` is `lanes / 32`, or 0 when not known in advance.
    #[target_feature(enable = "avx2")]
    pub(super) unsafe fn match_row<const CHUNKS: usize, const SLIDE: bool>(row: Row<'_>) {
        let chunks = if CHUNKS == 0 { row.lanes / 32 } else { CHUNKS };
        let lanes = chunks * 32;
        let Row { count, radius, .. } = row;
        let steps = count + 2 * radius;
        assert!(lanes == row.lanes && lanes <= MAX_LANES && lanes > 0);
        if SLIDE {
            assert!(row.new_left.len() >= steps && row.old_left.len() >= steps);
            assert!(row.new_right.len() >= steps + lanes && row.old_right.len() >= steps + lanes);
            assert!(row.columns.len() >= (steps + 1) * lanes);
        }
        assert!(row.outside.len() >= count + lanes);
        assert!(row.cost.len() >= count * lanes && row.best_lane.len() >= count);
        assert!(row.best_cost.len() >= count && row.ambiguous.len() >= count);
        assert!(row.less.len() >= count && row.more.len() >= count);
        assert!(row.right_best.len() >= count + lanes && row.right_cost.len() >= count + lanes);

        let columns = row.columns.as_mut_ptr();
        let none = _mm256_set1_epi16(-1);
        let mut window = [_mm256_setzero_si256(); VECTORS];
        let mut right_cost = [none; VECTORS];
        let mut right_best = [_mm256_setzero_si256(); VECTORS];
        // SAFETY: every pointer below stays inside the slices whose lengths were just checked: columns
        // `0..=steps`, right bytes up to `steps - 1 + lanes`, outputs up to `count` or `count + lanes`.
        unsafe {
            for c in 0..if SLIDE { 2 * radius } else { 0 } {
                slide_column::<CHUNKS>(&row, columns, c, chunks, &mut window);
            }
            for i in 0..count {
                if SLIDE {
                    slide_column::<CHUNKS>(&row, columns, i + 2 * radius, chunks, &mut window);
                }
                let cost = row.cost.as_mut_ptr().add(i * lanes).cast::<__m256i>();
                let masked = !row.inside.contains(&i);
                *row.right_cost.get_unchecked_mut(i) = _mm256_extract_epi16::<0>(right_cost[0]) as u16;
                *row.right_best.get_unchecked_mut(i) = _mm256_extract_epi16::<0>(right_best[0]) as u16;
                let here = _mm256_set1_epi16(i as i16);
                let mut least = none;
                let mut open = [none; VECTORS];
                for q in 0..chunks {
                    let (mut lo, mut hi);
                    if SLIDE {
                        let gone = columns.add(i * lanes).cast::<__m256i>();
                        lo = _mm256_sub_epi16(window[2 * q], _mm256_loadu_si256(gone.add(2 * q)));
                        hi = _mm256_sub_epi16(window[2 * q + 1], _mm256_loadu_si256(gone.add(2 * q + 1)));
                        window[2 * q] = lo;
                        window[2 * q + 1] = hi;
                        _mm256_storeu_si256(cost.add(2 * q), lo);
                        _mm256_storeu_si256(cost.add(2 * q + 1), hi);
                    } else {
                        lo = _mm256_loadu_si256(cost.add(2 * q));
                        hi = _mm256_loadu_si256(cost.add(2 * q + 1));
                    }
                    if masked {
                        let m = _mm256_loadu_si256(row.outside.as_ptr().add(i + 32 * q).cast());
                        lo = _mm256_or_si256(lo, _mm256_unpacklo_epi8(m, m));
                        hi = _mm256_or_si256(hi, _mm256_unpackhi_epi8(m, m));
                    }
                    open[2 * q] = lo;
                    open[2 * q + 1] = hi;
                    least = _mm256_min_epu16(least, _mm256_min_epu16(lo, hi));

                    // The right pixels' window moves on by one: lane k takes lane k + 1.
                    let next_cost = if q + 1 < chunks { right_cost[2 * q + 2] } else { none };
                    let next_best = if q + 1 < chunks { right_best[2 * q + 2] } else { none };
                    let (rc_lo, rc_hi) = shift_lane(right_cost[2 * q], right_cost[2 * q + 1], next_cost);
                    let (rb_lo, rb_hi) = shift_lane(right_best[2 * q], right_best[2 * q + 1], next_best);
                    let min_lo = _mm256_min_epu16(rc_lo, lo);
                    let min_hi = _mm256_min_epu16(rc_hi, hi);
                    right_cost[2 * q] = min_lo;
                    right_cost[2 * q + 1] = min_hi;
                    // Equal to the old cost: the earlier (nearer to disparity `min`) pixel keeps it.
                    right_best[2 * q] = _mm256_blendv_epi8(here, rb_lo, _mm256_cmpeq_epi16(min_lo, rc_lo));
                    right_best[2 * q + 1] = _mm256_blendv_epi8(here, rb_hi, _mm256_cmpeq_epi16(min_hi, rc_hi));
                }
                let half = _mm_min_epu16(_mm256_castsi256_si128(least), _mm256_extracti128_si256::<1>(least));
                let best = _mm_extract_epi16::<0>(_mm_minpos_epu16(half)) as u16;
                let best_all = _mm256_set1_epi16(best as i16);
                let mut lane = 0;
                for q in 0..chunks {
                    let equal = _mm256_movemask_epi8(_mm256_packs_epi16(
                        _mm256_cmpeq_epi16(open[2 * q], best_all),
                        _mm256_cmpeq_epi16(open[2 * q + 1], best_all),
                    )) as u32;
                    if equal != 0 {
                        lane = 32 * q + 31 - equal.leading_zeros() as usize;
                    }
                }
                *row.best_lane.get_unchecked_mut(i) = lane as u16;
                *row.best_cost.get_unchecked_mut(i) = best;
                let cost = cost.cast::<u16>();
                *row.less.get_unchecked_mut(i) = *cost.add(slot_interleaved((lane + 1).min(lanes - 1)));
                *row.more.get_unchecked_mut(i) = *cost.add(slot_interleaved(lane.saturating_sub(1)));
                let mut rivals = 0;
                if row.uniqueness_percent > 0 {
                    let limit = _mm256_set1_epi16(limit_cost(best, row.uniqueness_percent) as i16);
                    for q in 0..chunks {
                        let (lo, hi) = (open[2 * q], open[2 * q + 1]);
                        let cheap = _mm256_movemask_epi8(_mm256_packs_epi16(
                            _mm256_cmpeq_epi16(_mm256_min_epu16(lo, limit), lo),
                            _mm256_cmpeq_epi16(_mm256_min_epu16(hi, limit), hi),
                        )) as u32;
                        let from = lane as isize - 32 * q as isize + 1;
                        let near = if (0..=33).contains(&from) { ((7u64 << from) >> 2) as u32 } else { 0 };
                        rivals |= cheap & !near;
                    }
                }
                *row.ambiguous.get_unchecked_mut(i) = u16::from(rivals != 0);
            }
            let mut tail = [0u16; MAX_LANES];
            for (source, target) in [(&right_cost, row.right_cost), (&right_best, row.right_best)] {
                std::ptr::copy_nonoverlapping(source.as_ptr().cast::<u16>(), tail.as_mut_ptr(), lanes);
                for k in 0..lanes {
                    target[count + k] = tail[slot_interleaved(k)];
                }
            }
        }
    }

    /// Brings column `c` up to date and adds it to the window.
    #[target_feature(enable = "avx2")]
    #[inline]
    unsafe fn slide_column<const CHUNKS: usize>(
        row: &Row<'_>,
        columns: *mut u16,
        c: usize,
        chunks: usize,
        window: &mut [__m256i; VECTORS],
    ) {
        let chunks = if CHUNKS == 0 { chunks } else { CHUNKS };
        let signs = _mm256_set1_epi16(0xff01u16 as i16);
        // SAFETY: the caller passes `c < count + 2 radius`; lengths were checked there.
        unsafe {
            let new = _mm256_set1_epi8(*row.new_left.get_unchecked(c) as i8);
            let old = _mm256_set1_epi8(*row.old_left.get_unchecked(c) as i8);
            let sums = columns.add((c + 1) * chunks * 32).cast::<__m256i>();
            for q in 0..chunks {
                let a = _mm256_loadu_si256(row.new_right.as_ptr().add(c + 32 * q).cast());
                let b = _mm256_loadu_si256(row.old_right.as_ptr().add(c + 32 * q).cast());
                let entering = _mm256_or_si256(_mm256_subs_epu8(new, a), _mm256_subs_epu8(a, new));
                let leaving = _mm256_or_si256(_mm256_subs_epu8(old, b), _mm256_subs_epu8(b, old));
                // Byte pairs (entering, leaving) times (1, -1), added: the change of 16 sums at a time.
                let lo = _mm256_maddubs_epi16(_mm256_unpacklo_epi8(entering, leaving), signs);
                let hi = _mm256_maddubs_epi16(_mm256_unpackhi_epi8(entering, leaving), signs);
                let lo = _mm256_add_epi16(_mm256_loadu_si256(sums.add(2 * q)), lo);
                let hi = _mm256_add_epi16(_mm256_loadu_si256(sums.add(2 * q + 1)), hi);
                _mm256_storeu_si256(sums.add(2 * q), lo);
                _mm256_storeu_si256(sums.add(2 * q + 1), hi);
                window[2 * q] = _mm256_add_epi16(window[2 * q], lo);
                window[2 * q + 1] = _mm256_add_epi16(window[2 * q + 1], hi);
            }
        }
    }

    /// Lanes of one chunk moved down by one; `next` brings the lane that enters.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn shift_lane(lo: __m256i, hi: __m256i, next: __m256i) -> (__m256i, __m256i) {
        let behind = _mm256_permute2x128_si256::<0x21>(lo, next);
        (_mm256_alignr_epi8::<2>(hi, lo), _mm256_alignr_epi8::<2>(behind, hi))
    }
}
