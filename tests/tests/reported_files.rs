//! Files from public bug reports of other projects: each plays with the correct values, or is refused with the reason.

use std::path::{Path, PathBuf};
use std::process::Command;

use panoscope_tests::machines::program;
use panoscope_tests::{root, scratch};

/// Expected result of running the graph in a folder of `../shared/foreign/reports`.
struct Case {
    folder: &'static str,
    arguments: &'static [&'static str],
    /// Whether it must succeed.
    is_right: bool,
    /// Part of its output.
    words: &'static str,
    /// Number of images that it writes.
    images: usize,
}

const fn plays(folder: &'static str, arguments: &'static [&'static str], images: usize, words: &'static str) -> Case {
    Case { folder, arguments, is_right: true, words, images }
}

const fn refused(folder: &'static str, arguments: &'static [&'static str], words: &'static str) -> Case {
    Case { folder, arguments, is_right: false, words, images: 0 }
}

static CASES: [Case; 21] = [
    plays("ros_unsorted", &["bag.toml", "--bag", "unsorted.mcap"], 60, "done: 30 frames"),
    plays("ros_zero_stamp", &["bag.toml", "--bag", "zero_stamp.mcap"], 60, "have no time"),
    plays("ros_mono16_12bit", &["bag.toml", "--bag", "mono16_12bit.mcap"], 20, "4095 is taken for white"),
    plays(
        "ros_empty_compressed",
        &["bag.toml", "--bag", "empty_compressed.mcap"],
        18,
        "it is empty; 1 message was left out",
    ),
    plays("ros_d1", &["bag.toml", "--bag", "d1.mcap"], 10, "done: 5 frames"),
    plays("ros_binning", &["bagrect.toml", "--bag", "binning2.mcap"], 5, "done: 5 frames"),
    plays("ros_binning", &["bagrect.toml", "--bag", "roi.mcap"], 5, "done: 5 frames"),
    refused("ros_r_zero", &["bagrect.toml", "--bag", "r_zero.mcap"], "its rectification R is all zero"),
    plays("mkv_late_start", &["vid.toml", "--left", "offset.mkv"], 20, "done: 20 frames"),
    plays("raw_mjpeg", &["vid.toml", "--left", "m.mjpeg"], 10, "done: 10 frames"),
    plays("pnm_maxval", &["still.toml", "--left", "max1.pgm"], 1, "done"),
    plays("pnm_maxval", &["still.toml", "--left", "dark_max4095.pgm"], 1, "done"),
    plays("tiff_kinds", &["still.toml", "--left", "bigtiff.tif"], 1, "done"),
    refused("tiff_kinds", &["still.toml", "--left", "one_bit.tif"], "Gray(1)) is not supported"),
    refused("tiff_kinds", &["still.toml", "--left", "planar.tif"], "one plane for each colour"),
    refused("tiff_kinds", &["still.toml", "--left", "stack.tif"], "it has 4 pages"),
    plays("path_bang", &["still.toml", "--left", "wow!.png"], 1, "done"),
    plays("calibration_transposed", &["depthcal.toml", "--cal", "metres.yml"], 0, "is its translation in m?"),
    refused("calibration_transposed", &["depthcal.toml", "--cal", "transposed.yml"], "`M1` is transposed"),
    plays("cjk_label", &["yolo.toml", "--model", "names.onnx"], 1, "cannot draw the class name"),
    refused("ros_unsorted", &["bag.toml", "--bag", "missing.mcap"], "missing.mcap"),
];

/// The images that a run wrote, in order.
fn images(folder: &Path) -> Vec<PathBuf> {
    let there = folder.join("out").read_dir().into_iter().flatten().flatten().map(|entry| entry.path());
    let mut images: Vec<PathBuf> = there.filter(|path| path.extension().is_some_and(|e| e == "png")).collect();
    images.sort();
    images
}

/// What is wrong with a case; `None` if nothing.
fn mistake(program: &Path, reports: &Path, case: &Case) -> Option<String> {
    let folder = scratch("reported");
    for entry in reports.join(case.folder).read_dir().expect("a folder").flatten() {
        std::fs::write(folder.join(entry.file_name()), std::fs::read(entry.path()).expect("a file")).expect("a copy");
    }
    let mut command = Command::new(program);
    command.current_dir(&folder).arg("run").args(case.arguments);
    panoscope_testing::own_settings(&mut command, &folder);
    let output = command.output().expect("it starts");
    let said = String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
    let written = images(&folder).len();
    let _ = std::fs::remove_dir_all(&folder);
    if said.contains("ONNX Runtime") && !output.status.success() {
        panoscope_testing::skipped!("{} needs ONNX Runtime", case.folder);
        return None;
    }
    let is_right = output.status.success() == case.is_right
        && said.contains(case.words)
        && (!case.is_right || written == case.images);
    (!is_right).then(|| format!("{} {:?}: {written} images, {}\n{said}", case.folder, case.arguments, output.status))
}

#[test]
fn files_that_people_reported_elsewhere_play_or_are_refused_with_the_reason() {
    let Some(program) = program() else { return panoscope_testing::skipped!("there is no program `panoscope`") };
    let reports = root().join("../shared/foreign/reports");
    if !reports.is_dir() {
        return panoscope_testing::skipped!("../shared/foreign/reports is not there");
    }
    let wrong: Vec<String> = CASES.iter().filter_map(|case| mistake(&program, &reports, case)).collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
