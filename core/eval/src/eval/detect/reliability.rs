//! Calibration of a detector's scores as probabilities, and the curve that corrects them.
//!
//! Finds are sorted into bins by their score; in each, the share of correct finds should equal the mean score. The
//! expected calibration error is the mean difference, each bin weighted by its finds (Naeini et al. 2015). A
//! temperature and a bias on the logit (Platt 1999; Guo et al. 2017) are fitted by maximum likelihood. They keep the
//! order of the scores, so that average precision is unchanged.

/// Number of bins of a diagram.
pub const BINS: usize = 10;
/// Minimum distance of a score from 0 and 1; scores are clamped.
const EDGE: f64 = 1e-6;
/// Steps of Newton's method, a dozen suffice.
const STEPS: usize = 50;
/// Weight of the prior of calibrated scores, in finds; keeps a fit of a few finds near the identity.
const PRIOR: f64 = 1.0;

/// One find: its score, and whether it is correct.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outcome {
    /// Score, 0 to 1.
    pub score: f64,
    /// Whether it matches an object of its class.
    pub is_right: bool,
}

/// Finds with scores in one part of 0..1.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Bin {
    /// Number of finds.
    pub count: usize,
    /// Mean score; NaN without a find.
    pub score: f64,
    /// Share of correct finds; NaN without a find.
    pub right: f64,
}

/// The bins of equal width.
pub fn bins(outcomes: impl Iterator<Item = Outcome>) -> [Bin; BINS] {
    let mut sums = [(0usize, 0.0, 0usize); BINS];
    for Outcome { score, is_right } in outcomes {
        let sum = &mut sums[((score * BINS as f64) as usize).min(BINS - 1)];
        *sum = (sum.0 + 1, sum.1 + score, sum.2 + usize::from(is_right));
    }
    sums.map(|(count, score, right)| {
        let n = count as f64;
        Bin { count, score: score / n, right: right as f64 / n }
    })
}

/// Expected calibration error, 0 to 1; NaN without a find.
pub fn expected_error(outcomes: impl Iterator<Item = Outcome>) -> f64 {
    let bins = bins(outcomes);
    let total: usize = bins.iter().map(|bin| bin.count).sum();
    let sum: f64 = bins.iter().filter(|b| b.count > 0).map(|b| b.count as f64 * (b.score - b.right).abs()).sum();
    if total == 0 { f64::NAN } else { sum / total as f64 }
}

/// Probability `1 / (1 + exp(-(logit(score) / temperature + bias)))`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Curve {
    /// Temperature; above 1 for an overconfident network.
    pub temperature: f64,
    /// Added to the logit.
    pub bias: f64,
}

fn logit(p: f64) -> f64 {
    let p = p.clamp(EDGE, 1.0 - EDGE);
    (p / (1.0 - p)).ln()
}

fn sigmoid(v: f64) -> f64 {
    1.0 / (1.0 + (-v).exp())
}

impl Curve {
    /// The identity.
    pub const NONE: Self = Self { temperature: 1.0, bias: 0.0 };

    /// The probability of a score.
    pub fn probability(self, score: f64) -> f64 {
        sigmoid(logit(score) / self.temperature + self.bias)
    }

    /// An outcome with its probability as score.
    pub fn of(self, outcome: Outcome) -> Outcome {
        Outcome { score: self.probability(outcome.score), ..outcome }
    }

    /// The maximum-likelihood curve; [`Self::NONE`] if finds are all correct, all wrong, or too few.
    ///
    /// Newton's method on slope and bias of the logistic regression, with a weak prior on a slope of 1 and a bias of 0.
    pub fn fit(outcomes: &[Outcome]) -> Self {
        let right = outcomes.iter().filter(|o| o.is_right).count();
        if right == 0 || right == outcomes.len() {
            return Self::NONE;
        }
        let (mut slope, mut bias) = (1.0, 0.0);
        for _ in 0..STEPS {
            let (mut g, mut h) = ([PRIOR * (slope - 1.0), PRIOR * bias], [PRIOR, 0.0, PRIOR]);
            for outcome in outcomes {
                let x = logit(outcome.score);
                let p = sigmoid(slope * x + bias);
                let (off, weight) = (p - f64::from(u8::from(outcome.is_right)), (p * (1.0 - p)).max(1e-9));
                g = [g[0] + off * x, g[1] + off];
                h = [h[0] + weight * x * x, h[1] + weight * x, h[2] + weight];
            }
            let determinant = h[0] * h[2] - h[1] * h[1];
            let step = [(h[2] * g[0] - h[1] * g[1]) / determinant, (h[0] * g[1] - h[1] * g[0]) / determinant];
            if !step.iter().all(|v| v.is_finite()) {
                return Self::NONE;
            }
            // Far from the best point a whole step may lead beyond it.
            let shorter = 2.0 / step[0].abs().max(step[1].abs()).max(2.0);
            (slope, bias) = (slope - shorter * step[0], bias - shorter * step[1]);
            if step[0].abs().max(step[1].abs()) < 1e-10 {
                break;
            }
        }
        // A score that says the opposite of what is right has no temperature.
        if slope > 1e-3 { Self { temperature: 1.0 / slope, bias } } else { Self::NONE }
    }
}

