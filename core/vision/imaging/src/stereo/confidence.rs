//! How far a matched disparity may be trusted, before any filter has seen it.

use crate::{Parallel, Rect, SharedMut, View};

/// What lowers the confidence of a disparity.
#[derive(Clone, Debug, PartialEq)]
pub struct ConfidenceParams {
    /// Largest difference in px to the right view's disparity; more makes the confidence 0.
    pub left_right_px: f32,
    /// Radius in px of the neighbourhood whose scatter of disparities, and whose share of matched pixels, is
    /// measured; 0 measures none. About half the matcher's window.
    pub scatter_radius_px: usize,
    /// Confidence lost per px^2 of variance in that neighbourhood: block matching is wrong near depth edges.
    pub loss_per_px2: f32,
    /// Gray level from which on a pixel is a highlight, which moves with the eye: confidence 0; 255 or
    /// less. `None` keeps highlights.
    pub highlight_level: Option<u8>,
    /// Level up to which (in all channels) a pixel is black: outside the scope's picture, confidence 0.
    pub dark_level: Option<u8>,
}

impl Default for ConfidenceParams {
    fn default() -> Self {
        Self {
            left_right_px: 1.5,
            scatter_radius_px: 5,
            loss_per_px2: 0.25,
            highlight_level: Some(250),
            dark_level: Some(4),
        }
    }
}

/// Disparities are quantised to this part of a px for the scatter, so that sums are whole numbers.
pub const STEPS_PER_PX: f32 = 4.0;
/// Largest quantised disparity: the squares of a 31 x 31 window of these still fit 32 bits, and their sum fits the bits below
/// the count.
const MAX_STEPS: f32 = 2047.0;
/// Sums carry the count of their pixels from this bit on.
const COUNT_SHIFT: u32 = 21;
/// Part of the neighbourhood that must be matched for full confidence.
pub const FULL_SHARE: f32 = 0.6;
/// Rows of one chunk; the rows of its window's rim are read twice.
const CHUNK_ROWS: usize = 48;

/// Work memory of [`Confidence::compute`].
#[derive(Debug, Default)]
pub struct Confidence {
    bands: Vec<Band>,
}

#[derive(Debug, Default)]
struct Band {
    /// Per column, over the window's rows: quantised disparities counted and summed (see [`COUNT_SHIFT`]), and their
    /// squares summed.
    columns: [Vec<u32>; 2],
    totals: [Vec<u32>; 2],
    /// Sums of 2, 4, 8 ... neighbours.
    doubled: [Vec<u32>; 2],
}

impl Confidence {
    /// Confidence 0..=1 of the disparities in `roi`, row-major, `roi.width * roi.height`; 0 where NaN.
    /// `guide` is gray or BGR. Sizes are the caller's duty (all views alike, `out` as long as the ROI).
    pub fn compute(
        &mut self,
        params: &ConfidenceParams,
        guide: View<'_, u8>,
        disparity: View<'_, f32>,
        disparity_right: Option<View<'_, f32>>,
        roi: Rect,
        avx2: bool,
        pool: &dyn Parallel,
        out: &mut [f32],
    ) {
        let roi = roi.clamped(disparity.width, disparity.height);
        if roi.is_empty() {
            return;
        }
        let chunks = roi.height.div_ceil(CHUNK_ROWS);
        if self.bands.len() < chunks {
            self.bands.resize_with(chunks, Band::default);
        }
        let bands = SharedMut::new(&mut self.bands);
        let out = SharedMut::new(out);
        pool.run(chunks, &|chunk| {
            // SAFETY: one band and its rows, one chunk.
            let band = unsafe { &mut bands.part(chunk, 1)[0] };
            let first = chunk * CHUNK_ROWS;
            let last = (first + CHUNK_ROWS).min(roi.height);
            let mut window = Window { disparity, roi, radius: params.scatter_radius_px, band, avx2 };
            if params.scatter_radius_px > 0 {
                window.start(first);
            }
            for row in first..last {
                // SAFETY: the rows `first..last` of the map belong to this chunk alone.
                let out = unsafe { out.part(row * roi.width, roi.width) };
                let y = roi.y + row;
                if params.scatter_radius_px > 0 {
                    window.step(row);
                    window.scatter(params.loss_per_px2, out);
                } else {
                    out.fill(1.0);
                }
                let here = &disparity.row(y)[roi.x..roi.x + roi.width];
                check_row(params.left_right_px, here, disparity_right.map(|map| map.row(y)), roi.x, avx2, out);
                if params.highlight_level.is_some() || params.dark_level.is_some() {
                    let channels = guide.channels;
                    let pixels = &guide.row(y)[roi.x * channels..(roi.x + roi.width) * channels];
                    let dark = params.dark_level.map_or(-1, i32::from);
                    let bright = params.highlight_level.map_or(256, i32::from);
                    match channels {
                        3 => exposure::<3>(pixels, (dark, bright), avx2, out),
                        _ => exposure::<1>(pixels, (dark, bright), avx2, out),
                    }
                }
            }
        });
    }
}

