//! Public data sets in graphs: ground truth compared with what the matcher finds, shipped graphs on other data than the phantom's, `panoscope
//! import`.

use crate::samples;
use std::path::Path;
use std::process::{Command, Output};

use crate::samples::Tree;
use panoscope_engine::Outcome;
use panoscope_graph::GraphOptions;
use panoscope_testing::Folder;
use panoscope_tests::{Run, named_program, root, run, run_file};

/// Views that are large enough to be matched.
const SIZE: (u32, u32) = (320, 240);

fn tree(folder: &Folder) -> Tree {
    Tree(folder.path().to_owned())
}

/// Value of a column in the first row of a table.
fn cell(folder: &Folder, file: &str, column: &str) -> f64 {
    let text = folder.read(file);
    let mut lines = text.lines();
    let at = lines.next().unwrap_or("").split(',').position(|name| name == column);
    let at = at.unwrap_or_else(|| panic!("{file} has no column {column}: {text}"));
    let row = lines.next().unwrap_or_else(|| panic!("{file} has no row: {text}"));
    row.split(',').nth(at).and_then(|value| value.parse().ok()).unwrap_or_else(|| panic!("{column}: {row}"))
}

/// Rectifies and matches the first sequence of `DIR/set` and writes the scores of disparity and depth compared with the ground truth.
fn judge(folder: &Folder, matcher: &str, more: &str) -> Run {
    let graph = format!(
        r#"
mode = "batch"
plugins = ["capture", "stereo", "sinks"]
[nodes.scope]
type = "data_set"
params = {{ folder = "set" }}
[nodes.rectify]
type = "rectify"
inputs = {{ left = "scope.left", right = "scope.right", calibration = "scope.calibration" }}
[nodes.match]
type = "stereo_bm"
inputs = {{ left = "rectify.left", right = "rectify.right" }}
params = {{ auto_offset = false, auto_range = false, {matcher} }}
[nodes.points]
type = "reproject"
inputs = {{ image = "rectify.left", disparity = "match.disparity", calibration = "rectify.calibration" }}
[nodes.disparity]
type = "evaluate_disparity"
inputs = {{ disparity = "match.disparity", truth = "scope.disparity" }}
[nodes.depth]
type = "evaluate_depth"
inputs = {{ depth = "points.depth", truth = "scope.depth" }}
[nodes.disparity_table]
type = "write_table"
inputs = {{ table = "disparity.table" }}
params = {{ path = "disparity.csv" }}
[nodes.depth_table]
type = "write_table"
inputs = {{ table = "depth.table" }}
params = {{ path = "depth.csv" }}
[nodes.raw]
type = "write_images"
inputs = {{ image = "scope.left" }}
params = {{ path = "raw.png" }}
[nodes.rectified]
type = "write_images"
inputs = {{ image = "rectify.left" }}
params = {{ path = "rectified.png" }}
{more}"#
    );
    let done = run(&folder.at("graph.toml"), &graph, 10, 2);
    assert_eq!(done.outcome, Outcome::Done, "{:?}", done.log);
    assert!(done.report.nodes.values().all(|node| node.faults == 0), "{:?}", done.log);
    done
}

/// Views that are already rectified, with principal columns 6 px apart: `rectify` leaves them unchanged, and depth accounts for `doffs`.
#[test]
fn matched_depth_of_rectified_views_agrees_with_the_truth() {
    const SHIFT: u32 = 14;
    let folder = Folder::new("data-sets-middlebury", &[]);
    let tree = tree(&folder);
    tree.picture("set/scene/im0.png", SIZE, 7, 0);
    tree.picture("set/scene/im1.png", SIZE, 7, SHIFT);
    tree.pfm("set/scene/disp0GT.pfm", SIZE, |x, _| if x < SHIFT { f32::INFINITY } else { SHIFT as f32 });
    let calibration = "cam0=[300 0 150; 0 300 120; 0 0 1]\ncam1=[300 0 156; 0 300 120; 0 0 1]\ndoffs=6\nbaseline=10\nwidth=320\nheight=240\n";
    tree.write("set/scene/calib.txt", calibration);
    judge(&folder, "min_disparity_px = 0, search_px = 32", "");
    assert!(cell(&folder, "disparity.csv", "bad1_pct") < 2.0, "{}", folder.read("disparity.csv"));
    assert!(cell(&folder, "disparity.csv", "coverage_pct") > 80.0, "{}", folder.read("disparity.csv"));
    // 300 px times 10 mm over 14 + 6 px: 150 mm; without doffs it would be 214 mm.
    assert!(cell(&folder, "depth.csv", "median_mm") < 0.5, "{}", folder.read("depth.csv"));
    let [raw, rectified] = ["raw.png", "rectified.png"].map(|file| image::open(folder.at(file)).expect("a picture"));
    assert!(raw == rectified, "`rectify` changed views that are rectified");
}

