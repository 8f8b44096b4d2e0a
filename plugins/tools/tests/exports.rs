//! Every kind of export is recognised, and its boxes are where the network put them.

use std::path::Path;

use crate::tiny_onnx::{Fixed, TinyModel, folder, runtime_is_there};
use panoscope_node::abi::Detection;
use panoscope_node::harness::{Harness, HarnessError};
use panoscope_node::{Bgr8, Mask};
use panoscope_tools::mask_rcnn::MaskRcnn;
use panoscope_tools::yolo::Yolo;

const NAMES: &str = "{0: 'grasper', 1: 'hook'}";
/// Input 64 x 64: 64 + 16 + 4 cells.
const CELLS: usize = 84;

fn model(outputs: Vec<(&'static str, Vec<i64>, Fixed)>) -> TinyModel {
    TinyModel { input: vec![1, 3, 64, 64], outputs, metadata: vec![("names", NAMES.into())] }
}

fn open(path: &Path, more: &str) -> Result<Harness<Yolo>, HarnessError> {
    Harness::<Yolo>::from_toml(&format!("params = {{ model = {path:?}, min_score = 0.25 {more} }}"))
}

/// Runs on a gray image of 128 x 96 px, twice as large as the input, and returns the boxes.
fn boxes(path: &Path, more: &str) -> Vec<(Detection, String)> {
    let mut node = open(path, more).expect("the model opens");
    let out = node.input_image::<Bgr8>("image", 128, 96, &vec![90; 128 * 96 * 3]).process().expect("it runs");
    let found = out.detections("detections").expect("detections");
    assert_eq!(found.image_size(), (128, 96));
    found.items().iter().map(|d| (*d, found.label(d.class_index).to_owned())).collect()
}

fn near(d: &Detection, want: [f32; 4]) {
    let got = [d.x_px, d.y_px, d.x_px + d.width_px, d.y_px + d.height_px];
    let off = got.iter().zip(&want).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(off < 0.05, "{got:?} instead of {want:?}");
}

fn rows(count: usize, len: usize, set: &[(usize, Vec<f32>)]) -> Fixed {
    let mut values = vec![0.0; count * len];
    for (row, v) in set {
        values[row * len..row * len + v.len()].copy_from_slice(v);
    }
    Fixed::Floats(values)
}

/// Cell (3, 2) of stride 8 is row 19: centre (28, 20), size 16 x 8 in the input; the image is twice as large.
fn one_hook() -> TinyModel {
    let v = vec![0.5, 0.5, 2f32.ln(), 0.0, 0.9, 0.1, 0.8];
    model(vec![("output", vec![1, CELLS as i64, 7], rows(CELLS, 7, &[(19, v)]))])
}

#[test]
fn yolox_boxes_are_relative_to_the_grid() {
    if !runtime_is_there() {
        return;
    }
    let m = one_hook();
    let found = boxes(&m.write(&folder("yolox"), "m.onnx"), "");
    assert_eq!(found.len(), 1);
    assert_eq!(found[0].1, "hook");
    assert!((found[0].0.score - 0.72).abs() < 1e-5);
    near(&found[0].0, [40.0, 32.0, 72.0, 48.0]);
}

#[test]
fn boxes_in_the_dark_are_dropped() {
    if !runtime_is_there() {
        return;
    }
    let path = one_hook().write(&folder("lit"), "m.onnx");
    // The box covers columns 40 to 72.
    for (first, expected) in [(0, 1), (50, 1), (62, 0)] {
        let mask: Vec<u8> = (0..128 * 96).map(|i| if i % 128 >= first { 255 } else { 0 }).collect();
        let mut node = open(&path, "").expect("the model opens");
        let out = node
            .input_image::<Bgr8>("image", 128, 96, &vec![90; 128 * 96 * 3])
            .input_image::<Mask>("mask", 128, 96, &mask)
            .process()
            .expect("it runs");
        assert_eq!(out.detections("detections").expect("detections").items().len(), expected, "lit from {first} on");
    }
}

/// A model with three rows: a certain hook, an instrument of uncertain kind, and a weak one.
fn calibrated(folder_name: &str, more: &[(&'static str, &str)]) -> std::path::PathBuf {
    let row =
        |x: f32, objectness: f32, grasper: f32, hook: f32| vec![x, 0.5, 2f32.ln(), 0.0, objectness, grasper, hook];
    let set = [(19, row(0.5, 0.9, 0.1, 0.8)), (3, row(0.5, 0.9, 0.3, 0.35)), (40, row(0.5, 0.2, 0.6, 0.1))];
    let mut m = model(vec![("output", vec![1, CELLS as i64, 7], rows(CELLS, 7, &set))]);
    m.metadata.extend(more.iter().map(|(key, value)| (*key, (*value).to_owned())));
    m.write(&folder(folder_name), "m.onnx")
}

fn summary(path: &Path, more: &str) -> Vec<(String, f32)> {
    boxes(path, more).into_iter().map(|(d, label)| (label, (d.score * 1000.0).round() / 1000.0)).collect()
}

#[test]
fn scores_of_a_calibrated_model_are_probabilities_and_an_unsure_kind_is_unknown() {
    if !runtime_is_there() {
        return;
    }
    let named = |name: &str, p: f32| (name.to_owned(), p);
    // logit(0.72) = 0.9445, half of it is 0.4722: 0.616. logit(0.315) = -0.777, -0.388: 0.404; of 0.9: 2.197, 1.099: 0.750. 0.12 is 0.270, above
    // the lowest score only as a probability.
    let (sure, unsure, weak) = (named("hook", 0.616), named("hook", 0.404), named("grasper", 0.27));
    let all = [sure.clone(), unsure, weak.clone()];
    let both = [("calibration_score", "2 0"), ("calibration_objectness", "2 0")];
    let path = calibrated("calibrated", &both);
    assert_eq!(summary(&path, ", unknown_below = 0.6"), [named("unknown", 0.75), sure.clone(), weak.clone()]);
    // 0.404 of 0.750 is above a half: it keeps the likelier name.
    assert_eq!(summary(&path, ", unknown_below = 0.5"), all);
    assert_eq!(summary(&path, ", unknown_below = 0.0"), all);
    let raw = [named("hook", 0.72), named("hook", 0.315)];
    assert_eq!(summary(&path, ", calibrated = false"), raw);
    // Without a curve of objectness nothing is unknown.
    let path = calibrated("calibrated-score", &both[..1]);
    assert_eq!(summary(&path, ", unknown_below = 0.9"), all);
    // A model's own limits, the second for hooks.
    let path = calibrated("calibrated-limits", &[both[0], ("class_limits", "0.1 0.5")]);
    assert_eq!(summary(&path, ", class_limits = true"), [sure, weak]);
    assert_eq!(summary(&path, ""), all);
    // A model without a calibration is as before, whatever is asked for.
    let path = calibrated("not-calibrated", &[]);
    assert_eq!(summary(&path, ", unknown_below = 1.0, class_limits = true"), raw);
    let damaged = calibrated("damaged-calibration", &[("calibration_score", "two")]);
    let error = open(&damaged, "").err().expect("refused").to_string();
    assert!(
        error.contains("m.onnx: `calibration_score`") && error.contains("`two`") && error.contains("export"),
        "{error}"
    );
}

#[test]
fn pictures_unlike_those_learned_from_are_said_after_a_while() {
    if !runtime_is_there() {
        return;
    }
    let m = |limit: &str, statistics: &str| {
        let mut m = model(vec![
            (
                "output",
                vec![1, CELLS as i64, 7],
                rows(CELLS, 7, &[(19, vec![0.5, 0.5, 2f32.ln(), 0.0, 0.9, 0.1, 0.8])]),
            ),
            // Two channels of 2 x 2 cells; the picture of 128 x 96 fills 64 x 48 px of the input: the upper cells.
            ("features", vec![1, 2, 2, 2], Fixed::Floats(vec![1.0, 3.0, 50.0, 50.0, 4.0, 4.0, 50.0, 50.0])),
        ]);
        m.metadata.push(("pictures", statistics.to_owned()));
        m.metadata.push(("pictures_limit", limit.to_owned()));
        m
    };
    // Means 2 and 4, less 1 and 2; whitened by ones: root of (1 + 4) / 2 = 1.5811.
    let statistics = "panoscope-pictures-1 1 2 1 0 0 1";
    let folder = folder("pictures");
    // `unlikeness` and `unlike` of the last image, boxes in it and the text for a screen; how often the log says it.
    let seen = |path: &Path, params: &str| {
        let mut node = open(path, params).expect("the model opens");
        let mut last = (0.0, 0.0, 0, String::new());
        for tick in 0..60 {
            node.at_tick(tick, tick as i64 * 100_000_000);
            let out = node.input_image::<Bgr8>("image", 128, 96, &vec![90; 128 * 96 * 3]).process().expect("it runs");
            let value = out.value::<panoscope_node::abi::Scalar>("unlikeness").expect("a number").value;
            let boxes = out.detections("detections").expect("boxes").items().len();
            let text = out.text("text").expect("a text").to_owned();
            last = (value, node.metric("unlike").expect("a metric"), boxes, text);
        }
        (last, node.logs().iter().filter(|line| line.message.contains("unlike the training images")).count())
    };
    let far = m("1", statistics).write(&folder, "far.onnx");
    let ((value, is_on, boxes, text), warnings) = seen(&far, "");
    assert!((value - 1.5811).abs() < 0.05, "{value}");
    assert_eq!((is_on, boxes, warnings), (1.0, 1, 1), "said once");
    assert!(text.contains("may be missed"), "{text}");
    let ((_, _, boxes, text), _) = seen(&far, r#", unlike = "drop""#);
    assert_eq!(boxes, 0);
    assert!(text.contains("not followed"), "{text}");
    let ((value, is_on, boxes, text), warnings) =
        seen(&m("3", statistics).write(&folder, "near.onnx"), r#", unlike = "drop""#);
    assert!((value - 1.5811 / 3.0).abs() < 0.02, "{value}");
    assert_eq!((is_on, boxes, text.as_str(), warnings), (0.0, 1, "", 0));
    let error = open(&m("1", "panoscope-pictures-1 1 2 3").write(&folder, "damaged.onnx"), "").err().expect("refused");
    assert!(error.to_string().contains("3 numbers instead of 6 for 2 channels"), "{error}");
    // A model without statistics says nothing of its pictures.
    let plain = model(vec![("output", vec![1, CELLS as i64, 7], rows(CELLS, 7, &[]))]).write(&folder, "plain.onnx");
    let mut node = open(&plain, "").expect("the model opens");
    let out = node.input_image::<Bgr8>("image", 128, 96, &vec![90; 128 * 96 * 3]).process().expect("it runs");
    assert!(out.is_empty("unlikeness").expect("an output"));
    assert_eq!(node.metric("unlike"), None);
}

#[test]
fn a_network_that_answers_no_numbers_is_refused_and_single_ones_are_told() {
    if !runtime_is_there() {
        return;
    }
    let folder = folder("nan");
    let answer = |values: Vec<f32>| model(vec![("output", vec![1, CELLS as i64, 7], Fixed::Floats(values))]);
    let error = open(&answer(vec![f32::NAN; CELLS * 7]).write(&folder, "all.onnx"), "").err().expect("refused");
    let error = error.to_string();
    assert!(error.contains("all.onnx is broken: 588 of 588 values of its output `output` are NaN"), "{error}");
    // Scores alone: boxes of such a network would be missing in silence.
    let scores: Vec<f32> = (0..CELLS * 7).map(|i| if i % 7 == 4 { f32::NAN } else { 0.5 }).collect();
    let error = open(&answer(scores).write(&folder, "scores.onnx"), "").err().expect("refused").to_string();
    assert!(error.contains("84 of 588 values") && error.contains("some in each row"), "{error}");
    // One damaged row among sound ones.
    let sound = vec![0.5, 0.5, 2f32.ln(), 0.0, 0.9, 0.1, 0.8];
    let damaged = vec![f32::NAN, 0.5, 0.0, 0.0, 0.9, 0.1, 0.8];
    let m = model(vec![("output", vec![1, CELLS as i64, 7], rows(CELLS, 7, &[(19, sound), (20, damaged)]))]);
    let mut node = open(&m.write(&folder, "one.onnx"), "").expect("it opens");
    for _ in 0..2 {
        let out = node.input_image::<Bgr8>("image", 128, 96, &vec![90; 128 * 96 * 3]).process().expect("it runs");
        assert_eq!(out.detections("detections").expect("detections").items().len(), 1);
    }
    assert_eq!(node.metric("bad_values"), Some(1.0));
    let warnings = node.logs().iter().filter(|l| l.message.contains("returned 1 values that are NaN")).count();
    assert_eq!(warnings, 1, "{:?}", node.logs());
}

#[test]
fn boxes_beyond_the_limit_are_counted_and_said_once() {
    if !runtime_is_there() {
        return;
    }
    let row = vec![0.5, 0.5, 2f32.ln(), 0.0, 0.9, 0.1, 0.8];
    let places = [19, 40, 44].map(|cell| (cell, row.clone()));
    let m = model(vec![("output", vec![1, CELLS as i64, 7], rows(CELLS, 7, &places))]);
    let mut node = open(&m.write(&folder("left_out"), "three.onnx"), ", max_boxes = 1").expect("it opens");
    for _ in 0..2 {
        let out = node.input_image::<Bgr8>("image", 128, 96, &vec![90; 128 * 96 * 3]).process().expect("it runs");
        assert_eq!(out.detections("detections").expect("detections").items().len(), 1);
    }
    assert_eq!(node.metric("left_out"), Some(2.0));
    let said = node.logs().iter().filter(|l| l.message.contains("2 boxes beyond `max_boxes` = 1")).count();
    assert_eq!(said, 1, "{:?}", node.logs());
}

#[test]
fn a_segmenter_without_numbers_is_refused() {
    if !runtime_is_there() {
        return;
    }
    let nan = |len: usize| Fixed::Floats(vec![f32::NAN; len]);
    let m = model(vec![
        ("boxes", vec![2, 4], Fixed::Floats(vec![1.0; 8])),
        ("labels", vec![2], Fixed::Ints(vec![1, 2])),
        ("scores", vec![2], nan(2)),
        ("masks", vec![2, 1, 28, 28], Fixed::Floats(vec![0.9; 2 * 28 * 28])),
    ]);
    let path = m.write(&folder("nan_masks"), "m.onnx");
    let opened = Harness::<MaskRcnn>::from_toml(&format!("params = {{ model = {path:?} }}"));
    let error = opened.err().expect("refused").to_string();
    assert!(error.contains("2 of 2 values of its output `scores` are NaN"), "{error}");
}

#[test]
fn yolov5_has_three_anchors_a_cell_and_a_centred_picture() {
    if !runtime_is_there() {
        return;
    }
    let v = vec![32.0, 32.0, 16.0, 8.0, 0.9, 0.8, 0.1];
    let n = 3 * CELLS;
    let m = model(vec![("output0", vec![1, n as i64, 7], rows(n, 7, &[(5, v)]))]);
    let found = boxes(&m.write(&folder("yolov5"), "m.onnx"), "");
    // 128 x 96 lies at 64 x 48 with 8 px above and below.
    near(&found[0].0, [48.0, 40.0, 80.0, 56.0]);
    assert_eq!(found[0].1, "grasper");
}

#[test]
fn yolov8_answers_in_columns_and_weak_doubles_go() {
    if !runtime_is_there() {
        return;
    }
    let mut values = vec![0.0; 6 * CELLS];
    for (column, v) in [
        (10, [32.0, 32.0, 16.0, 8.0, 0.0, 0.9]),
        (11, [33.0, 32.0, 16.0, 8.0, 0.0, 0.6]),
        (50, [10.0, 20.0, 4.0, 4.0, 0.5, 0.0]),
    ] {
        v.iter().enumerate().for_each(|(k, x)| values[k * CELLS + column] = *x);
    }
    let m = model(vec![("output0", vec![1, 6, CELLS as i64], Fixed::Floats(values))]);
    let found = boxes(&m.write(&folder("yolov8"), "m.onnx"), "");
    assert_eq!(found.len(), 2, "{found:?}");
    near(&found[0].0, [48.0, 40.0, 80.0, 56.0]);
    near(&found[1].0, [16.0, 20.0, 24.0, 28.0]);
    assert_ne!(found[0].0.track_id, found[1].0.track_id);
}

#[test]
fn end_to_end_answers_corners() {
    if !runtime_is_there() {
        return;
    }
    let v = vec![24.0, 28.0, 40.0, 36.0, 0.7, 1.0];
    let mut m = model(vec![("output0", vec![1, 30, 6], rows(30, 6, &[(0, v)]))]);
    m.metadata.push(("end2end", "True".into()));
    let found = boxes(&m.write(&folder("e2e"), "m.onnx"), "");
    assert_eq!(found.len(), 1);
    near(&found[0].0, [48.0, 40.0, 80.0, 56.0]);
    assert_eq!(found[0].1, "hook");
}

#[test]
fn detr_answers_logits_and_shares_of_a_stretched_picture() {
    if !runtime_is_there() {
        return;
    }
    let logits = Fixed::Floats(vec![-5.0, -5.0, 2.0, -5.0, -5.0, -5.0]);
    let places = rows(3, 4, &[(1, vec![0.5, 0.5, 0.25, 0.125])]);
    let m = model(vec![("logits", vec![1, 3, 2], logits), ("pred_boxes", vec![1, 3, 4], places)]);
    let found = boxes(&m.write(&folder("detr"), "m.onnx"), "");
    assert_eq!(found.len(), 1);
    near(&found[0].0, [48.0, 42.0, 80.0, 54.0]);
}

#[test]
fn an_answer_of_unknown_shape_is_refused_with_what_would_do() {
    if !runtime_is_there() {
        return;
    }
    let m = model(vec![("weird", vec![1, 7, 11], Fixed::Floats(vec![0.0; 77]))]);
    let error = open(&m.write(&folder("weird"), "m.onnx"), "").err().expect("refused").to_string();
    assert!(error.contains("`weird` 1x7x11") && error.contains("1x84x(5+C)") && error.contains("layout"), "{error}");
}

#[test]
fn a_label_table_of_another_length_is_refused() {
    if !runtime_is_there() {
        return;
    }
    let mut m = model(vec![("output", vec![1, CELLS as i64, 7], rows(CELLS, 7, &[]))]);
    m.metadata = vec![("names", "['a', 'b', 'c']".into())];
    let error = open(&m.write(&folder("labels"), "m.onnx"), "").err().expect("refused").to_string();
    assert!(error.contains("has 2 classes, but the label table has 3 names"), "{error}");
}

#[test]
fn nan_and_endless_answers_are_no_boxes() {
    if !runtime_is_there() {
        return;
    }
    let set = [
        (0, vec![f32::NAN, 0.0, 0.0, 0.0, 0.9, 0.9, 0.0]),
        (1, vec![0.0, 0.0, f32::INFINITY, 0.0, 0.9, 0.9, 0.0]),
        (2, vec![0.0, 0.0, 0.0, 0.0, f32::NAN, 0.9, 0.0]),
        (3, vec![0.0, 0.0, 0.0, 0.0, 0.9, f32::NAN, f32::NAN]),
    ];
    let m = model(vec![("output", vec![1, CELLS as i64, 7], rows(CELLS, 7, &set))]);
    let path = m.write(&folder("nan"), "m.onnx");
    assert_eq!(boxes(&path, "").len(), 0);
    let mut node = open(&path, "").expect("opens");
    for (w, h) in [(1, 1), (3, 5), (4000, 2), (2, 3000)] {
        let out = node.input_image::<Bgr8>("image", w, h, &vec![7; w * h * 3]).process().expect("any size runs");
        assert_eq!(out.detections("detections").expect("detections").items().len(), 0);
    }
}

#[test]
fn mask_rcnn_pastes_small_masks_into_their_boxes() {
    if !runtime_is_there() {
        return;
    }
    // The left half of a 28 x 28 map is tool.
    let map: Vec<f32> = (0..28 * 28).map(|i| if i % 28 < 14 { 1.0 } else { 0.0 }).collect();
    let m = TinyModel {
        input: vec![3, 96, 128],
        outputs: vec![
            ("boxes", vec![1, 4], Fixed::Floats(vec![20.0, 30.0, 76.0, 86.0])),
            ("labels", vec![1], Fixed::Ints(vec![2])),
            ("scores", vec![1], Fixed::Floats(vec![0.9])),
            ("masks", vec![1, 1, 28, 28], Fixed::Floats(map)),
        ],
        metadata: vec![("names", "['grasper', 'hook']".into()), ("family", "torchvision".into())],
    };
    let path = m.write(&folder("masks"), "m.onnx");
    let mut node = Harness::<MaskRcnn>::from_toml(&format!("params = {{ model = {path:?} }}")).expect("opens");
    let out = node.input_image::<Bgr8>("image", 128, 96, &vec![90; 128 * 96 * 3]).process().expect("runs");
    let found = out.instances("instances").expect("instances");
    let items = found.detections();
    assert_eq!(items.label(items.items()[0].class_index), "hook");
    let set: usize = found.mask(0).iter().map(|b| b.count_ones() as usize).sum();
    assert_eq!(set, 28 * 56, "half of a box of 56 x 56 px");
    let bit = |x: usize, y: usize| found.mask(0)[y * 16 + x / 8] & (0x80 >> (x % 8)) != 0;
    assert!(bit(20, 30) && bit(47, 85) && !bit(48, 50) && !bit(19, 50) && !bit(30, 29));
    // The box covers columns 20 to 76.
    for (first, expected) in [(40, 1), (60, 0), (0, 1)] {
        let lit: Vec<u8> = (0..128 * 96).map(|i| if i % 128 >= first { 255 } else { 0 }).collect();
        let out = node
            .input_image::<Bgr8>("image", 128, 96, &vec![90; 128 * 96 * 3])
            .input_image::<Mask>("mask", 128, 96, &lit)
            .process()
            .expect("runs");
        assert_eq!(out.instances("instances").expect("instances").detections().items().len(), expected, "from {first}");
    }
}

#[test]
fn a_segmenter_drops_its_instruments_in_unfamiliar_pictures() {
    if !runtime_is_there() {
        return;
    }
    let folder = folder("unlike_masks");
    let m = |limit: &str| TinyModel {
        input: vec![3, 96, 128],
        outputs: vec![
            ("boxes", vec![1, 4], Fixed::Floats(vec![20.0, 30.0, 76.0, 86.0])),
            ("labels", vec![1], Fixed::Ints(vec![2])),
            ("scores", vec![1], Fixed::Floats(vec![0.9])),
            ("masks", vec![1, 1, 28, 28], Fixed::Floats(vec![1.0; 28 * 28])),
            // Two channels of 3 x 4 cells: means 2 and 4.
            ("features", vec![1, 2, 3, 4], Fixed::Floats([[2.0; 12], [4.0; 12]].concat())),
        ],
        metadata: vec![
            ("names", "['grasper', 'hook']".into()),
            ("family", "torchvision".into()),
            ("pictures", "panoscope-pictures-1 1 2 1 0 0 1".into()),
            ("pictures_limit", limit.to_owned()),
        ],
    };
    // `unlike`, instruments and the text for a screen, of the last image.
    let seen = |name: &str, limit: &str, unlike: &str| {
        let path = m(limit).write(&folder, name);
        let params = format!("params = {{ model = {path:?}, unlike = \"{unlike}\" }}");
        let mut node = Harness::<MaskRcnn>::from_toml(&params).expect("opens");
        let mut last = None;
        for tick in 0..60 {
            node.at_tick(tick, tick as i64 * 100_000_000);
            let out = node.input_image::<Bgr8>("image", 128, 96, &vec![90; 128 * 96 * 3]).process().expect("runs");
            let instances = out.instances("instances").expect("instances").detections().items().len();
            let value = out.value::<panoscope_node::abi::Scalar>("unlikeness").expect("a number").value;
            let text = out.text("text").expect("a text").to_owned();
            last = Some((value, node.metric("unlike").expect("a metric"), instances, text));
        }
        last.expect("it ran")
    };
    // Root of (1 + 4) / 2.
    let (value, is_on, instances, text) = seen("far.onnx", "1", "drop");
    assert!((value - 1.5811).abs() < 0.05, "{value}");
    assert_eq!((is_on, instances), (1.0, 0));
    assert!(text.contains("not followed"), "{text}");
    let (_, is_on, instances, text) = seen("kept.onnx", "1", "keep");
    assert_eq!((is_on, instances), (1.0, 1));
    assert!(text.contains("may be missed"), "{text}");
    let (_, is_on, instances, text) = seen("near.onnx", "3", "drop");
    assert_eq!((is_on, instances, text.as_str()), (0.0, 1, ""));
}

#[test]
fn yolo_seg_masks_are_sums_of_prototypes() {
    if !runtime_is_there() {
        return;
    }
    let mut values = vec![0.0; 8 * CELLS];
    [32.0, 32.0, 32.0, 16.0, 0.9, 0.0, 1.0, 0.0].iter().enumerate().for_each(|(k, x)| values[k * CELLS + 9] = *x);
    // Prototype 0 says tool left of the middle, prototype 1 everywhere.
    let mut prototypes: Vec<f32> = (0..256).map(|i| if i % 16 < 8 { 8.0 } else { -8.0 }).collect();
    prototypes.extend([8.0; 256]);
    let m = model(vec![
        ("output0", vec![1, 8, CELLS as i64], Fixed::Floats(values)),
        ("output1", vec![1, 2, 16, 16], Fixed::Floats(prototypes)),
    ]);
    let path = m.write(&folder("seg"), "m.onnx");
    let mut node = Harness::<MaskRcnn>::from_toml(&format!("params = {{ model = {path:?} }}")).expect("opens");
    let out = node.input_image::<Bgr8>("image", 128, 128, &vec![90; 128 * 128 * 3]).process().expect("runs");
    let found = out.instances("instances").expect("instances");
    let bit = |x: usize, y: usize| found.mask(0)[y * 16 + x / 8] & (0x80 >> (x % 8)) != 0;
    assert!(bit(33, 64) && bit(60, 64) && !bit(70, 64) && !bit(31, 64));
}

#[test]
fn outlines_of_an_uncertain_kind_are_unknown() {
    if !runtime_is_there() {
        return;
    }
    // Two rows: one whose classes have 0.45 each, and one that is surely of the second class. One prototype, everywhere.
    let mut values = vec![0.0; 7 * CELLS];
    let mut row = |cell: usize, numbers: [f32; 7]| {
        numbers.iter().enumerate().for_each(|(k, x)| values[k * CELLS + cell] = *x);
    };
    row(9, [16.0, 16.0, 16.0, 16.0, 0.45, 0.45, 1.0]);
    row(5, [48.0, 56.0, 16.0, 8.0, 0.0, 0.8, 1.0]);
    let m = model(vec![
        ("output0", vec![1, 7, CELLS as i64], Fixed::Floats(values)),
        ("output1", vec![1, 1, 16, 16], Fixed::Floats(vec![8.0; 256])),
    ]);
    let path = m.write(&folder("seg_unknown"), "m.onnx");
    let found = |params: &str| {
        let mut node =
            Harness::<MaskRcnn>::from_toml(&format!("params = {{ model = {path:?}{params} }}")).expect("opens");
        let out = node.input_image::<Bgr8>("image", 128, 128, &vec![90; 128 * 128 * 3]).process().expect("runs");
        let found = out.instances("instances").expect("instances").detections();
        let of = |item: &panoscope_node::abi::Detection| {
            (found.label(item.class_index).to_owned(), (100.0 * item.score).round())
        };
        found.items().iter().map(of).collect::<Vec<_>>()
    };
    let hook = ("hook".to_owned(), 80.0);
    assert_eq!(found(", unknown_below = 0.6"), [("unknown".to_owned(), 90.0), hook.clone()]);
    // The better class has half of the sum: it is named, and its score is too low.
    assert_eq!(found(", unknown_below = 0.5"), std::slice::from_ref(&hook));
    assert_eq!(found(""), [hook]);
}

#[test]
fn a_provider_that_is_not_there_leaves_the_network_to_the_processor() {
    if !runtime_is_there() {
        return;
    }
    let path = one_hook().write(&folder("provider"), "m.onnx");
    for (name, title) in [
        ("cuda", "CUDA"),
        ("tensorrt", "TensorRT"),
        ("openvino", "OpenVINO"),
        ("rocm", "ROCm"),
        ("migraphx", "MIGraphX"),
    ] {
        let chosen = format!(", provider = \"{name}\"");
        let node = open(&path, &chosen).expect("the model opens");
        let logged: Vec<&str> = node.logs().iter().map(|line| line.message.as_str()).collect();
        // An ONNX Runtime with this provider, on a machine with a device for it, runs the network there without a word.
        if !logged.is_empty() {
            assert!(logged[0].starts_with(&format!("{title} cannot run")), "{logged:?}");
            assert!(logged[0].contains("using the processor") && logged[0].contains("ORT_DYLIB_PATH"), "{logged:?}");
        }
        let found = boxes(&path, &chosen);
        assert_eq!((found.len(), found[0].1.as_str()), (1, "hook"), "{name}");
        near(&found[0].0, [40.0, 32.0, 72.0, 48.0]);
    }
    let logs = open(&path, "").expect("the model opens").logs().len();
    assert_eq!(logs, 0, "nothing to say of the processor");
}
