//! Counts false and missed warnings against true distances.

use super::hysteresis::{Hysteresis, Rule};

/// Counts of a [`Judge`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Verdict {
    /// Images evaluated.
    pub ticks: u64,
    /// Approaches by true distance.
    pub approaches: u64,
    /// Approaches without a warning within the allowed delay after the distance fell below `on_mm` by more than the
    /// margin.
    pub missed: u64,
    /// Warnings.
    pub warnings: u64,
    /// Warnings for which, from the allowed delay before their start, no distance was within `off_mm` plus the margin.
    pub false_warnings: u64,
    /// Sum of the delays of warnings that were not missed, s.
    pub delay_sum_s: f64,
    /// Maximum of these delays, s.
    pub delay_max_s: f64,
    /// Measured distances for which the true one is known.
    pub distances: u64,
    /// Sum of their absolute errors, mm.
    pub error_sum_mm: f64,
    /// Sum of their squared errors, mm^2.
    pub error_squares: f64,
}

impl Verdict {
    /// Mean delay of warnings, s; NaN if there are none.
    pub fn delay_s(&self) -> f64 {
        let warned = self.approaches - self.missed;
        if warned == 0 { f64::NAN } else { self.delay_sum_s / warned as f64 }
    }

    /// Root mean square of the distances' errors, mm; NaN if there are none.
    pub fn rms_mm(&self) -> f64 {
        if self.distances == 0 { f64::NAN } else { (self.error_squares / self.distances as f64).sqrt() }
    }

    /// Adds the counts of another tip.
    pub fn add(&mut self, other: &Self) {
        self.ticks += other.ticks;
        self.approaches += other.approaches;
        self.missed += other.missed;
        self.warnings += other.warnings;
        self.false_warnings += other.false_warnings;
        self.delay_sum_s += other.delay_sum_s;
        self.delay_max_s = self.delay_max_s.max(other.delay_max_s);
        self.distances += other.distances;
        self.error_sum_mm += other.error_sum_mm;
        self.error_squares += other.error_squares;
    }
}

/// Evaluates the warnings of one tip.
///
/// An approach is what the rule itself makes of true distances, if it comes nearer than `on_mm` by the margin: what
/// only grazes the threshold may be warned of or not. A warning is false where the true distance stays beyond `off_mm`
/// and the margin all the while.
#[derive(Clone, Debug)]
pub struct Judge {
    rule: Rule,
    margin_mm: f64,
    delay_s: f64,
    truth: Hysteresis,
    verdict: Verdict,
    approach: Option<Approach>,
    warning: Option<Warning>,
    /// Last time at which the true distance was within `off_mm` plus the margin, s.
    near_s: f64,
    warned_s: f64,
}

#[derive(Clone, Copy, Debug)]
struct Approach {
    end_s: Option<f64>,
    /// Time since which it is below `on_mm` by more than the margin, s.
    near_s: Option<f64>,
    warned_s: Option<f64>,
}

#[derive(Clone, Copy, Debug)]
struct Warning {
    is_true: bool,
}

impl Judge {
    /// An evaluation by a rule; a warning later than `delay_s` counts as missed.
    pub fn new(rule: Rule, margin_mm: f64, delay_s: f64) -> Self {
        Self {
            rule,
            margin_mm,
            delay_s,
            truth: Hysteresis::default(),
            verdict: Verdict::default(),
            approach: None,
            warning: None,
            near_s: f64::NEG_INFINITY,
            warned_s: f64::NEG_INFINITY,
        }
    }

    /// Adds one image: the true distance, the measured one (NaN if unknown), and whether there is a warning.
    pub fn step(&mut self, now_s: f64, true_mm: f64, measured_mm: f64, is_warned: bool) {
        self.verdict.ticks += 1;
        let error = (measured_mm - true_mm).abs();
        if error.is_finite() {
            self.verdict.distances += 1;
            self.verdict.error_sum_mm += error;
            self.verdict.error_squares += error * error;
        }
        if true_mm <= self.rule.off_mm.max(self.rule.on_mm) + self.margin_mm {
            self.near_s = now_s;
        }
        self.warned_s = if is_warned { now_s } else { self.warned_s };
        let is_near = self.truth.step(now_s, true_mm, &self.rule);
        if self.approach.as_ref().is_some_and(|a| a.end_s.is_some_and(|end| is_near || now_s - end > self.delay_s)) {
            self.close_approach();
        }
        if is_near && self.approach.is_none() {
            self.approach = Some(Approach { end_s: None, near_s: None, warned_s: None });
        }
        if let Some(approach) = &mut self.approach {
            if true_mm <= self.rule.on_mm - self.margin_mm {
                approach.near_s.get_or_insert(now_s);
            }
            if is_warned {
                approach.warned_s.get_or_insert(now_s);
            }
            if !is_near {
                approach.end_s.get_or_insert(now_s);
            }
        }
        let is_true = now_s - self.near_s <= self.delay_s;
        match (&mut self.warning, is_warned) {
            (None, true) => self.warning = Some(Warning { is_true }),
            (Some(warning), true) => warning.is_true |= is_true,
            (Some(_), false) => self.close_warning(),
            (None, false) => {}
        }
    }

