//! The rendered pair for evaluations and timings of depth: text of its source and rectification.

/// First part of a graph: nodes `scope`, a phantom with `params`, and `rectify`. `plugins` are those of further nodes.
pub fn rectified_phantom(mode: &str, plugins: &[&str], params: &str) -> String {
    rectified(mode, plugins, &format!("type = \"phantom\"\nparams = {{ {params} }}\n"))
}

/// As [`rectified_phantom`], with another source of pairs and their calibration.
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
