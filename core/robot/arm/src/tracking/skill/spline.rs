//! A quintic spline fitted to unevenly spaced samples: positions, velocities and jerks of a movement.
//!
//! Biomechanics computes jerk from quintic splines (Woltring 1986, "A Fortran package for generalized, cross-validatory
//! spline smoothing and differentiation"). Here they are fitted by least squares to evenly spaced knots, with a very
//! small penalty on third differences (Eilers and Marx 1996, "Flexible smoothing with B-splines and penalties") that
//! only matters where samples are missing. Exact for positions that are quintic in time, as a minimum-jerk reach is.

use super::Sample;

/// Degree of the spline.
const DEGREE: usize = 5;
/// Basis functions that are not zero at a time, and the band of the equations.
const ORDER: usize = DEGREE + 1;
/// Weight of the penalty per sample in a knot's interval.
const PENALTY: f64 = 1e-10;

/// A spline with reusable buffers.
#[derive(Clone, Debug, Default)]
pub struct Spline {
    start_s: f64,
    knot_s: f64,
    intervals: usize,
    coefficients: Vec<[f64; 3]>,
    /// Lower band of the symmetric matrix, a row each.
    band: Vec<[f64; ORDER]>,
}

/// The basis functions of a degree that are not zero in an interval, at `u` (0..1) of it.
fn basis(u: f64, degree: usize) -> [f64; ORDER] {
    let mut n = [0.0; ORDER];
    n[0] = 1.0;
    for j in 1..=degree {
        let mut saved = 0.0;
        for r in 0..j {
            // Evenly spaced knots: each difference of two is `j`.
            let part = n[r] / j as f64;
            n[r] = saved + ((r + 1) as f64 - u) * part;
            saved = (u + (j - r - 1) as f64) * part;
        }
        n[j] = saved;
    }
    n
}

impl Spline {
    /// Fits to samples between two times. Returns false, without a spline, if there are fewer than eight samples or no
    /// time between them.
    pub fn fit(&mut self, samples: &[Sample], start_s: f64, end_s: f64, knot_s: f64) -> bool {
        let first = samples.partition_point(|s| s.at_s < start_s - 1e-9);
        let end = samples.partition_point(|s| s.at_s <= end_s + 1e-9);
        self.intervals = 0;
        let Some(samples) = samples.get(first..end).filter(|s| s.len() >= 8) else { return false };
        let length_s = end_s - start_s;
        if length_s.is_nan() || length_s <= 0.0 {
            return false;
        }
        let intervals =
            ((length_s / knot_s).round() as usize).clamp(1, (samples.len() / 2).saturating_sub(DEGREE).max(1));
        let count = intervals + DEGREE;
        (self.start_s, self.knot_s) = (start_s, length_s / intervals as f64);
        self.band.clear();
        self.band.resize(count, [0.0; ORDER]);
        self.coefficients.clear();
        self.coefficients.resize(count, [0.0; 3]);
        self.intervals = intervals;
        for sample in samples {
            let (interval, u) = self.place(sample.at_s);
            let weights = basis(u, DEGREE);
            for i in 0..ORDER {
                for j in 0..=i {
                    self.band[interval + i][i - j] += weights[i] * weights[j];
                }
                (0..3).for_each(|k| self.coefficients[interval + i][k] += weights[i] * sample.place_mm[k]);
            }
        }
        let weight = PENALTY * samples.len() as f64 / intervals as f64;
        for row in 0..count.saturating_sub(3) {
            let difference = [-1.0, 3.0, -3.0, 1.0];
            for i in 0..4 {
                for j in 0..=i {
                    self.band[row + i][i - j] += weight * difference[i] * difference[j];
                }
            }
        }
        if self.solve() {
            return true;
        }
        self.intervals = 0;
        false
    }

