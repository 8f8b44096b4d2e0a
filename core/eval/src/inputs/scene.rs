//! Source, rectification and depth of pairs as graph text.

use super::quoted;
use crate::embedded;

fn head(mode: &str, plugins: &[&str], source: &str) -> String {
    let plugins: String = plugins.iter().map(|name| format!(", \"{name}\"")).collect();
    format!("mode = \"{mode}\"\nplugins = [\"phantom\", \"capture\", \"stereo\"{plugins}]\n[nodes.scope]\n{source}\n")
}

/// Inputs of a node that takes pairs of node `scope`.
const PAIR: &str = r#"inputs = { left = "scope.left", right = "scope.right", calibration = "scope.calibration" }"#;

/// Type and parameters of a phantom.
pub fn phantom(params: &str) -> String {
    format!("type = \"phantom\"\nparams = {{ {params} }}\n")
}

/// First part of a graph: nodes `scope`, of the type and parameters `source`, and `rectify`. `plugins` are those of further nodes.
pub fn rectified(mode: &str, plugins: &[&str], source: &str) -> String {
    head(mode, plugins, source) + "[nodes.rectify]\ntype = \"rectify\"\n" + PAIR + "\n"
}

/// First part of a graph for [`crate::run::run`]: nodes `scope` and `depth`, which is the depth preset.
pub fn depth(mode: &str, source: &str) -> String {
    let part = quoted(&embedded::path("parts/stereo_depth.toml"));
    head(mode, &[], source) + "[nodes.depth]\ngraph = " + &part + "\n" + PAIR + "\n"
}
