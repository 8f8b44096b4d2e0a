//! How long one view is behind the other, by the rows of features while the image moves.
//!
//! Where a view is late by `delay`, a matched point is off its row by `delay` times its vertical velocity. A calibration that does not fit moves points
//! off their rows too, but always by the same amount at one position of the view. Least squares over the features of several checks separate both:
//! `rows = a + b x + c y + delay * velocity`.

use crate::geometry::{median, solve_regular};

/// Unknowns: three of the calibration, and the delay.
const UNKNOWNS: usize = 4;
/// Weight of the checks before, at each new one: about twelve count.
const MEMORY: f64 = 0.92;
/// Features whose rows or velocity are this many times the median distance from the median are mismatched.
const OUTLIER: f64 = 5.0;
/// Smallest number of features of a check.
const MIN_FEATURES: usize = 10;

/// One feature, seen in both views and again in the next left view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RowSample {
    /// Position in the view, -1 to 1.
    pub at: [f64; 2],
    /// Row in the left view less that in the right view, px.
    pub rows_px: f64,
    /// Rows per second in the left view, px/s.
    pub velocity_px_s: f64,
}

/// A delay of the right view; negative where the left one is late.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Delay {
    /// The delay, s.
    pub delay_s: f64,
    /// Its standard deviation, s: large while the image rests.
    pub deviation_s: f64,
}

/// Estimates the delay between two views.
#[derive(Clone, Debug, Default)]
pub struct ViewDelay {
    /// Mean products of the unknowns' factors and the rows, summed over checks.
    sums: [[f64; UNKNOWNS + 1]; UNKNOWNS + 1],
    checks: f64,
}

/// Keeps values near their median.
fn is_near(values: &[f64], floor: f64) -> impl Fn(f64) -> bool + use<> {
    let middle = median(&mut values.to_vec());
    let reach = OUTLIER * median(&mut values.iter().map(|value| (value - middle).abs()).collect::<Vec<_>>()).max(floor);
    move |value| (value - middle).abs() <= reach
}

impl ViewDelay {
    /// Adds the features of a check, whose rows are exact to about `unit_px`.
    pub fn add(&mut self, samples: &[RowSample], unit_px: f64) {
        let rows = is_near(&samples.iter().map(|sample| sample.rows_px).collect::<Vec<_>>(), unit_px);
        let velocity = is_near(&samples.iter().map(|sample| sample.velocity_px_s).collect::<Vec<_>>(), unit_px);
        let kept: Vec<&RowSample> =
            samples.iter().filter(|sample| rows(sample.rows_px) && velocity(sample.velocity_px_s)).collect();
        if kept.len() < MIN_FEATURES {
            return;
        }
        self.sums.iter_mut().flatten().for_each(|sum| *sum *= MEMORY);
        self.checks = MEMORY * self.checks + 1.0;
        let weight = 1.0 / kept.len() as f64;
        for sample in kept {
            let factors = [1.0, sample.at[0], sample.at[1], sample.velocity_px_s, sample.rows_px];
            for (row, a) in self.sums.iter_mut().zip(factors) {
                row.iter_mut().zip(factors).for_each(|(sum, b)| *sum += weight * a * b);
            }
        }
    }

    /// The delay; `None` without enough checks. Its deviation counts each check as one feature, because those of one check err alike.
    pub fn estimate(&self) -> Option<Delay> {
        if self.checks < 2.5 {
            return None;
        }
        let rows: [f64; UNKNOWNS] = std::array::from_fn(|index| self.sums[index][UNKNOWNS]);
        let unit: [f64; UNKNOWNS] = std::array::from_fn(|index| if index + 1 == UNKNOWNS { 1.0 } else { 0.0 });
        let solution = self.solve(rows)?;
        let inverse = self.solve(unit)?[UNKNOWNS - 1];
        let explained: f64 = solution.iter().zip(rows).map(|(a, b)| a * b).sum();
        let variance = ((self.sums[UNKNOWNS][UNKNOWNS] - explained) / self.checks).max(0.0);
        let deviation_s = (variance * inverse).max(0.0).sqrt();
        Some(Delay { delay_s: solution[UNKNOWNS - 1], deviation_s })
    }

    /// Solves the normal equations; `None` where the image never moved.
    fn solve(&self, right: [f64; UNKNOWNS]) -> Option<[f64; UNKNOWNS]> {
        let matrix: [[f64; UNKNOWNS]; UNKNOWNS] =
            std::array::from_fn(|row| std::array::from_fn(|column| self.sums[row][column]));
        solve_regular(&matrix, &right, 1e-9)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Twelve checks of an image that moves up and down by `speed_px_s`, seen by a calibration that is off by `off_px`.
    fn estimate(delay_s: f64, speed_px_s: f64, off_px: f64) -> Option<Delay> {
        let mut delay = ViewDelay::default();
        for check in 0..12 {
            let velocity = speed_px_s * (1.9 * f64::from(check)).sin();
            let sample = |index: i32| {
                let at = [f64::from(index % 9) / 4.0 - 1.0, f64::from(index / 9) / 3.0 - 1.0];
                let noise = 0.4 * (f64::from(index * 7 + check * 13) * 2.4).sin();
                // Every tenth is mismatched.
                let wrong = if index % 10 == 9 { 30.0 } else { 0.0 };
                RowSample {
                    at,
                    rows_px: off_px * (1.0 + at[1]) + delay_s * velocity + noise + wrong,
                    velocity_px_s: velocity,
                }
            };
            delay.add(&(0..60).map(sample).collect::<Vec<_>>(), 1.0);
        }
        delay.estimate()
    }

    #[test]
    fn a_delay_is_told_from_a_wrong_calibration() {
        for (delay_s, off_px) in [(0.0, 0.0), (0.0, 3.0), (0.033, 0.0), (-0.033, 2.0), (0.066, -2.0)] {
            let found = estimate(delay_s, 60.0, off_px).expect("the image moves");
            assert!((found.delay_s - delay_s).abs() < 0.003 && found.deviation_s < 0.008, "{delay_s} s: {found:?}");
        }
    }

    #[test]
    fn a_resting_image_says_nothing() {
        assert!(estimate(0.0, 0.0, 2.0).is_none_or(|found| found.deviation_s > 0.1));
        assert!(estimate(0.033, 1.0, 0.0).is_none_or(|found| found.deviation_s > 0.05));
        assert_eq!(ViewDelay::default().estimate(), None);
    }
}
