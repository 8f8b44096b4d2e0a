//! Relay feedback (Astrom and Hagglund 1984, "Automatic tuning of simple regulators with specifications on phase and
//! amplitude margins"): a relay in the controller's place makes the loop oscillate at the period at which a
//! proportional controller would just sustain it.

use std::f64::consts::{PI, TAU};

use super::TuneError;

/// Parameters of the relay.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Relay {
    /// Amplitude of the output, which has the sign of the error, E/s.
    pub amplitude: f64,
    /// Errors below this do not switch it, E: more than the noise.
    pub hysteresis: f64,
    /// Time from one sample to the next, s.
    pub step_s: f64,
    /// Time limit for a steady oscillation, s.
    pub max_s: f64,
}

/// The limit of stability of a loop under proportional control.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ultimate {
    /// Gain at which the loop would oscillate forever, 1/s.
    pub gain: f64,
    /// Period of this oscillation, s.
    pub period_s: f64,
    /// Peak error of the relay's oscillation, E.
    pub swing: f64,
}

/// Number of periods that are measured, after as many that are skipped.
const PERIODS: usize = 6;
/// Largest difference between measured periods, as a share of their mean.
const STEADY: f64 = 0.15;

impl Relay {
    /// Makes `plant` oscillate: it takes the relay's output for one step and returns the error after it. The error
    /// falls while the output is above 0.
    ///
    /// The gain is the ratio of the first harmonics of both signals over whole periods, not of the relay's amplitude to
    /// the peak: that describing function is 19 % off for an integrator with dead time, whose swing is a triangle.
    ///
    /// # Errors
    /// [`TuneError::BadRelay`] for an amplitude, step or time that is not above 0; [`TuneError::NoSwing`] where the
    /// error does not cross 0 often enough, or not steadily; [`TuneError::NotFinite`] where the plant returns no finite
    /// number.
    pub fn swing(&self, plant: &mut dyn FnMut(f64) -> f64) -> Result<Ultimate, TuneError> {
        for (what, value) in [("amplitude", self.amplitude), ("step", self.step_s), ("longest time", self.max_s)] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(TuneError::BadRelay { what, value });
            }
        }
        let (mut output, mut error) = (self.amplitude, f64::INFINITY);
        let (mut outputs, mut errors, mut rises) = (Vec::new(), Vec::new(), Vec::new());
        while (errors.len() as f64) * self.step_s < self.max_s && rises.len() <= 2 * PERIODS {
            let next = plant(output);
            if !next.is_finite() {
                return Err(TuneError::NotFinite { at_s: errors.len() as f64 * self.step_s });
            }
            if error < 0.0 && next >= 0.0 {
                // Between both samples, where the straight line crosses 0.
                rises.push(errors.len() as f64 - next / (next - error));
            }
            outputs.push(output);
            errors.push(next);
            error = next;
            if error > self.hysteresis {
                output = self.amplitude;
            } else if error < -self.hysteresis {
                output = -self.amplitude;
            }
        }
        let seconds = errors.len() as f64 * self.step_s;
        let (Some(first), Some(last)) = (rises.get(PERIODS), rises.get(2 * PERIODS)) else {
            return Err(TuneError::NoSwing { periods: rises.len().saturating_sub(1), seconds });
        };
        let period = (last - first) / PERIODS as f64;
        let uneven = rises[PERIODS..].windows(2).map(|two| (two[1] - two[0] - period).abs()).fold(0.0, f64::max);
        // One sample of the relay's own is no unsteadiness.
        if uneven > (STEADY * period).max(1.0) {
            return Err(TuneError::Uneven { share: uneven / period, seconds });
        }
        // Both signals' part at that period, over the whole periods that fit best between samples.
        let (from, to) = (first.round() as usize, (last.round() as usize).min(errors.len()));
        let harmonic = |values: &[f64]| {
            let (mut re, mut im) = (0.0, 0.0);
            for (k, value) in values[from..to].iter().enumerate() {
                let (sin, cos) = (TAU * k as f64 / period).sin_cos();
                (re, im) = (re + value * cos, im + value * sin);
            }
            re.hypot(im) / (to - from) as f64
        };
        let (driven, answered) = (harmonic(&outputs), harmonic(&errors));
        let swing = errors[from..to].iter().fold(0.0_f64, |most, error| most.max(error.abs()));
        if answered <= 1e-12 {
            return Err(TuneError::NoSwing { periods: rises.len(), seconds });
        }
        Ok(Ultimate { gain: driven / answered, period_s: period * self.step_s, swing })
    }
}

