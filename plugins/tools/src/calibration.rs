//! Converts a network's scores to probabilities, fitted on what the detector found in operations that its training left out.
//!
//! `panoscope eval detect --folds` fits the numbers, `export_detector.py --calibration` writes them into the model: `calibration_score` and
//! `calibration_objectness` as temperature and bias, `class_limits` as a probability per class, `class_limits_precision` as the share of correct
//! boxes above them.

use crate::candidates::Candidate;

/// The calibration in a model's metadata cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{key}` in the model's metadata is `{value}`; expected {expected}: export the model again")]
pub struct CalibrationError {
    /// Key of the metadata.
    pub key: &'static str,
    /// Value found there.
    pub value: String,
    /// Description of valid values.
    pub expected: String,
}

/// Probability `1 / (1 + exp(-(logit(score) / temperature + bias)))` of a score.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Curve {
    /// Above 1 for an overconfident network.
    pub temperature: f32,
    /// Added to the logit; below 0 for a network that detects too much.
    pub bias: f32,
}

/// Scores are clamped to this distance from 0 and 1.
const EDGE: f32 = 1e-6;

fn logit(p: f32) -> f32 {
    let p = p.clamp(EDGE, 1.0 - EDGE);
    (p / (1.0 - p)).ln()
}

fn sigmoid(v: f32) -> f32 {
    1.0 / (1.0 + (-v).exp())
}

impl Curve {
    /// The probability of a score, 0 to 1.
    pub fn probability(self, score: f32) -> f32 {
        sigmoid(logit(score) / self.temperature + self.bias)
    }

    /// The score with this probability.
    pub fn score(self, probability: f32) -> f32 {
        sigmoid((logit(probability) - self.bias) * self.temperature)
    }

    fn read(key: &'static str, value: &str) -> Result<Self, CalibrationError> {
        let wrong = || CalibrationError {
            key,
            value: value.chars().take(60).collect(),
            expected: "a temperature above 0 and a bias".into(),
        };
        match numbers(value).as_deref() {
            Some(&[temperature, bias]) if temperature > 0.0 => Ok(Self { temperature, bias }),
            _ => Err(wrong()),
        }
    }
}

/// Parses finite numbers separated by spaces; `None` if one is not a number.
pub(crate) fn numbers(text: &str) -> Option<Vec<f32>> {
    let parsed: Result<Vec<f32>, _> = text.split_whitespace().map(str::parse).collect();
    parsed.ok().filter(|all| all.iter().all(|v: &f32| v.is_finite()))
}

/// Conversion of a model's scores to probabilities.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    /// Probability that a box and its class are correct.
    pub score: Curve,
    /// Probability that a box is on an instrument of any class, from the objectness alone; `None` if it was not measured.
    pub objectness: Option<Curve>,
    /// Minimum probability of each class at which the requested share of boxes was correct; empty if there was none.
    pub limits: Vec<f32>,
}

impl Calibration {
    /// Reads the calibration of a model with `classes` classes from its metadata; `None` if it has none.
    ///
    /// # Errors
    /// Numbers are missing, not finite, or do not match the number of classes.
    pub fn read<'a>(
        classes: usize,
        metadata: impl Fn(&str) -> Option<&'a str>,
    ) -> Result<Option<Self>, CalibrationError> {
        const LIMITS: &str = "class_limits";
        let Some(score) = metadata("calibration_score") else { return Ok(None) };
        let score = Curve::read("calibration_score", score)?;
        let objectness = metadata("calibration_objectness");
        let objectness = objectness.map(|value| Curve::read("calibration_objectness", value)).transpose()?;
        let mut limits = Vec::new();
        if let Some(value) = metadata(LIMITS) {
            let all = numbers(value).filter(|all| all.len() == classes && all.iter().all(|v| (0.0..=1.0).contains(v)));
            limits = all.ok_or_else(|| CalibrationError {
                key: LIMITS,
                value: value.chars().take(60).collect(),
                expected: format!("{classes} numbers from 0 to 1"),
            })?;
        }
        Ok(Some(Self { score, objectness, limits }))
    }
}

/// Rules for what a calibrated detector reports.
#[derive(Clone, Copy, Debug)]
pub struct Rule<'a> {
    /// The model's calibration.
    pub calibration: &'a Calibration,
    /// Minimum probability that is reported.
    pub min_score: f32,
    /// Minimum probability of the class of a box, given that it is on an instrument. Below it the class is `unknown`. 0: never.
    pub unknown_below: f32,
    /// Index of the class `unknown`.
    pub unknown: u32,
    /// Applies the model's own limit of each class if it is above `min_score`.
    pub own_limits: bool,
}

