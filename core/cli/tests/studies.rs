//! `panoscope sweep` over parameters and node types against truth in files, and `panoscope report` over its runs.

use crate::common;
use std::fs;
use std::path::{Path, PathBuf};

const SIZE: (usize, usize) = (224, 80);
/// True disparity of each pair, px.
const DISPARITY: [usize; 2] = [40, 46];
/// Columns without truth: what the right view does not show, and the matcher's window.
const BORDER: usize = 80;

fn run(arguments: &[&str]) -> (i32, String, String) {
    common::run(&["capture", "stereo"], arguments)
}

/// Random gray values in blocks of 2 x 2 px.
fn texture(x: usize, y: usize) -> u8 {
    let mut hash =
        ((x / 2) as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ ((y / 2) as u64).wrapping_mul(0xC2B2_AE3D_27D4_EB4F);
    hash = (hash ^ (hash >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    40 + (hash >> 56) as u8 / 2
}

/// A folder with two pairs of a plane, their true disparity as PFM, and a graph that judges a matcher.
fn data_set(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("panoscope_studies_{name}_{}", std::process::id()));
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).expect("a folder");
    let (width, height) = SIZE;
    for (pair, disparity) in DISPARITY.iter().enumerate() {
        let picture = |shift: usize| {
            image::GrayImage::from_fn(width as u32, height as u32, |x, y| {
                image::Luma([texture(x as usize + shift, y as usize)])
            })
        };
        picture(0).save(folder.join(format!("left_{pair}.png"))).expect("written");
        picture(*disparity).save(folder.join(format!("right_{pair}.png"))).expect("written");
        let row = (0..width).map(|x| if x < BORDER { f32::INFINITY } else { *disparity as f32 });
        let row: Vec<u8> = row.flat_map(f32::to_le_bytes).collect();
        let pfm = [format!("Pf\n{width} {height}\n-1\n").as_bytes(), &row.repeat(height)].concat();
        fs::write(folder.join(format!("truth_{pair}.pfm")), pfm).expect("written");
    }
    let graph = r#"mode = "batch"
plugins = ["capture", "stereo"]
[nodes.views]
type = "capture"
params = { left = "left_*.png", right = "right_*.png" }
[nodes.truth]
type = "read_maps"
inputs = { image = "views.left" }
params = { path = "truth_*.pfm" }
[nodes.match]
type = "stereo_bm"
inputs = { left = "views.left", right = "views.right" }
params = { auto_offset = false, search_px = 64, texture = 5 }
[nodes.evaluate]
type = "evaluate_disparity"
inputs = { disparity = "match.disparity", truth = "truth.disparity" }
"#;
    fs::write(folder.join("judged.toml"), graph).expect("written");
    folder
}

fn text(path: &Path) -> String {
    path.display().to_string()
}

fn results(folder: &Path, run: usize) -> serde_json::Value {
    let file = folder.join(format!("run_{run:04}/results.json"));
    serde_json::from_str(&fs::read_to_string(file).expect("results")).expect("JSON")
}

#[test]
fn matchers_and_parameters_are_compared_against_truth_in_files() {
    let folder = data_set("grid");
    let (graph, out, html) = (text(&folder.join("judged.toml")), folder.join("study"), folder.join("report.html"));
    let sweep = [
        "sweep",
        &graph,
        "--param",
        "match.type=stereo_bm,stereo_sgbm",
        "--param",
        "match.search_px=32,64",
        "--measure",
        "evaluate.bad2_pct",
        "--measure",
        "evaluate.table.coverage_pct",
        "--measure",
        "match.count",
        "--jobs",
        "2",
        "--out",
    ];
    let (code, said, told) = run(&[&sweep[..], &[&text(&out)]].concat());
    assert_eq!(code, 0, "{said}{told}");
    assert!(told.contains("match.texture is left out"), "{told}");
    assert!(said.contains("done: 4 of 4 values measured"), "{said}");
    let table = fs::read_to_string(out.join("results.csv")).expect("a table");
    assert!(table.starts_with("run,\"match.type\",\"match.search_px\",\"evaluate.bad2_pct mean\","), "{table}");
    assert_eq!(table.lines().count(), 5);
    for number in 1..=4 {
        let results = results(&out, number);
        let (kind, search) = (["stereo_bm", "stereo_sgbm"][(number - 1) / 2], ["32", "64"][(number - 1) % 2]);
        assert_eq!((&results["params"][0]["value"], &results["params"][1]["value"]), (&kind.into(), &search.into()));
        let mean = |index: usize| results["measures"][index]["mean"].as_f64().expect("a number");
        assert_eq!((results["measures"][0]["count"].as_u64(), mean(2)), (Some(2), 2.0));
        // Only a search of 64 px sees disparities of 40 and 46.
        let (bad, coverage) = (mean(0), mean(1));
        if search == "64" {
            assert!(bad < 5.0 && coverage > 95.0, "{kind}: {bad}, {coverage}");
        } else {
            assert!(bad > 95.0, "{kind}: {bad}");
        }
        assert_eq!(results["plugins"].as_array().expect("hashes").len(), 2);
        assert!(!results["machine"]["os"].as_str().expect("a system").is_empty());
        let written = fs::read_to_string(out.join(format!("run_{number:04}/graph.toml"))).expect("a graph");
        assert!(written.contains(kind) && written.contains(&format!("search_px = {search}")), "{written}");
    }
    let (code, said, told) = run(&["report", &text(&out), "--html", &text(&html)]);
    assert_eq!(code, 0, "{said}{told}");
    assert!(said.contains("4 runs compared") && said.contains("search_px = 64"), "{said}");
    let page = fs::read_to_string(&html).expect("a page");
    assert_eq!(page.matches("(best)").count(), 3, "one for each measure");
    assert!(page.contains("<svg") && page.contains("stereo_sgbm"));
    // A study is not written over another one.
    let (code, _, told) = run(&[&sweep[..], &[&text(&out)]].concat());
    assert!(code == 2 && told.contains("holds a study already"), "{told}");
    fs::remove_dir_all(folder).expect("removed");
}

#[test]
fn a_node_that_always_fails_is_no_measurement() {
    let folder = data_set("faults");
    for pair in 0..DISPARITY.len() {
        fs::write(folder.join(format!("truth_{pair}.pfm")), b"Pf\n1 1\n-1\n\0\0\x80?").expect("written");
    }
    let (graph, out) = (text(&folder.join("judged.toml")), folder.join("study"));
    let (code, said, told) = run(&[
        "sweep",
        &graph,
        "--param",
        "match.search_px=32,64",
        "--measure",
        "evaluate.bad2_pct",
        "--out",
        &text(&out),
    ]);
    assert_eq!(code, 1, "{said}{told}");
    assert!(said.contains("0 of 2 values measured"), "{said}{told}");
    let table = fs::read_to_string(out.join("results.csv")).expect("a table");
    let failed = table.lines().skip(1).filter(|line| line.contains("every call of node `truth` failed")).count();
    assert_eq!(failed, 2, "{table}");
    fs::remove_dir_all(folder).expect("removed");
}

#[test]
fn random_runs_repeat_with_their_seed_and_mistakes_are_named() {
    let folder = data_set("random");
    let graph = text(&folder.join("judged.toml"));
    let measure = ["--measure", "evaluate.bad2_pct"];
    let random =
        ["sweep", &graph, "--param", "match.block_px=3..15", "--param", "match.search_px=64..96", "--random", "3"];
    let table = |seed: &str| {
        let (code, said, told) = run(&[&random[..], &measure, &["--random-seed", seed]].concat());
        assert_eq!(code, 0, "{said}{told}");
        said
    };
    let first = table("5");
    assert_eq!(first, table("5"));
    assert_ne!(first, table("6"));
    // A search makes all its runs.
    let search = ["sweep", &graph, "--param", "match.min_disparity_px=-200..200", "--search", "12", "--frames", "1"];
    let (code, said, told) = run(&[&search[..], &measure].concat());
    assert!(code == 0 && said.contains("done: 12 of 12 values measured"), "{said}{told}");
    let refused = |param: &[&str]| {
        let (code, _, told) = run(&[&["sweep", &graph], param, &measure].concat());
        assert_eq!(code, 2, "{told}");
        told
    };
    let told = refused(&["--param", "match.type=stereo_bm,stereo_xy"]);
    assert!(told.contains("no node type `stereo_xy`"), "{told}");
    let told = refused(&["--param", "match.type=stereo_bm,stereo_sgbm", "--param", "match.texture=1..9"]);
    assert!(told.contains("`match` (stereo_sgbm) has no such parameter"), "{told}");
    let told = refused(&["--param", "match.block_px=5,6"]);
    assert!(told.contains("block_px"), "{told}");
    let told = refused(&["--param", "match.block_px", "--param", "match.search_px", "--from", "3"]);
    assert!(told.contains("own range"), "{told}");
    let (code, _, told) = run(&["report", &text(&folder), "--html", &text(&folder.join("x.html"))]);
    assert!(code == 2 && told.contains("holds no run"), "{told}");
    fs::remove_dir_all(folder).expect("removed");
}
