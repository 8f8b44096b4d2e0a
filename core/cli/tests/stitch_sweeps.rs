//! `panoscope eval stitch --speeds` and `--cases`: graphs side by side on the same pictures of the phantom.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use crate::common::plugins;

const PLUGINS: [&str; 6] = ["phantom", "stereo", "stitch", "flow", "sinks", "overlay"];
/// Pictures a quarter as large: a look takes seconds.
const SMALL: [&str; 4] = ["--set", "scope.width=320", "--set", "scope.height=240"];

fn run(folder: Option<&Path>, arguments: &[&str]) -> (i32, String, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_panoscope"));
    if let Some(folder) = folder {
        command.env("PANOSCOPE_PLUGIN_PATH", folder);
    }
    let Output { status, stdout, stderr } = command.args(arguments).output().expect("the program starts");
    let text = |bytes| String::from_utf8(bytes).expect("UTF-8");
    (status.code().unwrap_or(-1), text(stdout), text(stderr))
}

/// A file of this test process that does not exist yet.
fn file(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("panoscope_sweeps_{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    folder.join(name)
}

fn graph(name: &str) -> String {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../graphs").join(name).display().to_string()
}

/// Value of a figure.
fn value(figures: &serde_json::Value, name: &str) -> Option<f64> {
    figures.as_array().expect("a list").iter().find(|f| f["name"] == name)?["value"].as_f64()
}

fn figures(path: &Path) -> serde_json::Value {
    serde_json::from_str(&std::fs::read_to_string(path).expect("the figures")).expect("JSON")
}

#[test]
fn graphs_are_swept_over_the_speed_of_the_cameras() {
    let Some(folder) = plugins(&PLUGINS) else { return };
    let (json, png) = (file("speeds.json"), file("speeds.png"));
    let (json_text, png_text) = (json.display().to_string(), png.display().to_string());
    let (grid, chapter) = (graph("stitch_grid.toml"), graph("thesis_chapter4.toml"));
    let own = [
        "eval", "stitch", "--speeds", "0,5", &grid, &chapter, "--frames", "12", "--json", &json_text, "--plot",
        &png_text,
    ];
    let (code, out, err) = run(Some(&folder), &[&own[..], &SMALL].concat());
    assert_eq!(code, 0, "{out}{err}");
    assert!(out.contains("counts as stitched when") && out.contains("best plane"), "{out}");
    let figures = figures(&json);
    for speed in ["0", "5"] {
        for name in ["stitch_grid", "thesis_chapter4"] {
            let share = value(&figures, &format!("stitched_share/{name}_{speed}_cm_s")).expect("a share");
            let align = value(&figures, &format!("align_px/{name}_{speed}_cm_s")).expect("an alignment");
            assert!(share >= 90.0 && align < 15.0, "{name} at {speed} cm/s: {share} %, {align} px");
        }
    }
    assert_eq!(value(&figures, "followed_cm_s/stitch_grid"), Some(5.0));
    let picture = image::open(&png).expect("the plot");
    assert_eq!((picture.width(), picture.height()), (1280, 360));
}

#[test]
fn chapter_4_stitches_smooth_tissue_that_chapter_2_does_not() {
    let Some(folder) = plugins(&PLUGINS) else { return };
    let json = file("cases.json");
    let json_text = json.display().to_string();
    let own = ["eval", "stitch", "--cases", "--only", "bare", "--frames", "12", "--json", &json_text];
    let (code, out, err) = run(Some(&folder), &[&own[..], &SMALL].concat());
    assert_eq!(code, 0, "{out}{err}");
    for table in ["Table 4.1", "Table 4.2", "Table 4.3", "jitter at rest"] {
        assert!(out.contains(table), "{table}: {out}");
    }
    let figures = figures(&json);
    let of = |measure: &str, name: &str| value(&figures, &format!("{measure}/bare_{name}"));
    let (surf, grid) =
        (of("stitched_share", "chapter_2").expect("a share"), of("stitched_share", "chapter_4").expect("a share"));
    assert!(grid >= 80.0 && surf <= grid - 30.0, "chapter 2 {surf} %, chapter 4 {grid} %");
    let jitter = (of("jitter_px", "chapter_4").expect("a jitter"), of("jitter_px", "grid").expect("a jitter"));
    assert!(jitter.0 < 10.0 && jitter.1 < 10.0, "{jitter:?} px");
    let floor = value(&figures, "align_floor_px/bare").expect("the best plane");
    assert!(
        of("align_px", "grid").expect("an alignment") >= floor && floor > 0.0,
        "nothing is better than the best plane"
    );
    for name in ["chapter_2", "chapter_4", "ROI", "grid"] {
        assert!(of("stitch_ms", name).expect("a time") > 0.0, "{name}");
    }
}

#[test]
fn wrong_sweeps_are_refused_in_words() {
    let (grid, none) = (graph("stitch_grid.toml"), "no_such_graph.toml");
    for (arguments, code, words) in [
        (&["--speeds", "5..1"][..], 2, "`5..1` does not ascend"),
        (&["--speeds", "1,fast"], 2, "`fast` is not a number"),
        (&["--speeds", "40"], 2, "outside 0 to 20"),
        (&["--speeds", "1", "--cases"], 2, "cannot be used with"),
        (&["--only", "smoke", &grid], 2, "--cases"),
        (&["--cases", "--only", "fog"], 2, "[possible values: plain"),
        (&[], 2, "required"),
        (&["--speeds", "1", none], 2, none),
        (&[&grid, &grid], 1, "--speeds or --cases"),
        (&["--speeds", "1", "--set", "nobody.x=1"], 1, "none of the graphs has a node `nobody`"),
    ] {
        let (got, out, err) = run(None, &[&["eval", "stitch"], arguments].concat());
        assert_eq!(got, code, "{arguments:?}: {out}{err}");
        assert!(format!("{out}{err}").contains(words), "{arguments:?}: {out}{err}");
    }
}

#[test]
fn a_graph_of_parts_is_judged_on_the_source_of_an_overlay() {
    let Some(folder) = plugins(&PLUGINS) else { return };
    let (json, graph, overlay) = (file("parts.json"), graph("panorama.toml"), graph("sources/phantom.toml"));
    let json_text = json.display().to_string();
    let own = [
        "eval",
        "stitch",
        &graph,
        "--with",
        &overlay,
        "--seed",
        "3",
        "--scene",
        "liver",
        "--set",
        "wide.blend_px=8",
        "--no-peer",
        "--frames",
        "12",
        "--json",
        &json_text,
    ];
    let (code, out, err) = run(Some(&folder), &[&own[..], &SMALL].concat());
    assert_eq!(code, 0, "{out}{err}");
    assert!(out.contains("wide/composite"), "times name the nodes of the part: {out}");
    let share = value(&figures(&json), "stitched_share/panorama").unwrap_or_else(|| panic!("{out}"));
    assert!(share > 50.0, "{share} %");
    // Mistakes stand in the files that have them.
    let wrong = ["eval", "stitch", &graph, "--with", &overlay, "--seed", "x"];
    let (code, out, err) = run(Some(&folder), &wrong);
    assert!(code == 2 && out.contains("argument `seed` must be a whole number"), "{code} {out}{err}");
}

#[test]
fn one_run_judges_a_graph_opencv_and_as_projective_as_possible_warps() {
    let Some(folder) = plugins(&["phantom", "stitch", "opencv", "capture", "sinks", "overlay"]) else { return };
    // A pair from files: without the phantom's incidents OpenCV takes seconds.
    let render = file("render.toml");
    let sink = |side: &str| {
        format!(
            "[nodes.{side}]\ntype = \"write_images\"\ninputs = {{ image = \"scope.{side}\" }}\nparams = {{ path = {:?}, at_end = true }}\n",
            file(&format!("{side}.png"))
        )
    };
    let scope =
        "[nodes.scope]\ntype = \"phantom\"\nparams = { scene = \"bowel\", seed = 7, width = 320, height = 240 }\n";
    let text =
        format!("mode = \"batch\"\nplugins = [\"phantom\", \"sinks\"]\n{scope}{}{}", sink("left"), sink("right"));
    std::fs::write(&render, text).expect("a graph");
    let (code, out, err) = run(Some(&folder), &["run", &render.display().to_string(), "--frames", "1", "--headless"]);
    assert_eq!(code, 0, "{out}{err}");
    let (json, pictures) = (file("beside.json"), file("panoramas"));
    let texts = [file("left.png"), file("right.png"), json.clone(), pictures.clone()].map(|p| p.display().to_string());
    let [left, right, json_text, pictures_text] = &texts;
    let graph = graph("panorama_files.toml");
    let own = [
        "eval",
        "stitch",
        &graph,
        "--left",
        left,
        "--right",
        right,
        "--frames",
        "12",
        "--json",
        json_text,
        "--pictures",
        pictures_text,
    ];
    let (code, out, err) = run(Some(&folder), &own);
    assert_eq!(code, 0, "{out}{err}");
    let figures = figures(&json);
    let apap = value(&figures, "align_px/panorama_files_apap").unwrap_or_else(|| panic!("{out}"));
    assert_eq!(value(&figures, "stitched_share/panorama_files_apap"), Some(100.0));
    let listed = figures.as_array().expect("a list").iter();
    let beside = listed.clone().find(|f| f["name"] == "align_px/panorama_files").expect("ours");
    assert!(beside["peer"].as_str().is_some_and(|peer| peer.starts_with("OpenCV")), "{beside}");
    // Neither holds its homography near a shift; one alone cannot follow the parallax.
    let opencv = beside["peer_value"].as_f64().expect("OpenCV's");
    assert!(apap < 0.9 * opencv, "{opencv} px by one homography, {apap} px by many");
    let picture = image::open(pictures.join("panorama_files.png")).expect("the panoramas");
    assert!(
        picture.width() > 400 && picture.height() > 3 * 240,
        "three panoramas: {}x{}",
        picture.width(),
        picture.height()
    );
    assert!(run(None, &["eval", "stitch", &graph, "--fov", "--pictures", "x"]).2.contains("cannot be used with"));
}
