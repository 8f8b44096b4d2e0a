//! Warnings of `proximity` compared with the phantom's exact distances, with exact depth and with matched depth.

use std::collections::HashMap;
use std::path::Path;

use panoscope_tests::{run, scratch};

/// The last two rows of a table, by name: exact counts, and counts with the margin.
fn counts(path: &Path) -> [HashMap<String, f64>; 2] {
    let text = std::fs::read_to_string(path).expect("the judge's counts");
    let names: Vec<String> = text.lines().next().expect("names").split(',').map(str::to_owned).collect();
    let row = |back: usize| {
        let cells = text.lines().rev().nth(back).expect("counts").split(',');
        names.iter().cloned().zip(cells.map(|cell| cell.parse().unwrap_or(f64::NAN))).collect()
    };
    [row(1), row(0)]
}

#[test]
fn no_approach_is_missed_and_exact_depth_warns_of_nothing_else() {
    let folder = scratch("proximity");
    let judged = |name: &str, depth: &str| {
        format!(
            r#"
[nodes.{name}]
type = "proximity"
inputs = {{ tip = ["scope.lead", "scope.second"], depth = "{depth}", instances = "scope.instances", calibration = "scope.calibration" }}
params = {{ warn_mm = 9.0 }}
[nodes.{name}_judge]
type = "evaluate_proximity"
inputs = {{ table = "{name}.table", truth = "scope.clearance" }}
params = {{ warn_mm = 9.0 }}
[nodes.{name}_out]
type = "write_table"
inputs = {{ table = "{name}_judge.table" }}
params = {{ path = "{}" }}
"#,
            folder.join(format!("{name}.csv")).display()
        )
    };
    let text = format!(
        r#"
mode = "batch"
plugins = ["phantom", "stereo", "tools", "sinks"]
[nodes.scope]
type = "phantom"
params = {{ scene = "bowel", seed = 7, distance_mm = 50.0, width = 320, height = 240, tools = 2, tool_kinds = "grasper, hook", tool_motion = "strokes", speed_mm_s = 2.0 }}
[nodes.match]
type = "stereo_bm"
inputs = {{ left = "scope.left", right = "scope.right" }}
[nodes.points]
type = "reproject"
inputs = {{ image = "scope.left", disparity = "match.disparity", calibration = "scope.calibration" }}
{}{}"#,
        judged("exact", "scope.depth"),
        judged("matched", "points.depth")
    );
    let ran = run(&folder.join("graph.toml"), &text, 450, 0);
    assert!(ran.log.is_empty(), "{:?}", ran.log);
    let [strict, exact] = counts(&folder.join("exact.csv"));
    assert!(strict["tissue_approaches"] >= 5.0 && exact["tissue_approaches"] >= 2.0, "the scene has some: {exact:?}");
    assert_eq!((exact["tissue_missed"], exact["tissue_false"]), (0.0, 0.0), "{exact:?}");
    // One that comes 0.2 mm within the threshold may be taken for one that does not.
    assert!(strict["tissue_missed"] <= 1.0 && strict["tissue_false"] == 0.0, "{strict:?}");
    assert!(exact["tissue_rms_mm"] < 0.5 && exact["tissue_known"] == exact["tissue_ticks"], "{exact:?}");
    assert!(exact["tips_approaches"] >= 5.0 && exact["tips_rms_mm"] < 1e-6, "{exact:?}");
    assert_eq!((strict["tips_missed"], strict["tips_false"]), (0.0, 0.0), "{strict:?}");
    let [_, matched] = counts(&folder.join("matched.csv"));
    assert_eq!(matched["tissue_missed"], 0.0, "{matched:?}");
    assert!(matched["tissue_false"] <= 1.0 && matched["tissue_rms_mm"] < 1.0, "{matched:?}");
    std::fs::remove_dir_all(folder).expect("the folder goes");
}
