//! Exports in half precision, with channels last and with keypoints, as users have them. Their output does not depend on the image.

use std::path::{Path, PathBuf};

use panoscope_node::Bgr8;
use panoscope_node::abi::Tip;
use panoscope_node::harness::Harness;
use panoscope_tools::mask_rcnn::MaskRcnn;
use panoscope_tools::yolo::Yolo;

use crate::tiny_onnx::{Fixed, TinyModel, folder, runtime_is_there};

/// A file of the folder of foreign exports; `None` if it does not exist.
fn foreign(name: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/foreign").join(name);
    if !path.is_file() {
        panoscope_testing::skipped!("../shared/foreign/{name} is not there");
        return None;
    }
    runtime_is_there().then_some(path)
}

const SIZE: (usize, usize) = (640, 480);

fn image() -> Vec<u8> {
    vec![90; SIZE.0 * SIZE.1 * 3]
}

/// Boxes of a 640x480 image as x, y, width and height in px, label and score.
fn boxes(path: &Path) -> Vec<([f32; 4], String, f32)> {
    let mut node = Harness::<Yolo>::from_toml(&format!("params = {{ model = {path:?} }}")).expect("the model opens");
    let out = node.input_image::<Bgr8>("image", SIZE.0, SIZE.1, &image()).process().expect("it runs");
    let found = out.detections("detections").expect("detections");
    let one = |d: &panoscope_node::abi::Detection| {
        ([d.x_px, d.y_px, d.width_px, d.height_px], found.label(d.class_index).to_owned(), d.score)
    };
    found.items().iter().map(one).collect()
}

/// Compares within a tenth of a px and three digits of the score, the precision of half floats.
fn assert_box(found: &[([f32; 4], String, f32)], label: &str) {
    let [(at, name, score)] = found else { panic!("{found:?}") };
    let off = at.iter().zip([100.0, 200.0, 200.0, 60.0]).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(off < 0.1 && name == label && (score - 0.9).abs() < 1e-3, "{found:?}");
}

#[test]
fn an_export_in_half_precision_gives_its_box() {
    let Some(path) = foreign("yolov8_half.onnx") else { return };
    assert_box(&boxes(&path), "hook");
}

#[test]
fn an_export_with_channels_last_gives_its_box() {
    let Some(path) = foreign("yolov8_nhwc.onnx") else { return };
    assert_box(&boxes(&path), "hook");
}

#[test]
fn keypoints_of_a_pose_export_are_tips() {
    let Some(path) = foreign("yolov8_pose.onnx") else { return };
    assert_box(&boxes(&path), "tool");
    assert_keypoints(&path, SIZE, [[110.0, 220.0, 0.95], [290.0, 240.0, 0.8]]);
}

/// Runs the model on an image of `size` px; the first two tips and the table hold `points` (x, y and score), and no third tip is given.
fn assert_keypoints(path: &Path, size: (usize, usize), points: [[f64; 3]; 2]) {
    let mut node = Harness::<Yolo>::from_toml(&format!("params = {{ model = {path:?} }}")).expect("the model opens");
    let image = vec![90; size.0 * size.1 * 3];
    let out = node.input_image::<Bgr8>("image", size.0, size.1, &image).process().expect("it runs");
    let item = out.detections("detections").expect("detections").items()[0];
    let table = out.table("keypoints").expect("a table");
    assert_eq!(table.names().collect::<Vec<_>>(), ["box", "keypoint", "x_px", "y_px", "score"]);
    let rows: Vec<&[f64]> = table.rows().collect();
    assert_eq!(rows.len(), 2);
    for (index, (point, row)) in points.iter().zip(rows).enumerate() {
        let tip = out.value::<Tip>(&format!("tip{index}")).expect("a tip");
        let got = [tip.u_px, tip.v_px, tip.score];
        assert!(got.iter().zip(point).all(|(a, b)| (a - b).abs() < 0.01), "{got:?} instead of {point:?}");
        assert_eq!((tip.class_index, tip.track_id, tip.xyz_valid), (item.class_index, item.track_id, 0));
        assert!(tip.xyz_mm.iter().all(|mm| mm.is_nan()));
        assert_eq!(row, [0.0, index as f64, got[0], got[1], got[2]]);
    }
    assert!(out.is_empty("tip2").expect("an output") && out.is_empty("tip3").expect("an output"));
}

/// A pose export of 64 x 64 px with suppression inside: corners, score, class, two keypoints.
fn pose_end_to_end(shape: &str) -> TinyModel {
    let mut values = vec![0.0; 12 * 30];
    values[..12].copy_from_slice(&[24.0, 28.0, 40.0, 36.0, 0.9, 0.0, 26.0, 30.0, 0.75, 38.0, 34.0, 0.5]);
    TinyModel {
        input: vec![1, 3, 64, 64],
        outputs: vec![("output0", vec![1, 30, 12], Fixed::Floats(values))],
        metadata: vec![
            ("names", "{0: 'tool'}".into()),
            ("task", "pose".into()),
            ("kpt_shape", shape.into()),
            ("end2end", "True".into()),
        ],
    }
}

