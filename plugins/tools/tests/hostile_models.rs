//! Damaged and foreign model files: a clear error or an empty result, never a crash, nothing read outside the model's folder.

use std::path::Path;

use crate::tiny_onnx::{Fixed, Message, TinyModel, folder, runtime_is_there, tensor, value_info, wrap};
use panoscope_base::onnx;
use panoscope_node::Bgr8;
use panoscope_node::harness::Harness;
use panoscope_node::random::SplitMix64;
use panoscope_tools::model::Model;
use panoscope_tools::onnx_file::{self, OnnxFileError};
use panoscope_tools::provider::Provider;
use panoscope_tools::yolo::Yolo;

fn good() -> TinyModel {
    TinyModel {
        input: vec![1, 3, 64, 64],
        outputs: vec![("output", vec![1, 84, 7], Fixed::Floats(vec![0.0; 84 * 7]))],
        metadata: Vec::new(),
    }
}

fn opens_or_says(path: &Path) -> Result<(), String> {
    match Harness::<Yolo>::from_toml(&format!("params = {{ model = {path:?} }}")) {
        Ok(mut node) => {
            let run = node.input_image::<Bgr8>("image", 32, 32, &[7; 32 * 32 * 3]).process();
            run.map(drop).map_err(|e| e.to_string())
        }
        Err(e) => Err(e.to_string()),
    }
}

#[test]
fn a_model_cut_off_anywhere_is_refused() {
    let (whole, home) = (good().bytes(), folder("cut"));
    let path = home.join("m.onnx");
    let has_runtime = runtime_is_there();
    for part in 0..40 {
        std::fs::write(&path, &whole[..whole.len() * part / 40]).expect("written");
        let looked = onnx_file::read(&path);
        if has_runtime {
            let error = opens_or_says(&path).expect_err("a part of a model is no model");
            assert!(error.contains("m.onnx"), "{error}");
        } else {
            assert!(looked.is_err() || part > 0);
        }
    }
}

#[test]
fn a_model_with_flipped_bits_does_no_harm() {
    if !runtime_is_there() {
        return;
    }
    let (whole, home) = (good().bytes(), folder("flip"));
    let path = home.join("m.onnx");
    let mut random = SplitMix64(7);
    for _ in 0..120 {
        let mut damaged = whole.clone();
        for _ in 0..4 {
            let bit = random.below(damaged.len() * 8);
            damaged[bit / 8] ^= 1 << (bit % 8);
        }
        std::fs::write(&path, &damaged).expect("written");
        if let Err(error) = opens_or_says(&path) {
            assert!(!error.is_empty());
        }
    }
}

fn with_weights_at(location: &str) -> Vec<u8> {
    let entry = |k: &str, v: &str| Message::default().text(1, k).text(2, v);
    let outside =
        Message::default().int(1, 4).int(2, 1).text(8, "w").message(13, &entry("location", location)).int(14, 1);
    let node = Message::default().text(1, "w").text(2, "output").text(4, "Identity");
    wrap(&Message::default().message(1, &node).text(2, "g").message(5, &outside), &[])
}

#[test]
fn weights_outside_the_folder_are_refused() {
    let home = folder("outside");
    let path = home.join("m.onnx");
    for location in ["/etc/passwd", "../secret.bin", "a/../../b", "", "."] {
        std::fs::write(&path, with_weights_at(location)).expect("written");
        assert!(matches!(onnx_file::read(&path), Err(OnnxFileError::Outside { .. })), "{location:?}");
    }
    let elsewhere = folder("elsewhere").join("w.bin");
    std::fs::write(&elsewhere, [0; 16]).expect("written");
    std::os::unix::fs::symlink(&elsewhere, home.join("link.bin")).expect("linked");
    std::fs::write(&path, with_weights_at("link.bin")).expect("written");
    assert!(matches!(onnx_file::read(&path), Err(OnnxFileError::Outside { .. })), "a link that leads out");
    std::fs::write(&path, with_weights_at("gone.bin")).expect("written");
    assert!(matches!(onnx_file::read(&path), Err(OnnxFileError::MissingWeights { .. })));
    std::fs::write(home.join("here.bin"), [0; 16]).expect("written");
    std::fs::write(&path, with_weights_at("here.bin")).expect("written");
    assert!(onnx_file::read(&path).is_ok());
}

