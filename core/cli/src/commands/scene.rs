//! The rendered pair on which depth is judged and timed: text of its source and its rectification, said once.

/// Head of a graph: nodes `scope`, a phantom with `params`, and `rectify`. More plugins than those two nodes need may be named.
pub fn rectified_phantom(mode: &str, plugins: &[&str], params: &str) -> String {
    let plugins: String = plugins.iter().map(|name| format!(", \"{name}\"")).collect();
    format!(
        r#"
mode = "{mode}"
plugins = ["phantom", "stereo"{plugins}]
[nodes.scope]
type = "phantom"
params = {{ {params} }}
[nodes.rectify]
type = "rectify"
inputs = {{ left = "scope.left", right = "scope.right", calibration = "scope.calibration" }}
"#
    )
}
