//! Disparity and surfaces against the truth.

use crate::View;
use crate::stereo::StereoError;
use crate::stereo::error::check_size;

/// Errors of a disparity map over the pixels whose truth is known.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DisparityScore {
    /// Pixels with finite truth, inside the mask.
    pub pixels: usize,
    /// Share of them with a disparity, 0..=1.
    pub density: f64,
    /// Share with an error above each of [`BAD_PX`]; a missing disparity counts as bad.
    pub bad: [f64; 4],
    /// The same among the pixels that have a disparity.
    pub bad_of_known: [f64; 4],
    /// Mean absolute error in px where there is a disparity.
    pub mean_error_px: f64,
    /// Root of the mean squared error in px where there is a disparity.
    pub rms_error_px: f64,
    /// Absolute error in px that 95 % of the pixels with a disparity stay below.
    pub p95_error_px: f64,
}

/// Thresholds of [`DisparityScore::bad`], in px.
pub const BAD_PX: [f64; 4] = [1.0, 2.0, 3.0, 4.0];

/// Errors of a depth map over the pixels whose truth is known.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DepthScore {
    /// Pixels with finite truth, inside the mask.
    pub pixels: usize,
    /// Share of them with a depth, 0..=1.
    pub density: f64,
    /// Median absolute error in mm where there is a depth.
    pub median_error_mm: f64,
    /// Mean absolute error in mm where there is a depth.
    pub mean_error_mm: f64,
    /// Absolute error in mm that 95 % of the pixels with a depth stay below.
    pub p95_error_mm: f64,
}

/// Compares maps with the truth; keeps its memory from one map to the next.
#[derive(Clone, Debug, Default)]
pub struct MapScorer {
    /// Absolute errors, in the map's unit.
    errors: Vec<f32>,
}

impl MapScorer {
    /// Takes the errors of all pixels; returns how many have a known truth. `truth` and `found`: NaN or infinity for unknown.
    fn compare(
        &mut self,
        found: View<'_, f32>,
        truth: View<'_, f32>,
        mask: Option<View<'_, u8>>,
        name: &'static str,
    ) -> Result<usize, StereoError> {
        let size = (truth.width, truth.height);
        check_size(name, size, (found.width, found.height))?;
        if let Some(mask) = &mask {
            check_size("mask", size, (mask.width, mask.height))?;
        }
        self.errors.clear();
        let mut pixels = 0;
        for y in 0..size.1 {
            for (x, (truth, found)) in truth.row(y).iter().zip(found.row(y)).enumerate() {
                let counts = mask.is_none_or(|mask| mask.row(y)[x * mask.channels] != 0);
                if !truth.is_finite() || !counts {
                    continue;
                }
                pixels += 1;
                if found.is_finite() {
                    self.errors.push((found - truth).abs());
                }
            }
        }
        Ok(pixels)
    }

    /// Scores `disparity` against `truth`, both in px with NaN or infinity for unknown. Where a `mask` is given, only its non-zero
    /// pixels count.
    ///
    /// # Errors
    /// When sizes do not agree.
    pub fn disparity(
        &mut self,
        disparity: View<'_, f32>,
        truth: View<'_, f32>,
        mask: Option<View<'_, u8>>,
    ) -> Result<DisparityScore, StereoError> {
        let pixels = self.compare(disparity, truth, mask, "disparity")?;
        let known = self.errors.len();
        let mut wrong = [0usize; 4];
        let (mut sum, mut squares) = (0.0f64, 0.0f64);
        for error in self.errors.iter().map(|error| f64::from(*error)) {
            for (wrong, limit) in wrong.iter_mut().zip(BAD_PX) {
                *wrong += usize::from(error > limit);
            }
            sum += error;
            squares += error * error;
        }
        Ok(DisparityScore {
            pixels,
            density: share(known, pixels),
            bad: wrong.map(|wrong| share(wrong + pixels - known, pixels)),
            bad_of_known: wrong.map(|wrong| share(wrong, known)),
            mean_error_px: if known == 0 { f64::NAN } else { sum / known as f64 },
            rms_error_px: if known == 0 { f64::NAN } else { (squares / known as f64).sqrt() },
            p95_error_px: quantile(&mut self.errors, 0.95),
        })
    }

    /// Scores `depth` against `truth`, both in mm with NaN or infinity for unknown. Where a `mask` is given, only its non-zero
    /// pixels count.
    ///
    /// # Errors
    /// When sizes do not agree.
    pub fn depth(
        &mut self,
        depth: View<'_, f32>,
        truth: View<'_, f32>,
        mask: Option<View<'_, u8>>,
    ) -> Result<DepthScore, StereoError> {
        let pixels = self.compare(depth, truth, mask, "depth")?;
        let known = self.errors.len();
        let sum: f64 = self.errors.iter().map(|error| f64::from(*error)).sum();
        Ok(DepthScore {
            pixels,
            density: share(known, pixels),
            mean_error_mm: if known == 0 { f64::NAN } else { sum / known as f64 },
            median_error_mm: quantile(&mut self.errors, 0.5),
            p95_error_mm: quantile(&mut self.errors, 0.95),
        })
    }
}

