//! `panoscope check` opens models in a child process and says why one cannot be used.

use std::path::Path;
use std::process::Command;
use std::time::Instant;

use crate::common::plugins;

/// Checks a graph whose detector reads `model`; exit code, what was said, seconds. The first word tells where ONNX
/// Runtime is missing.
fn check(folder: &Path, plugins: &Path, model: &[u8]) -> (i32, String, f64) {
    std::fs::write(folder.join("m.onnx"), model).expect("a file");
    let graph = folder.join("graph.toml");
    let text = "plugins = [\"flow\", \"tools\", \"sinks\"]\n[nodes.camera]\ntype = \"frames\"\n[nodes.find]\ntype = \"yolo\"\n\
                inputs = { image = \"camera.image\" }\nparams = { model = \"m.onnx\" }\n[nodes.out]\ntype = \"write_table\"\n\
                inputs = { detections = \"find.detections\" }\nparams = { path = \"out.jsonl\" }\n";
    std::fs::write(&graph, text).expect("a file");
    let begun = Instant::now();
    let mut command = Command::new(env!("CARGO_BIN_EXE_panoscope"));
    let output = command.env("PANOSCOPE_PLUGIN_PATH", plugins).arg("check").arg(&graph).output().expect("it starts");
    let words = String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
    (output.status.code().unwrap_or(-1), words, begun.elapsed().as_secs_f64())
}

