//! Axes of a study: parameters and node types with their values.

use panoscope_base::random::SplitMix64;
use panoscope_graph::{ParamKind, ParamValue};

use super::error::SweepError;
use super::values::{self, shown};

/// Name of a node's type in an axis, such as `match.type`.
pub(super) const TYPE: &str = "type";

/// Requested values of an axis.
#[derive(Clone, Debug, PartialEq)]
pub enum AxisValues {
    /// From one end to the other; default: the ends of the parameter's range. Switches and choices take all their
    /// values.
    Range {
        /// First value.
        from: Option<f64>,
        /// Last value.
        to: Option<f64>,
        /// Number of values of a grid; default: that of the study.
        steps: Option<usize>,
    },
    /// These values, as in a graph file.
    List(Vec<String>),
}

/// A parameter or type that a study varies.
#[derive(Clone, Debug, PartialEq)]
pub struct AxisRequest {
    /// `node.param`, or `node.type`.
    pub param: String,
    /// Its requested values.
    pub values: AxisValues,
}

impl AxisRequest {
    /// Reads `node.param`, `node.param=1..9`, `node.param=1..9/5` (five values) or `node.param=a,b,c`.
    ///
    /// # Errors
    /// The text is none of them.
    pub fn parse(text: &str) -> Result<Self, SweepError> {
        let bad = |reason: &str| SweepError::Param { param: text.to_owned(), reason: reason.to_owned() };
        let Some((param, values)) = text.split_once('=') else {
            let values = AxisValues::Range { from: None, to: None, steps: None };
            return Ok(Self { param: text.trim().to_owned(), values });
        };
        let (param, values) = (param.trim().to_owned(), values.trim());
        let Some((from, rest)) = values.split_once("..") else {
            let list: Vec<String> = values.split(',').map(|value| value.trim().to_owned()).collect();
            if list.iter().any(String::is_empty) {
                return Err(bad("a value is empty: write FROM..TO, FROM..TO/STEPS or VALUE,VALUE,..."));
            }
            return Ok(Self { param, values: AxisValues::List(list) });
        };
        let (to, steps) = match rest.split_once('/') {
            Some((to, steps)) => {
                (to, Some(steps.trim().parse().map_err(|_| bad("the number of steps must be a whole number"))?))
            }
            None => (rest, None),
        };
        let end = |text: &str| match text.trim() {
            "" => Ok(None),
            text => text.parse().map(Some).map_err(|_| bad("both ends of a range must be numbers")),
        };
        Ok(Self { param, values: AxisValues::Range { from: end(from)?, to: end(to)?, steps } })
    }
}

/// A value as in a graph file, and as a number; for words their position.
pub type AxisValue = (String, f64);

/// An axis checked against the declaration of its parameter.
#[derive(Clone, Debug)]
pub struct Axis {
    /// `node.param`, or `node.type`.
    pub param: String,
    /// Unit of the parameter; empty for none.
    pub unit: String,
    /// Whether the values are words; their numbers are then positions.
    pub has_words: bool,
    /// Values of a grid; in a random study without `range`, the values to draw from.
    pub values: Vec<AxisValue>,
    /// Ends of a continuous range.
    pub(super) range: Option<(f64, f64)>,
    /// Whether it varies the type of a node.
    pub(super) is_type: bool,
}

impl Axis {
    /// An axis of words, in the given order.
    pub(super) fn of_list(param: &str, unit: &str, list: &[String]) -> Self {
        let numbers: Option<Vec<f64>> = list.iter().map(|v| v.parse().ok().filter(|v: &f64| v.is_finite())).collect();
        let at = |index: usize| numbers.as_ref().map_or(index as f64, |numbers| numbers[index]);
        let values = list.iter().enumerate().map(|(index, value)| (value.clone(), at(index))).collect();
        Self {
            param: param.to_owned(),
            unit: unit.to_owned(),
            has_words: numbers.is_none(),
            values,
            range: None,
            is_type: false,
        }
    }

