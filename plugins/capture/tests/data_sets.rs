//! `data_set` on tiny copies of each layout: images, calibration, ground truth at known pixels, boxes.

use crate::samples;
use std::path::Path;

use crate::common::{Folder, encode, value};
use crate::samples::{DOFFS, HEIGHT, MIDDLEBURY_BASELINE, MIDDLEBURY_FOCAL, SCARED_Z, SHIFT, Tree, WIDTH};
use panoscope_capture::data_set::DataSet;
use panoscope_node::abi::Calibration;
use panoscope_node::harness::{Harness, HarnessError, Level, Outputs, Setup};
use panoscope_node::{Bgr8, Depth, Disparity};

const FRAMES: u8 = 3;

/// The left view above the right one: gray `20 i + 10` and 200.
fn video(path: &Path) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let (width, height) = (WIDTH as usize, HEIGHT as usize);
    let frame = |i: u8| [vec![20 * i + 10; 3 * width * height], vec![200; 3 * width * height]].concat();
    encode(path, 20.0, (width, 2 * height), "jpegenc ! avimux", (0..FRAMES).map(frame).enumerate());
}

fn tree(folder: &Folder) -> Tree {
    Tree(folder.0.clone())
}

fn try_open(folder: &Folder, params: &str) -> Result<Harness<DataSet>, HarnessError> {
    Harness::open(Setup::new(&format!("params = {{ {params} }}")).graph_dir(&folder.0).batch())
}

fn open(folder: &Folder, set: &str, sequence: &str) -> Harness<DataSet> {
    try_open(folder, &format!("folder = \"{set}\", sequence = \"{sequence}\"")).unwrap()
}

fn drain(node: &mut Harness<DataSet>) -> Vec<Outputs> {
    let mut all = Vec::new();
    loop {
        let out = node.process().unwrap();
        if out.ended() || all.len() > 100 {
            return all;
        }
        all.push(out);
    }
}

fn disparity(out: &Outputs, x: u32, y: u32) -> f32 {
    out.plane::<Disparity>("disparity").unwrap().row(y as usize)[x as usize]
}

fn depth(out: &Outputs, x: u32, y: u32) -> f32 {
    out.plane::<Depth>("depth").unwrap().row(y as usize)[x as usize]
}

fn near(found: f32, expected: f64) {
    assert!((f64::from(found) - expected).abs() < 1e-4 * expected.abs(), "{found}, not {expected}");
}

fn is_empty(out: &Outputs, port: &str) -> bool {
    out.is_empty(port).unwrap()
}

/// Boxes and class names of a tick.
fn boxes(out: &Outputs) -> Vec<([f32; 4], String)> {
    let found = out.detections("detections").unwrap();
    let of = |item: &panoscope_node::abi::Detection| {
        assert_eq!(item.score, 1.0);
        ([item.x_px, item.y_px, item.width_px, item.height_px], found.label(item.class_index).to_owned())
    };
    found.items().iter().map(of).collect()
}

/// Checks maps of the plane that SCARED's copy shows, `z` mm in front of the raw left camera.
fn is_plane(out: &Outputs, z: f64) {
    let calibration: Calibration = out.value("calibration").unwrap();
    assert_eq!(calibration.is_rectified, 0, "the views are raw");
    let (r, p, q) = (calibration.rectified_from_left, calibration.left_projection, calibration.right_projection);
    assert!((r[2]).abs() > 0.01, "the left camera is turned by rectification: {r:?}");
    let (mut known, mut apart) = (0, 0.0f64);
    for y in 0..HEIGHT {
        for x in 0..WIDTH {
            let found = depth(out, x, y);
            if found.is_nan() {
                assert!(disparity(out, x, y).is_nan());
                continue;
            }
            let (xr, yr) = ((f64::from(x) - p[2]) / p[0], (f64::from(y) - p[6]) / p[5]);
            // The raw z of a rectified point is the plane's distance.
            let expected = z / (r[2] * xr + r[5] * yr + r[8]);
            assert!((f64::from(found) - expected).abs() < 0.08, "({x}, {y}): {found}, not {expected}");
            near(disparity(out, x, y), -q[3] / expected + p[2] - q[2] + (-q[3] / f64::from(found) + q[3] / expected));
            known += 1;
            apart = apart.max((expected - z).abs());
        }
    }
    assert!(known > WIDTH * HEIGHT / 2, "{known} pixels are known");
    assert!(apart > 1.0, "the raw z would be off by {apart} mm only");
}