    fn close_approach(&mut self) {
        let Some(approach) = self.approach.take() else { return };
        let Some(near_s) = approach.near_s else { return };
        self.verdict.approaches += 1;
        let delay = approach.warned_s.map_or(f64::INFINITY, |at| (at - near_s).max(0.0));
        if delay > self.delay_s {
            self.verdict.missed += 1;
            return;
        }
        self.verdict.delay_sum_s += delay;
        self.verdict.delay_max_s = self.verdict.delay_max_s.max(delay);
    }

    fn close_warning(&mut self) {
        if let Some(warning) = self.warning.take() {
            self.verdict.warnings += 1;
            self.verdict.false_warnings += u64::from(!warning.is_true);
        }
    }

    /// The counts, as if the current approach ended here.
    pub fn verdict(&self) -> Verdict {
        let mut ended = self.clone();
        ended.close_approach();
        ended.close_warning();
        ended.verdict
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RULE: Rule = Rule { on_mm: 5.0, off_mm: 6.0, min_s: 0.0 };

    /// One step per 0.1 s: true distance and whether it is warned of.
    fn judged(steps: &[(f64, bool)]) -> Verdict {
        let mut judge = Judge::new(RULE, 0.5, 0.25);
        for (k, (distance, is_warned)) in steps.iter().enumerate() {
            judge.step(0.1 * k as f64, *distance, distance + 0.5, *is_warned);
        }
        judge.verdict()
    }

    #[test]
    fn approaches_are_warned_of_or_missed_and_warnings_true_or_false() {
        let off = (9.0, false);
        let warned = judged(&[off, (4.0, false), (3.0, true), (4.0, true), off, off, off, off]);
        assert_eq!((warned.approaches, warned.missed, warned.warnings, warned.false_warnings), (1, 0, 1, 0));
        assert!((warned.delay_s() - 0.1).abs() < 1e-9 && (warned.rms_mm() - 0.5).abs() < 1e-9, "{warned:?}");
        let slow = judged(&[off, (4.0, false), (3.0, false), (3.0, false), (3.0, false), (3.0, true), off]);
        assert_eq!(
            (slow.approaches, slow.missed, slow.warnings, slow.false_warnings),
            (1, 1, 1, 0),
            "it comes too late"
        );
        let missed = judged(&[off, (4.0, false), (3.0, false), off, off, off, off]);
        assert_eq!((missed.approaches, missed.missed, missed.warnings), (1, 1, 0));
        let wrong = judged(&[off, off, off, (9.0, true), (8.0, true), off]);
        assert_eq!((wrong.approaches, wrong.warnings, wrong.false_warnings), (0, 1, 1));
        // A warning that comes after the allowed delay misses the approach, and is late, not false, only within that delay.
        let late = judged(&[off, (4.0, false), off, off, off, off, (9.0, true), off]);
        assert_eq!((late.approaches, late.missed, late.warnings, late.false_warnings), (1, 1, 1, 1));
        // What grazes the threshold may be warned of or not.
        for is_warned in [false, true] {
            let grazed = judged(&[off, (4.8, is_warned), (4.9, is_warned), off, off, off, off]);
            assert_eq!((grazed.approaches, grazed.missed, grazed.false_warnings), (0, 0, 0));
        }
        // Two approaches one after the other are two.
        let two = judged(&[(4.0, true), (9.0, true), (4.0, true), (9.0, false), off, off, off, off]);
        assert_eq!((two.approaches, two.missed), (2, 0));
        // An approach that is still going on counts.
        assert_eq!(judged(&[off, (4.0, false)]).missed, 1);
    }
}