/// Rules that compute gains from a loop's limit of stability.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rule {
    /// Ziegler and Nichols 1942, "Optimum settings for automatic controllers": each swing is a quarter of the one
    /// before.
    ZieglerNichols,
    /// Tyreus and Luyben 1992, "Tuning PI controllers for integrator/dead time processes": calmer, for integrating
    /// loops.
    TyreusLuyben,
    /// AMIGO for integrating processes: Astrom and Hagglund 2004, "Revisiting the Ziegler-Nichols step response method
    /// for PID control"; speed and dead time of the integrator from the limit of stability.
    Amigo,
}

/// Parts of a PID controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Parts {
    /// Proportional part only.
    P,
    /// Proportional and integral parts.
    Pi,
    /// All three parts.
    Pid,
}

impl Parts {
    /// All combinations, from the simplest.
    pub const ALL: [Self; 3] = [Self::P, Self::Pi, Self::Pid];

    /// Name of the combination.
    pub fn name(self) -> &'static str {
        match self {
            Self::P => "P",
            Self::Pi => "PI",
            Self::Pid => "PID",
        }
    }
}

/// Gains of the three parts: 1/s, 1/s^2, 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tuned {
    /// Proportional gain, 1/s.
    pub proportional: f64,
    /// Integral gain, 1/s^2.
    pub integral: f64,
    /// Derivative gain, without unit.
    pub derivative: f64,
}

impl Rule {
    /// All rules.
    pub const ALL: [Self; 3] = [Self::ZieglerNichols, Self::TyreusLuyben, Self::Amigo];

