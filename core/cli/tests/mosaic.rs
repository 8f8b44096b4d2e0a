//! `panoscope eval mosaic`: its figures beside an open chain, what it writes, and what it refuses.

use std::path::PathBuf;
use std::process::Command;

use crate::common::plugins;

fn run(arguments: &[&str]) -> (i32, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_panoscope"));
    if let Some(folder) = plugins(&["phantom", "stitch", "sinks"]) {
        command.env("PANOSCOPE_PLUGIN_PATH", folder);
    }
    let output = command.args(arguments).output().expect("the program starts");
    (output.status.code().unwrap_or(-1), String::from_utf8_lossy(&output.stderr).into_owned())
}

#[test]
fn a_closed_loop_is_judged_beside_an_open_chain() {
    if plugins(&["phantom", "stitch", "sinks"]).is_none() {
        return;
    }
    let folder: PathBuf = std::env::temp_dir().join(format!("panoscope_mosaic_{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let path = |name: &str| folder.join(name).display().to_string();
    let (json, plot, pictures) = (path("figures.json"), path("drift.png"), path("pictures"));
    let (code, said) = run(&[
        "eval",
        "mosaic",
        "--scene",
        "plane",
        "--width",
        "320",
        "--path-mm",
        "30",
        "--speed-mm-s",
        "25",
        "--json",
        &json,
        "--plot",
        &plot,
        "--pictures",
        &pictures,
    ]);
    assert_eq!(code, 0, "{said}");
    let text = std::fs::read_to_string(&json).expect("figures");
    let all: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let list = all.as_array().cloned().or_else(|| all["figures"].as_array().cloned()).expect("a list of figures");
    let figure = |name: &str| list.iter().find(|f| f["name"] == name).unwrap_or_else(|| panic!("no {name} in {text}"));
    let value = |name: &str| figure(name)["value"].as_f64().unwrap_or(f64::NAN);
    let open_px = figure("lap_drift_px/plane")["peer_value"].as_f64().expect("the open chain");
    assert!(value("lap_drift_px/plane") < open_px && value("floor_px/plane") < 0.05, "{text}");
    assert!(value("registered_pct/plane") > 99.0 && value("closures/plane") >= 1.0, "{text}");
    // A ring of 30 mm seen in views of 43 x 32 mm.
    assert!((200.0..400.0).contains(&value("coverage_pct/plane")), "{text}");
    for picture in [plot, format!("{pictures}/plane_closed.png"), format!("{pictures}/plane_open.png")] {
        assert!(std::fs::metadata(&picture).is_ok_and(|file| file.len() > 1000), "{picture}");
    }
    std::fs::remove_dir_all(folder).expect("removed");
}

#[test]
fn a_camera_that_stands_still_is_refused() {
    let (code, said) = run(&["eval", "mosaic", "--speed-mm-s", "0"]);
    assert!(code == 2 && said.contains("--speed-mm-s is 0; it must be 1 to 25"), "{code}: {said}");
}
