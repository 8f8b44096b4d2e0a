//! Warnings of `proximity` beside the phantom's exact distances: none missed, none false.

use panoscope_tests::{run, scratch};

/// The last line of a table: names and numbers.
fn last(path: &std::path::Path) -> std::collections::HashMap<String, f64> {
    let text = std::fs::read_to_string(path).expect("the judge's counts");
    let mut lines = text.lines();
    let names = lines.next().expect("names").split(',').map(str::to_owned);
    let cells = lines.next_back().expect("counts").split(',').map(|cell| cell.parse().unwrap_or(f64::NAN));
    names.zip(cells).collect()
}

fn judged(name: &str, middle: &str, depth: &str) -> std::collections::HashMap<String, f64> {
    let folder = scratch(&format!("proximity-{name}"));
    let text = format!(
        r#"
mode = "batch"
plugins = ["phantom", "stereo", "tools", "sinks"]
[nodes.scope]
type = "phantom"
params = {{ scene = "bowel", seed = 7, distance_mm = 60.0, width = 480, height = 360, tools = 2, tool_kinds = "grasper, hook", tool_motion = "strokes", speed_mm_s = 2.0 }}
{middle}
[nodes.near]
type = "proximity"
inputs = {{ tip = ["scope.lead", "scope.second"], depth = "{depth}", instances = "scope.instances", calibration = "scope.calibration" }}
[nodes.judge]
type = "evaluate_proximity"
inputs = {{ table = "near.table", truth = "scope.clearance" }}
[nodes.out]
type = "write_table"
inputs = {{ table = "judge.table" }}
params = {{ path = "{}" }}
"#,
        folder.join("counts.csv").display()
    );
    let ran = run(&folder.join("graph.toml"), &text, 300, 0);
    assert!(ran.log.is_empty(), "{:?}", ran.log);
    let counts = last(&folder.join("counts.csv"));
    std::fs::remove_dir_all(folder).expect("the folder goes");
    counts
}

#[test]
fn no_warning_is_missed_or_false_beyond_a_millimetre_with_true_depth() {
    let counts = judged("truth", "", "scope.depth");
    assert!(counts["tissue_approaches"] >= 3.0, "the scene has approaches: {counts:?}");
    assert_eq!((counts["tissue_missed"], counts["tissue_false"]), (0.0, 0.0), "{counts:?}");
    assert!(counts["tissue_rms_mm"] < 1.0, "{counts:?}");
    assert_eq!((counts["tips_missed"], counts["tips_false"]), (0.0, 0.0), "{counts:?}");
}

#[test]
fn depth_that_cameras_match_warns_of_every_approach_too() {
    let middle = r#"
[nodes.match]
type = "stereo_bm"
inputs = { left = "scope.left", right = "scope.right" }
[nodes.points]
type = "reproject"
inputs = { image = "scope.left", disparity = "match.disparity", calibration = "scope.calibration" }
"#;
    let counts = judged("stereo", middle, "points.depth");
    assert!(counts["tissue_approaches"] >= 3.0, "the scene has approaches: {counts:?}");
    assert_eq!(counts["tissue_missed"], 0.0, "{counts:?}");
}
