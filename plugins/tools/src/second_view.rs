//! Depth of an instrument's end, from a comparison of both views.
//!
//! A matcher compares windows. In a window around a thin end most pixels are tissue, so the matcher finds the tissue's disparity or none. Here both
//! views are first classified into instrument and tissue, by the colours learned from its silhouette, and these maps are compared: the outline of an
//! end is visible in both views even on smooth steel.

use panoscope_node::{Rect, View};

use crate::shaft::End;
use crate::silhouette::Silhouette;

/// Half the side of the compared window, px at 640 columns.
const HALF_WIDTH: f64 = 26.0;
const HALF_HEIGHT: f64 = 18.0;
/// Distance of the window's centre inside the instrument, as a share of its half width.
const INSIDE: f64 = 0.4;
/// Number of image columns for which these sizes are stated.
const COLUMNS: f64 = 640.0;
/// Upper limit of the log-likelihood ratio of a pixel outside the silhouette.
const OUTSIDE: f32 = -2.0;
/// Minimum normalised correlation of both views, and minimum lead over every position farther away than `BESIDE_PX`.
const MIN_VALUE: f32 = 0.6;
const BETTER: f32 = 0.03;
const BESIDE_PX: usize = 6;
/// Minimum and maximum share of instrument in the window: an end has both instrument and tissue around it.
const SHARES: (f32, f32) = (0.03, 0.9);

/// Minimum side of the compared window, cells.
const MIN_SIDE: usize = 8;
/// Cells on either side of the best coarse position that are tried at full size.
const REFINED_CELLS: usize = 2;
/// Number of independent sums of products, so that they are computed in parallel.
const LANES: usize = 8;

/// Compares an end between two views; reuses its buffers.
#[derive(Debug, Default)]
pub struct SecondView {
    left: Vec<f32>,
    right: Vec<f32>,
    fit: Vec<f32>,
    /// Log-likelihood ratios of a row of pixels.
    ratios: Vec<f32>,
    /// Sums of the columns of the right strip, and of their squares.
    sums: Vec<[f32; 2]>,
}

/// The compared window of the left view, and its search range, in whole px.
#[derive(Clone, Copy, Debug)]
struct Window {
    x: (usize, usize),
    y: (usize, usize),
    /// Minimum and maximum disparity that is tried, px.
    disparities: (usize, usize),
    /// Side of a cell, px.
    pitch: usize,
}

impl Window {
    /// The window of an end in views of `size`, see [`SecondView::disparity`].
    fn of(end: &End, (width, height): (usize, usize), range: (f64, f64)) -> Option<Self> {
        let scale = (width as f64 / COLUMNS).max(0.25);
        let (half_x, half_y) = (HALF_WIDTH * scale, HALF_HEIGHT * scale);
        let (u, v) = (end.u_px - end.direction[0] * INSIDE * half_x, end.v_px - end.direction[1] * INSIDE * half_y);
        if !(u.is_finite() && v.is_finite() && range.0.is_finite() && range.1.is_finite()) {
            return None;
        }
        let side = |from: f64, to: f64, most: usize| {
            let clip = |at: f64| at.round().clamp(0.0, most as f64) as usize;
            (clip(from), clip(to))
        };
        let (x, y) = (side(u - half_x, u + half_x, width), side(v - half_y, v + half_y, height));
        // The window must be completely in the other view.
        let (first, last) = (range.0.max(0.0).ceil() as usize, (range.1.max(0.0) as usize).min(x.0));
        let pitch = (scale.round() as usize).max(1);
        let window = Self { x, y, disparities: (first, last), pitch };
        let (columns, rows) = window.size();
        if columns < MIN_SIDE || rows < MIN_SIDE || first + 2 * BESIDE_PX * pitch >= last {
            return None;
        }
        Some(window)
    }

    /// The pixels of the left and the right view that are read.
    fn areas(&self) -> [Rect; 2] {
        let (width, height, (first, last)) = (self.x.1 - self.x.0, self.y.1 - self.y.0, self.disparities);
        let area = |x: usize, width: usize| Rect::new(x, self.y.0, width, height);
        [area(self.x.0, width), area(self.x.0 - last, width + last - first)]
    }

    /// Number of columns and rows, cells.
    fn size(&self) -> (usize, usize) {
        ((self.x.1 - self.x.0) / self.pitch, (self.y.1 - self.y.0) / self.pitch)
    }
}

