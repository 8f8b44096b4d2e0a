//! Depth of an instrument's end, by comparing it between both views.
//!
//! A matcher compares windows, and in a window around a thin end most pixels are tissue: it finds the tissue's disparity, or none. Here both views
//! are first classified into instrument and tissue, by the colours learned from its silhouette, and these maps are compared: the outline of an end is
//! visible in both views, however smooth its steel is.

use panoscope_node::View;

use crate::shaft::End;
use crate::silhouette::Silhouette;

/// Half the sides of the window that is compared, px at 640 columns.
const HALF_WIDTH: f64 = 26.0;
const HALF_HEIGHT: f64 = 18.0;
/// Distance of the window's centre inside the instrument, as a share of its half width.
const INSIDE: f64 = 0.4;
/// Columns of the picture for which these sizes are stated.
const COLUMNS: f64 = 640.0;
/// Upper limit of the log-likelihood ratio of a pixel outside the silhouette.
const OUTSIDE: f32 = -2.0;
/// Smallest normalised correlation of both views, and smallest lead over every position farther away than `BESIDE_PX`.
const LEAST: f32 = 0.6;
const BETTER: f32 = 0.03;
const BESIDE_PX: usize = 6;
/// Share of the window that is instrument, at least and at most: an end has both around it.
const SHARES: (f32, f32) = (0.03, 0.9);

/// Compares an end between two views; reuses its buffers.
#[derive(Debug, Default)]
pub struct SecondView {
    left: Vec<f32>,
    right: Vec<f32>,
    fit: Vec<f32>,
}

impl SecondView {
    /// Disparity of an end of the instrument that `silhouette` cut out last, px; disparities from `range` are tried. None where colours were not
    /// learned, the end is not seen in the other view, or no position fits clearly better than all others. Both views are rectified and of one size, blue,
    /// green, red. Cost O(window x range).
    pub fn disparity(
        &mut self,
        end: &End,
        silhouette: &Silhouette,
        views: [&View<'_, u8>; 2],
        range: (f64, f64),
    ) -> Option<f64> {
        let [left, right] = views;
        let (width, height) = (left.width, left.height);
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
        let ((x0, x1), (y0, y1)) = (side(u - half_x, u + half_x, width), side(v - half_y, v + half_y, height));
        let (columns, rows) = (x1 - x0, y1 - y0);
        if columns < 8 || rows < 8 {
            return None;
        }
        // The window must be completely in the other view.
        let first = range.0.max(0.0).ceil() as usize;
        let last = (range.1.max(0.0) as usize).min(x0);
        if first + 2 * BESIDE_PX >= last {
            return None;
        }
        let pixel = |view: &View<'_, u8>, x: usize, y: usize| {
            let row = view.row(y);
            [row[3 * x], row[3 * x + 1], row[3 * x + 2]]
        };
        self.left.clear();
        let mut inside = 0;
        for y in y0..y1 {
            for x in x0..x1 {
                let ratio = silhouette.log_ratio(pixel(left, x, y))?;
                let is_own = silhouette.contains(x, y);
                inside += usize::from(is_own);
                // Pixels that look like the instrument but are not connected with it are elsewhere in space.
                self.left.push(if is_own { ratio } else { ratio.min(OUTSIDE) });
            }
        }
        let share = inside as f32 / (columns * rows) as f32;
        if !(SHARES.0..=SHARES.1).contains(&share) {
            return None;
        }
        let (from, to) = (x0 - last, x1 - first);
        let strip = to - from;
        self.right.clear();
        for y in y0..y1 {
            for x in from..to {
                self.right.push(silhouette.log_ratio(pixel(right, x, y))?);
            }
        }
        let count = (columns * rows) as f32;
        let mean = self.left.iter().sum::<f32>() / count;
        self.left.iter_mut().for_each(|ratio| *ratio -= mean);
        let own = self.left.iter().map(|ratio| ratio * ratio).sum::<f32>();
        // One fit per disparity, from `last` down to `first`, as the window moves to the right.
        self.fit.clear();
        for offset in 0..=last - first {
            let (mut cross, mut sum, mut square) = (0.0_f32, 0.0_f32, 0.0_f32);
            for row in 0..rows {
                let theirs = &self.right[row * strip + offset..row * strip + offset + columns];
                for (own, ratio) in self.left[row * columns..(row + 1) * columns].iter().zip(theirs) {
                    cross += own * ratio;
                    sum += ratio;
                    square += ratio * ratio;
                }
            }
            let spread = (square - sum * sum / count).max(1e-3);
            self.fit.push(cross / (own * spread).sqrt().max(1e-6));
        }
        let (best, most) = self.fit.iter().copied().enumerate().max_by(|a, b| a.1.total_cmp(&b.1))?;
        let others = self.fit.iter().enumerate().filter(|(at, _)| at.abs_diff(best) > BESIDE_PX);
        let second = others.map(|(_, fit)| *fit).fold(f32::NEG_INFINITY, f32::max);
        if most < LEAST || most < second + BETTER || best == 0 || best + 1 == self.fit.len() {
            return None;
        }
        let (before, after) = (f64::from(self.fit[best - 1]), f64::from(self.fit[best + 1]));
        let bend = before - 2.0 * f64::from(most) + after;
        let part = if bend < -1e-9 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 };
        Some(last as f64 - (best as f64 + part))
    }
}
