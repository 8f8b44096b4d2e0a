//! The example plugins in C and C++ run in one graph with Rust nodes.

use std::path::Path;
use std::process::Command;

use panoscope_tests::{root, run, scratch};

fn build(compiler: &str, source: &str, flags: &[&str], folder: &Path) -> bool {
    let library = folder.join(format!("lib{}.so", source.split('.').next().unwrap_or(source)));
    let output = Command::new(compiler)
        .args(["-O2", "-fPIC", "-fvisibility=hidden", "-shared"])
        .args(flags)
        .arg("-I")
        .arg(root().join("core/contract/abi"))
        .arg(root().join("tests/c").join(source))
        .arg("-o")
        .arg(library)
        .output();
    match output {
        Ok(output) => {
            assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
            true
        }
        Err(error) => {
            panoscope_testing::skipped!("{compiler} cannot be run ({error})");
            false
        }
    }
}

#[test]
fn c_and_cpp_run_beside_rust() {
    let folder = scratch("c-plugins");
    let built = build("cc", "edge_c.c", &["-std=c11"], &folder)
        && build("c++", "edge_cpp.cpp", &["-std=c++17", "-fno-gnu-unique"], &folder);
    if !built {
        return;
    }
    let graph = format!(
        r#"
mode = "batch"
plugins = ["phantom", "edge_c", "edge_cpp", "sinks"]
plugin_paths = ["{0}"]

[nodes.scope]
type = "phantom"
params = {{ width = 160, height = 120 }}

[nodes.c]
type = "edge_c"
inputs = {{ image = "scope.left" }}

[nodes.cpp]
type = "edge_cpp"
inputs = {{ image = "scope.left" }}

[nodes.c_pictures]
type = "write_images"
inputs = {{ image = "c.edges" }}
params = {{ path = "{0}/c_{{seq}}.png" }}

[nodes.cpp_pictures]
type = "write_images"
inputs = {{ image = "cpp.edges" }}
params = {{ path = "{0}/cpp_{{seq}}.png" }}
"#,
        folder.display()
    );
    let done = run(&folder.join("graph.toml"), &graph, 5, 2);
    for node in ["c", "cpp"] {
        let report = &done.report.nodes[node];
        assert_eq!((report.count, report.faults), (5, 0), "{:?}", done.log);
    }
    assert_eq!(done.report.nodes["scope"].conversions, 5, "one gray copy serves both readers");
    let pictures: Vec<_> =
        panoscope_tests::files(&folder).into_iter().filter(|(name, _)| name.ends_with(".png")).collect();
    assert_eq!(pictures.len(), 10);
    for (name, bytes) in pictures {
        let picture = image::load_from_memory(&bytes).expect(&name).to_luma8();
        assert_eq!(picture.dimensions(), (160, 120));
        let edges = picture.pixels().filter(|p| p.0[0] > 32).count();
        assert!((100..160 * 120 / 2).contains(&edges), "{name} shows {edges} edge pixels");
    }
    let _ = std::fs::remove_dir_all(&folder);
}