fn share(count: usize, of: usize) -> f64 {
    if of == 0 { 0.0 } else { count as f64 / of as f64 }
}

/// The value that `part` of them stay below, the nearest one by rank; NaN of none. Reorders them.
fn quantile(values: &mut [f32], part: f64) -> f64 {
    if values.is_empty() {
        return f64::NAN;
    }
    let rank = ((values.len() - 1) as f64 * part).round() as usize;
    f64::from(*values.select_nth_unstable_by(rank, f32::total_cmp).1)
}

/// [`MapScorer::disparity`] for a single map.
///
/// # Errors
/// When sizes do not agree.
pub fn score_disparity(
    disparity: View<'_, f32>,
    truth: View<'_, f32>,
    mask: Option<View<'_, u8>>,
) -> Result<DisparityScore, StereoError> {
    MapScorer::default().disparity(disparity, truth, mask)
}

/// Distances from measured points to a surface given as points.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SurfaceScore {
    /// Number of points that were compared.
    pub points: usize,
    /// Median distance in mm.
    pub median_mm: f64,
    /// Distance in mm that 95 % of the points stay below.
    pub p95_mm: f64,
    /// Mean distance in mm.
    pub mean_mm: f64,
    /// Share of the points that are nearer than the reach, 0..=1.
    pub within_reach: f64,
}

/// For each measured point, the distance to the nearest point of the true surface, at most `reach_mm`
/// (farther points count as `reach_mm`). Points with a NaN are skipped.
///
/// # Errors
/// When `reach_mm` is not positive or the surface is empty.
pub fn score_surface(measured: &[[f32; 3]], surface: &[[f32; 3]], reach_mm: f32) -> Result<SurfaceScore, StereoError> {
    if !(reach_mm > 0.0 && reach_mm.is_finite()) {
        let (value, accepted) = (reach_mm.to_string(), "a positive length");
        return Err(StereoError::Parameter { name: "reach_mm", value, accepted });
    }
    if surface.is_empty() {
        return Err(StereoError::Format { format: "surface", reason: "it has no points".into() });
    }
    let cells = Cells::new(surface, reach_mm);
    let mut distances: Vec<f32> = Vec::with_capacity(measured.len());
    for point in measured.iter().filter(|point| point.iter().all(|value| value.is_finite())) {
        distances.push(cells.nearest(point, reach_mm));
    }
    // NaN of no distance at all.
    let mean_mm = distances.iter().map(|d| f64::from(*d)).sum::<f64>() / distances.len() as f64;
    let near = distances.iter().filter(|d| **d < reach_mm).count();
    Ok(SurfaceScore {
        points: distances.len(),
        within_reach: share(near, distances.len()),
        median_mm: quantile(&mut distances, 0.5),
        p95_mm: quantile(&mut distances, 0.95),
        mean_mm,
    })
}

/// Surface points sorted into cubes whose side is the reach.
struct Cells<'a> {
    points: &'a [[f32; 3]],
    /// (cube, index of the point), sorted.
    order: Vec<([i32; 3], u32)>,
    side: f32,
}

impl<'a> Cells<'a> {
    fn new(points: &'a [[f32; 3]], side: f32) -> Self {
        let finite = points.iter().enumerate().filter(|(_, point)| point.iter().all(|value| value.is_finite()));
        let mut order: Vec<_> = finite.map(|(index, point)| (cube(point, side), index as u32)).collect();
        order.sort_unstable();
        Self { points, order, side }
    }

    fn nearest(&self, point: &[f32; 3], reach: f32) -> f32 {
        let [x, y, z] = cube(point, self.side);
        let mut best = reach * reach;
        for i in -1..=1 {
            for j in -1..=1 {
                // The last index varies fastest, so three cubes are one run.
                let from = [x.saturating_add(i), y.saturating_add(j), z.saturating_sub(1)];
                let to = [from[0], from[1], z.saturating_add(1)];
                let start = self.order.partition_point(|(cube, _)| *cube < from);
                for (_, index) in self.order[start..].iter().take_while(|(cube, _)| *cube <= to) {
                    let other = &self.points[*index as usize];
                    best = best.min((0..3).map(|axis| (other[axis] - point[axis]).powi(2)).sum());
                }
            }
        }
        best.sqrt()
    }
}

fn cube(point: &[f32; 3], side: f32) -> [i32; 3] {
    point.map(|value| (value / side).floor() as i32)
}