#[test]
fn scareds_points_are_moved_into_the_rectified_view() {
    let folder = Folder::new("scared");
    samples::scared(&tree(&folder), video);
    let all = drain(&mut open(&folder, "SCARED", "dataset_1/keyframe_1"));
    assert_eq!(all.len(), 1);
    let [left, right] = ["left", "right"].map(|port| all[0].plane::<Bgr8>(port).unwrap());
    assert_eq!([left.width, left.height, right.width], [WIDTH as usize, HEIGHT as usize, WIDTH as usize]);
    assert_ne!(left.data, right.data);
    is_plane(&all[0], SCARED_Z);
    assert!(is_empty(&all[0], "detections") && is_empty(&all[0], "tip"));
    // The corner without points is unknown.
    let unknown = all[0].plane::<Depth>("depth").unwrap().data.iter().filter(|z| z.is_nan()).count();
    assert!(unknown > 30, "{unknown}");
}

#[test]
fn scareds_video_has_the_points_of_its_frames() {
    let folder = Folder::new("scared_video");
    samples::scared(&tree(&folder), video);
    let mut node = open(&folder, "SCARED", "dataset_1/keyframe_1/data");
    let all = drain(&mut node);
    assert_eq!(all.len(), FRAMES as usize);
    for (index, out) in all.iter().enumerate() {
        let (left, right) = (out.plane::<Bgr8>("left").unwrap(), out.plane::<Bgr8>("right").unwrap());
        assert_eq!((left.height, right.height), (HEIGHT as usize, HEIGHT as usize));
        assert!(left.data[0].abs_diff(20 * index as u8 + 10) < 6 && right.data[0].abs_diff(200) < 6);
        match index {
            0 => is_plane(out, 80.0),
            1 => assert!(is_empty(out, "depth") && is_empty(out, "disparity") && !is_empty(out, "calibration")),
            _ => is_plane(out, 90.0),
        }
    }
    assert!(node.logs().iter().any(|line| line.level == Level::Info && line.message.contains("kinematics")));
}

#[test]
fn stereomis_is_one_video_of_raw_views() {
    let folder = Folder::new("stereomis");
    samples::stereomis(&tree(&folder), video);
    let all = drain(&mut open(&folder, "StereoMIS_0_0_1", ""));
    assert_eq!(all.len(), FRAMES as usize);
    let calibration: Calibration = all[0].value("calibration").unwrap();
    assert_eq!((calibration.is_rectified, calibration.right.cx, calibration.baseline_mm), (0, 33.5, 4.15));
    assert!(calibration.right_projection[3] < 0.0, "with its rectification");
    assert!(is_empty(&all[0], "depth") && is_empty(&all[0], "detections"));
}

#[test]
fn hamlyns_depth_gives_disparity() {
    let folder = Folder::new("hamlyn");
    samples::hamlyn(&tree(&folder));
    let all = drain(&mut open(&folder, "hamlyn", "rectified01/rectified01"));
    assert_eq!(all.len(), 3);
    let calibration: Calibration = all[2].value("calibration").unwrap();
    assert_eq!((calibration.is_rectified, calibration.left.width, calibration.baseline_mm), (1, WIDTH, 5.4));
    near(depth(&all[2], 10, 10), 90.0);
    near(disparity(&all[2], 10, 10), 60.0 * 5.4 / 90.0);
    assert!(depth(&all[2], 3, 10).is_nan() && disparity(&all[2], 3, 10).is_nan());
    // The sequences for tracking have one view, and depth without a calibration.
    let all = drain(&mut open(&folder, "hamlyn_tracking", "test1"));
    near(depth(&all[0], 3, 3), 70.0);
    assert!(is_empty(&all[0], "right") && is_empty(&all[0], "disparity") && is_empty(&all[0], "calibration"));
}