    /// Cholesky's method on the band, in place.
    fn solve(&mut self) -> bool {
        let count = self.band.len();
        for i in 0..count {
            for back in (0..ORDER.min(i + 1)).rev() {
                let j = i - back;
                // Both rows reach back to `i - DEGREE`.
                let low = i.saturating_sub(DEGREE);
                let sum: f64 =
                    (low..j).map(|k| self.band[i][i - k] * if j - k < ORDER { self.band[j][j - k] } else { 0.0 }).sum();
                let value = self.band[i][back] - sum;
                if back == 0 {
                    if value <= 1e-13 {
                        return false;
                    }
                    self.band[i][0] = value.sqrt();
                } else {
                    self.band[i][back] = value / self.band[j][0];
                }
            }
        }
        for k in 0..3 {
            for i in 0..count {
                let low = i.saturating_sub(DEGREE);
                let sum: f64 = (low..i).map(|j| self.band[i][i - j] * self.coefficients[j][k]).sum();
                self.coefficients[i][k] = (self.coefficients[i][k] - sum) / self.band[i][0];
            }
            for i in (0..count).rev() {
                let high = (i + DEGREE).min(count - 1);
                let sum: f64 = (i + 1..=high).map(|j| self.band[j][j - i] * self.coefficients[j][k]).sum();
                self.coefficients[i][k] = (self.coefficients[i][k] - sum) / self.band[i][0];
            }
        }
        self.coefficients.iter().flatten().all(|v| v.is_finite())
    }

    fn place(&self, at_s: f64) -> (usize, f64) {
        let x = (at_s - self.start_s) / self.knot_s;
        let interval = (x.max(0.0) as usize).min(self.intervals - 1);
        (interval, x - interval as f64)
    }

    /// Place (0), velocity (1), acceleration (2) or jerk (3) at a time, mm / s^`derivative`; zero before the first fit.
    pub fn at(&self, at_s: f64, derivative: usize) -> [f64; 3] {
        if self.intervals == 0 {
            return [0.0; 3];
        }
        let (interval, u) = self.place(at_s);
        let mut local: [[f64; 3]; ORDER] = std::array::from_fn(|i| self.coefficients[interval + i]);
        for step in 0..derivative.min(DEGREE) {
            for i in 0..DEGREE - step {
                local[i] = std::array::from_fn(|k| (local[i + 1][k] - local[i][k]) / self.knot_s);
            }
        }
        let degree = DEGREE - derivative.min(DEGREE);
        let weights = basis(u, degree);
        std::array::from_fn(|k| (0..=degree).map(|i| weights[i] * local[i][k]).sum())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quintic_and_its_jerk_are_met_through_gaps() {
        let place = |t: f64| [t.powi(5) - 2.0 * t.powi(3), 50.0 + t * t, -3.0 * t];
        let mut samples = Vec::new();
        for k in 0..90 {
            let t = f64::from(k) / 30.0 + 0.004 * f64::from(k * 7 % 5);
            if !(30..36).contains(&k) {
                samples.push(Sample { at_s: t, place_mm: place(t), depth_mm: 0.0, tissue_mm: f64::NAN });
            }
        }
        let mut spline = Spline::default();
        assert!(spline.fit(&samples, 0.2, 2.8, 0.1));
        for k in 0..=26 {
            let t = 0.2 + 0.1 * f64::from(k);
            let (at, jerk) = (spline.at(t, 0), spline.at(t, 3));
            let off = (0..3).map(|k| (at[k] - place(t)[k]).abs()).fold(0.0, f64::max);
            assert!(off < 1e-3, "{t}: {off} mm");
            let want = 60.0 * t * t - 12.0;
            assert!(
                (jerk[0] - want).abs() < 0.01 * want.abs().max(50.0) && jerk[1].abs() < 1.0,
                "{t}: {jerk:?} {want}"
            );
        }
        assert!(!spline.fit(&samples, 0.2, 0.3, 0.1), "too few samples");
        assert_eq!(spline.at(0.25, 0), [0.0; 3]);
    }
}