#[test]
fn graphs_in_graphs_without_end_are_refused() {
    let home = folder("nested");
    let path = home.join("m.onnx");
    let mut graph = Message::default().text(2, "inner");
    for _ in 0..400 {
        let attribute = Message::default().text(1, "then_branch").message(6, &graph).int(20, 5);
        let node = Message::default().text(4, "If").message(5, &attribute);
        graph = Message::default().message(1, &node).text(2, "outer");
    }
    std::fs::write(&path, wrap(&graph, &[])).expect("written");
    let error = onnx_file::read(&path).expect_err("refused").to_string();
    assert!(error.contains("more than 16 levels deep"), "{error}");
}

#[test]
fn what_is_no_model_is_named() {
    let home = folder("foreign");
    for (name, bytes) in
        [("text.onnx", b"hello, I am a text\n".to_vec()), ("empty.onnx", Vec::new()), ("zeros.onnx", vec![0; 4096])]
    {
        let path = home.join(name);
        std::fs::write(&path, bytes).expect("written");
        let error = onnx_file::read(&path).expect_err("refused").to_string();
        assert!(error.contains(name) && error.contains("export it again"), "{error}");
    }
    let error = onnx_file::read(&home.join("absent.onnx")).expect_err("refused").to_string();
    assert!(error.contains("absent.onnx") && error.contains("`model`"), "{error}");
}

#[test]
fn a_model_that_takes_no_picture_is_named() {
    if !runtime_is_there() {
        return;
    }
    let home = folder("input");
    for input in [vec![1, 5], vec![2, 3, 64, 64], vec![1, 4, 64, 64]] {
        let path = TinyModel { input, ..good() }.write(&home, "m.onnx");
        let error = opens_or_says(&path).expect_err("refused");
        assert!(error.contains("expected one image: f32 or f16, 1x3xHxW or 1xHxWx3"), "{error}");
    }
    // Weights where a picture belongs.
    let held = tensor("images", &[1, 3, 8, 8], &Fixed::Floats(vec![0.0; 192]));
    std::fs::write(home.join("w.onnx"), wrap(&Message::default().text(2, "g").message(5, &held), &[]))
        .expect("written");
    assert!(opens_or_says(&home.join("w.onnx")).is_err());
}

/// A model whose output is a tensor with weights in the file `w.bin`.
fn with_output_at(values: usize) -> Vec<u8> {
    let entry = |key: &str, value: &str| Message::default().text(1, key).text(2, value);
    let length = (4 * values).to_string();
    let held = Message::default()
        .int(1, values as i64)
        .int(2, 1)
        .text(8, "held")
        .message(13, &entry("location", "w.bin"))
        .message(13, &entry("offset", "0"))
        .message(13, &entry("length", &length))
        .int(14, 1);
    let node = Message::default().text(1, "held").text(2, "output").text(4, "Identity");
    let graph = Message::default()
        .message(1, &node)
        .text(2, "tiny")
        .message(5, &held)
        .message(11, &value_info("images", 1, &[1, 3, 64, 64]))
        .message(12, &value_info("output", 1, &[values as i64]));
    wrap(&graph, &[])
}

#[test]
fn weights_that_a_host_appended_to_a_model_are_used() {
    if !runtime_is_there() {
        return;
    }
    let values = 300;
    let weights = |first: f32| -> Vec<u8> { (0..values).flat_map(|k| (first + k as f32).to_le_bytes()).collect() };
    let home = folder("appended");
    let first_value = |path: &Path| {
        let mut model = Model::open(path, 1, (64, 64), Provider::Cpu).unwrap_or_else(|error| panic!("{error}"));
        let picture = vec![0.0; 3 * 64 * 64];
        let read = |tensors: &[panoscope_tools::session::Tensor<'_>]| {
            tensors.first().and_then(|tensor| tensor.data.floats().map(|floats| (floats.len(), floats[0])))
        };
        model.run(&picture, read).expect("it runs")
    };
    // Beside the model.
    let plain = home.join("plain.onnx");
    std::fs::write(&plain, with_output_at(values)).expect("written");
    std::fs::write(home.join("w.bin"), weights(5.0)).expect("written");
    assert_eq!(first_value(&plain), Some((values, 5.0)));
    // Appended: they count, and not those beside it.
    let mut bytes = with_output_at(values);
    bytes.extend(onnx::bundle_header("w.bin", 4 * values as u64));
    bytes.extend(weights(7.0));
    let bundled = home.join("bundled.onnx");
    std::fs::write(&bundled, &bytes).expect("written");
    assert_eq!(first_value(&bundled), Some((values, 7.0)));
    std::fs::remove_file(home.join("w.bin")).expect("removed");
    assert_eq!(first_value(&bundled), Some((values, 7.0)));
    assert!(Model::open(&plain, 1, (64, 64), Provider::Cpu).is_err());
}