#[test]
fn kittis_calibration_and_truth_belong_to_single_pictures() {
    let folder = Folder::new("kitti");
    samples::kitti(&tree(&folder));
    let all = drain(&mut open(&folder, "KITTI", "data_scene_flow/training/image_2"));
    let focal: Vec<f64> = all.iter().map(|out| out.value::<Calibration>("calibration").unwrap().left.fx).collect();
    assert_eq!(focal, [60.0, 60.0, 50.0]);
    // 0.54 m between cameras 2 and 3.
    near(depth(&all[0], 20, 4), 60.0 * 540.0 / f64::from(SHIFT));
    near(depth(&all[2], 20, 4), 50.0 * 540.0 / f64::from(SHIFT));
    assert_eq!(disparity(&all[0], 20, 4), SHIFT as f32);
    assert!(disparity(&all[0], 20, 5).is_nan() && depth(&all[0], 2, 4).is_nan(), "sparse as in the file");
    assert!(is_empty(&all[1], "disparity"), "000000_11 has none");
    let all = drain(&mut open(&folder, "KITTI", "data_stereo_flow/training/image_0"));
    near(depth(&all[0], 9, 9), 60.0 * 500.0 / f64::from(SHIFT));
    let all = drain(&mut open(&folder, "KITTI", "2011_09_26/2011_09_26_drive_0001_sync/image_02"));
    assert!(is_empty(&all[0], "depth"));
    near(depth(&all[1], 9, 9), 12_500.0);
    near(disparity(&all[1], 9, 9), 60.0 * 540.0 / 12_500.0);
    assert!(depth(&all[1], 5, 9).is_nan());
    let all = drain(&mut open(&folder, "KITTI/dataset", "sequences/00/image_0"));
    assert_eq!((all.len(), is_empty(&all[3], "depth")), (4, true));
    let calibration: Calibration = all[3].value("calibration").unwrap();
    assert_eq!((calibration.left.width, calibration.left.height), (WIDTH, HEIGHT), "from the pictures");
}

#[test]
fn middleburys_disparities_are_shifted_by_doffs() {
    let folder = Folder::new("middlebury");
    samples::middlebury(&tree(&folder));
    for (set, sequence) in [("MiddEval3", "trainingQ/Adirondack"), ("Middlebury2014", "")] {
        let all = drain(&mut open(&folder, set, sequence));
        assert_eq!(disparity(&all[0], 40, 7), SHIFT as f32);
        near(depth(&all[0], 40, 7), MIDDLEBURY_FOCAL * MIDDLEBURY_BASELINE / (f64::from(SHIFT) + DOFFS));
        assert!(disparity(&all[0], 2, 7).is_nan() && depth(&all[0], 2, 7).is_nan());
    }
    for (set, first) in [("Middlebury2006", "Aloe"), ("Middlebury2003", "cones")] {
        let all = drain(&mut open(&folder, set, first));
        assert_eq!(disparity(&all[0], 40, 7), SHIFT as f32);
        assert!(disparity(&all[0], 2, 7).is_nan() && is_empty(&all[0], "depth") && is_empty(&all[0], "calibration"));
    }
    let all = drain(&mut open(&folder, "MiddEval3", "testQ/Australia"));
    assert!(is_empty(&all[0], "disparity") && !is_empty(&all[0], "calibration"));
}

#[test]
fn masks_of_instruments_become_boxes() {
    let folder = Folder::new("endovis");
    samples::endovis(&tree(&folder));
    let all = drain(&mut open(&folder, "EndoVis2017", "instrument_dataset_2"));
    assert_eq!(all.len(), 2);
    // The speck of four pixels is none.
    let expected = [([10.0, 8.0, 12.0, 6.0], "Bipolar Forceps"), ([30.0, 20.0, 5.0, 9.0], "Other")];
    assert_eq!(boxes(&all[0]), expected.map(|(place, name)| (place, name.to_owned())));
    assert!(is_empty(&all[1], "detections") && is_empty(&all[1], "instances"), "not labelled is not nothing there");
    let found = all[0].instances("instances").unwrap();
    let list = found.detections();
    assert_eq!((list.items().len(), list.image_size()), (2, (WIDTH as usize, HEIGHT as usize)));
    // The border of full frames is cut off, from the masks too.
    let all = drain(&mut open(&folder, "EndoVis2017", "instrument_dataset_1"));
    let left = all[0].plane::<Bgr8>("left").unwrap();
    assert_eq!((left.width, left.height), (1280, 1024));
    assert_eq!(all[0].value::<Calibration>("calibration").unwrap().left.width, 1280);
    let expected = ([100.0, 100.0, 230.0, 122.0], "Prograsp Forceps".to_owned());
    assert_eq!(boxes(&all[0]), [expected], "parts of one instrument touch");
    let whole =
        image::open(folder.0.join("EndoVis2017/instrument_dataset_1/left_frames/frame000.png")).unwrap().to_rgb8();
    assert_eq!(left.row(0)[0], whole.get_pixel(320, 28).0[2]);
    let all = drain(&mut open(&folder, "EndoVis2018", ""));
    let expected = [([4.0, 4.0, 20.0, 5.0], "instrument-shaft"), ([24.0, 4.0, 6.0, 5.0], "instrument-clasper")];
    assert_eq!(boxes(&all[0]), expected.map(|(place, name)| (place, name.to_owned())));
}

