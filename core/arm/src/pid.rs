//! A discrete PID: filtered derivative, anti-windup, dead zone (after Astrom and Hagglund, "Advanced PID Control", 2006).

/// Gains of one channel whose error is in some unit E and whose output is in E/s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gains {
    /// 1/s.
    pub proportional: f64,
    /// 1/s^2.
    pub integral: f64,
    /// 1.
    pub derivative: f64,
    /// Time constant of the derivative's filter, s.
    pub filter_s: f64,
    /// Errors below this count as none, E.
    pub dead_zone: f64,
    /// Largest output, E/s.
    pub most: f64,
}

/// State of one channel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pid {
    integral: f64,
    slope: f64,
    last: Option<f64>,
}

/// Takes the dead zone off an error; the result grows from 0 at its border.
pub fn beyond(error: f64, dead_zone: f64) -> f64 {
    error.signum() * (error.abs() - dead_zone).max(0.0)
}

impl Pid {
    /// Forgets everything.
    pub fn reset(&mut self) {
        *self = Self::default();
    }

    /// One step of `dt_s`: `error` drives the proportional and derivative parts, `slow_error` the integral (the same, or one that holds no
    /// prediction). A step without time, or an error that is no number, gives 0 and changes nothing.
    pub fn step(&mut self, gains: &Gains, error: f64, slow_error: f64, dt_s: f64) -> f64 {
        if !(error.is_finite() && slow_error.is_finite() && dt_s > 0.0 && dt_s.is_finite()) {
            return 0.0;
        }
        let (error, slow) = (beyond(error, gains.dead_zone), beyond(slow_error, gains.dead_zone));
        let last = self.last.replace(error).unwrap_or(error);
        let part = dt_s / (gains.filter_s.max(0.0) + dt_s);
        self.slope += part * ((error - last) / dt_s - self.slope);
        let grown = self.integral + gains.integral * slow * dt_s;
        let wanted = gains.proportional * error + grown + gains.derivative * self.slope;
        let output = wanted.clamp(-gains.most, gains.most);
        // At the limit the integral only goes back.
        if output == wanted || (grown - self.integral) * wanted < 0.0 {
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
            error += (1.0 - pid.step(&GAINS, error, error, 0.01)) * 0.01;
        }
        assert!((error - GAINS.dead_zone).abs() < 0.05 || error.abs() < GAINS.dead_zone, "{error}");
    }

    #[test]
    fn at_the_limit_nothing_winds_up() {
        let mut pid = Pid::default();
        for _ in 0..1000 {
            assert_eq!(pid.step(&GAINS, 100.0, 100.0, 0.01), 10.0);
        }
        // The first error of the other sign is answered at once.
        let turned = (0..20).map(|_| pid.step(&GAINS, -3.0, -3.0, 0.01)).last().unwrap_or(0.0);
        assert!(turned < 0.0, "{turned}");
    }

    #[test]
    fn hostile_numbers_change_nothing() {
        let mut pid = Pid::default();
        pid.step(&GAINS, 1.0, 1.0, 0.01);
        let before = pid;
        for (error, dt) in [(f64::NAN, 0.01), (f64::INFINITY, 0.01), (1.0, 0.0), (1.0, -1.0), (1.0, f64::NAN)] {
            assert_eq!(pid.step(&GAINS, error, error, dt), 0.0);
            assert_eq!(pid, before);
        }
    }
}