/// Gray of a smooth texture on a plane, `x` and `y` in mm.
fn texture(x: f64, y: f64) -> u8 {
    let lattice = |i: i64, j: i64| {
        let mut v = (i as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ (j as u64).wrapping_mul(0xC2B2_AE3D_27D4_EB4F);
        v = (v ^ (v >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        ((v >> 40) & 0xFF) as f64
    };
    let (x, y) = (x / 1.5, y / 1.5);
    let (i, j, u, v) = (x.floor() as i64, y.floor() as i64, x - x.floor(), y - y.floor());
    let row = |j: i64| lattice(i, j) * (1.0 - u) + lattice(i + 1, j) * u;
    (row(j) * (1.0 - v) + row(j + 1) * v) as u8
}

/// A SCARED keyframe of a slanted plane, rendered for raw cameras of which the right one is rotated by 6 degrees: `rectify` and the matcher find what
/// the points state, once these are moved into the rectified view.
#[test]
fn matched_depth_of_raw_views_agrees_with_points_of_the_raw_camera() {
    const FOCAL: f64 = 320.0;
    const CENTRE: [f64; 2] = [159.5, 119.5];
    const SLANT: f64 = 0.25;
    let turn = 6.0f64.to_radians();
    let (sine, cosine) = turn.sin_cos();
    // Right from left: X_r = R X_l + T.
    let r = [[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]];
    let t = [-4.5, 0.05, 0.1];
    // The plane z = 90 + SLANT x of the left camera along a ray from `origin`.
    let hit = |origin: [f64; 3], ray: [f64; 3]| {
        let along = (90.0 + SLANT * origin[0] - origin[2]) / (ray[2] - SLANT * ray[0]);
        [0, 1, 2].map(|axis| origin[axis] + along * ray[axis])
    };
    let ray = |x: u32, y: u32| [(f64::from(x) - CENTRE[0]) / FOCAL, (f64::from(y) - CENTRE[1]) / FOCAL, 1.0];
    let back = |v: [f64; 3]| [0, 1, 2].map(|column| (0..3).map(|row| r[row][column] * v[row]).sum::<f64>());
    let right_origin = back(t.map(|v: f64| -v));
    let folder = Folder::new("data-sets-scared", &[]);
    let tree = tree(&folder);
    tree.points("set/keyframe_1/left_depth_map.tiff", SIZE, |x, y| hit([0.0; 3], ray(x, y)).map(|v| v as f32));
    let picture = |file: &str, point: &dyn Fn(u32, u32) -> [f64; 3]| {
        let gray = |x: u32, y: u32| {
            let [px, py, _] = point(x, y);
            image::Rgb([texture(px, py); 3])
        };
        image::RgbImage::from_fn(SIZE.0, SIZE.1, gray).save(tree.at(file)).expect("a picture");
    };
    picture("set/keyframe_1/Left_Image.png", &|x, y| hit([0.0; 3], ray(x, y)));
    picture("set/keyframe_1/Right_Image.png", &|x, y| hit(right_origin, back(ray(x, y))));
    let k = [FOCAL, 0.0, CENTRE[0], 0.0, FOCAL, CENTRE[1], 0.0, 0.0, 1.0];
    let matrices = [
        samples::matrix("M1", 3, 3, &k),
        samples::matrix("D1", 1, 5, &[0.0; 5]),
        samples::matrix("M2", 3, 3, &k),
        samples::matrix("D2", 1, 5, &[0.0; 5]),
        samples::matrix("R", 3, 3, r.as_flattened()),
        samples::matrix("T", 3, 1, &t),
    ];
    tree.write("set/keyframe_1/endoscope_calibration.yaml", format!("%YAML:1.0\n---\n{}", matrices.concat()));
    // The z of the raw camera, for comparison.
    let raw_z = r#"
[nodes.raw_z]
type = "read_maps"
inputs = { image = "rectify.left" }
params = { path = "set/keyframe_1/left_depth_map.tiff", holds = "depth" }
[nodes.raw_depth]
type = "evaluate_depth"
inputs = { depth = "points.depth", truth = "raw_z.depth" }
[nodes.raw_table]
type = "write_table"
inputs = { table = "raw_depth.table" }
params = { path = "raw_depth.csv" }
"#;
    judge(&folder, "min_disparity_px = 0, search_px = 64", raw_z);
    let (moved, raw) = (cell(&folder, "depth.csv", "median_mm"), cell(&folder, "raw_depth.csv", "median_mm"));
    println!("median error {moved:.3} mm beside the moved points, {raw:.3} mm beside the raw z");
    assert!(raw > 4.0 * moved, "{moved} mm beside the moved points, {raw} mm beside the raw z");
    let scores = folder.read("disparity.csv");
    assert!(cell(&folder, "disparity.csv", "pixels") > 30_000.0, "{scores}");
    assert!(cell(&folder, "disparity.csv", "mean_px") < 0.3, "{scores}");
    assert!(cell(&folder, "depth.csv", "median_mm") < 1.0, "{}", folder.read("depth.csv"));
    let [raw, rectified] = ["raw.png", "rectified.png"].map(|file| image::open(folder.at(file)).expect("a picture"));
    assert!(raw != rectified, "raw views are rectified");
}

/// A shipped graph with the overlay `data_set.toml`. `None` where the test is skipped.
fn shipped(folder: &Folder, graph: &str, set: &Path, sequence: &str, sinks: &[(&str, &str)]) -> Option<Run> {
    let args = [("folder", set.display().to_string()), ("sequence", sequence.to_owned())];
    let options = GraphOptions {
        with: vec![root().join("graphs/sources/data_set.toml")],
        args: args.map(|(name, text)| (name.to_owned(), text)).to_vec(),
        set: sinks.iter().map(|(node, file)| format!("{node}.path={}", folder.at(file).display())).collect(),
        ..GraphOptions::default()
    };
    let done = run_file(&root().join("graphs").join(graph), &options, 5)?;
    assert_eq!(done.outcome, Outcome::Done, "{graph}: {:?}", done.log);
    let faults: Vec<_> = done.report.nodes.iter().filter(|(_, node)| node.faults > 0).map(|(id, _)| id).collect();
    assert!(faults.is_empty(), "{graph}: {faults:?}: {:?}", done.log);
    Some(done)
}

#[test]
fn graphs_judged_by_the_phantoms_truth_run_on_data_sets() {
    let folder = Folder::new("data-sets-graphs", &[]);
    let tree = tree(&folder);
    samples::middlebury(&tree);
    samples::cholecseg8k(&tree);
    let set = folder.at("MiddEval3");
    let done = shipped(&folder, "stereo_judged.toml", &set, "trainingQ/Adirondack", &[("still", "stereo.png")]);
    let done = done.expect("it needs no ONNX Runtime");
    assert_eq!(done.report.nodes["truth_colours"].count, 1, "{:?}", done.log);
    assert!(image::open(folder.at("stereo.png")).is_ok());
    let Some(done) = shipped(&folder, "tools_judged.toml", &folder.at("CholecSeg8k"), "", &[("still", "tools.png")])
    else {
        return;
    };
    assert!(done.report.nodes["true_boxes"].count > 0, "{:?}", done.log);
    assert!(image::open(folder.at("tools.png")).is_ok());
}

fn import(program: &Path, words: &[&str]) -> (Option<i32>, String, String) {
    let Output { status, stdout, stderr } =
        Command::new(program).arg("import").args(words).output().expect("the program starts");
    (status.code(), String::from_utf8_lossy(&stdout).into_owned(), String::from_utf8_lossy(&stderr).into_owned())
}

fn no_video(path: &Path) {
    std::fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
    std::fs::write(path, "a video").expect("a file");
}

#[test]
fn import_lists_what_it_found() {
    let Some(program) = named_program() else { return };
    let folder = Folder::new("data-sets-import", &[]);
    let tree = tree(&folder);
    samples::all(&tree, no_video);
    tree.write("Middlebury2014/Bicycle1-perfect/calib.txt", "cam0=[60 0 30; 0 60");
    let at = folder.path().display().to_string();
    let (code, said, errors) = import(&program, &[&at]);
    assert_eq!((code, errors.as_str()), (Some(0), ""), "{said}");
    let row = |name: &str| {
        let words = |line: &str| line.split_whitespace().map(str::to_owned).collect::<Vec<_>>();
        said.lines()
            .map(words)
            .find(|words| words.first().is_some_and(|word| word == name))
            .unwrap_or_else(|| panic!("no {name}:\n{said}"))
    };
    assert_eq!(row("sequence").join(" "), "sequence data set pictures size views calibration truth labels");
    assert_eq!(
        row("MiddEval3/trainingQ/Adirondack")[1..].join(" "),
        "Middlebury 1 64x48 2 150.00 mm, rectified disparity -"
    );
    assert_eq!(row("SCARED/dataset_1/keyframe_1/data")[1..].join(" "), "SCARED video - 2 4.20 mm points (2) -");
    assert_eq!(row("EndoVis2017/instrument_dataset_1")[1..].join(" "), "EndoVis 2017 1 1280x1024 2 4.35 mm - masks");
    assert_eq!(row("m2cai16-tool-locations")[1..].join(" "), "m2cai16-tool-locations 3 64x48 1 - - boxes (2)");
    assert_eq!(row("Middlebury2014/Bicycle1-perfect")[1..].join(" "), "Middlebury 1 64x48 2 damaged disparity -");
    for words in [
        "SCARED/dataset_8/keyframe_0/data: scene_points.tar.gz is packed",
        "Bicycle1-perfect/calib.txt: `width` is missing",
        "packed files are not read, unpack them",
        "--with graphs/sources/data_set.toml --folder",
    ] {
        // The folder of a packed file is searched only where no layout claims it.
        assert!(said.contains(words) || words.starts_with("packed"), "{words} is not said:\n{said}");
    }
    let (code, said, _) = import(&program, &[&at, "--json"]);
    let all: serde_json::Value = serde_json::from_str(&said).expect("JSON");
    let sequences = all["sequences"].as_array().expect("a list");
    assert_eq!((code, sequences.len()), (Some(0), 26));
    let of = |name: &str| sequences.iter().find(|s| s["sequence"] == name).unwrap_or_else(|| panic!("no {name}"));
    let kitti = of("KITTI/data_scene_flow/training/image_2");
    assert_eq!(kitti["calibration"]["files"], "one for each picture");
    assert_eq!((&kitti["truth"]["holds"], &kitti["truth"]["pictures"]), (&"disparity".into(), &2.into()));
    assert_eq!(of("CholecSeg8k/video01/video01_00080")["labels"]["classes"][1], "L-hook Electrocautery");
    let damaged = &of("Middlebury2014/Bicycle1-perfect")["calibration"];
    assert!(damaged["error"].as_str().is_some_and(|e| e.contains("is missing")) && damaged["baseline_mm"].is_null());
}

#[test]
fn import_says_what_it_looked_for() {
    let Some(program) = named_program() else { return };
    let folder = Folder::new("data-sets-import-none", &[("inside/notes.txt", "nothing"), ("set.tar.gz", "packed")]);
    let (code, said, errors) = import(&program, &[&folder.path().display().to_string()]);
    assert_eq!((code, said.as_str()), (Some(1), ""), "{errors}");
    for words in [
        "no data set of a known layout",
        "2 folders searched",
        "unpack them: set.tar.gz",
        "SCARED: endoscope_calibration.yaml",
        "KITTI: image_2 with image_3",
        "files.toml",
    ] {
        assert!(errors.contains(words), "{words} is not said:\n{errors}");
    }
    let (code, _, errors) = import(&program, &[&folder.at("nowhere").display().to_string()]);
    assert!(code == Some(2) && errors.contains("there is no folder"), "{errors}");
}

/// Real data sets, if this machine has them.
#[test]
fn real_pictures_play() {
    let data = root().join("../shared/data");
    if !data.is_dir() {
        return panoscope_testing::skipped!("there is no {}", data.display());
    }
    let folder = Folder::new("data-sets-real", &[]);
    let graph = format!(
        r#"
mode = "batch"
plugins = ["capture", "tools", "flow"]
[nodes.scope]
type = "data_set"
params = {{ folder = "{}", sequence = "m2cai16-tool-locations/test" }}
[nodes.judge]
type = "evaluate_detections"
inputs = {{ detections = "scope.detections", truth = "scope.detections" }}
[nodes.end]
type = "drain"
inputs = {{ image = "scope.left" }}
"#,
        data.display()
    );
    let done = run(&folder.at("graph.toml"), &graph, 20, 2);
    assert_eq!(done.outcome, Outcome::Done, "{:?}", done.log);
    assert_eq!((done.report.nodes["judge"].count, done.report.nodes["end"].count), (20, 20), "{:?}", done.log);
    let sinks = [("video", "wide.mkv"), ("still", "wide.png")];
    let done = shipped(&folder, "panorama.toml", &data.join("stereo"), "hamlyn_640x480", &sinks)
        .expect("no ONNX Runtime is needed");
    assert!(done.report.nodes["video"].count >= 4, "{:?}", done.log);
    let wide = image::open(folder.at("wide.png")).expect("the still");
    // Without the black rims of the views.
    assert!(wide.width() >= 560, "{} columns", wide.width());
}
