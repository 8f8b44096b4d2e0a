//! Values of parameters as JSON text, which Python's own module reads and writes.

use panoscope_graph::{Catalog, Graph, ParamValue};
use serde_json::{Value, json};

/// A value or the name of a parameter that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ValueError {
    /// The text is not JSON.
    #[error("{0}")]
    Json(#[from] serde_json::Error),
    /// TOML has no such value.
    #[error("{0}")]
    Toml(#[from] toml::ser::Error),
    /// The name of the parameter has no dot.
    #[error("`{param}` is not NODE.PARAM")]
    Name {
        /// The given name.
        param: String,
    },
    /// The graph has no such node.
    #[error("there is no node `{node}`; the nodes are {known}")]
    Node {
        /// The given name of the node.
        node: String,
        /// Names of all nodes.
        known: String,
    },
    /// The node has no such parameter.
    #[error("`{node}` has no parameter `{name}`; it has {known}")]
    Param {
        /// Name of the node.
        node: String,
        /// The given name of the parameter.
        name: String,
        /// Names of the node's parameters.
        known: String,
    },
}

/// A value for the text of a graph; fails for values that TOML does not have.
pub fn to_toml(text: &str) -> Result<toml::Value, ValueError> {
    let value: Value = serde_json::from_str(text)?;
    Ok(toml::Value::try_from(value)?)
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
pub fn value_of(graph: &Graph, catalog: &Catalog, param: &str) -> Result<String, ValueError> {
    let (node, name) = param.rsplit_once('.').ok_or_else(|| ValueError::Name { param: param.to_owned() })?;
    let ids = || graph.nodes.iter().map(|node| node.id.as_str()).collect::<Vec<_>>().join(", ");
    let index = graph.node(node).ok_or_else(|| ValueError::Node { node: node.to_owned(), known: ids() })?;
    let node = &graph.nodes[index];
    let node_type = node.node_type(catalog);
    let names = || node_type.params.iter().map(|param| param.name.as_str()).collect::<Vec<_>>().join(", ");
    let value = node_type.param(name).and_then(|at| node.params.get(at));
    let value =
        value.ok_or_else(|| ValueError::Param { node: node.id.clone(), name: name.to_owned(), known: names() })?;
    Ok(to_json(value))
}