    /// The axis of a range of a parameter. With `is_random` it has all allowed values, or both ends.
    pub(super) fn of_range(
        request: &AxisRequest,
        kind: &ParamKind,
        unit: &str,
        steps: usize,
        is_random: bool,
    ) -> Result<Self, SweepError> {
        let bad = |reason: String| SweepError::Param { param: request.param.clone(), reason };
        let AxisValues::Range { from, to, steps: own } = request.values else {
            return Err(bad("no range is given".to_owned()));
        };
        let steps = match (is_random, kind) {
            (true, ParamKind::Int { .. }) => super::MAX_STEPS,
            (true, _) => 2,
            (false, _) => own.unwrap_or(steps),
        };
        let found = values::of(kind, from, to, steps).map_err(|error| bad(error.to_string()))?;
        let has_words = matches!(kind, ParamKind::Bool { .. } | ParamKind::Choice { .. });
        let range = match (&found[..], is_random) {
            ([(ParamValue::Float(_), from), .., (_, to)], true) => Some((*from, *to)),
            _ => None,
        };
        let values = found.iter().map(|(value, at)| (shown(value), *at)).collect();
        Ok(Self { param: request.param.clone(), unit: unit.to_owned(), has_words, values, range, is_type: false })
    }

    /// A value at random.
    pub(super) fn draw(&self, random: &mut SplitMix64) -> AxisValue {
        match self.range {
            Some((from, to)) => {
                let part = (random.bits() >> 11) as f64 / (1u64 << 53) as f64;
                self.number(from + (to - from) * part)
            }
            None => self.values[random.below(self.values.len())].clone(),
        }
    }

    /// A number of the range, rounded to a short decimal number.
    pub(super) fn number(&self, value: f64) -> AxisValue {
        let (from, to) = self.range.unwrap_or((value, value + 1.0));
        let digits = 10f64.powi(5 - (to - from).abs().log10().floor() as i32);
        let value = ((value * digits).round() / digits).clamp(from.min(to), from.max(to));
        (format!("{value:?}"), value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_lists_and_bare_names_are_read() {
        let range = |from, to, steps| AxisValues::Range { from, to, steps };
        let values = |text: &str| AxisRequest::parse(text).map(|axis| axis.values);
        assert_eq!(values("a.b").unwrap(), range(None, None, None));
        assert_eq!(values("a.b=-1.5..9").unwrap(), range(Some(-1.5), Some(9.0), None));
        assert_eq!(values("a.b=3..15/4").unwrap(), range(Some(3.0), Some(15.0), Some(4)));
        assert_eq!(values("a.b=..9").unwrap(), range(None, Some(9.0), None));
        let list = vec!["stereo_bm".to_owned(), "stereo_sgbm".to_owned()];
        assert_eq!(values("a.type=stereo_bm, stereo_sgbm").unwrap(), AxisValues::List(list));
        for wrong in ["a.b=x..9", "a.b=1..9/x", "a.b=1,,2", "a.b="] {
            assert!(AxisRequest::parse(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn random_values_stay_in_their_range_and_on_their_steps() {
        let float = ParamKind::Float { default: 0.0, min: Some(0.0), max: Some(8.0), step: None };
        let int = ParamKind::Int { default: 16, min: Some(16), max: Some(256), step: Some(16) };
        let axis = |text: &str, kind: &ParamKind| {
            Axis::of_range(&AxisRequest::parse(text).unwrap(), kind, "px", 9, true).unwrap()
        };
        let (gain, search) = (axis("a.b=1..3", &float), axis("a.c", &int));
        let mut random = SplitMix64(7);
        for _ in 0..200 {
            let (text, value) = gain.draw(&mut random);
            assert!((1.0..=3.0).contains(&value) && text.parse() == Ok(value), "{text}");
            let (_, value) = search.draw(&mut random);
            assert!((16.0..=256.0).contains(&value) && value % 16.0 == 0.0, "{value}");
        }
    }
}
