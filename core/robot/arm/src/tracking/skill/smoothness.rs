//! Measures of smoothness.

use std::f64::consts::PI;

/// Amplitude of the normalised spectrum below which it does not count (Balasubramanian et al. 2015).
pub const SPARC_AMPLITUDE: f64 = 0.05;
/// Highest frequency that counts, Hz.
pub const SPARC_HIGHEST_HZ: f64 = 10.0;
/// Zero padding of the spectrum: 2 to this power times the length. The published 4 cuts the cusps between the lobes of
/// a constant speed, which gives 3 % less than the integral.
const PADDING: u32 = 6;
/// Dimensionless jerk that counts as zero: a minimum-jerk reach has 204.8.
const NO_JERK: f64 = 1e-3;

/// Log dimensionless jerk: `-ln(T^3 / v_peak^2 * integral of |jerk|^2)`.
///
/// Hogan and Sternad 2009, normalised by the peak speed as in Balasubramanian et al. 2012 and 2015. Greater is
/// smoother; a minimum-jerk reach from rest to rest has `-ln 204.8 = -5.322` whatever its length and duration. `None`
/// if nothing moves or the speed is constant. `squared_jerk`: integral over the movement, mm^2/s^5.
pub fn log_dimensionless_jerk(duration_s: f64, peak_mm_s: f64, squared_jerk: f64) -> Option<f64> {
    let jerk = duration_s.powi(3) / (peak_mm_s * peak_mm_s) * squared_jerk;
    (peak_mm_s > 0.0 && jerk.is_finite() && jerk > NO_JERK).then(|| -jerk.ln())
}

/// Reusable buffers of spectra.
#[derive(Clone, Debug, Default)]
pub struct Spectrum {
    re: Vec<f64>,
    im: Vec<f64>,
}

impl Spectrum {
    /// Spectral arc length of a speed profile (SPARC; Balasubramanian et al. 2015).
    ///
    /// `-integral of sqrt((1/w_c)^2 + (dV/dw)^2) dw` from 0 to `w_c`, where V is the amplitude of the spectrum, 1 at
    /// zero, and `w_c` the last frequency up to 10 Hz at which V reaches 0.05. Greater is smoother. `speeds` are
    /// `step_s` apart. `None` for profiles without length or speed.
    pub fn arc_length(&mut self, speeds: &[f64], step_s: f64) -> Option<f64> {
        if speeds.len() < 4 || step_s.is_nan() || step_s <= 0.0 {
            return None;
        }
        let size = speeds.len().next_power_of_two() << PADDING;
        self.re.clear();
        self.re.extend_from_slice(speeds);
        self.re.resize(size, 0.0);
        self.im.clear();
        self.im.resize(size, 0.0);
        fft(&mut self.re, &mut self.im);
        let step_hz = 1.0 / (step_s * size as f64);
        let bins = ((SPARC_HIGHEST_HZ / step_hz) as usize + 1).min(size / 2);
        let amplitude = |bin: usize| self.re[bin].hypot(self.im[bin]);
        let zero = amplitude(0);
        if zero.is_nan() || zero <= 0.0 {
            return None;
        }
        let last = (0..bins).rev().find(|bin| amplitude(*bin) >= SPARC_AMPLITUDE * zero)?;
        if last == 0 {
            return None;
        }
        let step = 1.0 / last as f64;
        let arc = |bin: usize| step.hypot((amplitude(bin + 1) - amplitude(bin)) / zero);
        Some(-(0..last).map(arc).sum::<f64>())
    }
}

/// Fourier transform in place; the length is a power of two (Cooley and Tukey 1965).
fn fft(re: &mut [f64], im: &mut [f64]) {
    let n = re.len();
    if n < 2 {
        return;
    }
    let shift = usize::BITS - n.trailing_zeros();
    for i in 0..n {
        let j = i.reverse_bits() >> shift;
        if i < j {
            re.swap(i, j);
            im.swap(i, j);
        }
    }
    let mut half = 1;
    while half < n {
        for k in 0..half {
            let (s, c) = (-PI * k as f64 / half as f64).sin_cos();
            for i in (k..n).step_by(2 * half) {
                let j = i + half;
                let (x, y) = (re[j] * c - im[j] * s, re[j] * s + im[j] * c);
                (re[j], im[j]) = (re[i] - x, im[i] - y);
                (re[i], im[i]) = (re[i] + x, im[i] + y);
            }
        }
        half *= 2;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_minimum_jerk_reach_has_its_known_log_dimensionless_jerk() {
        // 720 L^2 / T^5, and a peak of 1.875 L / T.
        for (length, duration) in [(50.0_f64, 1.0_f64), (8.0, 0.4)] {
            let squared = 720.0 * length * length / duration.powi(5);
            let ldlj = log_dimensionless_jerk(duration, 1.875 * length / duration, squared).unwrap();
            assert!((ldlj + 204.8_f64.ln()).abs() < 1e-12);
        }
        assert_eq!(log_dimensionless_jerk(1.0, 0.0, 0.0), None);
        assert_eq!(log_dimensionless_jerk(1.0, 10.0, 0.0), None, "steady speed has no jerk");
    }

    #[test]
    fn the_transform_is_fouriers() {
        let x: Vec<f64> = (0..32).map(|k| f64::from(k * k % 17)).collect();
        let (mut re, mut im) = (x.clone(), vec![0.0; 32]);
        fft(&mut re, &mut im);
        for bin in 0..32 {
            let part = |f: fn(f64) -> f64| -> f64 {
                x.iter().enumerate().map(|(k, x)| x * f(-2.0 * PI * (bin * k) as f64 / 32.0)).sum()
            };
            assert!((re[bin] - part(f64::cos)).abs() < 1e-9 && (im[bin] - part(f64::sin)).abs() < 1e-9);
        }
    }

    #[test]
    fn spectral_arc_length_does_not_depend_on_amplitude_and_falls_with_each_arrest() {
        let bell = |t: f64| if (0.0..=1.0).contains(&t) { 30.0 * (t * (1.0 - t)).powi(2) } else { 0.0 };
        let profile = |count: usize, gain: f64| -> Vec<f64> {
            (0..=100 * count)
                .map(|k| gain * (0..count).map(|c| bell(0.01 * k as f64 - c as f64)).sum::<f64>())
                .collect()
        };
        let mut spectrum = Spectrum::default();
        let one = spectrum.arc_length(&profile(1, 1.0), 0.01).unwrap();
        assert!((one - spectrum.arc_length(&profile(1, 40.0), 0.01).unwrap()).abs() < 1e-12);
        // Published figures for a single smooth reach lie between -1.4 and -1.6.
        assert!((-1.6..-1.35).contains(&one), "{one}");
        let two = spectrum.arc_length(&profile(2, 1.0), 0.01).unwrap();
        let four = spectrum.arc_length(&profile(4, 1.0), 0.01).unwrap();
        assert!(two < one - 0.3 && four < two - 0.3, "{one} {two} {four}");
        assert_eq!(spectrum.arc_length(&[0.0; 50], 0.01), None);
    }
}
