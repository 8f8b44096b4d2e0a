//! How far a matched disparity may be trusted, before any filter has seen it.

use crate::stereo::Roi;
use crate::{Parallel, SharedMut, View};

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
const STEPS_PER_PX: f32 = 4.0;
/// Part of the neighbourhood that must be matched for full confidence.
const FULL_SHARE: f32 = 0.6;
/// Rows of one chunk; the rows of its window's rim are read twice.
const CHUNK_ROWS: usize = 48;

/// Work memory of [`Confidence::compute`].
#[derive(Debug, Default)]
pub struct Confidence {
    bands: Vec<Band>,
}

#[derive(Debug, Default)]
struct Band {
    /// Per column: count, sum and sum of squares of quantised disparities in the window's rows.
    columns: [Vec<u32>; 3],
    totals: [Vec<u32>; 3],
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
        roi: Roi,
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
                // SAFETY: as above.
                let out = unsafe { out.part(row * roi.width, roi.width) };
                let y = roi.y + row;
                if params.scatter_radius_px > 0 {
                    window.step(row);
                    window.scatter(params.loss_per_px2, out);
                } else {
                    out.fill(1.0);
                }
                let here = &disparity.row(y)[roi.x..roi.x + roi.width];
                check_row(params, here, disparity_right.map(|map| map.row(y)), roi.x, out);
                if params.highlight_level.is_some() || params.dark_level.is_some() {
                    let channels = guide.channels;
                    let pixels = &guide.row(y)[roi.x * channels..(roi.x + roi.width) * channels];
                    let limits = (params.dark_level, params.highlight_level);
                    match channels {
                        3 => exposure::<3>(pixels, limits, out),
                        _ => exposure::<1>(pixels, limits, out),
                    }
                }
            }
        });
    }
}

/// Clears the confidence of black pixels and of highlights. All channels count at once: a strongly
/// coloured pixel is neither.
fn exposure<const CHANNELS: usize>(pixels: &[u8], limits: (Option<u8>, Option<u8>), out: &mut [f32]) {
    let dark = limits.0.map_or(-1, i16::from);
    let bright = limits.1.map_or(256, i16::from);
    for (pixel, value) in pixels.chunks_exact(CHANNELS).zip(out) {
        let (mut least, mut most) = (u8::MAX, 0);
        for channel in 0..CHANNELS {
            least = least.min(pixel[channel]);
            most = most.max(pixel[channel]);
        }
        let clear = (i16::from(least) >= bright) | (i16::from(most) <= dark);
        *value = if clear { 0.0 } else { *value };
    }
}

/// Clears the confidence of unmatched pixels and of those that the right view contradicts.
fn check_row(params: &ConfidenceParams, here: &[f32], right: Option<&[f32]>, x0: usize, out: &mut [f32]) {
    for (i, (d, value)) in here.iter().zip(out).enumerate() {
        let mut agree = d.is_finite();
        if let Some(right) = right {
            // Rounded to nearest; NaN and what lies outside fail the comparison.
            let x = (x0 + i) as f32 - d + 0.5;
            let inside = x >= 0.0 && x < right.len() as f32;
            // SAFETY: a number in 0..len, or 0.
            let x: i32 = unsafe { (if inside { x } else { 0.0 }).to_int_unchecked() };
            agree &= inside & ((d - right[x as usize]).abs() <= params.left_right_px);
        }
        *value = if agree { *value } else { 0.0 };
    }
}

/// Sums over a square window that slides down a band.
struct Window<'a, 'b> {
    disparity: View<'a, f32>,
    roi: Roi,
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
        let [count, sum, square] = self.band.columns.each_mut().map(|plane| &mut plane[rim..]);
        #[cfg(target_arch = "x86_64")]
        if self.avx2 {
            // SAFETY: the caller found AVX2.
            unsafe { accumulate_avx2(values, remove, count, sum, square) };
            return;
        }
        let _ = self.avx2;
        accumulate(values, remove, count, sum, square);
    }

    /// Writes `(1 - loss * variance) * share`, at least 0, for the current row; `share` grows with the part
    /// of the window that is matched at all.
    fn scatter(&mut self, loss: f32, out: &mut [f32]) {
        box_sums(&self.band.columns, self.radius, &mut self.band.totals);
        let [count, sum, square] = &self.band.totals;
        let loss = loss / (STEPS_PER_PX * STEPS_PER_PX);
        let full = 1.0 / (FULL_SHARE * ((2 * self.radius + 1) * (2 * self.radius + 1)) as f32);
        #[cfg(target_arch = "x86_64")]
        if self.avx2 {
            // SAFETY: the caller found AVX2.
            unsafe { variance_avx2(count, sum, square, (loss, full), out) };
            return;
        }
        variance(count, sum, square, (loss, full), out);
    }
}

