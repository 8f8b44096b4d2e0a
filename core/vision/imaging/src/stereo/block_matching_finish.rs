//! From winners to disparities: sub-pixel fit, the tests, and the right view's map, one row at a time.
//!
//! Each row runs in two loops: one that picks the neighbours' costs (scattered reads), one that does
//! the arithmetic on plain arrays, without branches, so that the compiler can vectorise it.

use crate::stereo::block_matching_kernel::slot_interleaved;

/// What the kernel left behind for one row, and room for the neighbours' costs.
pub(crate) struct Winners<'a> {
    pub lanes: usize,
    pub count: usize,
    /// Whether lanes lie in the AVX2 kernel's order.
    pub interleaved: bool,
    pub cost: &'a [u16],
    pub best_lane: &'a [u16],
    pub best_cost: &'a [u16],
    pub ambiguous: &'a [u16],
    pub texture: &'a [u16],
    pub right_best: &'a [u16],
    pub right_cost: &'a [u16],
    pub less: &'a mut [u16],
    pub more: &'a mut [u16],
    pub back: &'a mut [u16],
    /// Output pixels that have no lane outside the right view.
    pub inside: std::ops::Range<usize>,
    /// As in the kernel's row.
    pub outside: &'a [u8],
}

const SLOTS: [u8; 32] = {
    let mut slots = [0; 32];
    let mut k = 0;
    while k < 32 {
        slots[k] = ((k & 7) | ((k & 16) >> 1) | ((k & 8) << 1)) as u8;
        k += 1;
    }
    slots
};

#[inline(always)]
fn slot(k: usize, interleaved: bool) -> usize {
    debug_assert_eq!(slot_interleaved(k), (k & !31) | usize::from(SLOTS[k & 31]));
    if interleaved { (k & !31) | usize::from(SLOTS[k & 31]) } else { k }
}

/// Limits of the tests; all inclusive.
pub(crate) struct Limits {
    pub texture_at_least: u16,
    pub left_right_at_most: u16,
}

/// Writes the left row; `first` is the disparity of the highest lane.
pub(crate) fn left(winners: &mut Winners<'_>, limits: &Limits, first: i32, avx2: bool, out: &mut [f32]) {
    pick_left(winners);
    #[cfg(target_arch = "x86_64")]
    if avx2 {
        // SAFETY: the caller found AVX2.
        unsafe { fit_left_avx2(winners, limits, first, out) };
        return;
    }
    let _ = avx2;
    fit_left(winners, limits, first, out);
}

