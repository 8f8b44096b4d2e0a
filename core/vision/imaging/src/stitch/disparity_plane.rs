//! A plane through disparities: the registration of views that share too little for a homography of eight parameters.
//!
//! In rectified views a plane in space has the disparity `d = x_slope * x + y_slope * y + offset`. Three parameters
//! stay well determined on a strip some tens of pixels wide, where the other five of a homography do not, and
//! extrapolate without folding.

use crate::geometry::Point;
use panoscope_base::random::SplitMix64;

/// Number of samples of three points.
const SAMPLES: usize = 256;
/// Maximum slope; tissue with a steeper one is not visible to both cameras, so larger slopes are wrong matches.
const MAX_SLOPE: f64 = 0.5;
/// Samples whose points span less area than this, in px^2, do not determine the slopes.
const MIN_AREA_PX2: f64 = 50.0;
/// Prior for a plane without rotation about the vertical axis: standard deviation of `x_slope`. The overlap of two
/// views side by side is narrow in x, so that noise alone would tilt the plane.
const X_SLOPE_DEVIATION: f64 = 0.1;
/// Rounds of the reweighted fit.
const ROUNDS: usize = 5;

/// One point of the left rectified view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Position in px.
    pub at: Point,
    /// Disparity in px.
    pub disparity_px: f64,
}

/// Disparity of a plane in space, in the left rectified view.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DisparityPlane {
    /// Change of the disparity per column.
    pub x_slope: f64,
    /// Change of the disparity per row.
    pub y_slope: f64,
    /// Disparity at the image's corner, px.
    pub offset_px: f64,
}

impl DisparityPlane {
    /// Disparity at a position of the left view, px.
    pub fn at(&self, [x, y]: Point) -> f64 {
        self.x_slope * x + self.y_slope * y + self.offset_px
    }

    /// Position in the left view of a position of the right rectified view, for a point of the plane.
    pub fn left_from_right(&self, [x, y]: Point) -> Point {
        // x_left = x + d(x_left, y).
        [(x + self.y_slope * y + self.offset_px) / (1.0 - self.x_slope), y]
    }

    /// The plane that most samples agree on to within `threshold_px`, refitted on all of them; `None` if fewer than
    /// `least` agree. The same samples and seed give the same plane.
    pub fn fit(samples: &[Sample], threshold_px: f64, least: usize, seed: u64) -> Option<Self> {
        let least = least.max(3);
        if samples.len() < least {
            return None;
        }
        let mut random = SplitMix64(seed);
        let mut best: Option<(f64, Self)> = None;
        for _ in 0..SAMPLES {
            let mut draw = || samples[random.below(samples.len())];
            let Some(plane) = Self::through([draw(), draw(), draw()]) else { continue };
            // MSAC (Torr and Zisserman 2000): an outlier costs its threshold.
            let cost: f64 = samples.iter().map(|s| plane.error_px(s).min(threshold_px)).sum();
            if best.is_none_or(|(least, _)| cost < least) {
                best = Some((cost, plane));
            }
        }
        let mut plane = best?.1;
        for _ in 0..ROUNDS {
            plane = plane.refit(samples, threshold_px)?;
        }
        let agree = samples.iter().filter(|s| plane.error_px(s) < threshold_px).count();
        (agree >= least && plane.is_plausible()).then_some(plane)
    }

    fn error_px(&self, sample: &Sample) -> f64 {
        (self.at(sample.at) - sample.disparity_px).abs()
    }

    fn is_plausible(&self) -> bool {
        // Written so that NaN fails too.
        self.x_slope.abs() <= MAX_SLOPE && self.y_slope.abs() <= MAX_SLOPE && self.offset_px.is_finite()
    }

    fn through([a, b, c]: [Sample; 3]) -> Option<Self> {
        let (u, v) = ([b.at[0] - a.at[0], b.at[1] - a.at[1]], [c.at[0] - a.at[0], c.at[1] - a.at[1]]);
        let area = u[0] * v[1] - u[1] * v[0];
        if area.abs() < MIN_AREA_PX2 {
            return None;
        }
        let (p, q) = (b.disparity_px - a.disparity_px, c.disparity_px - a.disparity_px);
        let (x_slope, y_slope) = ((p * v[1] - q * u[1]) / area, (q * u[0] - p * v[0]) / area);
        let offset_px = a.disparity_px - x_slope * a.at[0] - y_slope * a.at[1];
        Some(Self { x_slope, y_slope, offset_px }).filter(Self::is_plausible)
    }

