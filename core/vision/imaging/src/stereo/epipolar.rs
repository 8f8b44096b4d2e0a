//! Vertical distance of matched points: 0 for a rectified pair, more when the calibration has drifted.

use super::StereoError;
use super::pair::{MapSamples, PairViews};
use crate::{Rect, View};

/// Rows searched above and below.
const REACH: usize = 6;
/// Half the side of the matching window, in px.
const RADIUS: usize = 4;
/// Spacing of the measured points, in px.
const STEP: usize = 24;
/// Smallest number of points for a result.
const MIN_POINTS: usize = 24;

/// Measures the vertical error of a matched pair. Reuses its memory.
#[derive(Debug, Default)]
pub struct Epipolar {
    samples: Vec<f32>,
    errors: Vec<f32>,
}

/// Distance of the measured points from the border, px.
const MARGIN: usize = REACH + RADIUS + 1;

impl Epipolar {
    /// Median distance in px of matched points from their rows; `None` when too few points have vertical texture. Where
    /// points are matched, it looks at both views in the host's memory.
    ///
    /// # Errors
    /// Those of the views and of the map.
    pub fn measure(
        &mut self,
        views: &mut dyn PairViews,
        disparity: &mut dyn MapSamples,
    ) -> Result<Option<f32>, StereoError> {
        let (width, height) = views.size();
        self.errors.clear();
        if width <= 2 * MARGIN || height <= 2 * MARGIN {
            return Ok(None);
        }
        let area = Rect::new(MARGIN, MARGIN, width - 2 * MARGIN, height - 2 * MARGIN);
        disparity.samples(area, STEP, &mut self.samples)?;
        let columns = area.width.div_ceil(STEP);
        let points = self.samples.iter().enumerate().filter_map(|(at, d)| {
            let (x, y) = (MARGIN + at % columns * STEP, MARGIN + at / columns * STEP);
            let to = x as f32 - d;
            // NaN fails.
            (to >= MARGIN as f32 && to < (width - MARGIN) as f32).then(|| ((x, y), to.round() as usize))
        });
        if points.clone().count() < MIN_POINTS {
            return Ok(None);
        }
        let [left, right] = views.whole()?;
        self.errors.extend(points.filter_map(|(at, to)| vertical_error(left, right, at, to)).map(f32::abs));
        if self.errors.len() < MIN_POINTS {
            return Ok(None);
        }
        let middle = self.errors.len() / 2;
        Ok(Some(*self.errors.select_nth_unstable_by(middle, f32::total_cmp).1))
    }
}

/// Rows from the left point to the best matching right one, to a fraction of a row.
fn vertical_error(left: View<'_, u8>, right: View<'_, u8>, (x, y): (usize, usize), to: usize) -> Option<f32> {
    const SIDE: usize = 2 * RADIUS + 1;
    let mean = |view: View<'_, u8>, x: usize, y: usize| -> i32 {
        let rows = y - RADIUS..=y + RADIUS;
        let sum: u32 =
            rows.flat_map(|row| &view.row(row)[x - RADIUS..=x + RADIUS]).map(|value| u32::from(*value)).sum();
        (sum / (SIDE * SIDE) as u32) as i32
    };
    let own = mean(left, x, y);
    let mut costs = [0_i32; 2 * REACH + 1];
    for (step, cost) in costs.iter_mut().enumerate() {
        let row = y + step - REACH;
        // Exposure may differ between the views.
        let gap = own - mean(right, to, row);
        for line in 0..SIDE {
            let a = &left.row(y + line - RADIUS)[x - RADIUS..=x + RADIUS];
            let b = &right.row(row + line - RADIUS)[to - RADIUS..=to + RADIUS];
            *cost += a.iter().zip(b).map(|(a, b)| (i32::from(*a) - i32::from(*b) - gap).abs()).sum::<i32>();
        }
    }
    let (best, least) = costs.iter().enumerate().min_by_key(|(_, cost)| **cost)?;
    let most = costs.iter().max()?;
    // Without vertical texture all rows match equally; at the edge of the range the minimum may be outside.
    if *most < 2 * least + 2 * (SIDE * SIDE) as i32 || best == 0 || best == 2 * REACH {
        return None;
    }
    let (above, below) = (costs[best - 1] as f32, costs[best + 1] as f32);
    let bend = above + below - 2.0 * *least as f32;
    let part = if bend > 0.0 { 0.5 * (above - below) / bend } else { 0.0 };
    Some(best as f32 - REACH as f32 + part)
}
