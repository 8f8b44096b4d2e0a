//! `panoscope eval disparity` with a graph of the user's.

use crate::common;
use std::fs;
use std::path::{Path, PathBuf};

const SIZE: (u32, u32) = (320, 160);
const DISPARITY_PX: u32 = 40;

const HEAD: &str = "mode = \"live\"\nplugins = [\"phantom\", \"stereo\", \"sinks\"]\n[nodes.scope]\ntype = \"phantom\"\n\
    [nodes.rectify]\ntype = \"rectify\"\ninputs = { left = \"scope.left\", right = \"scope.right\", calibration = \"scope.calibration\" }\n";
const MATCH: &str = "[nodes.match]\ntype = \"stereo_bm\"\ninputs = { left = \"rectify.left\", right = \"rectify.right\" }\n\
    params = { auto_offset = false, auto_range = false, search_px = 64 }\n";
const SINK: &str = "[nodes.points]\ntype = \"reproject\"\n\
    inputs = { image = \"rectify.left\", disparity = \"match.disparity\", calibration = \"rectify.calibration\" }\n\
    [nodes.file]\ntype = \"write_cloud\"\ninputs = { cloud = \"points.cloud\" }\nparams = { path = \"never.ply\" }\n";

/// A pair of a plane with a random texture, and its disparity.
fn pair(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("panoscope_eval_disparity_{name}_{}", std::process::id()));
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).expect("a folder");
    let picture = |shift: u32| {
        image::GrayImage::from_fn(SIZE.0, SIZE.1, |x, y| {
            let mut hash = u64::from(x + shift).wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ u64::from(y / 2) << 32;
            hash = (hash ^ (hash >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
            image::Luma([40 + (hash >> 56) as u8 / 2])
        })
    };
    picture(0).save(folder.join("left.png")).expect("written");
    picture(DISPARITY_PX).save(folder.join("right.png")).expect("written");
    let row = (0..SIZE.0).map(|x| if x < 64 { f32::INFINITY } else { DISPARITY_PX as f32 });
    let row: Vec<u8> = row.flat_map(f32::to_le_bytes).collect();
    let pfm = [format!("Pf\n{} {}\n-1\n", SIZE.0, SIZE.1).as_bytes(), &row.repeat(SIZE.1 as usize)].concat();
    fs::write(folder.join("truth.pfm"), pfm).expect("written");
    folder
}

fn eval(folder: &Path, graph: &str, more: &[&str]) -> (i32, String, String) {
    let file = |name: &str| folder.join(name).display().to_string();
    fs::write(folder.join("own.toml"), graph).expect("written");
    let (own, left, right, truth, json) =
        (file("own.toml"), file("left.png"), file("right.png"), file("truth.pfm"), file("figures.json"));
    let words = [
        "eval",
        "disparity",
        &own,
        "--left",
        &left,
        "--right",
        &right,
        "--truth",
        &truth,
        "--search-px",
        "64",
        "--json",
        &json,
    ];
    common::run(&["capture", "phantom", "stereo", "sinks"], &[&words[..], more].concat())
}

#[test]
fn a_graph_is_judged_on_the_pair_in_place_of_its_source() {
    let folder = pair("graph");
    let (code, said, told) = eval(&folder, &format!("{HEAD}{MATCH}{SINK}"), &[]);
    assert_eq!(code, 0, "{said}{told}");
    let figures = || -> serde_json::Value {
        serde_json::from_str(&fs::read_to_string(folder.join("figures.json")).expect("figures")).expect("JSON")
    };
    let value = |figures: &serde_json::Value, name: &str| {
        let all = figures.as_array().or_else(|| figures["figures"].as_array()).expect("a list").clone();
        all.iter()
            .find(|f| f["name"] == name)
            .and_then(|f| f["value"].as_f64())
            .unwrap_or_else(|| panic!("{name}: {all:?}"))
    };
    let found = figures();
    // The same matcher with the same settings, through files, nodes and rectification.
    for measure in ["bad1", "bad2", "density", "mean_error"] {
        let (own, ours) =
            (value(&found, &format!("{measure}/left/graph")), value(&found, &format!("{measure}/left/bm")));
        assert_eq!(own, ours, "{measure}");
    }
    assert!(value(&found, "bad2/left/graph") < 5.0);
    assert!(!folder.join("never.ply").exists());
    let (code, said, told) = eval(&folder, &format!("{HEAD}{MATCH}"), &["--set", "match.search_px=32"]);
    assert_eq!(code, 0, "{said}{told}");
    assert!(value(&figures(), "bad2/left/graph") > 95.0, "40 px are not searched");
    fs::remove_dir_all(folder).expect("removed");
}

#[test]
fn a_graph_that_cannot_be_judged_is_refused_with_a_remedy() {
    let folder = pair("refused");
    let second = MATCH.replace("nodes.match", "nodes.other");
    let colours = "[nodes.colours]\ntype = \"disparity_wls\"\n\
        inputs = { image = \"rectify.left\", disparity = \"scope.disparity\", disparity_right = \"match.disparity_right\" }\n";
    for (graph, more, error) in [
        (HEAD.to_owned(), &[][..], "no node gives a disparity"),
        (
            format!("{HEAD}{MATCH}{second}"),
            &[],
            "several disparities, match.disparity, other.disparity: name one with --disparity",
        ),
        (format!("{HEAD}{MATCH}"), &["--disparity", "wls.disparity"], "there is no output wls.disparity"),
        (
            format!("{HEAD}{MATCH}{colours}"),
            &[],
            "`colours` reads `scope.disparity`, which a pair of pictures does not have",
        ),
        (format!("{HEAD}{MATCH}").replace("search_px = 64", "search_px = 7"), &[], "search_px"),
    ] {
        let (code, said, told) = eval(&folder, &graph, more);
        assert_eq!(code, 2, "{error}: {said}{told}");
        assert!(said.contains(error) || told.contains(error), "{error}: {said}{told}");
    }
    let (code, said, told) = eval(&folder, &format!("{HEAD}{MATCH}{second}"), &["--disparity", "other.disparity"]);
    assert_eq!(code, 0, "{said}{told}");
    fs::remove_dir_all(folder).expect("removed");
}
