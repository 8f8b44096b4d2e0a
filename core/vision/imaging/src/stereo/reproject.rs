//! From disparity to millimetres: depth and points in the left rectified camera's frame.

use crate::stereo::error::{check_channels, check_size};
use crate::stereo::{Rectification, StereoError};
use crate::{Parallel, Rect, SharedMut, View, ViewMut};

/// Which disparities become points.
#[derive(Clone, Debug, PartialEq)]
pub struct ReprojectParams {
    /// Nearest depth kept, in mm.
    pub near_mm: f32,
    /// Farthest depth kept, in mm.
    pub far_mm: f32,
    /// Confidence below which a pixel is dropped (where a confidence map is given), 0 to 1.
    pub min_confidence: f32,
    /// Largest step in px of disparity between pixels that count as one surface. A pixel between two
    /// surfaces, near neither (a flying pixel), is dropped.
    pub surface_step_px: f32,
    /// Of the eight neighbours, how many must be on the pixel's own surface; 0 keeps all.
    pub min_neighbours: usize,
}

impl Default for ReprojectParams {
    fn default() -> Self {
        Self { near_mm: 1.0, far_mm: 1e4, min_confidence: 0.05, surface_step_px: 1.0, min_neighbours: 5 }
    }
}

/// Inputs of [`reproject`]; all views have the same size.
#[derive(Clone, Copy, Debug)]
pub struct ReprojectInput<'a> {
    /// Px of the left rectified view, NaN where unknown.
    pub disparity: View<'a, f32>,
    /// 0..=1, optional.
    pub confidence: Option<View<'a, f32>>,
    /// Where to work.
    pub roi: Rect,
}

/// Writes depth in mm and, when asked for, points `x y z` in mm (three channels), NaN where unknown.
/// Returns how many pixels are known.
///
/// A pixel is dropped when its disparity or confidence is too small, its depth out of range, or too few
/// of its neighbours lie on the same surface: this test removes single pixels, thin shreds and the
/// pixels that filters put between a near and a far surface.
///
/// # Errors
/// When sizes or channel counts do not agree.
pub fn reproject(
    input: ReprojectInput<'_>,
    rectification: &Rectification,
    params: &ReprojectParams,
    pool: &dyn Parallel,
    depth: ViewMut<'_, f32>,
    points: Option<ViewMut<'_, f32>>,
) -> Result<usize, StereoError> {
    let (width, height) = (input.disparity.width, input.disparity.height);
    check_channels("disparity", &[1], "1", input.disparity.channels)?;
    check_channels("depth", &[1], "1", depth.channels)?;
    check_size("depth", (width, height), (depth.width, depth.height))?;
    if let Some(map) = &input.confidence {
        check_channels("confidence", &[1], "1", map.channels)?;
        check_size("confidence", (width, height), (map.width, map.height))?;
    }
    if let Some(map) = &points {
        check_channels("points", &[3], "3 (x y z)", map.channels)?;
        check_size("points", (width, height), (map.width, map.height))?;
    }
    let roi = input.roi.clamped(width, height);
    let stride = depth.stride;
    let depth = SharedMut::new(depth.data);
    let (stride_points, points) = match points {
        Some(map) => (map.stride, Some(SharedMut::new(map.data))),
        None => (0, None),
    };
    let (focal, baseline) = (rectification.left.focal_px, rectification.baseline_mm);
    let scale = (focal * baseline) as f32;
    let shift = (rectification.right.cx - rectification.left.cx) as f32;
    let (cx, cy) = (rectification.left.cx as f32, rectification.left.cy as f32);
    let per_px = (1.0 / focal) as f32;
    const CHUNK_ROWS: usize = 16;
    let known = std::sync::atomic::AtomicUsize::new(0);
    pool.run(height.div_ceil(CHUNK_ROWS), &|chunk| {
        let mut count = 0;
        for y in chunk * CHUNK_ROWS..((chunk + 1) * CHUNK_ROWS).min(height) {
            // SAFETY: one row, one chunk.
            let depth = unsafe { depth.part(y * stride, width) };
            depth.fill(f32::NAN);
            if y >= roi.y && y < roi.y + roi.height {
                count += depth_row(&input, params, roi, y, (scale, shift), depth);
            }
            if let Some(points) = &points {
                // SAFETY: one row, one chunk.
                let points = unsafe { points.part(y * stride_points, 3 * width) };
                let v = (y as f32 - cy) * per_px;
                for (x, (point, z)) in points.chunks_exact_mut(3).zip(depth).enumerate() {
                    point[0] = (x as f32 - cx) * per_px * *z;
                    point[1] = v * *z;
                    point[2] = *z;
                }
            }
        }
        // A sum of integers does not depend on the order.
        known.fetch_add(count, std::sync::atomic::Ordering::Relaxed);
    });
    Ok(known.into_inner())
}