#[test]
fn cholecseg8ks_codes_are_instruments_and_tissue() {
    let folder = Folder::new("cholecseg8k");
    samples::cholecseg8k(&tree(&folder));
    let all = drain(&mut open(&folder, "CholecSeg8k", ""));
    assert_eq!(all.len(), 2);
    let expected = [([5.0, 6.0, 10.0, 4.0], "Grasper"), ([40.0, 20.0, 8.0, 8.0], "L-hook Electrocautery")];
    assert_eq!(boxes(&all[0]), expected.map(|(place, name)| (place, name.to_owned())));
    assert!(is_empty(&all[1], "detections") && is_empty(&all[0], "right"));
    let found = all[0].instances("instances").unwrap();
    let set: u32 = found.mask(0).iter().map(|byte| byte.count_ones()).sum();
    assert_eq!(set, 40, "10 x 4 pixels");
}

#[test]
fn boxes_of_voc_and_yolo_are_scaled_to_the_picture() {
    let folder = Folder::new("boxes");
    samples::boxes(&tree(&folder));
    let all = drain(&mut open(&folder, "m2cai16-tool-locations", "m2cai16-tool-locations/test"));
    assert_eq!(all.len(), 2);
    assert_eq!(boxes(&all[0]), [([10.0, 5.0, 10.0, 10.0], "Hook".to_owned())]);
    assert!(boxes(&all[1]).is_empty() && is_empty(&all[0], "instances"), "a picture without a file shows nothing");
    let found = all[0].detections("detections").unwrap();
    assert_eq!((found.label(0), found.label(1)), ("Grasper", "Bipolar"), "the list's order");
    let all = drain(&mut open(&folder, "yolo", "yolo/train"));
    assert_eq!(boxes(&all[0]), [([24.0, 12.0, 16.0, 24.0], "hook".to_owned())]);
}

#[test]
fn a_loop_starts_again_with_its_truth_and_a_new_instance_goes_on() {
    let folder = Folder::new("loop");
    samples::kitti(&tree(&folder));
    let params = r#"folder = "KITTI", sequence = "data_scene_flow/training/image_2", loop = true, rate_hz = 10.0"#;
    let mut node = try_open(&folder, params).unwrap();
    let has: Vec<bool> = (0..5).map(|_| !is_empty(&node.process().unwrap(), "disparity")).collect();
    assert_eq!(has, [true, false, true, true, false]);
    let state = node.save_state().unwrap().unwrap();
    assert!(state.len() < 1000, "{} bytes for two names and numbers", state.len());
    let mut next = try_open(&folder, params).unwrap();
    next.load_state(&state).unwrap();
    let out = next.process().unwrap();
    assert_eq!(out.value::<Calibration>("calibration").unwrap().left.fx, 50.0, "the third picture");
    assert_eq!(out.tick().capture_ns, 500_000_000);
    // Another sequence begins at its first picture.
    let mut other = open(&folder, "KITTI", "dataset/sequences/00/image_0");
    other.load_state(&state).unwrap();
    assert_eq!(drain(&mut other).len(), 4);
}

#[test]
fn the_first_sequence_is_taken_and_said() {
    let folder = Folder::new("first");
    samples::middlebury(&tree(&folder));
    samples::pairs(&tree(&folder));
    let node = open(&folder, ".", "");
    let said =
        node.logs().iter().any(|line| line.message.contains("`MiddEval3/testQ/Australia` is the first of 6 sequences"));
    assert!(said, "{:?}", node.logs());
    let all = drain(&mut open(&folder, "pairs", ""));
    assert_eq!(all.len(), 2);
    assert_ne!(value(&all[0], "left"), value(&all[0], "right"));
}

