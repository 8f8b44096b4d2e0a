//! In batch mode the number of threads never changes a byte.

use panoscope_tests::{files, run, scratch};

/// The demo's chain with a sink for every image.
fn chain(folder: &std::path::Path) -> String {
    let folder = folder.display();
    format!(
        r#"
mode = "batch"
plugins = ["phantom", "stitch", "sinks"]

[nodes.scope]
type = "phantom"
params = {{ scene = "bowel", seed = 7, width = 320, height = 240 }}

[nodes.register]
type = "register_surf"
inputs = {{ left = "scope.left", right = "scope.right" }}

[nodes.wide]
type = "composite"
inputs = {{ left = "scope.left", right = "scope.right", homography = "register.homography" }}

[nodes.pictures]
type = "write_raw"
inputs = {{ image = "wide.panorama" }}
params = {{ path = "{folder}/wide_{{seq}}.raw" }}

[nodes.maps]
type = "write_table"
inputs = {{ homography = "register.homography", roi = "register.roi_left" }}
params = {{ path = "{folder}/maps.jsonl" }}
"#
    )
}

#[test]
fn one_two_and_eight_threads_give_the_same_bytes() {
    let mut first: Option<Vec<(String, Vec<u8>)>> = None;
    for threads in [1, 2, 8] {
        let folder = scratch(&format!("determinism-{threads}"));
        let done = run(&folder.join("graph.toml"), &chain(&folder), 20, threads);
        assert_eq!(done.report.frames, 20);
        assert!(done.report.nodes.values().all(|n| n.faults == 0 && n.dropped == 0), "{:?}", done.log);
        let made = files(&folder);
        assert_eq!(made.len(), 21, "20 pictures and a table: {:?}", made.iter().map(|m| &m.0).collect::<Vec<_>>());
        match &first {
            None => first = Some(made),
            Some(first) => {
                for (a, b) in first.iter().zip(&made) {
                    assert_eq!(a.0, b.0);
                    assert!(a.1 == b.1, "{} differs between 1 and {threads} threads", a.0);
                }
            }
        }
        let _ = std::fs::remove_dir_all(&folder);
    }
}
