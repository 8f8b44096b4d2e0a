//! A source that fails names its position, does not hide the fault, and does not restart at its first frame.

use std::path::{Path, PathBuf};

use panoscope_engine::Outcome;
use panoscope_tests::{Run, run, scratch};

const PICTURES: usize = 12;
const DAMAGED: usize = 5;

fn pictures(name: &str) -> PathBuf {
    let folder = scratch(name);
    for index in 0..PICTURES {
        let picture = image::GrayImage::from_pixel(32, 24, image::Luma([index as u8 * 20]));
        picture.save(folder.join(format!("{index:03}.png"))).expect("a picture");
    }
    let damaged = folder.join(format!("{DAMAGED:03}.png"));
    let bytes = std::fs::read(&damaged).expect("its bytes");
    std::fs::write(damaged, &bytes[..bytes.len() / 2]).expect("half of them");
    folder
}

fn play(folder: &Path, mode: &str, params: &str) -> Run {
    let graph = format!(
        r#"
mode = "{mode}"
plugins = ["capture", "flow"]
[nodes.scope]
type = "capture"
params = {{ left = "*.png", pace = "off"{params} }}
[nodes.sink]
type = "drain"
inputs = {{ image = "scope.left" }}
"#
    );
    run(&folder.join("graph.toml"), &graph, 300, 2)
}

#[test]
fn a_batch_ends_at_a_damaged_picture() {
    let folder = pictures("sources-batch");
    let done = play(&folder, "batch", "");
    let scope = &done.report.nodes["scope"];
    assert_eq!((scope.faults, scope.restarts), (1, 0), "{:?}", done.log);
    assert_eq!(done.report.nodes["sink"].count, DAMAGED as u64);
    assert!(done.log.iter().any(|line| line.contains("005.png") && line.contains("image 6 of 12")), "{:?}", done.log);
    let done = play(&folder, "batch", ", on_damage = \"skip\"");
    assert_eq!(done.report.nodes["scope"].faults, 0);
    assert_eq!(done.report.nodes["sink"].count, PICTURES as u64 - 1);
    assert_eq!(done.outcome, Outcome::Done);
    let _ = std::fs::remove_dir_all(folder);
}

#[test]
fn a_live_source_goes_on_with_the_next_picture() {
    let folder = pictures("sources-live");
    let done = play(&folder, "live", "");
    let scope = &done.report.nodes["scope"];
    assert_eq!((scope.faults, scope.restarts), (1, 1), "{:?}", done.log);
    // All pictures but one, and the damaged one counted as a call: nothing comes twice.
    assert_eq!(scope.count, PICTURES as u64, "{:?}", done.log);
    let _ = std::fs::remove_dir_all(folder);
}
