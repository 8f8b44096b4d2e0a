//! Parameters of nodes as parameters of Foxglove.

use std::collections::BTreeMap;

use foxglove::websocket::{AnyClient, Parameter, ParameterValue, SetParametersResponder};
use panoscope_base::secret::redact;
use panoscope_engine::Engine;
use panoscope_graph::{Catalog, Graph, ParamKind, ParamValue, ValueError};
use panoscope_host::loader::Live;

/// A request to set parameters.
pub struct Request {
    /// The client that sent it.
    pub client: AnyClient,
    /// New values.
    pub parameters: Vec<Parameter>,
    /// Receives the values in force afterwards.
    pub responder: SetParametersResponder,
}

/// The values of all parameters, by `node.param`.
pub fn all(engine: &Engine, graph: &Graph, catalog: &Catalog) -> BTreeMap<String, Parameter> {
    let mut all = BTreeMap::new();
    for node in &graph.nodes {
        let Some(values) = engine.param_values(&node.id) else { continue };
        for (param, value) in node.node_type(catalog).params.iter().zip(values) {
            let name = format!("{}.{}", node.id, param.name);
            all.insert(name.clone(), shown(name, value));
        }
    }
    all
}

fn shown(name: String, value: ParamValue) -> Parameter {
    match value {
        ParamValue::Bool(value) => Parameter { value: Some(ParameterValue::Bool(value)), ..Parameter::empty(name) },
        ParamValue::Int(value) => Parameter::integer(name, value),
        ParamValue::Float(value) => Parameter::float64(name, value),
        ParamValue::Choice { name: word, .. } => Parameter::string(name, word),
        ParamValue::Text(text) => Parameter::string(name, redact(&text)),
        ParamValue::Path(path) => Parameter::string(name, redact(&path.to_string_lossy())),
        ParamValue::Floats(values) => Parameter::float64_array(name, values),
    }
}

/// A parameter that is not set.
#[derive(Debug, thiserror::Error)]
pub enum ParameterError {
    /// No such parameter.
    #[error("there is no parameter `{name}`")]
    Unknown {
        /// Beginning of the requested name.
        name: String,
    },
    /// The parameter exists and is unchanged.
    #[error("`{name}` was not set: {why}")]
    Refused {
        /// The parameter, as `node.param`.
        name: String,
        /// Reason.
        why: Refusal,
    },
}

/// Reason why an existing parameter is not set.
#[derive(Debug, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// The preset of the graph leaves it out.
    #[error("the graph has a `[preset]`, which does not pin it")]
    NotPinned,
    /// Its node has side effects and no preset pins the parameter.
    #[error("its node has side effects; pin it in `[preset]` to allow it")]
    SideEffects,
    /// The request has no value.
    #[error("it has no value")]
    NoValue,
    /// Texts and paths are refused, because they can name any file or address.
    #[error("texts and paths, which name files, addresses and pipelines, are not set from here")]
    Text,
    /// The value is of another type.
    #[error("the value has another type")]
    Type,
    /// The value does not fit the declaration.
    #[error(transparent)]
    Value(#[from] ValueError),
    /// The value is outside of the range of its pin.
    #[error("the value is outside {low} to {high}, which `[preset]` allows")]
    Range {
        /// The lowest value.
        low: f64,
        /// The highest value.
        high: f64,
    },
    /// The running graph refuses it.
    #[error("{0}")]
    Live(String),
}

/// Converts a value for the graph file and for the engine, or returns why it does not fit this parameter.
fn value_of(kind: &ParamKind, value: &ParameterValue) -> Result<(toml::Value, ParamValue), Refusal> {
    let whole = |value: &ParameterValue| match value {
        ParameterValue::Integer(number) => Some(*number),
        // JSON of JavaScript does not tell them apart. The cast is exact for these.
        ParameterValue::Float64(number) if number.fract() == 0.0 && number.abs() <= 2f64.powi(53) => {
            Some(*number as i64)
        }
        _ => None,
    };
    let float = |value: &ParameterValue| match value {
        ParameterValue::Integer(number) => Some(*number as f64),
        ParameterValue::Float64(number) => Some(*number),
        _ => None,
    };
    let both = match (kind, value) {
        (ParamKind::Text { .. } | ParamKind::Path { .. }, _) => {
            return Err(Refusal::Text);
        }
        (ParamKind::Bool { .. }, ParameterValue::Bool(on)) => Some((toml::Value::Boolean(*on), ParamValue::Bool(*on))),
        (ParamKind::Int { .. }, value) => {
            whole(value).map(|number| (toml::Value::Integer(number), ParamValue::Int(number)))
        }
        (ParamKind::Float { .. }, value) => {
            float(value).map(|number| (toml::Value::Float(number), ParamValue::Float(number)))
        }
        (ParamKind::Choice { choices, .. }, ParameterValue::String(word)) => {
            // A word that is none of them is refused below, in the runtime's words.
            let index = choices.iter().position(|choice| choice == word).unwrap_or(usize::MAX);
            Some((toml::Value::String(word.clone()), ParamValue::Choice { index, name: word.clone() }))
        }
        (ParamKind::Floats { .. }, ParameterValue::Array(values)) => {
            let numbers: Option<Vec<f64>> = values.iter().map(float).collect();
            numbers.map(|numbers| {
                let array = numbers.iter().map(|number| toml::Value::Float(*number)).collect();
                (toml::Value::Array(array), ParamValue::Floats(numbers))
            })
        }
        _ => None,
    };
    let (text, value) = both.ok_or(Refusal::Type)?;
    kind.accepts(&value)?;
    Ok((text, value))
}