impl Rule<'_> {
    /// Minimum score and minimum objectness, as the network outputs them, of a row that may be reported.
    pub fn floors(&self) -> (f32, f32) {
        let objectness = self.calibration.objectness.filter(|_| self.unknown_below > 0.0);
        (self.calibration.score.score(self.min_score), objectness.map_or(f32::INFINITY, |c| c.score(self.min_score)))
    }

    /// Converts scores to probabilities, labels boxes of uncertain class as `unknown`, and drops what is below the limits.
    ///
    /// The probability of an `unknown` box is that of being on an instrument of any class.
    pub fn apply(&self, candidates: &mut Vec<Candidate>) {
        candidates.retain_mut(|candidate| {
            let named = self.calibration.score.probability(candidate.score);
            if let Some(curve) = self.calibration.objectness.filter(|_| self.unknown_below > 0.0) {
                let any = curve.probability(candidate.objectness).max(named);
                if any >= self.min_score && named < self.unknown_below * any {
                    (candidate.class_index, candidate.score) = (self.unknown, any);
                    return true;
                }
            }
            let own = self.calibration.limits.get(candidate.class_index as usize).filter(|_| self.own_limits);
            candidate.score = named;
            named >= own.map_or(self.min_score, |own| own.max(self.min_score))
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(pairs: &[(&str, &'static str)]) -> Result<Option<Calibration>, CalibrationError> {
        Calibration::read(2, |key| pairs.iter().find(|(name, _)| *name == key).map(|(_, value)| *value))
    }

    #[test]
    fn curves_go_both_ways_and_keep_the_order() {
        let curve = Curve { temperature: 1.7, bias: -0.4 };
        let mut last = 0.0;
        for k in 1..100 {
            let score = k as f32 / 100.0;
            let p = curve.probability(score);
            assert!(p > last && (curve.score(p) - score).abs() < 1e-4, "{score} {p}");
            last = p;
        }
        // Temperature 1, bias 0: as the network says.
        assert!((Curve { temperature: 1.0, bias: 0.0 }.probability(0.3) - 0.3).abs() < 1e-6);
        assert!(curve.probability(0.0) > 0.0 && curve.probability(1.0) < 1.0);
        // By hand: logit(0.9) = 2.1972; / 2 - 0.5 = 0.5986; sigmoid = 0.6453.
        assert!((Curve { temperature: 2.0, bias: -0.5 }.probability(0.9) - 0.6453).abs() < 1e-4);
    }

    #[test]
    fn metadata_is_read_or_refused_with_its_key() {
        assert_eq!(read(&[]), Ok(None));
        let full = read(&[
            ("calibration_score", "1.5 -0.25"),
            ("calibration_objectness", "2 0"),
            ("class_limits", "0.4 0.75"),
        ]);
        let want = Calibration {
            score: Curve { temperature: 1.5, bias: -0.25 },
            objectness: Some(Curve { temperature: 2.0, bias: 0.0 }),
            limits: vec![0.4, 0.75],
        };
        assert_eq!(full, Ok(Some(want)));
        for (key, value) in [
            ("calibration_score", "1.5"),
            ("calibration_score", "0 1"),
            ("calibration_score", "nan 0"),
            ("calibration_objectness", "one two"),
            ("class_limits", "0.4"),
            ("class_limits", "0.4 1.4"),
        ] {
            let mut pairs = vec![("calibration_score", "1 0"), ("calibration_objectness", "1 0")];
            pairs.retain(|(name, _)| *name != key);
            pairs.push((key, value));
            let error = read(&pairs).expect_err(value).to_string();
            assert!(error.contains(key) && error.contains(value) && error.contains("export"), "{error}");
        }
    }

    fn candidate(score: f32, objectness: f32, class_index: u32) -> Candidate {
        Candidate { corners: [0.0, 0.0, 9.0, 9.0], score, objectness, class_index, row: 0 }
    }

    #[test]
    fn an_unsure_class_is_unknown_and_a_sure_one_keeps_its_name() {
        let plain = Curve { temperature: 1.0, bias: 0.0 };
        let calibration = Calibration { score: plain, objectness: Some(plain), limits: vec![0.0, 0.6] };
        let rule =
            Rule { calibration: &calibration, min_score: 0.3, unknown_below: 0.5, unknown: 2, own_limits: false };
        let kept = |rule: &Rule<'_>, c: Candidate| {
            let mut list = vec![c];
            rule.apply(&mut list);
            list.first().map(|c| (c.class_index, (c.score * 100.0).round()))
        };
        assert_eq!(kept(&rule, candidate(0.72, 0.9, 1)), Some((1, 72.0)), "sure");
        assert_eq!(kept(&rule, candidate(0.36, 0.9, 1)), Some((2, 90.0)), "an instrument, but which?");
        assert_eq!(kept(&rule, candidate(0.2, 0.9, 1)), Some((2, 90.0)), "below the limit by its class alone");
        assert_eq!(kept(&rule, candidate(0.2, 0.25, 1)), None, "no instrument");
        let never = Rule { unknown_below: 0.0, ..rule };
        assert_eq!(kept(&never, candidate(0.36, 0.9, 1)), Some((1, 36.0)));
        assert_eq!(kept(&never, candidate(0.2, 0.9, 1)), None);
        let own = Rule { own_limits: true, unknown_below: 0.0, ..rule };
        assert_eq!(kept(&own, candidate(0.5, 0.6, 1)), None, "below its class's own limit");
        assert_eq!(kept(&own, candidate(0.5, 0.6, 0)), Some((0, 50.0)));
        assert_eq!(never.floors().1, f32::INFINITY);
        let (score, objectness) = rule.floors();
        assert!((score - 0.3).abs() < 1e-5 && (objectness - 0.3).abs() < 1e-5);
    }
}
