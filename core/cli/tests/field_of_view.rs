//! `panoscope eval stitch --fov`: how far the shipped graphs see, 20 mm from the tissue and with four cameras.

use std::path::Path;
use std::process::Command;

use crate::common::plugins;

/// Runs `eval stitch` on shipped graphs and gives its figures; none without plugins.
fn figures(name: &str, arguments: &[&str]) -> Option<serde_json::Value> {
    let plugins = plugins(&["phantom", "stereo", "stitch"])?;
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let file = std::env::temp_dir().join(format!("panoscope_fov_{}_{name}.json", std::process::id()));
    let output = Command::new(env!("CARGO_BIN_EXE_panoscope"))
        .current_dir(root)
        .env("PANOSCOPE_PLUGIN_PATH", plugins)
        .args(["eval", "stitch"])
        .args(arguments)
        .arg("--json")
        .arg(&file)
        .output()
        .expect("the program starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = std::fs::read_to_string(&file).expect("the figures");
    let _ = std::fs::remove_file(&file);
    Some(serde_json::from_str(&text).expect("JSON"))
}

fn figure(figures: &serde_json::Value, name: &str) -> (f64, Option<f64>) {
    let all = figures.as_array().expect("a list of figures");
    let found = all.iter().find(|figure| figure["name"] == name).unwrap_or_else(|| panic!("{name} is not in {all:?}"));
    (found["value"].as_f64().expect("a number"), found["peer_value"].as_f64())
}

#[test]
fn two_cameras_see_nearly_twice_as_much_at_20_mm() {
    let graphs = ["graphs/stitch_roi.toml", "graphs/stitch_grid.toml"];
    let arguments = [graphs[0], graphs[1], "--fov", "--distances", "20", "--frames", "20"];
    let Some(all) = figures("near", &arguments) else { return };
    for graph in ["stitch_roi", "stitch_grid"] {
        for scene in ["bowel", "liver"] {
            let of = |measure: &str| figure(&all, &format!("{measure}/{graph}_{scene}_20mm"));
            let ((total, truth), (gain, _)) = (of("fov_total_pct"), of("fov_gain_pct"));
            let truth = truth.expect("the phantom knows the truth");
            assert!(total > 170.0 && total <= truth, "{graph} {scene}: {total} % of {truth} %");
            assert!((total - gain - 100.0).abs() < 1e-6 && (185.0..200.0).contains(&truth), "{gain} {truth}");
        }
    }
}

#[test]
fn a_narrow_overlap_that_is_not_searched_is_reported_as_lost() {
    let off = "wide.strips=false";
    let arguments = ["graphs/stitch_roi.toml", "--fov", "--distances", "20", "--frames", "20", "--set", off];
    let Some(all) = figures("lost", &arguments) else { return };
    let (total, _) = figure(&all, "fov_total_pct/stitch_roi_bowel_20mm");
    let (lost, _) = figure(&all, "fov_lost_frames/stitch_roi_bowel_20mm");
    assert_eq!((total, lost), (100.0, 20.0), "one view, and no frame of it passes as a panorama");
}

#[test]
fn four_cameras_see_nearly_three_times_as_much() {
    let arguments = ["graphs/four_cameras.toml", "--fov", "--distances", "30", "--frames", "20"];
    let Some(all) = figures("four", &arguments) else { return };
    for scene in ["bowel", "liver"] {
        let (total, truth) = figure(&all, &format!("fov_total_pct/four_cameras_{scene}_30mm"));
        assert!(total > 240.0 && total <= truth.expect("the truth"), "{scene}: {total} % of {truth:?} %");
    }
}

#[test]
fn a_graph_without_the_phantom_is_refused_with_the_reason() {
    let Some(plugins) = plugins(&["capture", "stitch"]) else { return };
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let output = Command::new(env!("CARGO_BIN_EXE_panoscope"))
        .current_dir(root)
        .env("PANOSCOPE_PLUGIN_PATH", plugins)
        .args(["eval", "stitch", "graphs/panorama_files.toml", "--fov"])
        .args(["--set", "scope.left=0", "--set", "scope.right=1"])
        .output()
        .expect("the program starts");
    let said = String::from_utf8_lossy(&output.stderr).into_owned() + &String::from_utf8_lossy(&output.stdout);
    assert!(!output.status.success() && said.contains("do not come from a `phantom`"), "{said}");
}
