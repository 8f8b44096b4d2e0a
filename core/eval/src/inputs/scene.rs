//! The rendered pair on which depth is judged and timed: text of its source and its rectification, said once.

/// Head of a graph: nodes `scope`, a phantom with `params`, and `rectify`. More plugins than those two nodes need may be named.
pub fn rectified_phantom(mode: &str, plugins: &[&str], params: &str) -> String {
    rectified(mode, plugins, &format!("type = \"phantom\"\nparams = {{ {params} }}\n"))
}

/// The same with any source of pairs and their calibration in place of the phantom.
pub fn rectified(mode: &str, plugins: &[&str], source: &str) -> String {
    let plugins: String = plugins.iter().map(|name| format!(", \"{name}\"")).collect();
    format!(
        r#"
mode = "{mode}"
plugins = ["phantom", "capture", "stereo"{plugins}]
[nodes.scope]
{source}
[nodes.rectify]
type = "rectify"
inputs = {{ left = "scope.left", right = "scope.right", calibration = "scope.calibration" }}
"#
    )
}