/// The minimum score at which the share of correct finds is at least `precision`; 1 if there is none.
pub fn limit_for(outcomes: &[Outcome], precision: f64) -> f64 {
    let mut sorted = outcomes.to_vec();
    sorted.sort_by(|a, b| b.score.total_cmp(&a.score));
    let (mut right, mut limit) = (0usize, 1.0);
    for (index, outcome) in sorted.iter().enumerate() {
        right += usize::from(outcome.is_right);
        // Finds of one score are above the limit together.
        let is_last = sorted.get(index + 1).is_none_or(|next| next.score < outcome.score);
        if is_last && right as f64 >= precision * (index + 1) as f64 {
            limit = outcome.score;
        }
    }
    limit
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_base::random::{SplitMix64, unit};

    fn drawn(curve: Curve, count: usize, seed: u64) -> Vec<Outcome> {
        let mut random = SplitMix64(seed);
        let mut next = || unit(random.bits());
        (0..count)
            .map(|_| {
                let score = 0.02 + 0.96 * next();
                Outcome { score, is_right: next() < curve.probability(score) }
            })
            .collect()
    }

    #[test]
    fn errors_are_those_counted_by_hand() {
        let outcome = |score, is_right| Outcome { score, is_right };
        // Two bins: 0.9 with half of two right, 0.2 with none of two right.
        let list = [outcome(0.92, true), outcome(0.98, false), outcome(0.21, false), outcome(0.29, false)];
        let bins = bins(list.into_iter());
        assert_eq!((bins[9].count, bins[2].count), (2, 2));
        assert!((bins[9].score - 0.95).abs() < 1e-12 && (bins[9].right - 0.5).abs() < 1e-12);
        assert!((expected_error(list.into_iter()) - (2.0 * 0.45 + 2.0 * 0.25) / 4.0).abs() < 1e-12);
        assert!(expected_error(std::iter::empty()).is_nan());
        assert_eq!(super::bins(std::iter::once(outcome(1.0, true)))[9].count, 1);
    }

    #[test]
    fn a_curve_is_found_again_and_takes_the_error_away() {
        for (temperature, bias, seed) in [(2.0, -0.6, 1), (0.7, 0.4, 2), (1.0, 0.0, 3), (3.5, -2.0, 4)] {
            let truth = Curve { temperature, bias };
            let list = drawn(truth, 20_000, seed);
            let fitted = Curve::fit(&list);
            assert!((fitted.temperature / temperature - 1.0).abs() < 0.06, "{fitted:?} instead of {truth:?}");
            assert!((fitted.bias - bias).abs() < 0.08, "{fitted:?} instead of {truth:?}");
            let after = expected_error(list.iter().map(|o| fitted.of(*o)));
            assert!(after < 0.02, "{truth:?}: {after}");
            if truth != Curve::NONE {
                let before = expected_error(list.iter().copied());
                assert!(before > 3.0 * after, "{truth:?}: {before} to {after}");
            }
        }
    }

    #[test]
    fn finds_that_tell_nothing_change_nothing() {
        assert_eq!(Curve::fit(&[]), Curve::NONE);
        let all = |is_right| vec![Outcome { score: 0.7, is_right }; 9];
        assert_eq!((Curve::fit(&all(true)), Curve::fit(&all(false))), (Curve::NONE, Curve::NONE));
        let mut opposite = vec![Outcome { score: 0.9, is_right: false }; 50];
        opposite.extend(vec![Outcome { score: 0.1, is_right: true }; 50]);
        assert_eq!(Curve::fit(&opposite), Curve::NONE);
    }

    #[test]
    fn a_limit_holds_its_precision() {
        let outcome = |score, is_right| Outcome { score, is_right };
        let list =
            [outcome(0.9, true), outcome(0.8, false), outcome(0.7, true), outcome(0.6, true), outcome(0.5, false)];
        assert_eq!(limit_for(&list, 0.75), 0.6, "three of four");
        assert_eq!(limit_for(&list, 0.9), 0.9);
        assert_eq!(limit_for(&list, 0.6), 0.5);
        assert_eq!(limit_for(&[outcome(0.9, false)], 0.5), 1.0);
        // Of two finds with one score both count.
        assert_eq!(limit_for(&[outcome(0.9, true), outcome(0.9, false)], 0.9), 1.0);
    }
}