#[test]
fn a_model_that_is_none_is_refused_at_its_place() {
    let Some(plugins) = plugins(&["flow", "tools", "sinks"]) else { return };
    let folder = std::env::temp_dir().join(format!("panoscope_models_{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let (code, words, _) = check(&folder, &plugins, b"this is no model");
    if words.contains("model-unchecked") {
        panoscope_testing::skipped!("{}", words.lines().next().unwrap_or("ONNX Runtime is not there"));
        return;
    }
    assert_eq!(code, 2, "{words}");
    assert!(words.contains("error[model-refused]") && words.contains("graph.toml:7:20"), "{words}");
    assert!(
        words.contains("m.onnx is malformed or truncated") && words.contains("`model` of `find` (yolo)"),
        "{words}"
    );
    std::fs::remove_dir_all(folder).expect("removed");
}

#[test]
fn a_model_of_another_kind_is_refused_with_both_shapes() {
    let Some(plugins) = plugins(&["flow", "tools", "sinks"]) else { return };
    let folder = std::env::temp_dir().join(format!("panoscope_models_kind_{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    // One input `images` 1x3x64x64, one constant output `weird` 1x7x11.
    let (code, words, _) = check(&folder, &plugins, &weird());
    if words.contains("model-unchecked") {
        panoscope_testing::skipped!("{}", words.lines().next().unwrap_or("ONNX Runtime is not there"));
        return;
    }
    assert_eq!(code, 2, "{words}");
    assert!(words.contains("`weird` 1x7x11") && words.contains("1x84x(5+C)"), "expected and found shapes: {words}");
    std::fs::remove_dir_all(folder).expect("removed");
}

#[test]
fn a_good_model_passes() {
    let Some(plugins) = plugins(&["flow", "tools", "sinks"]) else { return };
    let folder = std::env::temp_dir().join(format!("panoscope_models_good_{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    // As YOLO's with 80 classes: a row per box and class.
    let (code, words, seconds) = check(&folder, &plugins, &constant("output0", [1, 84, 84]));
    if words.contains("model-unchecked") {
        panoscope_testing::skipped!("{}", words.lines().next().unwrap_or("ONNX Runtime is not there"));
        return;
    }
    assert_eq!(code, 0, "{words}");
    assert!(words.contains("ok (3 nodes, 2 connections)"), "{words}");
    println!("checked in {seconds:.1} s");
    std::fs::remove_dir_all(folder).expect("removed");
}

/// What `describe` says of a file; exit code, standard output, standard error.
fn describe(file: &Path, arguments: &[&str]) -> (i32, String, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_panoscope"));
    let output = command.arg("describe").arg(file).args(arguments).output().expect("it starts");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.code().unwrap_or(-1), text(&output.stdout), text(&output.stderr))
}

#[test]
fn a_model_is_described_with_a_graph_that_runs_it() {
    let Some(plugins) = plugins(&["phantom", "stereo", "overlay", "tools", "sinks"]) else { return };
    let folder = std::env::temp_dir().join(format!("panoscope_models_described_{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let task = |task: &[u8]| field(14, &[field(1, b"task"), field(2, task)].concat());
    for (name, model, parts) in [
        (
            "depth",
            constant("depth", [1, 64, 64]),
            ["type = \"onnx\"", "[inputs.images]\nport = \"image\"", "[outputs.depth]\nport = \"depth\""],
        ),
        (
            "odd name",
            constant("it's a mask", [1, 64, 64]),
            ["type = \"onnx\"", "[outputs.\"it\\u0027s a mask\"]", "port = \"mask\""],
        ),
        (
            "boxes",
            constant("output0", [1, 84, 84]),
            ["type = \"onnx\"", "[outputs.output0]\nport = \"detections\"", "overlay"],
        ),
        (
            "pose",
            [constant("output0", [1, 84, 84]), task(b"pose")].concat(),
            ["type = \"yolo\"", "network.tip0", "task: pose"],
        ),
        (
            "segment",
            [constant("output0", [1, 84, 84]), task(b"segment")].concat(),
            ["type = \"mask_rcnn\"", "network.instances", "task: segment"],
        ),
    ] {
        let file = folder.join("m.onnx");
        std::fs::write(&file, &model).expect("a file");
        let (code, said, _) = describe(&file, &[]);
        assert_eq!(code, 0, "{name}: {said}");
        assert!(said.contains("  images: f32 1x3x64x64\n") && said.contains("(ONNX, opset 13)"), "{name}: {said}");
        assert!(parts.iter().all(|part| said.contains(part)), "{name}: {parts:?} in {said}");
        let (_, json, _) = describe(&file, &["--json"]);
        let about: serde_json::Value = serde_json::from_str(&json).expect("JSON");
        assert_eq!(about["inputs"][0]["shape"], serde_json::json!([1, 3, 64, 64]), "{name}");
        let graph = about["graph"].as_str().expect("a graph");
        assert!(said.ends_with(graph), "{name}: {said}");
        let path = folder.join("graph.toml");
        std::fs::write(&path, graph).expect("a file");
        let mut command = Command::new(env!("CARGO_BIN_EXE_panoscope"));
        let output =
            command.env("PANOSCOPE_PLUGIN_PATH", &plugins).arg("check").arg(&path).output().expect("it starts");
        let words = String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
        // The model of a segmenter has no masks; the graph is right.
        let is_right = output.status.success() || (name == "segment" && words.contains("error[model-refused]"));
        assert!(is_right && !words.contains("warning[unused"), "{name}: {words}");
    }
    std::fs::remove_dir_all(folder).expect("removed");
}

#[test]
fn what_cannot_be_described_is_refused() {
    let folder = std::env::temp_dir().join(format!("panoscope_models_undescribed_{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let file = folder.join("m.onnx");
    let (code, _, words) = describe(&file, &[]);
    assert!(code == 2 && words.contains("cannot read the model") && words.contains("m.onnx"), "{words}");
    std::fs::write(&file, &weird()[..40]).expect("a file");
    let (code, _, words) = describe(&file, &[]);
    assert!(code == 2 && words.contains("m.onnx is not a complete ONNX file"), "{words}");
    let (code, _, words) = describe(&folder.join("folder.onnx").join(".."), &[]);
    assert!(code == 2 && words.contains("error"), "{words}");
    std::fs::remove_dir_all(folder).expect("removed");
}

/// A field of a protobuf message.
fn field(number: u8, bytes: &[u8]) -> Vec<u8> {
    let mut out = vec![number << 3 | 2];
    let mut length = bytes.len();
    while length >= 0x80 {
        out.push(length as u8 | 0x80);
        length >>= 7;
    }
    out.push(length as u8);
    out.extend_from_slice(bytes);
    out
}

fn weird() -> Vec<u8> {
    constant("weird", [1, 7, 11])
}

/// A network with one input `images` 1x3x64x64 and one output that is always 0.
fn constant(output: &str, shape: [u8; 3]) -> Vec<u8> {
    let values = shape.iter().map(|d| usize::from(*d)).product::<usize>();
    let number = |field: u8, value: u8| vec![field << 3, value];
    let value_info = |name: &[u8], dims: &[u8]| {
        let shape: Vec<u8> = dims.iter().flat_map(|&d| field(1, &number(1, d))).collect();
        let tensor = [number(1, 1), field(2, &shape)].concat();
        [field(1, name), field(2, &field(1, &tensor))].concat()
    };
    let held = [
        shape.iter().flat_map(|&d| number(1, d)).collect(),
        number(2, 1),
        field(8, b"held"),
        field(9, &vec![0; values * 4]),
    ]
    .concat();
    let node = [field(1, b"held"), field(2, output.as_bytes()), field(4, b"Identity")].concat();
    let graph = [
        field(1, &node),
        field(2, b"g"),
        field(5, &held),
        field(11, &value_info(b"images", &[1, 3, 64, 64])),
        field(12, &value_info(output.as_bytes(), &shape)),
    ]
    .concat();
    [number(1, 8), field(7, &graph), field(8, &[field(1, b""), number(2, 13)].concat())].concat()
}
