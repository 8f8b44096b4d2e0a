//! One movement, from rest to rest, as far as it is visible.

use super::Sample;
use super::smoothness::{Spectrum, log_dimensionless_jerk};
use super::spline::Spline;
use crate::tracking::vector::{norm, sub};

/// Share of its peak speed at which a movement begins and ends, if that is not slower than rest.
pub const EDGE: f64 = 0.1;
/// As [`EDGE`], for the first bounds, which are found with rougher speeds.
pub(super) const ROUGH_EDGE: f64 = 0.05;
/// Minimum duration of a movement whose smoothness is measured, s; shorter ones are mostly tracking noise.
pub const MIN_S: f64 = 0.2;
/// Minimum length of a movement whose smoothness is measured, mm.
pub const MIN_MM: f64 = 2.0;
/// Step of integrals, s.
const STEP_S: f64 = 0.002;
/// Step of the speed profile whose spectrum is taken, s.
const PROFILE_STEP_S: f64 = 0.01;

/// Measures of one movement, from where its speed first passes [`EDGE`] of its peak (or the
/// speed of rest, where that is greater) to where it last does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Movement {
    /// Start, s.
    pub start_s: f64,
    /// Duration, s.
    pub duration_s: f64,
    /// Length of its path, mm.
    pub path_mm: f64,
    /// Straight distance between its ends, mm. Economy of motion is this divided by the path (Oropesa et al. 2013).
    pub chord_mm: f64,
    /// Highest speed, mm/s.
    pub peak_mm_s: f64,
    /// Integral of the squared jerk, mm^2/s^5.
    pub squared_jerk: f64,
    /// Log dimensionless jerk; see [`log_dimensionless_jerk`].
    pub ldlj: Option<f64>,
    /// Spectral arc length; see [`Spectrum::arc_length`].
    pub sparc: Option<f64>,
}

/// Measures movements; reuses its buffers.
#[derive(Clone, Debug, Default)]
pub struct Meter {
    spline: Spline,
    spectrum: Spectrum,
    speeds: Vec<f64>,
}

/// Integral by Simpson's rule over `parts` (made even) of a range.
fn integral(from: f64, to: f64, parts: usize, mut of: impl FnMut(f64) -> f64) -> f64 {
    let parts = parts.max(2).next_multiple_of(2);
    let step = (to - from) / parts as f64;
    let weight = |k: usize| if k == 0 || k == parts { 1.0 } else { [2.0, 4.0][k % 2] };
    (0..=parts).map(|k| weight(k) * of(from + step * k as f64)).sum::<f64>() * step / 3.0
}

impl Meter {
    /// Measures the movement between two times; `None` if it is too short, too small or too sparsely sampled. Its edges
    /// have at least the speed `rest_mm_s`.
    pub fn measure(
        &mut self,
        samples: &[Sample],
        start_s: f64,
        end_s: f64,
        knot_s: f64,
        rest_mm_s: f64,
    ) -> Option<Movement> {
        if end_s - start_s < MIN_S || !self.spline.fit(samples, start_s, end_s, knot_s) {
            return None;
        }
        let spline = &self.spline;
        let speed = |t: f64| norm(spline.at(t, 1));
        let parts = ((end_s - start_s) / STEP_S).ceil() as usize;
        let step = (end_s - start_s) / parts as f64;
        self.speeds.clear();
        self.speeds.extend((0..=parts).map(|k| speed(start_s + step * k as f64)));
        let peak = self.speeds.iter().copied().fold(0.0, f64::max);
        let edge = (EDGE * peak).max(rest_mm_s);
        let first = self.speeds.iter().position(|v| *v >= edge)?;
        let last = self.speeds.iter().rposition(|v| *v >= edge)?;
        // Between two steps the speed is taken as a line.
        let part = |slow: usize, fast: usize| {
            let (a, b) = (self.speeds[slow], self.speeds[fast]);
            if b > a { (edge - a) / (b - a) } else { 0.0 }
        };
        let from = if first == 0 { 0.0 } else { (first - 1) as f64 + part(first - 1, first) };
        let to = if last == parts { parts as f64 } else { (last + 1) as f64 - part(last + 1, last) };
        let (from, to) = (start_s + step * from, start_s + step * to);
        let duration_s = to - from;
        let parts = (duration_s / STEP_S).ceil() as usize;
        let path_mm = integral(from, to, parts, speed);
        if duration_s < MIN_S || path_mm < MIN_MM {
            return None;
        }
        let squared_jerk = integral(from, to, parts, |t| norm(spline.at(t, 3)).powi(2));
        let chord_mm = norm(sub(spline.at(to, 0), spline.at(from, 0)));
        let count = (duration_s / PROFILE_STEP_S).round().max(8.0) as usize;
        let step = duration_s / count as f64;
        self.speeds.clear();
        self.speeds.extend((0..=count).map(|k| speed(from + step * k as f64)));
        Some(Movement {
            start_s: from,
            duration_s,
            path_mm,
            chord_mm: chord_mm.min(path_mm),
            peak_mm_s: peak,
            squared_jerk,
            ldlj: log_dimensionless_jerk(duration_s, peak, squared_jerk),
            sparc: self.spectrum.arc_length(&self.speeds, step),
        })
    }
}
