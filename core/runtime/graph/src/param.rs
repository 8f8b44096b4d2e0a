//! Parameters of node types: their kinds, limits and values.

use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use thiserror::Error;

/// A parameter of a node type.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Param {
    /// Name used under `params`.
    pub name: String,
    /// Documentation.
    #[serde(default)]
    pub doc: String,
    /// Unit such as `px`, `mm`, `ms`; empty for none.
    #[serde(default)]
    pub unit: String,
    /// Type, default and limits.
    #[serde(flatten)]
    pub kind: ParamKind,
    /// A change reopens the node instead of being applied between two ticks.
    #[serde(default)]
    pub reopen: bool,
    /// Way of picking the value, besides typing.
    #[serde(default, skip_serializing_if = "Pick::is_none")]
    pub pick: Pick,
    /// The node writes the file that the path names. The path may hold placeholders such as `{seq}`.
    #[serde(default, skip_serializing_if = "is_false")]
    pub writes: bool,
    /// The default of the path is relative to [`NodeType::shipped_dir`](crate::NodeType::shipped_dir) and not to the
    /// graph file.
    #[serde(default, skip_serializing_if = "is_false")]
    pub shipped: bool,
}

fn is_false(flag: &bool) -> bool {
    !flag
}

/// Way of picking a value, besides typing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Pick {
    /// By typing only.
    #[default]
    None,
    /// Points of an image in px: u, v, u, v, ... The image is the first one that the node reads, or the first one that
    /// a source makes.
    Points,
    /// Rectangles of such an image in px: x, y, width, height, ...
    Rectangles,
    /// A file or folder, relative to the graph file.
    File,
}

impl Pick {
    /// Whether the value can only be typed.
    pub fn is_none(&self) -> bool {
        *self == Self::None
    }

    /// Numbers of one point or rectangle; 0 for the others.
    pub fn stride(self) -> usize {
        match self {
            Self::Points => 2,
            Self::Rectangles => 4,
            Self::None | Self::File => 0,
        }
    }

    /// For `describe` and the schema; empty for [`Self::None`].
    pub fn words(self) -> &'static str {
        match self {
            Self::None => "",
            Self::Points => "points of the picture: u, v, u, v, ...",
            Self::Rectangles => "rectangles of the picture: x, y, width, height, ...",
            Self::File => "may name a file",
        }
    }
}

/// Type, default and limits of a parameter. A missing limit means unbounded on that side.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
pub enum ParamKind {
    /// true or false.
    Bool {
        /// Value when the graph says nothing.
        default: bool,
    },
    /// Whole number; with a step, allowed values are `min + k * step` (`k * step` without a minimum).
    Int {
        /// Value when the graph says nothing.
        default: i64,
        /// Smallest allowed value.
        #[serde(default)]
        min: Option<i64>,
        /// Largest allowed value.
        #[serde(default)]
        max: Option<i64>,
        /// Distance between allowed values.
        #[serde(default)]
        step: Option<i64>,
    },
    /// Finite number. The step is a hint for sliders, not a constraint.
    Float {
        /// Value when the graph says nothing.
        default: f64,
        /// Smallest allowed value.
        #[serde(default)]
        min: Option<f64>,
        /// Largest allowed value.
        #[serde(default)]
        max: Option<f64>,
        /// Slider step.
        #[serde(default)]
        step: Option<f64>,
    },
    /// One of a fixed list of words.
    Choice {
        /// Value when the graph says nothing.
        default: String,
        /// Allowed words.
        choices: Vec<String>,
    },
    /// Free text.
    Text {
        /// Value when the graph says nothing.
        default: String,
    },
    /// File or folder, relative to the graph file. Empty means "not set".
    Path {
        /// Value when the graph says nothing; relative to the graph file too, unless [`Param::shipped`].
        default: String,
        /// It must exist when the graph is checked.
        #[serde(default)]
        must_exist: bool,
    },
    /// List of finite numbers, such as points or a rectangle.
    Floats {
        /// Value when the graph says nothing.
        default: Vec<f64>,
        /// Minimum number of entries.
        #[serde(default)]
        min_len: usize,
        /// Maximum number of entries; `None` for no limit.
        #[serde(default)]
        max_len: Option<usize>,
    },
}

impl ParamKind {
    /// Description of the type for messages: `a whole number`, `true or false`, ...
    pub fn expected(&self) -> &'static str {
        match self {
            Self::Bool { .. } => "true or false",
            Self::Int { .. } => "a whole number",
            Self::Float { .. } => "a number",
            Self::Choice { .. } => "one of a list of words",
            Self::Text { .. } => "a text in quotes",
            Self::Path { .. } => "a path in quotes",
            Self::Floats { .. } => "a list of numbers",
        }
    }
}

/// Value of a parameter, already of the declared type and inside its limits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ParamValue {
    /// true or false.
    Bool(bool),
    /// Whole number.
    Int(i64),
    /// Finite number.
    Float(f64),
    /// One of the declared words.
    Choice {
        /// Position in the declared list.
        index: usize,
        /// The word.
        name: String,
    },
    /// Free text.
    Text(String),
    /// Path resolved against the folder of the graph file; empty when not set.
    Path(PathBuf),
    /// List of finite numbers.
    Floats(Vec<f64>),
}

