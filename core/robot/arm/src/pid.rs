//! A discrete PID (after Astrom and Hagglund, "Advanced PID Control", 2006). The derivative is that of the filtered
//! measurement, so that a new set-point causes no kick; the integral stops while the output is limited (anti-windup);
//! small errors are ignored (dead zone).

/// Gains of one channel whose error is in some unit E and whose output is in E/s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gains {
    /// Gain of the proportional part, 1/s.
    pub proportional: f64,
    /// Gain of the integral part, 1/s^2.
    pub integral: f64,
    /// Gain of the derivative part, without unit.
    pub derivative: f64,
    /// Time constant of the derivative's filter, a first-order low-pass, s: faster changes count as noise. At least one
    /// step for a sampled measurement.
    pub filter_s: f64,
    /// Errors below this count as 0, E.
    pub dead_zone: f64,
    /// Maximum output, E/s.
    pub most: f64,
}

/// Inputs of one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Error of the proportional part, E.
    pub error: f64,
    /// Error that the integral sums, E: the same, or the error without prediction.
    pub slow_error: f64,
    /// Measurement of the derivative part, E: rises with the error, but does not jump with the set-point.
    pub measured: f64,
    /// Whether the last output was limited.
    pub is_limited: bool,
}

impl Sample {
    /// One error for all parts, for a constant set-point.
    pub fn of(error: f64) -> Self {
        Self { error, slow_error: error, measured: error, is_limited: false }
    }
}

/// State of one channel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pid {
    integral: f64,
    slope: f64,
    /// The previous measurement, E.
    last: Option<f64>,
}

/// Subtracts the dead zone from an error; the result is 0 at its border.
pub fn beyond(error: f64, dead_zone: f64) -> f64 {
    error.signum() * (error.abs() - dead_zone).max(0.0)
}

impl Pid {
    /// Resets the state.
    pub fn reset(&mut self) {
        *self = Self::default();
    }

    /// Advances by `dt_s` and returns the output, E/s. A step of no time, or a sample that is not finite, returns 0 and
    /// changes nothing.
    ///
    /// At its own limit, and while `is_limited`, the integral only decreases in size. Within the dead zone the
    /// derivative fades to 0, so that noise does not move an arm at rest.
    pub fn step(&mut self, gains: &Gains, sample: &Sample, dt_s: f64) -> f64 {
        let Sample { error, slow_error, measured, is_limited } = *sample;
        if !((error + slow_error + measured).is_finite() && dt_s > 0.0 && dt_s.is_finite()) {
            return 0.0;
        }
        let fade = if gains.dead_zone > 0.0 { (error.abs() / gains.dead_zone).min(1.0) } else { 1.0 };
        let (error, slow) = (beyond(error, gains.dead_zone), beyond(slow_error, gains.dead_zone));
        let last = self.last.replace(measured).unwrap_or(measured);
        let part = dt_s / (gains.filter_s.max(0.0) + dt_s);
        self.slope += part * ((measured - last) / dt_s - self.slope);
        let grown = self.integral + gains.integral * slow * dt_s;
        let wanted = gains.proportional * error + grown + gains.derivative * fade * self.slope;
        let output = wanted.clamp(-gains.most, gains.most);
        if (output == wanted && !is_limited) || (grown - self.integral) * wanted < 0.0 {
            self.integral = grown.clamp(-gains.most, gains.most);
        }
        output
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GAINS: Gains =
        Gains { proportional: 2.0, integral: 1.0, derivative: 0.1, filter_s: 0.05, dead_zone: 0.5, most: 10.0 };

    #[test]
    fn the_integral_takes_a_steady_load_away() {
        // A plant that drifts by 1 a second: de/dt = 1 - u.
        let (mut pid, mut error) = (Pid::default(), 3.0);
        for _ in 0..3000 {
            error += (1.0 - pid.step(&GAINS, &Sample::of(error), 0.01)) * 0.01;
        }
        assert!((error - GAINS.dead_zone).abs() < 0.05 || error.abs() < GAINS.dead_zone, "{error}");
    }

    #[test]
    fn at_the_limit_nothing_winds_up() {
        let mut pid = Pid::default();
        for _ in 0..1000 {
            assert_eq!(pid.step(&GAINS, &Sample::of(100.0), 0.01), 10.0);
        }
        // The first error of the other sign is answered at once.
        let turned = (0..20).map(|_| pid.step(&GAINS, &Sample::of(-3.0), 0.01)).last().unwrap_or(0.0);
        assert!(turned < 0.0, "{turned}");
    }

    #[test]
    fn hostile_numbers_change_nothing() {
        let mut pid = Pid::default();
        pid.step(&GAINS, &Sample::of(1.0), 0.01);
        let before = pid;
        for (error, dt) in [(f64::NAN, 0.01), (f64::INFINITY, 0.01), (1.0, 0.0), (1.0, -1.0), (1.0, f64::NAN)] {
            assert_eq!(pid.step(&GAINS, &Sample::of(error), dt), 0.0);
            assert_eq!(pid, before);
        }
    }

    #[test]
    fn a_new_goal_does_not_kick_the_derivative() {
        let gains =
            Gains { proportional: 0.0, integral: 0.0, derivative: 0.5, filter_s: 0.0, dead_zone: 0.0, most: 1e6 };
        let mut pid = Pid::default();
        let moving = |k: f64| 2.0 * 0.01 * k;
        // A measurement that rises by 2 a second, and a goal that jumps by 50 in the middle.
        for k in 0..20 {
            let measured = moving(f64::from(k));
            let error = measured - if k < 10 { 0.0 } else { 50.0 };
            let output = pid.step(&gains, &Sample { error, slow_error: error, measured, is_limited: false }, 0.01);
            if k > 0 {
                assert!((output - 1.0).abs() < 1e-9, "step {k}: {output}");
            }
        }
    }

    #[test]
    fn the_derivative_is_filtered_by_its_time_constant() {
        let gains =
            Gains { proportional: 0.0, integral: 0.0, derivative: 1.0, filter_s: 0.1, dead_zone: 0.0, most: 1e6 };
        let mut pid = Pid::default();
        let rises = |pid: &mut Pid, k: i32| {
            let measured = f64::from(k) * 1e-3;
            pid.step(&gains, &Sample { error: 1.0, slow_error: 1.0, measured, is_limited: false }, 1e-3)
        };
        let after: Vec<f64> = (0..=300).map(|k| rises(&mut pid, k)).collect();
        // 1 - 1/e of the slope after one time constant.
        assert!((after[100] - 0.632).abs() < 0.01 && (after[300] - 0.95).abs() < 0.01, "{} {}", after[100], after[300]);
    }

    #[test]
    fn what_is_not_carried_out_does_not_wind_up() {
        let gains =
            Gains { proportional: 1.0, integral: 1.0, derivative: 0.0, filter_s: 0.0, dead_zone: 0.0, most: 100.0 };
        let run = |is_limited: bool| {
            let mut pid = Pid::default();
            for _ in 0..500 {
                pid.step(&gains, &Sample { is_limited, ..Sample::of(2.0) }, 0.01);
            }
            // Back over the goal: what was summed up goes first.
            pid.step(&gains, &Sample::of(-0.1), 0.01)
        };
        assert!(run(false) > 9.0 && run(true) < 0.0, "{} {}", run(false), run(true));
    }
}
