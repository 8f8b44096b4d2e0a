//! From disparity to millimetres: depth and points in the left rectified camera's frame.

use crate::stereo::error::{check_channels, check_size};
use crate::stereo::{Rectification, Roi, StereoError};
use crate::{Parallel, SharedMut, View, ViewMut};

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

/// Inputs of [`reproject`]; views have one size.
#[derive(Clone, Copy, Debug)]
pub struct ReprojectInput<'a> {
    /// Px of the left rectified view, NaN where unknown.
    pub disparity: View<'a, f32>,
    /// 0..=1, optional.
    pub confidence: Option<View<'a, f32>>,
    /// Where to work.
    pub roi: Roi,
}

/// Writes depth in mm and, when asked for, points `x y z` in mm (three channels), NaN where unknown.
/// Returns how many pixels are known.
///
/// A pixel is dropped when its disparity or confidence is too small, its depth out of range, or too few
/// of its neighbours lie on the same surface: that test takes away single pixels, thin shreds and the
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
                for x in roi.x..roi.x + roi.width {
                    let d = input.disparity.data[y * input.disparity.stride + x];
                    let z = scale / (d + shift);
                    // NaN fails the comparisons.
                    if z >= params.near_mm && z <= params.far_mm && keep(&input, params, roi, x, y, d) {
                        depth[x] = z;
                        count += 1;
                    }
                }
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
        // A sum of whole numbers: the order does not show.
        known.fetch_add(count, std::sync::atomic::Ordering::Relaxed);
    });
    Ok(known.into_inner())
}

/// The confidence and neighbourhood tests.
#[inline]
fn keep(input: &ReprojectInput<'_>, params: &ReprojectParams, roi: Roi, x: usize, y: usize, d: f32) -> bool {
    if let Some(map) = &input.confidence
        && !(map.data[y * map.stride + x] >= params.min_confidence)
    {
        return false;
    }
    if params.min_neighbours == 0 {
        return true;
    }
    let (mut same, mut there) = (0, 0);
    for dy in [-1isize, 0, 1] {
        let Some(row) = y.checked_add_signed(dy).filter(|row| *row >= roi.y && *row < roi.y + roi.height) else {
            continue;
        };
        for dx in [-1isize, 0, 1] {
            let column = x.checked_add_signed(dx).filter(|column| *column >= roi.x && *column < roi.x + roi.width);
            let Some(column) = column.filter(|_| dx != 0 || dy != 0) else { continue };
            there += 1;
            let other = input.disparity.data[row * input.disparity.stride + column];
            same += usize::from((other - d).abs() <= params.surface_step_px);
        }
    }
    // At the ROI's border fewer neighbours exist; the share that must agree is the same.
    same * 8 >= params.min_neighbours.min(8) * there
}