/// One row of depths; returns how many are known.
fn depth_row(
    input: &ReprojectInput<'_>,
    params: &ReprojectParams,
    roi: Rect,
    y: usize,
    (scale, shift): (f32, f32),
    depth: &mut [f32],
) -> usize {
    let row = |y: usize| &input.disparity.row(y)[roi.x..roi.x + roi.width];
    let out = &mut depth[roi.x..roi.x + roi.width];
    let here = row(y);
    let above = if y > roi.y { Some(row(y - 1)) } else { None };
    let below = if y + 1 < roi.y + roi.height { Some(row(y + 1)) } else { None };
    let n = roi.width;
    if let (Some(above), Some(below), true) = (above, below, n > 2 && params.min_neighbours > 0) {
        // Inside the ROI all eight neighbours exist: no branches, so that the loop can be vectorised.
        let least = params.min_neighbours.min(8) as i32;
        let step = params.surface_step_px;
        let rows = [above, here, below].map(|row| [&row[..n - 2], &row[1..n - 1], &row[2..]]);
        let middle = &mut out[1..n - 1];
        for x in 0..n - 2 {
            let d = rows[1][1][x];
            let mut same = -1;
            for row in &rows {
                for side in row {
                    same += i32::from((side[x] - d).abs() <= step);
                }
            }
            let z = scale / (d + shift);
            let keep = (same >= least) & (z >= params.near_mm) & (z <= params.far_mm);
            middle[x] = if keep { z } else { f32::NAN };
        }
    }
    let edge = above.is_none() || below.is_none() || n <= 2 || params.min_neighbours == 0;
    let mut x = 0;
    while x < n {
        let d = here[x];
        let z = scale / (d + shift);
        // NaN fails the comparisons.
        let ranged = z >= params.near_mm && z <= params.far_mm;
        out[x] = if ranged && agrees(input, params, roi, (roi.x + x, y), d) { z } else { f32::NAN };
        x += if edge || x + 1 >= n { 1 } else { n - 1 };
    }
    if let Some(map) = &input.confidence {
        for (z, confidence) in out.iter_mut().zip(&map.row(y)[roi.x..roi.x + roi.width]) {
            *z = if *confidence >= params.min_confidence { *z } else { f32::NAN };
        }
    }
    out.iter().map(|z| usize::from(z.is_finite())).sum()
}

/// Whether enough neighbours lie on the pixel's surface, anywhere in the ROI.
fn agrees(input: &ReprojectInput<'_>, params: &ReprojectParams, roi: Rect, (x, y): (usize, usize), d: f32) -> bool {
    let (mut same, mut there) = (0, 0);
    for row in y.saturating_sub(1).max(roi.y)..(y + 2).min(roi.y + roi.height) {
        for column in x.saturating_sub(1).max(roi.x)..(x + 2).min(roi.x + roi.width) {
            if (column, row) != (x, y) {
                there += 1;
                let other = input.disparity.data[row * input.disparity.stride + column];
                same += usize::from((other - d).abs() <= params.surface_step_px);
            }
        }
    }
    // At the ROI's border fewer neighbours exist; the share that must agree is the same.
    same * 8 >= params.min_neighbours.min(8) * there
}