/// Clears the confidence of black pixels (`limits.0` and below) and of highlights (`limits.1` and above). All channels count
/// at once: a strongly coloured pixel is neither.
fn exposure<const CHANNELS: usize>(pixels: &[u8], limits: (i32, i32), avx2: bool, out: &mut [f32]) {
    let mut done = 0;
    #[cfg(target_arch = "x86_64")]
    if avx2 {
        // SAFETY: the caller found AVX2.
        done = unsafe { avx2::exposure::<CHANNELS>(pixels, limits, out) };
    }
    let _ = avx2;
    let (dark, bright) = limits;
    for (pixel, value) in pixels.chunks_exact(CHANNELS).zip(out).skip(done) {
        let (mut least, mut most) = (u8::MAX, 0);
        for channel in 0..CHANNELS {
            least = least.min(pixel[channel]);
            most = most.max(pixel[channel]);
        }
        let clear = (i32::from(least) >= bright) | (i32::from(most) <= dark);
        *value = if clear { 0.0 } else { *value };
    }
}

/// Clears the confidence of unmatched pixels and of those that the right view contradicts.
fn check_row(max_px: f32, here: &[f32], right: Option<&[f32]>, x0: usize, avx2: bool, out: &mut [f32]) {
    let Some(right) = right else {
        for (d, value) in here.iter().zip(out) {
            *value = if d.is_finite() { *value } else { 0.0 };
        }
        return;
    };
    let mut done = 0;
    #[cfg(target_arch = "x86_64")]
    if avx2 {
        // SAFETY: the caller found AVX2.
        done = unsafe { avx2::check_row(max_px, here, right, x0, out) };
    }
    let _ = avx2;
    for (i, (d, value)) in here.iter().zip(out).enumerate().skip(done) {
        // Rounded to nearest; NaN and what lies outside fail the comparison.
        let x = (x0 + i) as f32 - d + 0.5;
        let inside = x >= 0.0 && x < right.len() as f32;
        // SAFETY: a number in 0..len, or 0.
        let x: i32 = unsafe { (if inside { x } else { 0.0 }).to_int_unchecked() };
        let agree = inside & ((d - right[x as usize]).abs() <= max_px);
        *value = if agree { *value } else { 0.0 };
    }
}

/// Sums over a square window that slides down a band.
struct Window<'a, 'b> {
    disparity: View<'a, f32>,
    roi: Rect,
    radius: usize,
    band: &'b mut Band,
    avx2: bool,
}

impl Window<'_, '_> {
    /// Fills the window above row `first`.
    fn start(&mut self, first: usize) {
        // Columns have a rim of zeros, so that sums along the row need no special case at the ends.
        for plane in &mut self.band.columns {
            plane.clear();
            plane.resize(self.roi.width + 2 * self.radius + 1, 0);
        }
        for plane in &mut self.band.totals {
            plane.resize(self.roi.width, 0);
        }
        for plane in &mut self.band.doubled {
            plane.resize(self.roi.width + 2 * self.radius, 0);
        }
        let from = first as isize - self.radius as isize - 1;
        for row in from..first as isize + self.radius as isize {
            self.add(row, false);
        }
    }

    /// Moves the window to `row`.
    fn step(&mut self, row: usize) {
        self.add(row as isize + self.radius as isize, false);
        self.add(row as isize - self.radius as isize - 1, true);
    }

    fn add(&mut self, row: isize, remove: bool) {
        if row < 0 || row >= self.roi.height as isize {
            return;
        }
        let values = &self.disparity.row(self.roi.y + row as usize)[self.roi.x..self.roi.x + self.roi.width];
        let rim = self.radius + 1;
        let [sum, square] = self.band.columns.each_mut().map(|plane| &mut plane[rim..]);
        #[cfg(target_arch = "x86_64")]
        if self.avx2 {
            // SAFETY: the caller found AVX2.
            unsafe { accumulate_avx2(values, remove, sum, square) };
            return;
        }
        let _ = self.avx2;
        accumulate(values, remove, sum, square);
    }