impl SecondView {
    /// The parts of the left and the right view of `size` that [`Self::disparity`] reads; `None` where it reads none.
    pub fn areas(end: &End, size: (usize, usize), range: (f64, f64)) -> Option<[Rect; 2]> {
        Window::of(end, size, range).map(|window| window.areas())
    }

    /// Disparity of an end of the instrument that `silhouette` segmented last, px; disparities from `range` are tried. `None` if colours were not
    /// learned, the end is not visible in the other view, or no position fits clearly better than all others. Both views are rectified and of one
    /// size, blue, green, red.
    ///
    /// Large views are first compared in cells, as many as a view of 640 columns has pixels, and then at full size near the best position. Cost
    /// O(cells of the window x cells of the range).
    pub fn disparity(
        &mut self,
        end: &End,
        silhouette: &Silhouette,
        views: [&View<'_, u8>; 2],
        range: (f64, f64),
    ) -> Option<f64> {
        let window = Window::of(end, (views[0].width, views[0].height), range)?;
        let Window { disparities: (first, last), pitch, .. } = window;
        self.compare(silhouette, views, &window)?;
        let (best, most) = self.best()?;
        let others = self.fit.iter().enumerate().filter(|(at, _)| at.abs_diff(best) > BESIDE_PX);
        let second = others.map(|(_, fit)| *fit).fold(f32::NEG_INFINITY, f32::max);
        if most < MIN_VALUE || most < second + BETTER || best == 0 || best + 1 == self.fit.len() {
            return None;
        }
        if pitch == 1 {
            return Some(last as f64 - (best as f64 + self.peak(best)));
        }
        let (at, beside) = (last - best * pitch, REFINED_CELLS * pitch);
        let disparities = (at.saturating_sub(beside).max(first), (at + beside).min(last));
        self.compare(silhouette, views, &Window { disparities, pitch: 1, ..window })?;
        let (best, _) = self.best()?;
        Some(disparities.1 as f64 - (best as f64 + self.peak(best)))
    }

    /// Position and value of the best fit.
    fn best(&self) -> Option<(usize, f32)> {
        self.fit.iter().copied().enumerate().max_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Subpixel position of the best fit relative to `best`: -0.5 to 0.5 positions, 0 at either end.
    fn peak(&self, best: usize) -> f64 {
        if best == 0 || best + 1 >= self.fit.len() {
            return 0.0;
        }
        let [before, most, after] = [best - 1, best, best + 1].map(|at| f64::from(self.fit[at]));
        let bend = before - 2.0 * most + after;
        if bend < -1e-9 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 }
    }

    /// Sets `fit` to the normalised correlation of the window with each position, from the maximum disparity down: the window moves to the right.
    /// `None` if the share of instrument is too small or too large.
    fn compare(&mut self, silhouette: &Silhouette, [left, right]: [&View<'_, u8>; 2], window: &Window) -> Option<()> {
        let Window { x: (x0, _), y: (y0, _), disparities: (first, last), pitch } = *window;
        let (columns, rows) = window.size();
        // In large cells every second pixel, each way, says as much as all.
        let step = pitch.div_ceil(2);
        let area = pitch.div_ceil(step).pow(2) as f32;
        fn pixels<'a>(view: &View<'a, u8>, x: usize, y: usize, count: usize) -> &'a [u8] {
            &view.row(y)[3 * x..3 * (x + count)]
        }
        let mut ratios = std::mem::take(&mut self.ratios);
        let (count, mut inside) = ((columns * rows) as f32, 0);
        self.left.clear();
        self.left.resize(columns * rows, 0.0);
        for (row, sums) in self.left.chunks_exact_mut(columns).enumerate() {
            let top = y0 + row * pitch;
            for y in (top..top + pitch).step_by(step) {
                silhouette.log_ratios(pixels(left, x0, y, columns * pitch), &mut ratios)?;
                for (column, (sum, ratios)) in sums.iter_mut().zip(ratios.chunks_exact(pitch)).enumerate() {
                    for (at, ratio) in ratios.iter().enumerate().step_by(step) {
                        let is_own = silhouette.contains(x0 + column * pitch + at, y);
                        inside += usize::from(is_own);
                        // Pixels that look like the instrument but are not connected with it are elsewhere in space.
                        *sum += if is_own { *ratio } else { ratio.min(OUTSIDE) };
                    }
                }
            }
            sums.iter_mut().for_each(|sum| *sum /= area);
        }
        if !(SHARES.0..=SHARES.1).contains(&(inside as f32 / (count * area))) {
            return None;
        }
        let positions = (last - first) / pitch + 1;
        let strip = columns + positions - 1;
        self.sums.clear();
        self.sums.resize(strip, [0.0; 2]);
        self.right.clear();
        self.right.resize(strip * rows, 0.0);
        for (row, means) in self.right.chunks_exact_mut(strip).enumerate() {
            let top = y0 + row * pitch;
            for y in (top..top + pitch).step_by(step) {
                silhouette.log_ratios(pixels(right, x0 - last, y, strip * pitch), &mut ratios)?;
                for (mean, ratios) in means.iter_mut().zip(ratios.chunks_exact(pitch)) {
                    ratios.iter().step_by(step).for_each(|ratio| *mean += ratio);
                }
            }
            for (mean, sums) in means.iter_mut().zip(&mut self.sums) {
                *mean /= area;
                *sums = [sums[0] + *mean, sums[1] + *mean * *mean];
            }
        }
        self.ratios = ratios;
        let mean = self.left.iter().sum::<f32>() / count;
        self.left.iter_mut().for_each(|ratio| *ratio -= mean);
        let own = self.left.iter().map(|ratio| ratio * ratio).sum::<f32>();
        self.fit.clear();
        for offset in 0..positions {
            let lines = self.left.chunks_exact(columns).zip(self.right.chunks_exact(strip));
            let cross = lines.map(|(own, theirs)| product(own, &theirs[offset..offset + columns])).sum::<f32>();
            let under = self.sums[offset..offset + columns].iter();
            let [sum, square] = under.fold([0.0; 2], |all, column| [all[0] + column[0], all[1] + column[1]]);
            let spread = (square - sum * sum / count).max(1e-3);
            self.fit.push(cross / (own * spread).sqrt().max(1e-6));
        }
        Some(())
    }
}

