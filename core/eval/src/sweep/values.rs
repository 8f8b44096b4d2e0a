//! The values of a sweep.

use panoscope_graph::{ParamKind, ParamValue};

use super::error::{MAX_STEPS, ValuesError};

/// A value as in a graph file.
pub fn shown(value: &ParamValue) -> String {
    match value {
        ParamValue::Bool(on) => on.to_string(),
        ParamValue::Int(number) => number.to_string(),
        // `{:?}` keeps the point that makes it a float, and the shortest digits that mean the same number.
        ParamValue::Float(number) => format!("{number:?}"),
        ParamValue::Choice { name, .. } | ParamValue::Text(name) => name.clone(),
        ParamValue::Path(path) => path.display().to_string(),
        ParamValue::Floats(list) => format!("{list:?}"),
    }
}

/// The values from one end to the other, each with its number; for switches and choices all values with their
/// positions.
pub(super) fn of(
    kind: &ParamKind,
    from: Option<f64>,
    to: Option<f64>,
    steps: usize,
) -> Result<Vec<(ParamValue, f64)>, ValuesError> {
    let unbounded = || ValuesError::Unbounded;
    match kind {
        ParamKind::Bool { .. } => Ok(vec![(ParamValue::Bool(false), 0.0), (ParamValue::Bool(true), 1.0)]),
        ParamKind::Choice { choices, .. } => {
            let choice =
                |(index, name): (usize, &String)| (ParamValue::Choice { index, name: name.clone() }, index as f64);
            Ok(choices.iter().enumerate().map(choice).collect())
        }
        ParamKind::Int { min, max, step, .. } => {
            let from = from.or(min.map(|m| m as f64)).ok_or_else(unbounded)?;
            let to = to.or(max.map(|m| m as f64)).ok_or_else(unbounded)?;
            let (base, step) = (min.unwrap_or(0) as f64, step.unwrap_or(1).max(1) as f64);
            // Never beyond what was asked for.
            let (low, high) = ((from.min(to) - base) / step, (from.max(to) - base) / step);
            let (low, high) = (low.ceil(), high.floor());
            if low > high {
                return Err(ValuesError::NoneAllowed { from, to, step });
            }
            let mut values: Vec<(ParamValue, f64)> = Vec::new();
            for number in spread(from, to, steps)? {
                // The nearest value that is allowed; neighbours that become one are taken once.
                let number = base + ((number - base) / step).round().clamp(low, high) * step;
                if values.last().is_none_or(|(_, last)| *last != number) {
                    values.push((ParamValue::Int(number as i64), number));
                }
            }
            accepted(kind, values)
        }
        ParamKind::Float { min, max, .. } => {
            let (from, to) = (from.or(*min).ok_or_else(unbounded)?, to.or(*max).ok_or_else(unbounded)?);
            let values = spread(from, to, steps)?;
            accepted(kind, values.into_iter().map(|v| (ParamValue::Float(v), v)).collect())
        }
        ParamKind::Text { .. } | ParamKind::Path { .. } | ParamKind::Floats { .. } => {
            Err(ValuesError::Kind { kind: kind.expected().to_string() })
        }
    }
}

fn spread(from: f64, to: f64, steps: usize) -> Result<Vec<f64>, ValuesError> {
    if !(from.is_finite() && to.is_finite()) {
        return Err(ValuesError::NotFinite);
    }
    if !(2..=MAX_STEPS).contains(&steps) {
        return Err(ValuesError::Steps { steps });
    }
    if from == to {
        return Err(ValuesError::Empty { end: from });
    }
    let part = |k: usize| k as f64 / (steps - 1) as f64;
    // Rounded to digits that a person would write.
    let digits = 10f64.powi(5 - (to - from).abs().log10().floor() as i32);
    let at = |k: usize| match k {
        0 => from,
        _ if k + 1 == steps => to,
        _ => ((from + (to - from) * part(k)) * digits).round() / digits,
    };
    Ok((0..steps).map(at).collect())
}

fn accepted(kind: &ParamKind, values: Vec<(ParamValue, f64)>) -> Result<Vec<(ParamValue, f64)>, ValuesError> {
    for (value, _) in &values {
        let refused = |reason: String| ValuesError::Refused { value: shown(value), reason };
        kind.accepts(value).map_err(|reason| refused(reason.to_string()))?;
    }
    Ok(values)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(kind: &ParamKind, from: f64, to: f64, steps: usize) -> Vec<String> {
        let values = of(kind, Some(from), Some(to), steps).expect("values");
        values.iter().map(|(value, _)| shown(value)).collect()
    }

    #[test]
    fn values_stand_on_the_steps_of_the_declaration() {
        let int = ParamKind::Int { default: 5, min: Some(5), max: Some(25), step: Some(2) };
        assert_eq!(words(&int, 5.0, 25.0, 5), ["5", "11", "15", "21", "25"]);
        assert_eq!(words(&int, 5.0, 9.0, 9), ["5", "7", "9"], "values that become one are taken once");
        assert_eq!(words(&int, 6.0, 24.0, 4), ["7", "13", "19", "23"], "no value lies beyond what was asked for");
        assert_eq!(words(&int, 24.0, 6.0, 2), ["23", "7"], "backwards, too");
        assert!(of(&int, Some(6.0), Some(6.5), 2).is_err_and(|why| why.to_string().contains("the step is 2")));
        assert_eq!(of(&int, None, None, 3).map(|v| v.len()), Ok(3));
        assert!(of(&int, Some(1.0), Some(9.0), 3).is_err_and(|why| why.to_string().contains("outside 5 to 25")));
        assert!(of(&int, Some(5.0), Some(9.0), 1).is_err());
    }

    #[test]
    fn floats_keep_their_point_and_choices_are_all_taken() {
        let float = ParamKind::Float { default: 0.0, min: Some(0.0), max: None, step: None };
        assert_eq!(words(&float, 0.0, 1.0, 4), ["0.0", "0.33333", "0.66667", "1.0"]);
        assert_eq!(words(&float, 1.0, 0.0, 2), ["1.0", "0.0"], "backwards, too");
        assert!(of(&float, None, None, 4).is_err_and(|why| why.to_string().contains("no limits")));
        let choice = ParamKind::Choice { default: "b".to_owned(), choices: vec!["a".to_owned(), "b".to_owned()] };
        assert_eq!(of(&choice, None, None, 9).map(|v| v.len()), Ok(2));
        assert!(of(&ParamKind::Text { default: String::new() }, None, None, 2).is_err());
    }
}
