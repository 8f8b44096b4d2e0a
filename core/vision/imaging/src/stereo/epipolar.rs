//! Vertical distance of matched points: 0 for a rectified pair, more when the calibration has drifted.

use super::StereoError;
use super::pair::{MapSamples, PairViews};
use crate::Rect;

/// Rows searched above and below.
const REACH: usize = 6;
/// Half the side of the matching window, and the side, in px.
const RADIUS: usize = 4;
const SIDE: usize = 2 * RADIUS + 1;
/// Spacing of the measured points, in px.
const STEP: usize = 24;
/// Smallest number of points for a result.
const MIN_POINTS: usize = 24;

/// Measures the vertical error of a matched pair. Reuses its memory.
#[derive(Debug, Default)]
pub struct Epipolar {
    samples: Vec<f32>,
    /// First columns and rows of the patches around matched points in both views, and the patches.
    corners: [Vec<[usize; 2]>; 2],
    patches: [Vec<u8>; 2],
    errors: Vec<f32>,
}

/// Distance of the measured points from the border, px.
const MARGIN: usize = REACH + RADIUS + 1;

impl Epipolar {
    /// Median distance in px of matched points from their rows; `None` when too few points have vertical texture.
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
        let [left, right] = &mut self.corners;
        left.clear();
        right.clear();
        for (at, d) in self.samples.iter().enumerate() {
            let (x, y) = (MARGIN + at % columns * STEP, MARGIN + at / columns * STEP);
            let to = x as f32 - d;
            // NaN fails.
            if to >= MARGIN as f32 && to < (width - MARGIN) as f32 {
                left.push([x - RADIUS, y - RADIUS]);
                right.push([to.round() as usize - RADIUS, y - RADIUS - REACH]);
            }
        }
        if left.len() < MIN_POINTS {
            return Ok(None);
        }
        let [patches, patches_right] = &mut self.patches;
        views.patches(0, left, (SIDE, SIDE), patches)?;
        views.patches(1, right, (SIDE, SIDE + 2 * REACH), patches_right)?;
        let (patches, _) = patches.as_chunks::<{ SIDE * SIDE }>();
        let patches_right = patches_right.chunks_exact(SIDE * (SIDE + 2 * REACH));
        let errors = patches.iter().zip(patches_right).filter_map(|(left, right)| vertical_error(left, right));
        self.errors.extend(errors.map(f32::abs));
        if self.errors.len() < MIN_POINTS {
            return Ok(None);
        }
        let middle = self.errors.len() / 2;
        Ok(Some(*self.errors.select_nth_unstable_by(middle, f32::total_cmp).1))
    }
}

/// Rows from the left point, in the middle of its patch, to the best matching right one, to a fraction of a row.
fn vertical_error(left: &[u8; SIDE * SIDE], right: &[u8]) -> Option<f32> {
    let mean = |patch: &[u8]| (patch.iter().map(|value| u32::from(*value)).sum::<u32>() / (SIDE * SIDE) as u32) as i32;
    let own = mean(left);
    let mut costs = [0_i32; 2 * REACH + 1];
    for (step, cost) in costs.iter_mut().enumerate() {
        let right = &right[step * SIDE..(step + SIDE) * SIDE];
        // Exposure may differ between the views.
        let gap = own - mean(right);
        *cost = left.iter().zip(right).map(|(a, b)| (i32::from(*a) - i32::from(*b) - gap).abs()).sum();
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
