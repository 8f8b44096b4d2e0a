//! Whether a value may be given to a parameter while the graph runs.

use crate::catalog::ParamKind;
use crate::checked::ParamValue;

impl ParamKind {
    /// Checks type and limits of a value that does not come from a file; the error says what is expected.
    pub fn accepts(&self, value: &ParamValue) -> Result<(), String> {
        let outside = |low: Option<String>, high: Option<String>| match (low, high) {
            (Some(low), Some(high)) => Err(format!("the value lies outside {low} to {high}")),
            (Some(low), None) => Err(format!("the value lies below {low}")),
            (None, Some(high)) => Err(format!("the value lies above {high}")),
            (None, None) => Err("the value is not finite".to_owned()),
        };
        match (self, value) {
            (Self::Bool { .. }, ParamValue::Bool(_)) => Ok(()),
            (Self::Int { min, max, step, .. }, ParamValue::Int(number)) => {
                if min.is_some_and(|m| *number < m) || max.is_some_and(|m| *number > m) {
                    return outside(min.map(|m| m.to_string()), max.map(|m| m.to_string()));
                }
                match step.filter(|s| *s > 1) {
                    Some(step) if (number - min.unwrap_or(0)) % step != 0 => {
                        Err(format!("the value is no multiple of {step} from {}", min.unwrap_or(0)))
                    }
                    _ => Ok(()),
                }
            }
            (Self::Float { min, max, .. }, ParamValue::Float(number)) => {
                let fits = number.is_finite() && min.is_none_or(|m| *number >= m) && max.is_none_or(|m| *number <= m);
                if fits { Ok(()) } else { outside(min.map(|m| m.to_string()), max.map(|m| m.to_string())) }
            }
            (Self::Choice { choices, .. }, ParamValue::Choice { index, name }) => {
                if choices.get(*index) == Some(name) {
                    Ok(())
                } else {
                    Err(format!("`{name}` is none of: {}", choices.join(", ")))
                }
            }
            (Self::Text { .. }, ParamValue::Text(_)) | (Self::Path { must_exist: false, .. }, ParamValue::Path(_)) => {
                Ok(())
            }
            (Self::Path { must_exist: true, .. }, ParamValue::Path(path)) => {
                if path.as_os_str().is_empty() || path.exists() {
                    Ok(())
                } else {
                    Err(format!("{} does not exist", path.display()))
                }
            }
            (Self::Floats { min_len, max_len, .. }, ParamValue::Floats(numbers)) => {
                if numbers.len() < *min_len || max_len.is_some_and(|m| numbers.len() > m) {
                    return outside(Some(format!("{min_len} numbers")), max_len.map(|m| format!("{m} numbers")));
                }
                if numbers.iter().all(|n| n.is_finite()) { Ok(()) } else { outside(None, None) }
            }
            _ => Err(format!("{} is expected", self.expected())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_types_and_steps_are_kept() {
        let int = ParamKind::Int { default: 64, min: Some(16), max: Some(256), step: Some(16) };
        assert!(int.accepts(&ParamValue::Int(32)).is_ok());
        assert_eq!(int.accepts(&ParamValue::Int(33)), Err("the value is no multiple of 16 from 16".into()));
        assert_eq!(int.accepts(&ParamValue::Int(8)), Err("the value lies outside 16 to 256".into()));
        assert_eq!(int.accepts(&ParamValue::Bool(true)), Err("a whole number is expected".into()));
        let float = ParamKind::Float { default: 0.0, min: None, max: None, step: None };
        assert!(float.accepts(&ParamValue::Float(f64::NAN)).is_err());
    }
}