/// Sums over `2 radius + 1` neighbours of three planes; `columns` begin `radius + 1` before the first pixel.
fn box_sums(columns: &[Vec<u32>; 3], radius: usize, totals: &mut [Vec<u32>; 3]) {
    let window = 2 * radius + 1;
    let n = totals[0].len();
    let [a, b, c] = columns.each_ref().map(|plane| &plane[..n + window]);
    let [out_a, out_b, out_c] = totals.each_mut().map(|plane| &mut plane[..n]);
    let first = |plane: &[u32]| plane[..window].iter().fold(0u32, |sum, value| sum.wrapping_add(*value));
    let (mut sum_a, mut sum_b, mut sum_c) = (first(a), first(b), first(c));
    let (next_a, next_b, next_c) = (&a[window..], &b[window..], &c[window..]);
    let (a, b, c) = (&a[..n], &b[..n], &c[..n]);
    let (next_a, next_b, next_c) = (&next_a[..n], &next_b[..n], &next_c[..n]);
    for x in 0..n {
        sum_a = sum_a.wrapping_add(next_a[x]).wrapping_sub(a[x]);
        sum_b = sum_b.wrapping_add(next_b[x]).wrapping_sub(b[x]);
        sum_c = sum_c.wrapping_add(next_c[x]).wrapping_sub(c[x]);
        out_a[x] = sum_a;
        out_b[x] = sum_b;
        out_c[x] = sum_c;
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn accumulate_avx2(values: &[f32], remove: bool, count: &mut [u32], sum: &mut [u32], square: &mut [u32]) {
    accumulate(values, remove, count, sum, square);
}

#[inline(always)]
fn accumulate(values: &[f32], remove: bool, count: &mut [u32], sum: &mut [u32], square: &mut [u32]) {
    let n = values.len();
    let (count, sum, square) = (&mut count[..n], &mut sum[..n], &mut square[..n]);
    let sign = if remove { u32::MAX } else { 1 };
    for x in 0..n {
        let valid = values[x].is_finite();
        // Clamped so that the square of a 31 x 31 window's worth still fits 32 bits.
        let steps = if valid { (values[x] * STEPS_PER_PX).clamp(0.0, 2047.0) } else { 0.0 };
        // SAFETY: 0..=2047.
        let steps: i32 = unsafe { steps.to_int_unchecked() };
        let steps = steps as u32;
        count[x] = count[x].wrapping_add(sign.wrapping_mul(u32::from(valid)));
        sum[x] = sum[x].wrapping_add(sign.wrapping_mul(steps));
        square[x] = square[x].wrapping_add(sign.wrapping_mul(steps * steps));
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn variance_avx2(count: &[u32], sum: &[u32], square: &[u32], (loss, full): (f32, f32), out: &mut [f32]) {
    variance(count, sum, square, (loss, full), out);
}

#[inline(always)]
fn variance(count: &[u32], sum: &[u32], square: &[u32], (loss, full): (f32, f32), out: &mut [f32]) {
    let n = out.len();
    let (count, sum, square) = (&count[..n], &sum[..n], &square[..n]);
    for x in 0..n {
        let share = 1.0 / (count[x] as i32).max(1) as f32;
        let mean = sum[x] as i32 as f32 * share;
        // Sums of squares can exceed 2^31 only where disparities exceed 400 px all over: halve them first.
        let variance = (square[x] >> 1) as i32 as f32 * 2.0 * share - mean * mean;
        // Lone matches in an unmatched neighbourhood are chance hits: the square keeps them small.
        let matched = (count[x] as i32 as f32 * full).min(1.0);
        out[x] = (1.0 - loss * variance.max(0.0)).clamp(0.0, 1.0) * (matched * matched);
    }
}
