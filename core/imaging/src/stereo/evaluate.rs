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
    /// Share with an error above 1, 2 and 4 px; a missing disparity counts as bad.
    pub bad: [f64; 3],
    /// The same among the pixels that have a disparity.
    pub bad_of_known: [f64; 3],
    /// Mean absolute error in px where there is a disparity.
    pub mean_error_px: f64,
    /// Root of the mean squared error in px where there is a disparity.
    pub rms_error_px: f64,
}

/// Thresholds of [`DisparityScore::bad`], in px.
pub const BAD_PX: [f64; 3] = [1.0, 2.0, 4.0];

/// Scores `disparity` against `truth`, both in px with NaN or infinity for unknown. Where a `mask` is
/// given, only its non-zero pixels count.
///
/// # Errors
/// When sizes do not agree.
pub fn score_disparity(
    disparity: View<'_, f32>,
    truth: View<'_, f32>,
    mask: Option<View<'_, u8>>,
) -> Result<DisparityScore, StereoError> {
    let size = (truth.width, truth.height);
    check_size("disparity", size, (disparity.width, disparity.height))?;
    if let Some(mask) = &mask {
        check_size("mask", size, (mask.width, mask.height))?;
    }
    let (mut pixels, mut known) = (0usize, 0usize);
    let mut wrong = [0usize; 3];
    let (mut sum, mut squares) = (0.0f64, 0.0f64);
    for y in 0..size.1 {
        for (x, (truth, found)) in truth.row(y).iter().zip(disparity.row(y)).enumerate() {
            let counts = mask.is_none_or(|mask| mask.row(y)[x * mask.channels] != 0);
            if !truth.is_finite() || !counts {
                continue;
            }
            pixels += 1;
            if !found.is_finite() {
                continue;
            }
            known += 1;
            let error = f64::from(found - truth).abs();
            for (wrong, limit) in wrong.iter_mut().zip(BAD_PX) {
                *wrong += usize::from(error > limit);
            }
            sum += error;
            squares += error * error;
        }
    }
    let share = |count: usize, of: usize| if of == 0 { 0.0 } else { count as f64 / of as f64 };
    Ok(DisparityScore {
        pixels,
        density: share(known, pixels),
        bad: wrong.map(|wrong| share(wrong + pixels - known, pixels)),
        bad_of_known: wrong.map(|wrong| share(wrong, known)),
        mean_error_px: if known == 0 { f64::NAN } else { sum / known as f64 },
        rms_error_px: if known == 0 { f64::NAN } else { (squares / known as f64).sqrt() },
    })
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
    if distances.is_empty() {
        return Ok(SurfaceScore { points: 0, median_mm: f64::NAN, p95_mm: f64::NAN, mean_mm: f64::NAN });
    }
    distances.sort_by(f32::total_cmp);
    let at = |share: f64| f64::from(distances[((distances.len() - 1) as f64 * share).round() as usize]);
    Ok(SurfaceScore {
        points: distances.len(),
        median_mm: at(0.5),
        p95_mm: at(0.95),
        mean_mm: distances.iter().map(|d| f64::from(*d)).sum::<f64>() / distances.len() as f64,
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