/// Sum of the products of two rows of equal length.
fn product(a: &[f32], b: &[f32]) -> f32 {
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    let mut sums = [0.0_f32; LANES];
    for (a, b) in a.iter().zip(b) {
        for (sum, (a, b)) in sums.iter_mut().zip(a.iter().zip(b)) {
            *sum += a * b;
        }
    }
    let rest = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum::<f32>();
    sums.iter().sum::<f32>() + rest
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::silhouette::Cues;

    /// Red tissue with a gray instrument that comes from the left and ends at `end`; sizes at 640 columns, times `scale`.
    fn picture((width, height): (usize, usize), scale: f64, end: (f64, f64)) -> Vec<u8> {
        let at = |x: usize, y: usize| {
            let noise = ((x * 31 + y * 17 + x * y) % 23) as u8;
            let (dx, dy) = (x as f64 - end.0, (y as f64 - end.1).abs());
            // It narrows towards its end.
            let half = (9.0 * scale).min(3.0 * scale - 0.3 * dx);
            if dx <= 0.0 && dy <= half {
                [120 + noise, 122 + noise, 124 + noise]
            } else {
                [30 + noise, 40 + noise, 150 + noise]
            }
        };
        (0..height).flat_map(|y| (0..width).flat_map(move |x| at(x, y))).collect()
    }

    #[test]
    fn an_end_is_found_in_the_other_view_at_every_size() {
        for (width, height) in [(640, 480), (1280, 720), (1920, 1080)] {
            let scale = width as f64 / 640.0;
            let (end, disparity) = ((360.0 * scale, 200.0 * scale), 83.4 * scale);
            let left = picture((width, height), scale, end);
            let right = picture((width, height), scale, (end.0 - disparity, end.1));
            let views = [&left, &right].map(|data| View::new(data, width, height, 3));
            let mut silhouette = Silhouette::default();
            let corners = [300.0, 180.0, 364.0, 220.0].map(|v: f64| (v * scale) as f32);
            let cues = Cues { size: (width, height), picture: Some(views[0]), nearness: None };
            assert!(silhouette.cut(corners, &cues), "{width}");
            let end = End { u_px: end.0, v_px: end.1, direction: [1.0, 0.0] };
            let mut second = SecondView::default();
            let mut find = |range| second.disparity(&end, &silhouette, [&views[0], &views[1]], range);
            let found = find((40.0 * scale, 140.0 * scale)).expect("it is in both views");
            // Pixels are whole: the true disparity is within half a pixel of what is drawn.
            assert!((found - disparity).abs() < 1.0, "{width}: {found} for {disparity}");
            assert_eq!(find((100.0 * scale, 200.0 * scale)), None, "{width}: it is outside the range");
        }
    }
}