    /// Least squares over the samples within the threshold, with the prior on `x_slope`.
    fn refit(&self, samples: &[Sample], threshold_px: f64) -> Option<Self> {
        // Around the middle of the samples the normal equations are well conditioned.
        let (mut middle, mut count) = ([0.0; 2], 0.0);
        for s in samples.iter().filter(|s| self.error_px(s) < threshold_px) {
            middle = [middle[0] + s.at[0], middle[1] + s.at[1]];
            count += 1.0;
        }
        if count < 3.0 {
            return None;
        }
        middle = middle.map(|m| m / count);
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        let (mut xd, mut yd, mut sum) = (0.0, 0.0, 0.0);
        for s in samples.iter().filter(|s| self.error_px(s) < threshold_px) {
            let (x, y) = (s.at[0] - middle[0], s.at[1] - middle[1]);
            xx += x * x;
            xy += x * y;
            yy += y * y;
            xd += x * s.disparity_px;
            yd += y * s.disparity_px;
            sum += s.disparity_px;
        }
        // The noise of a sample is about a third of the threshold.
        let prior = (threshold_px / 3.0 / X_SLOPE_DEVIATION).powi(2);
        // A row's worth of pixels keeps the slope in y determined when all samples lie in one row.
        let (xx, yy) = (xx + prior, yy + 1.0);
        let determinant = xx * yy - xy * xy;
        if determinant <= 0.0 {
            return None;
        }
        let (x_slope, y_slope) = ((xd * yy - yd * xy) / determinant, (yd * xx - xd * xy) / determinant);
        let offset_px = sum / count - x_slope * middle[0] - y_slope * middle[1];
        Some(Self { x_slope, y_slope, offset_px })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A strip of `width` columns at the right border of a 640x480 view.
    fn strip(width: usize, of: impl Fn(f64, f64) -> f64) -> Vec<Sample> {
        let mut samples = Vec::new();
        for row in 0..20 {
            for column in 0..width / 8 {
                let at = [(640 - width + column * 8) as f64, (row * 24) as f64];
                samples.push(Sample { at, disparity_px: of(at[0], at[1]) });
            }
        }
        samples
    }

    #[test]
    fn a_plane_in_a_narrow_strip_is_found_among_outliers() {
        let truth = DisparityPlane { x_slope: 0.02, y_slope: -0.03, offset_px: 570.0 };
        let mut samples = strip(64, |x, y| truth.at([x, y]));
        for (index, sample) in samples.iter_mut().enumerate() {
            match index % 5 {
                0 => sample.disparity_px -= 40.0,
                1 => sample.disparity_px += 25.0 + index as f64 / 10.0,
                _ => {}
            }
        }
        let plane = DisparityPlane::fit(&samples, 4.0, 12, 1).unwrap();
        for at in [[600.0, 20.0], [630.0, 400.0]] {
            assert!((plane.at(at) - truth.at(at)).abs() < 0.3, "{plane:?}");
        }
        // The far edge of the right view, where nothing was measured.
        let edge = plane.left_from_right([639.0, 240.0])[0] - truth.left_from_right([639.0, 240.0])[0];
        assert!(edge.abs() < 12.0, "{edge} px at the far edge");
    }

    #[test]
    fn noise_in_a_strip_of_one_column_does_not_tilt_the_plane() {
        let samples = strip(16, |x, y| 600.0 + ((x * 7.0 + y * 13.0) % 5.0) * 0.4 - 0.8);
        let plane = DisparityPlane::fit(&samples, 4.0, 12, 1).unwrap();
        assert!(plane.x_slope.abs() < 0.05 && plane.y_slope.abs() < 0.01, "{plane:?}");
    }

    #[test]
    fn disparities_without_a_plane_are_refused() {
        let mut random = SplitMix64(5);
        let mut samples = strip(64, |_, _| 0.0);
        for sample in &mut samples {
            sample.disparity_px = 200.0 + random.below(400) as f64;
        }
        assert_eq!(DisparityPlane::fit(&samples, 4.0, 40, 1), None);
        assert_eq!(DisparityPlane::fit(&samples[..2], 4.0, 3, 1), None);
    }

    #[test]
    fn a_position_of_the_right_view_comes_back() {
        let plane = DisparityPlane { x_slope: 0.1, y_slope: 0.05, offset_px: 300.0 };
        let left = [500.0, 100.0];
        let right = [left[0] - plane.at(left), left[1]];
        let back = plane.left_from_right(right);
        assert!((back[0] - left[0]).abs() < 1e-9 && back[1] == left[1]);
    }
}