#[test]
fn what_is_wrong_is_named_with_its_file() {
    let folder = Folder::new("wrong");
    let tree = tree(&folder);
    samples::middlebury(&tree);
    samples::scared(&tree, |path| std::fs::create_dir_all(path.parent().unwrap()).unwrap());
    samples::endovis(&tree);
    let refused = |params: &str| try_open(&folder, params).err().unwrap().to_string();
    assert!(refused("").contains("no folder is given"), "{}", refused(""));
    assert!(refused(r#"folder = "nowhere""#).contains("there is no folder"), "{}", refused(r#"folder = "nowhere""#));
    std::fs::create_dir(folder.0.join("empty")).unwrap();
    let message = refused(r#"folder = "empty""#);
    assert!(message.contains("no data set of a known layout (SCARED; StereoMIS"), "{message}");
    let message = refused(r#"folder = "MiddEval3", sequence = "trainingQ/Adirondak""#);
    assert!(
        message.contains("has no sequence `trainingQ/Adirondak`") && message.contains("testQ/Australia"),
        "{message}"
    );
    let failure = |set: &str, sequence: &str| {
        let opened = try_open(&folder, &format!("folder = \"{set}\", sequence = \"{sequence}\""));
        opened.and_then(|mut node| node.process()).err().unwrap().to_string()
    };
    // A calibration that is cut off.
    let whole = std::fs::read_to_string(tree.at("MiddEval3/testQ/Australia/calib.txt")).unwrap();
    tree.write("MiddEval3/testQ/Australia/calib.txt", &whole[..whole.len() / 2]);
    let message = failure("MiddEval3", "testQ/Australia");
    assert!(message.contains("Australia/calib.txt"), "{message}");
    // One for views of another size.
    tree.write("MiddEval3/testQ/Australia/calib.txt", whole.replace("width=64", "width=128"));
    let message = failure("MiddEval3", "testQ/Australia");
    assert!(message.contains("views of 128x48, but view 0 is 64x48"), "{message}");
    // Truth that is cut off, or of another size.
    let truth = tree.at("MiddEval3/trainingQ/Adirondack/disp0GT.pfm");
    let bytes = std::fs::read(&truth).unwrap();
    std::fs::write(&truth, &bytes[..1000]).unwrap();
    let message = failure("MiddEval3", "trainingQ/Adirondack");
    assert!(message.contains("disp0GT.pfm"), "{message}");
    std::fs::write(&truth, b"Pf\n1 1\n-1\n1234").unwrap();
    let message = failure("MiddEval3", "trainingQ/Adirondack");
    assert!(message.contains("disp0GT.pfm is 1x1, but its image is 64x48"), "{message}");
    let points = tree.at("SCARED/dataset_1/keyframe_1/left_depth_map.tiff");
    let bytes = std::fs::read(&points).unwrap();
    std::fs::write(&points, &bytes[..bytes.len() / 2]).unwrap();
    let message = failure("SCARED", "dataset_1/keyframe_1");
    assert!(message.contains("left_depth_map.tiff"), "{message}");
    // A mask of another size, and one that is none.
    let mask = "EndoVis2017/instrument_dataset_2/ground_truth/Other_labels/frame000.png";
    tree.mask(mask, (10, 10), &[]);
    let message = failure("EndoVis2017", "instrument_dataset_2");
    assert!(message.contains("Other_labels/frame000.png is 10x10, but its image is 64x48"), "{message}");
    tree.write(mask, "no picture");
    let message = failure("EndoVis2017", "instrument_dataset_2");
    assert!(message.contains("the mask is damaged or not a PNG"), "{message}");
}

#[test]
fn outputs_that_stay_empty_are_warned_of() {
    let folder = Folder::new("lacks");
    samples::middlebury(&tree(&folder));
    samples::pairs(&tree(&folder));
    let problems = |params: &str, read: &[&str]| -> Vec<String> {
        let setup = Setup::new(&format!("params = {{ {params} }}")).graph_dir(&folder.0).read_only(read);
        let found = Harness::<DataSet>::problems(&setup, &[]).unwrap();
        found.into_iter().map(|problem| format!("{problem:?}")).collect()
    };
    assert!(problems(r#"folder = "MiddEval3", sequence = "trainingQ/Adirondack""#, &["left", "depth"]).is_empty());
    let said = problems(r#"folder = "pairs""#, &["left", "calibration", "depth"]);
    assert!(said.iter().any(|p| p.contains("output `calibration` is connected but stays empty")), "{said:?}");
    assert!(said.iter().any(|p| p.contains("the sequence has no ground-truth maps")), "{said:?}");
    let said = problems(r#"folder = "Middlebury2006""#, &["disparity", "depth"]);
    assert!(said.len() == 1 && said[0].contains("a calibration is needed to convert disparity to depth"), "{said:?}");
    assert!(problems("", &["left"])[0].contains("no folder is given"));
    assert!(problems(r#"folder = "pairs", sequence = "x""#, &["left"])[0].contains("has no sequence `x`"));
}
