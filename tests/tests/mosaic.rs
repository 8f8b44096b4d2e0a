//! The mosaic of one moving camera: the shipped graph, and its drift compared with the phantom's ground truth.

use std::collections::HashMap;
use std::path::Path;
use std::time::Duration;

use panoscope_engine::{Engine, Options, Outcome};
use panoscope_graph::{GraphText, check};
use panoscope_host::loader::{self as loader, Loader};
use panoscope_tests::{await_end, run, scratch};

/// Columns of a table as `write_table` writes it.
fn columns(path: &Path) -> HashMap<String, Vec<f64>> {
    let text = std::fs::read_to_string(path).expect("a table");
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().expect("names").split(',').collect();
    let mut columns: HashMap<String, Vec<f64>> = names.iter().map(|name| ((*name).to_owned(), Vec::new())).collect();
    for line in lines {
        for (name, cell) in names.iter().zip(line.split(',')) {
            columns.get_mut(*name).expect("a column").push(cell.parse().unwrap_or(f64::NAN));
        }
    }
    columns
}

#[test]
fn the_graph_that_ships_closes_its_loop() {
    let folder = scratch("mosaic_graph");
    let path = panoscope_tests::root().join("graphs/mosaic.toml");
    let mut text = GraphText::load(&path).unwrap_or_else(|mistakes| panic!("{}", mistakes.render(false)));
    // Once round and a little further, in small pictures.
    for set in ["scope.width=320", "scope.height=240", "scope.speed_mm_s=25.0", "scope.path_mm=30.0", "mosaic.scale=1"]
    {
        text.set(set);
    }
    for (param, file) in [("video.path", "mosaic.mkv"), ("still.path", "mosaic.png"), ("state.path", "mosaic.csv")] {
        text.set(&format!("{param}={}", folder.join(file).display()));
    }
    let loader = Loader::search(&loader::search_path(&text.plugin_paths()));
    let catalog = loader.catalog(&text.plugins());
    let (graph, warnings) =
        check(&text, &catalog).into_result().unwrap_or_else(|mistakes| panic!("{}", mistakes.render(false)));
    assert!(warnings.is_empty(), "{}", warnings.render(false));
    let options = Options {
        frames: Some(130),
        paced: false,
        ticks_at_once: Some(1),
        graph_dir: path.parent().expect("graphs").to_owned(),
        ..Options::default()
    };
    let engine = Engine::start(graph, &catalog, &loader, options).unwrap_or_else(|error| panic!("{error}"));
    await_end(&engine, |_| {});
    assert_eq!(engine.close(Duration::from_secs(60)), Outcome::Done, "{:?}", engine.recent_log());
    for (id, node) in &engine.report().nodes {
        assert_eq!((node.faults, node.count > 0), (0, true), "`{id}`: {:?}", engine.recent_log());
    }
    let state = columns(&folder.join("mosaic.csv"));
    let last = |name: &str| *state[name].last().expect("a row");
    assert!(last("closures") >= 1.0 && last("drift_px").is_finite(), "lost in {} frames", last("lost_frames"));
    assert!(last("coverage_pct") > 200.0 && last("lost_frames") == 0.0, "{} %", last("coverage_pct"));
    let still = image_size(&folder.join("mosaic.png"));
    // The canvas, and the bar with its words below.
    assert_eq!(still, (1280, 960 + 106));
    assert!(folder.join("mosaic.mkv").metadata().is_ok_and(|f| f.len() > 1000));
    std::fs::remove_dir_all(folder).expect("removed");
}

/// Width and height in a PNG's header.
fn image_size(path: &Path) -> (u32, u32) {
    let bytes = std::fs::read(path).expect("a picture");
    let word = |at: usize| u32::from_be_bytes(bytes[at..at + 4].try_into().expect("four bytes"));
    (word(16), word(20))
}

#[test]
fn over_a_plane_the_second_lap_lies_where_the_first_one_did() {
    let folder = scratch("mosaic_drift");
    let judged = |name: &str, is_closed: bool| {
        format!(
            r#"
[nodes.{name}]
type = "mosaic"
inputs = {{ image = "scope.left" }}
params = {{ loop_closure = {is_closed}, scale = 1, max_keyframes = 100 }}
[nodes.{name}_judge]
type = "evaluate_mosaic"
inputs = {{ homography = "{name}.homography", pose = "scope.pose", depth = "scope.depth", calibration = "scope.calibration" }}
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
plugins = ["phantom", "stitch", "sinks"]
[nodes.scope]
type = "phantom"
params = {{ scene = "bowel", relief = 0.0, seed = 7, width = 320, height = 240, camera_path = "ring", path_mm = 30.0, speed_mm_s = 25.0, breathing_mm = 0.0 }}
{}{}"#,
        judged("closed", true),
        judged("open", false)
    );
    let ran = run(&folder.join("graph.toml"), &text, 235, 0);
    assert!(ran.log.is_empty(), "{:?}", ran.log);
    let lap = |name: &str| {
        let table = columns(&folder.join(format!("{name}.csv")));
        let count = table["tick"].len();
        assert!(count >= 235 && table["state"].iter().all(|state| *state == 0.0), "{name}: {:?}", table["state"]);
        let rms = |column: &str| {
            let last = &table[column][count - 117..];
            (last.iter().map(|v| v * v).sum::<f64>() / last.len() as f64).sqrt()
        };
        // Two rings of 30 mm.
        let path = table["path_mm"][count - 1];
        assert!((185.0..200.0).contains(&path), "{path} mm");
        (rms("drift_px"), rms("drift_mm"), rms("floor_px"))
    };
    let ((closed_px, closed_mm, floor_px), (open_px, ..)) = (lap("closed"), lap("open"));
    assert!(floor_px < 0.05, "over a plane a homography is exact: {floor_px} px");
    assert!(closed_px < 1.0 && closed_px < 0.6 * open_px, "{closed_px} px with closed loops, {open_px} px without");
    // A pixel is 50 mm / 375 px wide on the tissue.
    assert!((closed_mm / (closed_px * 50.0 / 375.0) - 1.0).abs() < 0.05, "{closed_mm} mm, {closed_px} px");
    std::fs::remove_dir_all(folder).expect("removed");
}
