//! The surgeon's preset without the phantom: on images, on videos, and on pairs of a real endoscope.

use std::path::Path;

use panoscope_engine::Outcome;
use panoscope_graph::GraphOptions;
use panoscope_testing::Folder;
use panoscope_tests::{CALIBRATION, Run, root, run, run_file};

const FRAMES: u64 = 8;

/// Writes a rendered pair to files, as cameras would deliver it.
fn pair(node: &str, ending: &str) -> String {
    let sink = |side: &str| {
        format!(
            "[nodes.{side}]\ntype = \"{node}\"\ninputs = {{ image = \"scope.{side}\" }}\nparams = {{ path = \"{side}{ending}\" }}\n"
        )
    };
    let scope = "mode = \"batch\"\nplugins = [\"phantom\", \"sinks\"]\n[nodes.scope]\ntype = \"phantom\"\n\
                 params = { scene = \"bowel\", seed = 7, distance_mm = 66.0, tools = 1 }\n";
    format!("{scope}{}{}", sink("left"), sink("right"))
}

/// Runs `panoscope run surgeon.toml --with sources/files.toml` with its output in `folder`. `None` if the test is skipped.
fn surgeon(folder: &Folder, left: &Path, right: &Path, more: &[&str]) -> Option<Run> {
    let calibration = &folder.at("scope.yml");
    let args = [("left", left), ("right", right), ("calibration", calibration)];
    let sinks = [("video", "surgeon.mkv"), ("still", "surgeon.png"), ("tip_file", "tip.csv")];
    let options = GraphOptions {
        with: vec![root().join("graphs/sources/files.toml")],
        args: args.map(|(name, file)| (name.to_owned(), file.display().to_string())).to_vec(),
        set: sinks
            .iter()
            .map(|(node, file)| format!("{node}.path={}", folder.at(file).display()))
            .chain(more.iter().map(|set| (*set).to_owned()))
            .collect(),
        ..GraphOptions::default()
    };
    run_file(&root().join("graphs/surgeon.toml"), &options, FRAMES)
}

/// Checks the final screen: a main image on three fifths of it, a surface without false holes, colours that cover the depths.
fn looks_right(run: &Run, max_dead_pct: f64) {
    let metric = |node: &str, name: &str| {
        let of = &run.report.nodes[node].metrics;
        *of.get(name).unwrap_or_else(|| panic!("`{node}` has no metric {name}: {of:?}"))
    };
    let (main, dead) = (metric("screen/screen", "main_pct"), metric("screen/screen", "dead_pct"));
    assert!(main >= 60.0 && dead <= max_dead_pct, "main picture {main:.1} %, dead area {dead:.1} %");
    let (cut, beyond) = (metric("screen/turn", "cut_pct"), metric("screen/colours", "beyond_pct"));
    assert!(cut <= 2.0 && beyond <= 5.0, "{cut:.1} % of the surface cut, {beyond:.1} % beyond the colours of depth");
}

fn is_right(run: &Run, folder: &Folder) {
    assert_eq!(run.outcome, Outcome::Done, "{:?}", run.log);
    let nodes = &run.report.nodes;
    assert!(nodes.values().all(|n| n.faults == 0), "{:?}", run.log);
    // A real scope is on no simulated arm: nothing may say that one moves it.
    assert!(!nodes.contains_key("arm_file") && !nodes.keys().any(|id| id.starts_with("scope/")), "{:?}", nodes.keys());
    for id in ["screen/screen", "screen/marks", "instruments/find", "follow", "points", "video"] {
        assert!(nodes[id].count > 0, "`{id}` made nothing: {:?}", run.log);
    }
    let still = image::open(folder.at("surgeon.png")).expect("the still").to_rgb8();
    let (width, height) = still.dimensions();
    assert!(width >= 1280 && height >= 600, "{width}x{height}");
    // The panorama fills the larger part of the left two thirds.
    let lit = still.enumerate_pixels().filter(|(x, _, p)| *x < width * 2 / 3 && p.0.iter().any(|&v| v > 24)).count();
    let share = lit as f64 / f64::from(width * 2 / 3 * height);
    assert!(share > 0.35, "{:.0} % of the panorama's place is lit", 100.0 * share);
    assert!(folder.at("surgeon.mkv").metadata().is_ok_and(|f| f.len() > 1000));
}

#[test]
fn the_surgeons_preset_runs_on_pictures() {
    let folder = Folder::new("surgeon-pictures", &[("scope.yml", CALIBRATION)]);
    let scene = run(&folder.at("scene.toml"), &pair("write_images", "_{seq}.png"), FRAMES, 2);
    assert_eq!(scene.outcome, Outcome::Done, "{:?}", scene.log);
    let done = surgeon(&folder, &folder.at("left_*.png"), &folder.at("right_*.png"), &[]);
    let Some(done) = done else { return };
    is_right(&done, &folder);
}

#[test]
fn the_surgeons_preset_runs_on_videos() {
    let folder = Folder::new("surgeon-videos", &[("scope.yml", CALIBRATION)]);
    let scene = run(&folder.at("scene.toml"), &pair("write_video", ".mkv"), FRAMES, 2);
    assert_eq!(scene.outcome, Outcome::Done, "{:?}", scene.log);
    let done = surgeon(&folder, &folder.at("left.mkv"), &folder.at("right.mkv"), &[]);
    let Some(done) = done else { return };
    is_right(&done, &folder);
}

#[test]
fn the_surgeons_preset_runs_on_pairs_of_a_real_endoscope() {
    let data = root().join("../shared/data/stereo/hamlyn_640x480");
    if !data.is_dir() {
        return panoscope_testing::skipped!("there is no {}", data.display());
    }
    // The pairs are rectified; nothing states their cameras. A baseline of 5.4 mm is that of the da Vinci's scope, the focal length an assumption:
    // lengths scale with both, pictures do not.
    let folder = Folder::new("surgeon-hamlyn", &[("scope.yml", &CALIBRATION.replace("-15., 0.", "-5.4, 0."))]);
    let Some(done) = surgeon(&folder, &data.join("left/*.png"), &data.join("right/*.png"), &[]) else { return };
    is_right(&done, &folder);
    looks_right(&done, 8.0);
}
