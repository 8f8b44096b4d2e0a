//! Every graph that ships is right, and says what it shows.

use std::path::Path;
use std::time::Duration;

use panoscope_engine::{Engine, Options, Outcome};
use panoscope_graph::{GraphOptions, GraphText, check};
use panoscope_loader::{self as loader, Loader};

#[test]
fn every_shipped_graph_checks() {
    let graphs = panoscope_tests::root().join("graphs");
    let mut count = 0;
    for folder in [graphs.clone(), graphs.join("parts")] {
        for entry in std::fs::read_dir(folder).expect("graphs").flatten() {
            let path = entry.path();
            if path.extension().is_none_or(|e| e != "toml") {
                continue;
            }
            // Graphs on files or cameras of the user's have arguments without values.
            let text = checked(&path, &GraphOptions { allow_missing_args: true, ..GraphOptions::default() });
            assert!(text.text().starts_with("# "), "{} does not open with what it shows", path.display());
            count += 1;
        }
    }
    assert!(count >= 2, "only {count} graphs were found");
}

/// Checks a graph with the plugins of this machine.
fn checked(path: &Path, options: &GraphOptions) -> GraphText {
    let text = GraphText::load_with(path, options).unwrap_or_else(|mistakes| panic!("{}", mistakes.render(false)));
    let loader = Loader::search(&loader::search_path(&text.plugin_paths()));
    let checked = check(&text, &loader.catalog(&text.plugins()));
    assert!(checked.graph.is_some(), "{}", checked.diagnostics.render(false));
    text
}

#[test]
fn the_depth_graph_takes_every_source() {
    let graphs = panoscope_tests::root().join("graphs");
    let options = |source: &str| GraphOptions {
        with: vec![graphs.join("sources").join(source)],
        allow_missing_args: true,
        ..GraphOptions::default()
    };
    for (source, missing) in [
        ("phantom.toml", vec![]),
        ("files.toml", vec!["left", "right", "calibration"]),
        ("cameras.toml", vec!["calibration"]),
    ] {
        let text = checked(&graphs.join("depth.toml"), &options(source));
        assert_eq!(text.missing_args(), missing, "{source}");
    }
}

/// A rendered pair in files, as cameras would give it.
const PAIR: &str = r#"mode = "batch"
plugins = ["phantom", "sinks"]
[nodes.scope]
type = "phantom"
params = { scene = "bowel", seed = 7, distance_mm = 66.0, tools = 1 }
[nodes.left]
type = "write_images"
inputs = { image = "scope.left" }
params = { path = "left_{seq}.png" }
[nodes.right]
type = "write_images"
inputs = { image = "scope.right" }
params = { path = "right_{seq}.png" }
"#;

/// The phantom's cameras, as `panoscope calibrate` would write them.
const CALIBRATION: &str = "%YAML:1.0
---
image_width: 640
image_height: 480
M1: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 750., 0., 319.5, 0., 750., 239.5, 0., 0., 1. ]
D1: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ 0., 0., 0., 0., 0. ]
M2: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 750., 0., 319.5, 0., 750., 239.5, 0., 0., 1. ]
D2: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ 0., 0., 0., 0., 0. ]
R: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 1., 0., 0., 0., 1., 0., 0., 0., 1. ]
T: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [ -15., 0., 0. ]
";

#[test]
fn the_system_for_cameras_is_right_and_runs_on_a_pair_with_its_calibration() {
    const FRAMES: u64 = 4;
    let folder = panoscope_tests::scratch("surgeon_cameras");
    let scene = panoscope_tests::run(&folder.join("scene.toml"), PAIR, FRAMES, 2);
    assert_eq!(scene.outcome, Outcome::Done, "{:?}", scene.log);
    std::fs::write(folder.join("scope.yml"), CALIBRATION).expect("written");

    let path = panoscope_tests::root().join("graphs/surgeon_cameras.toml");
    let mut text = GraphText::load(&path).unwrap_or_else(|mistakes| panic!("{}", mistakes.render(false)));
    assert!(!text.text().contains("scope.tip"), "no camera gives a tip");
    // As `--left`, `--right` and `--set` of the README's command.
    for (param, file) in [
        ("scope.left", "left_*.png"),
        ("scope.right", "right_*.png"),
        ("scope.calibration", "scope.yml"),
        ("video.path", "screen.mkv"),
        ("tip_file.path", "tip.csv"),
    ] {
        text.set(&format!("{param}={}", folder.join(file).display()));
    }
    let loader = Loader::search(&loader::search_path(&text.plugin_paths()));
    let catalog = loader.catalog(&text.plugins());
    let (graph, warnings) =
        check(&text, &catalog).into_result().unwrap_or_else(|mistakes| panic!("{}", mistakes.render(false)));
    assert!(warnings.is_empty(), "{}", warnings.render(false));

    let graph_dir = path.parent().expect("graphs").to_owned();
    let options = Options { frames: Some(FRAMES), paced: false, graph_dir, ..Options::default() };
    let engine = match Engine::start(graph, &catalog, &loader, options) {
        Ok(engine) => engine,
        Err(error) if error.to_string().contains("ONNX Runtime's shared library is not there") => {
            return panoscope_testing::skipped!("{error}");
        }
        Err(error) => panic!("{error}"),
    };
    assert!(engine.wait(Some(Duration::from_secs(180))), "it does not end: {:?}", engine.recent_log());
    assert_eq!(engine.close(Duration::from_secs(60)), Outcome::Done, "{:?}", engine.recent_log());
    let report = engine.report();
    for (id, node) in &report.nodes {
        assert_eq!(node.faults, 0, "`{id}`: {:?}", engine.recent_log());
    }
    for id in ["state", "marks", "find", "follow", "points", "video"] {
        assert!(report.nodes[id].count > 0, "`{id}` made nothing: {:?}", engine.recent_log());
    }
    assert!(folder.join("screen.mkv").metadata().is_ok_and(|f| f.len() > 1000));
    std::fs::remove_dir_all(folder).expect("removed");
}