fn pick_left(w: &mut Winners<'_>) {
    let count = w.count;
    for (i, (k, back)) in w.best_lane[..count].iter().zip(w.back[..count].iter_mut()).enumerate() {
        *back = w.right_best[i + 1 + usize::from(*k)];
    }
    // Next to the right view's edges a neighbour may be outside: no fit there.
    for i in (0..count.min(w.inside.start)).chain(w.inside.end.clamp(w.inside.start.min(count), count)..count) {
        let k = usize::from(w.best_lane[i]);
        if (k > 0 && w.outside[i + k - 1] != 0) || w.outside[i + k + 1] != 0 {
            w.less[i] = w.best_cost[i];
            w.more[i] = w.best_cost[i];
        }
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn fit_left_avx2(winners: &Winners<'_>, limits: &Limits, first: i32, out: &mut [f32]) {
    fit_left(winners, limits, first, out);
}

#[inline(always)]
fn fit_left(w: &Winners<'_>, limits: &Limits, first: i32, out: &mut [f32]) {
    let n = w.count;
    let last_lane = w.lanes as i32 - 1;
    let (lane, here, less, more) = (&w.best_lane[..n], &w.best_cost[..n], &w.less[..n], &w.more[..n]);
    let (back, ambiguous, texture) = (&w.back[..n], &w.ambiguous[..n], &w.texture[..n]);
    let out = &mut out[..n];
    let (texture_least, apart_most) = (limits.texture_at_least, i32::from(limits.left_right_at_most));
    for i in 0..n {
        let k = i32::from(lane[i]);
        let apart = (i32::from(back[i]) - i as i32).abs();
        let keep = (ambiguous[i] == 0) & (texture[i] >= texture_least) & (apart <= apart_most);
        let inner = (k > 0) & (k < last_lane);
        let offset = equiangular(i32::from(less[i]), i32::from(here[i]), i32::from(more[i]));
        let value = (first + last_lane - k) as f32 + if inner { offset } else { 0.0 };
        out[i] = if keep { value } else { f32::NAN };
    }
}

/// Writes those of the right winners that lie inside a view of `width` columns; `x0` is the first
/// output pixel's column.
pub(crate) fn right_within(
    winners: &mut Winners<'_>,
    x0: usize,
    width: usize,
    first: i32,
    avx2: bool,
    out: &mut [f32],
) {
    let entries = (winners.count + winners.lanes) as i64;
    // Entry j is right pixel `shift + j`; entry 0 is never a pixel.
    let shift = x0 as i64 - i64::from(first) - winners.lanes as i64;
    let from = (-shift).clamp(1, entries);
    let to = (width as i64 - shift).clamp(from, entries);
    if from < to {
        let pixels = (shift + from) as usize..(shift + to) as usize;
        right(winners, from as usize, first, avx2, &mut out[pixels]);
    }
}

/// Writes the right row: entry `j` of the winners goes to `out[j - from]`.
fn right(w: &mut Winners<'_>, from: usize, first: i32, avx2: bool, out: &mut [f32]) {
    pick_right(w, from, out.len());
    #[cfg(target_arch = "x86_64")]
    if avx2 {
        // SAFETY: the caller found AVX2.
        unsafe { fit_right_avx2(w, from, first, out) };
        return;
    }
    let _ = avx2;
    fit_right(w, from, first, out);
}

fn pick_right(w: &mut Winners<'_>, from: usize, n: usize) {
    let (lanes, count) = (w.lanes, w.count);
    let cost = &w.cost[..count * lanes];
    let best = &w.right_best[from..from + n];
    for (step, ((i, less), more)) in best.iter().zip(&mut w.less[..n]).zip(&mut w.more[..n]).enumerate() {
        let i = usize::from(*i);
        let k = (step + from - 1).wrapping_sub(i).min(lanes - 1);
        let (left, right) = (i.saturating_sub(1), (i + 1).min(count - 1));
        *less = cost[left * lanes + slot((k + 1).min(lanes - 1), w.interleaved)];
        *more = cost[right * lanes + slot(k.saturating_sub(1), w.interleaved)];
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn fit_right_avx2(w: &Winners<'_>, from: usize, first: i32, out: &mut [f32]) {
    fit_right(w, from, first, out);
}

#[inline(always)]
fn fit_right(w: &Winners<'_>, from: usize, first: i32, out: &mut [f32]) {
    let n = out.len();
    let lanes = w.lanes as i32;
    let last = w.count as i32 - 1;
    let (best, here) = (&w.right_best[from..from + n], &w.right_cost[from..from + n]);
    let (less, more) = (&w.less[..n], &w.more[..n]);
    for step in 0..n {
        let i = i32::from(best[step]);
        let relative = i + lanes - (from + step) as i32;
        let inner = (relative > 0) & (relative < lanes - 1) & (i > 0) & (i < last);
        let offset = equiangular(i32::from(less[step]), i32::from(here[step]), i32::from(more[step]));
        let value = (first + relative) as f32 + if inner { offset } else { 0.0 };
        out[step] = if here[step] == u16::MAX { f32::NAN } else { value };
    }
}

/// Position of the minimum, in -0.5..=0.5, from the costs one disparity less, here and one more.
#[inline(always)]
pub(crate) fn equiangular(less: i32, here: i32, more: i32) -> f32 {
    let rise = less.max(more) - here;
    ((less - more) as f32 / (2 * rise.max(1)) as f32).clamp(-0.5, 0.5)
}
