//! Position and velocity from unevenly spaced samples: a cubic fitted around the wanted time.
//!
//! Savitzky and Golay 1964, "Smoothing and differentiation of data by simplified least squares procedures", extended to
//! uneven spacing: weights fall off as (1 - |u|^3)^3 (Cleveland 1979). Exact for positions that are cubic in time.

use super::Sample;

/// Minimum number of samples of a fit, if there are as many.
pub const MIN_SAMPLES: usize = 7;

/// Position (mm) and velocity (mm/s) at one time. The fourth number is the depth along the view.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State {
    /// Position, mm.
    pub place: [f64; 4],
    /// Velocity, mm/s.
    pub velocity: [f64; 4],
}

impl State {
    /// Length of the velocity in space, mm/s.
    pub fn speed(&self) -> f64 {
        let [x, y, z, _] = self.velocity;
        (x * x + y * y + z * z).sqrt()
    }
}

/// The samples around a time: all within `half_s`, or the nearest [`MIN_SAMPLES`].
fn around(samples: &[Sample], at_s: f64, half_s: f64) -> &[Sample] {
    let mut first = samples.partition_point(|s| s.at_s < at_s - half_s);
    let mut end = samples.partition_point(|s| s.at_s <= at_s + half_s);
    while end - first < MIN_SAMPLES.min(samples.len()) {
        let before = (first > 0).then(|| at_s - samples[first - 1].at_s);
        let after = (end < samples.len()).then(|| samples[end].at_s - at_s);
        match (before, after) {
            (Some(b), Some(a)) if b <= a => first -= 1,
            (Some(_), None) => first -= 1,
            _ => end += 1,
        }
    }
    &samples[first..end]
}

/// Solves `a x = b` for a symmetric positive matrix by Cholesky's method; false if it is not positive definite.
fn solve(a: &mut [[f64; 4]; 4], b: &mut [[f64; 4]; 4]) -> bool {
    for i in 0..4 {
        for j in 0..=i {
            let sum = a[i][j] - (0..j).map(|k| a[i][k] * a[j][k]).sum::<f64>();
            if i == j {
                if sum <= 1e-14 {
                    return false;
                }
                a[i][i] = sum.sqrt();
            } else {
                a[i][j] = sum / a[j][j];
            }
        }
    }
    for column in 0..4 {
        for i in 0..4 {
            let sum = b[i][column] - (0..i).map(|k| a[i][k] * b[k][column]).sum::<f64>();
            b[i][column] = sum / a[i][i];
        }
        for i in (0..4).rev() {
            let sum = b[i][column] - (i + 1..4).map(|k| a[k][i] * b[k][column]).sum::<f64>();
            b[i][column] = sum / a[i][i];
        }
    }
    true
}

/// Fits at a time. `samples` are ordered by time; without samples the result is `None`. With few samples the curve is
/// of a lower degree.
pub fn fit(samples: &[Sample], at_s: f64, half_s: f64) -> Option<State> {
    let near = around(samples, at_s, half_s);
    let reach = near.iter().map(|s| (s.at_s - at_s).abs()).fold(0.0, f64::max);
    // A little beyond the farthest one, which would have no weight at all.
    let reach = (reach * 1.05).max(half_s).max(1e-6);
    let mean = |channel: usize| near.iter().map(|s| channel_of(s, channel)).sum::<f64>() / near.len() as f64;
    let middle: [f64; 4] = std::array::from_fn(mean);
    let most = match near.len() {
        0 => return None,
        1 => 0,
        2 => 1,
        3 | 4 => 2,
        _ => 3,
    };
    for degree in (0..=most).rev() {
        let (mut a, mut b) = ([[0.0; 4]; 4], [[0.0; 4]; 4]);
        for sample in near {
            let u = (sample.at_s - at_s) / reach;
            let fade = 1.0 - u.abs().powi(3);
            let weight = fade * fade * fade;
            let powers = [1.0, u, u * u, u * u * u];
            for i in 0..=degree {
                for j in 0..=i {
                    a[i][j] += weight * powers[i] * powers[j];
                }
                for (channel, b) in b[i].iter_mut().enumerate() {
                    *b += weight * powers[i] * (channel_of(sample, channel) - middle[channel]);
                }
            }
        }
        (degree + 1..4).for_each(|i| a[i][i] = 1.0);
        if solve(&mut a, &mut b) {
            let place = std::array::from_fn(|channel| middle[channel] + b[0][channel]);
            return Some(State { place, velocity: b[1].map(|v| v / reach) });
        }
    }
    None
}

fn channel_of(sample: &Sample, channel: usize) -> f64 {
    if channel < 3 { sample.place_mm[channel] } else { sample.depth_mm }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cubic_is_met_exactly_at_odd_times() {
        let place = |t: f64| [3.0 + 2.0 * t - t * t + 0.5 * t * t * t, -t, 4.0 * t * t, 7.0 * t];
        let times = [0.0, 0.031, 0.07, 0.095, 0.14, 0.151, 0.21, 0.26, 0.3, 0.33];
        let samples = times.map(|t| {
            let [x, y, z, depth_mm] = place(t);
            Sample { at_s: t, place_mm: [x, y, z], depth_mm, tissue_mm: f64::NAN }
        });
        for t in [0.0, 0.1, 0.17, 0.33] {
            let state = fit(&samples, t, 0.1).unwrap();
            let velocity = [2.0 - 2.0 * t + 1.5 * t * t, -1.0, 8.0 * t, 7.0];
            for k in 0..4 {
                assert!((state.place[k] - place(t)[k]).abs() < 1e-9, "{state:?}");
                assert!((state.velocity[k] - velocity[k]).abs() < 1e-7, "{state:?}");
            }
        }
        assert_eq!(fit(&[], 0.0, 0.1), None);
        assert_eq!(fit(&samples[..1], 0.0, 0.1).unwrap().speed(), 0.0);
        assert!((fit(&samples[..2], 0.0, 0.1).unwrap().velocity[1] + 1.0).abs() < 1e-9);
    }
}