    /// Name of the rule.
    pub fn name(self) -> &'static str {
        match self {
            Self::ZieglerNichols => "Ziegler-Nichols",
            Self::TyreusLuyben => "Tyreus-Luyben",
            Self::Amigo => "AMIGO",
        }
    }

    /// Gains of a rule; `None` if the rule has none for these parts.
    pub fn gains(self, ultimate: &Ultimate, parts: Parts) -> Option<Tuned> {
        let Ultimate { gain, period_s, .. } = *ultimate;
        // Dead time of the integrator that has this limit, and its speed: it turns by 90 degrees, the dead time by the other 90.
        let dead_s = period_s / 4.0;
        let speed = PI / (2.0 * gain * dead_s);
        // Gain, time of the integral, time of the derivative.
        let (k, ti_s, td_s) = match (self, parts) {
            (Self::ZieglerNichols, Parts::P) => (0.5 * gain, f64::INFINITY, 0.0),
            (Self::ZieglerNichols, Parts::Pi) => (0.45 * gain, period_s / 1.2, 0.0),
            (Self::ZieglerNichols, Parts::Pid) => (0.6 * gain, period_s / 2.0, period_s / 8.0),
            (Self::TyreusLuyben, Parts::Pi) => (gain / 3.2, 2.2 * period_s, 0.0),
            (Self::TyreusLuyben, Parts::Pid) => (gain / 2.2, 2.2 * period_s, period_s / 6.3),
            (Self::Amigo, Parts::Pi) => (0.35 / (speed * dead_s), 13.4 * dead_s, 0.0),
            (Self::Amigo, Parts::Pid) => (0.45 / (speed * dead_s), 8.0 * dead_s, 0.5 * dead_s),
            (Self::TyreusLuyben | Self::Amigo, Parts::P) => return None,
        };
        Some(Tuned { proportional: k, integral: k / ti_s, derivative: k * td_s })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RELAY: Relay = Relay { amplitude: 2.0, hysteresis: 0.0, step_s: 1e-3, max_s: 60.0 };

    /// A plant behind a dead time, in steps of 1 ms: `answer` takes one input and returns one output.
    fn late(dead_s: f64, mut answer: impl FnMut(f64) -> f64) -> impl FnMut(f64) -> f64 {
        let mut queue = std::collections::VecDeque::from(vec![0.0; (dead_s / 1e-3).round() as usize]);
        move |input| {
            queue.push_back(input);
            let input = queue.pop_front().unwrap_or(input);
            // The error of a goal that lies at 0.
            -answer(input)
        }
    }

    #[test]
    fn an_integrator_with_dead_time_has_the_limit_that_theory_gives() {
        for (speed, dead_s) in [(1.0, 0.1), (0.8, 0.25), (2.5, 0.06)] {
            let mut y = -0.3;
            let mut plant = late(dead_s, |u| {
                y += speed * u * 1e-3;
                y
            });
            let found = RELAY.swing(&mut plant).unwrap();
            // Its phase is -90 degrees and that of the dead time: the limit lies where that is another 90.
            let (gain, period_s) = (PI / (2.0 * speed * dead_s), 4.0 * dead_s);
            assert!((found.gain / gain - 1.0).abs() < 0.03, "{found:?}, theory {gain}");
            assert!((found.period_s / period_s - 1.0).abs() < 0.03, "{found:?}, theory {period_s}");
            // The peak alone would say 4 d / (pi a).
            assert!((4.0 * RELAY.amplitude / (PI * found.swing) / gain - 0.81).abs() < 0.03);
        }
    }

    #[test]
    fn a_second_order_with_dead_time_has_the_limit_that_its_phase_gives() {
        // 3 / ((1 + 0.5 s)(1 + 0.2 s)) behind 0.15 s.
        let (k, t1, t2, dead_s) = (3.0, 0.5, 0.2, 0.15);
        let phase = |w: f64| w * dead_s + (w * t1).atan() + (w * t2).atan() - PI;
        let (mut low, mut high) = (0.1, 100.0);
        for _ in 0..100 {
            let middle = (low + high) / 2.0;
            if phase(middle) < 0.0 { low = middle } else { high = middle }
        }
        let gain = (1.0 + (low * t1).powi(2)).sqrt() * (1.0 + (low * t2).powi(2)).sqrt() / k;
        let (mut x1, mut x2) = (-0.2, 0.0);
        let mut plant = late(dead_s, |u| {
            x1 += (k * u - x1) / t1 * 1e-3;
            x2 += (x1 - x2) / t2 * 1e-3;
            x2
        });
        let found = RELAY.swing(&mut plant).unwrap();
        assert!((found.gain / gain - 1.0).abs() < 0.05, "{found:?}, theory {gain}");
        assert!((found.period_s / (TAU / low) - 1.0).abs() < 0.05, "{found:?}, theory {}", TAU / low);
    }

    #[test]
    fn what_does_not_swing_is_told() {
        // The error never comes back.
        let mut away = |_: f64| 1.0;
        assert!(matches!(RELAY.swing(&mut away), Err(TuneError::NoSwing { periods: 0, .. })));
        let mut broken = |_: f64| f64::NAN;
        assert!(matches!(RELAY.swing(&mut broken), Err(TuneError::NotFinite { .. })));
        for relay in [Relay { amplitude: 0.0, ..RELAY }, Relay { step_s: f64::NAN, ..RELAY }] {
            assert!(matches!(relay.swing(&mut away), Err(TuneError::BadRelay { .. })));
        }
    }

    #[test]
    fn rules_give_what_their_papers_say() {
        // An integrator of speed 1 with a dead time of 0.1 s.
        let ultimate = Ultimate { gain: PI / 0.2, period_s: 0.4, swing: 0.1 };
        let near = |rule: Rule, parts: Parts, want: [f64; 3]| {
            let found = rule.gains(&ultimate, parts).unwrap();
            for (found, want) in [found.proportional, found.integral, found.derivative].iter().zip(want) {
                assert!((found - want).abs() < 1e-6 * want.max(1.0), "{rule:?} {parts:?}: {found}, not {want}");
            }
        };
        let gain = ultimate.gain;
        near(Rule::ZieglerNichols, Parts::P, [0.5 * gain, 0.0, 0.0]);
        near(Rule::ZieglerNichols, Parts::Pid, [0.6 * gain, 3.0 * gain, 0.03 * gain]);
        near(Rule::TyreusLuyben, Parts::Pi, [gain / 3.2, gain / 3.2 / 0.88, 0.0]);
        near(Rule::Amigo, Parts::Pid, [4.5, 4.5 / 0.8, 4.5 * 0.05]);
        assert_eq!(Rule::Amigo.gains(&ultimate, Parts::P), None);
    }
}