    /// Writes `(1 - loss * variance) * share`, at least 0, for the current row; `share` grows with the part
    /// of the window that is matched at all.
    fn scatter(&mut self, loss: f32, out: &mut [f32]) {
        let loss = loss / (STEPS_PER_PX * STEPS_PER_PX);
        let full = 1.0 / (FULL_SHARE * ((2 * self.radius + 1) * (2 * self.radius + 1)) as f32);
        #[cfg(target_arch = "x86_64")]
        if self.avx2 {
            // SAFETY: the caller found AVX2.
            unsafe { scatter_avx2(self.band, self.radius, (loss, full), out) };
            return;
        }
        scatter(self.band, self.radius, (loss, full), out);
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn scatter_avx2(band: &mut Band, radius: usize, weights: (f32, f32), out: &mut [f32]) {
    scatter(band, radius, weights, out);
}

#[inline(always)]
fn scatter(band: &mut Band, radius: usize, weights: (f32, f32), out: &mut [f32]) {
    let Band { columns, totals, doubled } = band;
    for (columns, totals) in columns.iter().zip(totals.iter_mut()) {
        box_sums(columns, radius, doubled, totals);
    }
    variance(&totals[0], &totals[1], weights, out);
}

/// Sums over `2 radius + 1` neighbours; `columns` begin `radius + 1` before the first pixel. Sums of 1, 2, 4, 8 ... neighbours
/// are added up, which vectors do at once, where a running sum goes step by step.
#[inline(always)]
fn box_sums(columns: &[u32], radius: usize, doubled: &mut [Vec<u32>; 2], totals: &mut [u32]) {
    let (window, n) = (2 * radius + 1, totals.len());
    let [sums, next] = doubled;
    let (mut sums, mut next) = (&mut sums[..], &mut next[..]);
    let columns = &columns[1..n + window];
    totals.copy_from_slice(&columns[..n]);
    let (mut size, mut taken) = (1, 1);
    while 2 * size <= window {
        // Sums of `2 size` neighbours, wherever as many are left.
        let (from, count) = (if size == 1 { columns } else { &*sums }, n + window - 2 * size);
        let (a, b) = (&from[..count], &from[size..size + count]);
        for ((out, a), b) in next[..count].iter_mut().zip(a).zip(b) {
            *out = a.wrapping_add(*b);
        }
        std::mem::swap(&mut sums, &mut next);
        size *= 2;
        if window & size != 0 {
            for (total, sum) in totals.iter_mut().zip(&sums[taken..taken + n]) {
                *total = total.wrapping_add(*sum);
            }
            taken += size;
        }
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn accumulate_avx2(values: &[f32], remove: bool, sum: &mut [u32], square: &mut [u32]) {
    accumulate(values, remove, sum, square);
}

#[inline(always)]
fn accumulate(values: &[f32], remove: bool, sum: &mut [u32], square: &mut [u32]) {
    let n = values.len();
    let (sum, square) = (&mut sum[..n], &mut square[..n]);
    let sign = if remove { u32::MAX } else { 1 };
    for x in 0..n {
        let valid = values[x].is_finite();
        let steps = if valid { (values[x] * STEPS_PER_PX).clamp(0.0, MAX_STEPS) } else { 0.0 };
        // SAFETY: 0..=MAX_STEPS.
        let steps: i32 = unsafe { steps.to_int_unchecked() };
        let steps = steps as u32;
        sum[x] = sum[x].wrapping_add(sign.wrapping_mul((u32::from(valid) << COUNT_SHIFT) + steps));
        square[x] = square[x].wrapping_add(sign.wrapping_mul(steps * steps));
    }
}

#[inline(always)]
fn variance(sum: &[u32], square: &[u32], (loss, full): (f32, f32), out: &mut [f32]) {
    let n = out.len();
    let (sum, square) = (&sum[..n], &square[..n]);
    for x in 0..n {
        let count = (sum[x] >> COUNT_SHIFT) as i32;
        let share = 1.0 / count.max(1) as f32;
        let mean = (sum[x] & ((1 << COUNT_SHIFT) - 1)) as i32 as f32 * share;
        // Sums of squares can exceed 2^31 only where disparities exceed 400 px all over: halve them first.
        let variance = (square[x] >> 1) as i32 as f32 * 2.0 * share - mean * mean;
        // Lone matches in an unmatched neighbourhood are chance hits: the square keeps them small.
        let matched = (count as f32 * full).min(1.0);
        out[x] = (1.0 - loss * variance.max(0.0)).clamp(0.0, 1.0) * (matched * matched);
    }
}

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use std::arch::x86_64::*;

    /// Returns how many pixels were done.
    #[target_feature(enable = "avx2")]
    pub(super) fn exposure<const CHANNELS: usize>(pixels: &[u8], (dark, bright): (i32, i32), out: &mut [f32]) -> usize {
        let order = _mm256_broadcastsi128_si256(_mm_setr_epi8(0, 1, 2, -1, 3, 4, 5, -1, 6, 7, 8, -1, 9, 10, 11, -1));
        let (dark, bright) = (_mm256_set1_epi32(dark + 1), _mm256_set1_epi32(bright - 1));
        let byte = _mm256_set1_epi32(255);
        let mut x = 0;
        // A group of three channels reads 28 bytes for its 24.
        while x + 8 <= out.len() && CHANNELS * x + if CHANNELS == 3 { 28 } else { 8 } <= pixels.len() {
            // SAFETY: inside both slices, as the loop's condition says.
            unsafe {
                let from = pixels.as_ptr().add(CHANNELS * x);
                let (least, most) = if CHANNELS == 3 {
                    let (low, high) = (_mm_loadu_si128(from.cast()), _mm_loadu_si128(from.add(12).cast()));
                    let v = _mm256_shuffle_epi8(_mm256_set_m128i(high, low), order);
                    let (g, r) = (_mm256_srli_epi32::<8>(v), _mm256_srli_epi32::<16>(v));
                    let least = _mm256_min_epu8(_mm256_min_epu8(v, g), r);
                    let most = _mm256_max_epu8(_mm256_max_epu8(v, g), r);
                    (_mm256_and_si256(least, byte), _mm256_and_si256(most, byte))
                } else {
                    let v = _mm256_cvtepu8_epi32(_mm_loadl_epi64(from.cast()));
                    (v, v)
                };
                let clear = _mm256_or_si256(_mm256_cmpgt_epi32(least, bright), _mm256_cmpgt_epi32(dark, most));
                let to = out.as_mut_ptr().add(x);
                _mm256_storeu_ps(to, _mm256_andnot_ps(_mm256_castsi256_ps(clear), _mm256_loadu_ps(to)));
            }
            x += 8;
        }
        x
    }

    /// Returns how many pixels were done.
    #[target_feature(enable = "avx2")]
    pub(super) fn check_row(max_px: f32, here: &[f32], right: &[f32], x0: usize, out: &mut [f32]) -> usize {
        let n = here.len().min(out.len());
        let (half, zero) = (_mm256_set1_ps(0.5), _mm256_setzero_ps());
        let (most, end) = (_mm256_set1_ps(max_px), _mm256_set1_ps(right.len() as f32));
        let sign = _mm256_set1_ps(-0.0);
        let mut column = _mm256_add_epi32(_mm256_set1_epi32(x0 as i32), _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7));
        let mut x = 0;
        while x + 8 <= n {
            // SAFETY: `x + 8 <= n`; gathered columns lie inside `right`, or are not gathered.
            unsafe {
                let d = _mm256_loadu_ps(here.as_ptr().add(x));
                let other = _mm256_add_ps(_mm256_sub_ps(_mm256_cvtepi32_ps(column), d), half);
                let inside =
                    _mm256_and_ps(_mm256_cmp_ps::<_CMP_GE_OQ>(other, zero), _mm256_cmp_ps::<_CMP_LT_OQ>(other, end));
                let index = _mm256_cvttps_epi32(_mm256_and_ps(other, inside));
                let there = _mm256_mask_i32gather_ps::<4>(zero, right.as_ptr(), index, inside);
                let apart = _mm256_andnot_ps(sign, _mm256_sub_ps(d, there));
                let agree = _mm256_and_ps(inside, _mm256_cmp_ps::<_CMP_LE_OQ>(apart, most));
                let to = out.as_mut_ptr().add(x);
                _mm256_storeu_ps(to, _mm256_and_ps(_mm256_loadu_ps(to), agree));
            }
            column = _mm256_add_epi32(column, _mm256_set1_epi32(8));
            x += 8;
        }
        x
    }
}
