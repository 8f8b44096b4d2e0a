//! Values of parameters as JSON text, which Python's own module reads and writes.

use panoscope_graph::{Catalog, Graph, ParamValue};
use serde_json::{Value, json};

/// A value for the text of a graph; fails for values that TOML does not have.
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

/// Value of `node.param` as JSON; fails for unknown names.
pub fn value_of(graph: &Graph, catalog: &Catalog, param: &str) -> Result<String, String> {
    let (node, name) = param.rsplit_once('.').ok_or_else(|| format!("`{param}` is not NODE.PARAM"))?;
    let ids = || graph.nodes.iter().map(|node| node.id.as_str()).collect::<Vec<_>>().join(", ");
    let index = graph.node(node).ok_or_else(|| format!("there is no node `{node}`; the nodes are {}", ids()))?;
    let node = &graph.nodes[index];
    let node_type = node.node_type(catalog);
    let names = || node_type.params.iter().map(|param| param.name.as_str()).collect::<Vec<_>>().join(", ");
    let value = node_type.param(name).and_then(|at| node.params.get(at));
    let value = value.ok_or_else(|| format!("`{}` has no parameter `{name}`; it has {}", node.id, names()))?;
    Ok(to_json(value))
}