/// Whether a number is within the range of a pin.
fn is_within(value: &ParamValue, range: Option<(f64, f64)>) -> Result<(), Refusal> {
    let Some((low, high)) = range else { return Ok(()) };
    let number = match value {
        ParamValue::Int(number) => *number as f64,
        ParamValue::Float(number) => *number,
        _ => return Ok(()),
    };
    if (low..=high).contains(&number) { Ok(()) } else { Err(Refusal::Range { low, high }) }
}

/// Sets one parameter. `Ok(false)` if it already has this value.
///
/// # Errors
/// There is no such parameter, or it is refused.
pub fn set(live: &mut Live, graph: &Graph, catalog: &Catalog, parameter: &Parameter) -> Result<bool, ParameterError> {
    let name = &parameter.name;
    let unknown = || ParameterError::Unknown { name: name.chars().take(200).collect() };
    let refused = |why: Refusal| ParameterError::Refused { name: name.clone(), why };
    let (id, param) = name.rsplit_once('.').ok_or_else(unknown)?;
    let index = graph.node(id).ok_or_else(unknown)?;
    let node_type = graph.nodes[index].node_type(catalog);
    let position = node_type.param(param).ok_or_else(unknown)?;
    let pin = graph.preset.pinned.iter().find(|pin| (pin.node, pin.param) == (index, position));
    if pin.is_none() && !graph.preset.pinned.is_empty() {
        return Err(refused(Refusal::NotPinned));
    }
    if pin.is_none() && node_type.side_effects {
        return Err(refused(Refusal::SideEffects));
    }
    let value = parameter.value.as_ref().ok_or_else(|| refused(Refusal::NoValue))?;
    let (text, value) = value_of(&node_type.params[position].kind, value).map_err(refused)?;
    is_within(&value, pin.and_then(|pin| pin.range)).map_err(refused)?;
    if live.engine().param_values(id).is_some_and(|values| values.get(position) == Some(&value)) {
        return Ok(false);
    }
    live.set_param(id, param, &text).map(|_| true).map_err(|error| refused(Refusal::Live(error.to_string())))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_javascript_are_whole_or_not() {
        let int = ParamKind::Int { default: 1, min: Some(0), max: Some(9), step: None };
        assert_eq!(value_of(&int, &ParameterValue::Float64(3.0)).unwrap().1, ParamValue::Int(3));
        for (value, words) in [
            (ParameterValue::Float64(3.5), "another type"),
            (ParameterValue::Float64(f64::NAN), "another type"),
            (ParameterValue::Integer(10), "outside 0 to 9"),
            (ParameterValue::String("3".to_owned()), "another type"),
        ] {
            let error = value_of(&int, &value).unwrap_err().to_string();
            assert!(error.contains(words), "{error}");
        }
        let float = ParamKind::Float { default: 1.0, min: Some(0.0), max: None, step: None };
        assert_eq!(value_of(&float, &ParameterValue::Integer(3)).unwrap().1, ParamValue::Float(3.0));
        assert!(
            value_of(&float, &ParameterValue::Float64(f64::INFINITY)).unwrap_err().to_string().contains("not finite")
        );
    }

    #[test]
    fn paths_and_texts_are_never_set() {
        let path = ParamKind::Path { default: String::new(), must_exist: false };
        let text = ParamKind::Text { default: String::new() };
        for kind in [path, text] {
            let error = value_of(&kind, &ParameterValue::String("/etc/passwd".to_owned())).unwrap_err().to_string();
            assert!(error.contains("are not set from here"), "{error}");
        }
    }

    #[test]
    fn passwords_are_not_shown() {
        let text = ParamValue::Text("rtsp://u:geheim@10.0.0.2/left".to_owned());
        let shown = shown("scope.left".to_owned(), text);
        assert_eq!(shown.value, Some(ParameterValue::String("rtsp://***@10.0.0.2/left".to_owned())));
    }

    #[test]
    fn pins_narrow_ranges() {
        assert!(is_within(&ParamValue::Int(5), Some((0.0, 4.0))).unwrap_err().to_string().contains("0 to 4"));
        assert_eq!(is_within(&ParamValue::Float(4.0), Some((0.0, 4.0))), Ok(()));
        assert_eq!(is_within(&ParamValue::Bool(true), Some((0.0, 4.0))), Ok(()));
    }
}