#[test]
fn keypoints_stand_behind_the_class_where_suppression_is_inside() {
    if !runtime_is_there() {
        return;
    }
    let path = pose_end_to_end("[2, 3]").write(&folder("pose_end_to_end"), "m.onnx");
    // 128 x 96 lies at 64 x 48 with 8 px above and below.
    assert_keypoints(&path, (128, 96), [[52.0, 44.0, 0.75], [76.0, 52.0, 0.5]]);
}

/// A detector of the YOLOX family of 64 x 64 px with one box (24, 28, 40, 36) and a map of tips of 2 x 2 cells.
fn with_tip_map(shape: Vec<i64>, map: Vec<f32>) -> TinyModel {
    // Strides 8, 16 and 32; cell (3, 3) of stride 8 has the box.
    let mut values = vec![0.0; 84 * 6];
    let size = |px: f32| (px / 8.0).ln();
    values[6 * 27..6 * 28].copy_from_slice(&[1.0, 1.0, size(16.0), size(8.0), 0.9, 1.0]);
    TinyModel {
        input: vec![1, 3, 64, 64],
        outputs: vec![("output", vec![1, 84, 6], Fixed::Floats(values)), ("tips", shape, Fixed::Floats(map))],
        metadata: vec![("names", "{0: 'tool'}".into()), ("task", "detect".into()), ("family", "yolox".into())],
    }
}

#[test]
fn a_map_of_tips_gives_each_box_its_tip() {
    if !runtime_is_there() {
        return;
    }
    // The second cell's tip is in the box, the third one's, with a higher score, is not.
    let map = vec![0.0, 0.7, 0.9, 0.0, 0.0, 26.0, 4.0, 0.0, 0.0, 34.0, 4.0, 0.0];
    let path = with_tip_map(vec![1, 3, 2, 2], map.clone()).write(&folder("tip_map"), "m.onnx");
    let mut node = Harness::<Yolo>::from_toml(&format!("params = {{ model = {path:?} }}")).expect("the model opens");
    let out = node.input_image::<Bgr8>("image", 128, 128, &vec![90; 128 * 128 * 3]).process().expect("it runs");
    let tip = out.value::<Tip>("tip0").expect("a tip");
    assert!(
        (tip.u_px - 52.0).abs() < 1e-3 && (tip.v_px - 68.0).abs() < 1e-3 && (tip.score - 0.7).abs() < 1e-6,
        "{tip:?}"
    );
    let table = out.table("keypoints").expect("a table");
    assert_eq!(table.rows().collect::<Vec<_>>(), [[0.0, 0.0, tip.u_px, tip.v_px, tip.score]]);
    assert!(out.is_empty("tip1").expect("an output"));
    // Two channels are no map of tips.
    let path = with_tip_map(vec![1, 2, 3, 2], map).write(&folder("no_tip_map"), "m.onnx");
    let error =
        Harness::<Yolo>::from_toml(&format!("params = {{ model = {path:?} }}")).err().expect("refused").to_string();
    assert!(error.contains("tips"), "{error}");
}

#[test]
fn nothing_found_gives_no_tip_and_an_empty_table() {
    if !runtime_is_there() {
        return;
    }
    let mut model = pose_end_to_end("[2, 3]");
    model.outputs[0].2 = Fixed::Floats(vec![0.0; 12 * 30]);
    let path = model.write(&folder("pose_nothing"), "m.onnx");
    let mut node = Harness::<Yolo>::from_toml(&format!("params = {{ model = {path:?} }}")).expect("the model opens");
    let out = node.input_image::<Bgr8>("image", 64, 48, &vec![90; 64 * 48 * 3]).process().expect("it runs");
    assert!(out.is_empty("tip0").expect("an output"));
    assert_eq!(out.table("keypoints").expect("a table").rows().count(), 0);
}

#[test]
fn exports_of_another_task_are_refused_by_its_name() {
    if !runtime_is_there() {
        return;
    }
    let folder = folder("tasks");
    for (task, is_yolo) in
        [("obb", true), ("classify", true), ("obb", false), ("classify", false), ("detect", false), ("pose", false)]
    {
        let model = TinyModel {
            input: vec![1, 3, 64, 64],
            outputs: vec![("output0", vec![1, 7, 84], Fixed::Floats(vec![0.0; 7 * 84]))],
            metadata: vec![("task", task.into())],
        };
        let path = model.write(&folder, "m.onnx");
        let params = format!("params = {{ model = {path:?} }}");
        let error = match is_yolo {
            true => Harness::<Yolo>::from_toml(&params).err().map(|e| e.to_string()),
            false => Harness::<MaskRcnn>::from_toml(&params).err().map(|e| e.to_string()),
        };
        let error = error.expect("refused");
        assert!(error.contains("m.onnx is exported for the task") && error.contains(&format!("`{task}`")), "{error}");
    }
}