/// A value that a parameter refuses.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum ValueError {
    /// The value has another type.
    #[error("expected {expected}")]
    Type {
        /// Description of the parameter's type.
        expected: &'static str,
    },
    /// The value, or the length of a list, is outside its limits.
    #[error("the value is outside {low} to {high}")]
    Outside {
        /// Lowest allowed.
        low: String,
        /// Highest allowed.
        high: String,
    },
    /// The value is below the minimum of a parameter without a maximum.
    #[error("the value is below {low}")]
    Below {
        /// Lowest allowed.
        low: String,
    },
    /// The value is above the maximum of a parameter without a minimum.
    #[error("the value is above {high}")]
    Above {
        /// Highest allowed.
        high: String,
    },
    /// NaN or infinite.
    #[error("the value is not finite")]
    NotFinite,
    /// The value lies between two steps.
    #[error("the value is not a multiple of {step} from {base}")]
    OffStep {
        /// Distance between allowed values.
        step: i64,
        /// Origin of the steps.
        base: i64,
    },
    /// The word is not in the list.
    #[error("`{word}` is not one of: {choices}")]
    UnknownChoice {
        /// The word.
        word: String,
        /// The allowed words.
        choices: String,
    },
    /// The file or folder must exist.
    #[error("{} does not exist", .path.display())]
    Missing {
        /// The path.
        path: PathBuf,
    },
}

/// The error for a value that is outside its limits, of which at least one is known, or not finite.
fn outside(low: Option<String>, high: Option<String>) -> ValueError {
    match (low, high) {
        (Some(low), Some(high)) => ValueError::Outside { low, high },
        (Some(low), None) => ValueError::Below { low },
        (None, Some(high)) => ValueError::Above { high },
        (None, None) => ValueError::NotFinite,
    }
}

impl ParamKind {
    /// Checks type and limits of a value that does not come from a graph file.
    ///
    /// # Errors
    /// The first rule that the value breaks.
    pub fn accepts(&self, value: &ParamValue) -> Result<(), ValueError> {
        match (self, value) {
            (Self::Bool { .. }, ParamValue::Bool(_)) => Ok(()),
            (Self::Int { min, max, step, .. }, ParamValue::Int(number)) => {
                if min.is_some_and(|m| *number < m) || max.is_some_and(|m| *number > m) {
                    return Err(outside(min.map(|m| m.to_string()), max.map(|m| m.to_string())));
                }
                let base = min.unwrap_or(0);
                match step.filter(|s| *s > 1) {
                    Some(step) if (i128::from(*number) - i128::from(base)) % i128::from(step) != 0 => {
                        Err(ValueError::OffStep { step, base })
                    }
                    _ => Ok(()),
                }
            }
            (Self::Float { min, max, .. }, ParamValue::Float(number)) => {
                if !number.is_finite() {
                    return Err(ValueError::NotFinite);
                }
                let fits = min.is_none_or(|m| *number >= m) && max.is_none_or(|m| *number <= m);
                if fits { Ok(()) } else { Err(outside(min.map(|m| m.to_string()), max.map(|m| m.to_string()))) }
            }
            (Self::Choice { choices, .. }, ParamValue::Choice { index, name }) => {
                if choices.get(*index) == Some(name) {
                    Ok(())
                } else {
                    Err(ValueError::UnknownChoice { word: name.clone(), choices: choices.join(", ") })
                }
            }
            (Self::Text { .. }, ParamValue::Text(_)) | (Self::Path { must_exist: false, .. }, ParamValue::Path(_)) => {
                Ok(())
            }
            (Self::Path { must_exist: true, .. }, ParamValue::Path(path)) => {
                if path.as_os_str().is_empty() || path.exists() {
                    Ok(())
                } else {
                    Err(ValueError::Missing { path: path.clone() })
                }
            }
            (Self::Floats { min_len, max_len, .. }, ParamValue::Floats(numbers)) => {
                if numbers.len() < *min_len || max_len.is_some_and(|m| numbers.len() > m) {
                    return Err(outside(Some(format!("{min_len} numbers")), max_len.map(|m| format!("{m} numbers"))));
                }
                if numbers.iter().all(|n| n.is_finite()) { Ok(()) } else { Err(ValueError::NotFinite) }
            }
            _ => Err(ValueError::Type { expected: self.expected() }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_types_and_steps_hold() {
        let int = ParamKind::Int { default: 64, min: Some(16), max: Some(256), step: Some(16) };
        let words = |kind: &ParamKind, value: ParamValue| kind.accepts(&value).map_err(|e| e.to_string());
        assert_eq!(words(&int, ParamValue::Int(32)), Ok(()));
        assert_eq!(words(&int, ParamValue::Int(33)), Err("the value is not a multiple of 16 from 16".into()));
        assert_eq!(words(&int, ParamValue::Int(8)), Err("the value is outside 16 to 256".into()));
        assert_eq!(words(&int, ParamValue::Bool(true)), Err("expected a whole number".into()));
        let float = ParamKind::Float { default: 0.0, min: None, max: None, step: None };
        assert_eq!(float.accepts(&ParamValue::Float(f64::NAN)), Err(ValueError::NotFinite));
    }
}
