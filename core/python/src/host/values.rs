//! Values of parameters as JSON text, which Python's own module reads and writes.

use panoscope_graph::ParamValue;
use serde_json::{Value, json};

/// A value for the text of a graph; the words of the error name what TOML does not have.
pub fn to_toml(text: &str) -> Result<toml::Value, String> {
    let value: Value = serde_json::from_str(text).map_err(|error| error.to_string())?;
    toml::Value::try_from(value).map_err(|error| error.to_string())
}

/// A value of a running node.
pub fn to_json(value: &ParamValue) -> String {
    let value = match value {
        ParamValue::Bool(value) => json!(value),
        ParamValue::Int(value) => json!(value),
        ParamValue::Float(value) => json!(value),
        ParamValue::Choice { name, .. } => json!(name),
        ParamValue::Text(text) => json!(text),
        ParamValue::Path(path) => json!(path),
        ParamValue::Floats(values) => json!(values),
    };
    value.to_string()
}
