//! Runs the tests of the training scripts.

use std::path::Path;
use std::process::Command;

/// Runs a test module of this plugin's training scripts.
fn passes(module: &str, needs: &[&str]) {
    passes_in("training", module, needs);
}

/// Runs a test module in a folder of training scripts; `needs` are packages without which it is skipped. `PANOSCOPE_PYTHON` names another interpreter, such as one in a
/// virtual environment with PyTorch.
fn passes_in(folder: &str, module: &str, needs: &[&str]) {
    let program = std::env::var_os("PANOSCOPE_PYTHON").unwrap_or_else(|| "python3".into());
    let python = |arguments: &[&str]| {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
        Command::new(&program).current_dir(folder).arg("-B").args(arguments).output()
    };
    // An interpreter older than 3.11 reads no TOML.
    let imports = needs.iter().map(|package| format!("import {package};")).collect::<String>();
    match python(&["-c", &imports]) {
        Err(error) => panoscope_testing::skipped!("no {}: {error}", program.display()),
        Ok(output) if !output.status.success() => {
            let error = String::from_utf8_lossy(&output.stderr);
            panoscope_testing::skipped!("{module}: {}", error.lines().last().unwrap_or("no Python package"));
        }
        Ok(_) => {
            let output = python(&["-m", "unittest", "-v", module]).expect("it ran before");
            let report = String::from_utf8_lossy(&output.stderr);
            assert!(output.status.success() && report.contains("... ok"), "{report}");
        }
    }
}

#[test]
fn the_reader_of_via_annotations_passes_its_tests() {
    passes("test_via", &[]);
}

#[test]
fn folds_and_their_predictions_pass_their_tests() {
    passes("test_folds", &["tomllib"]);
}

#[test]
fn networks_and_the_training_loop_pass_their_tests() {
    passes("test_training", &["torch", "cv2", "numpy", "onnx", "tomllib"]);
}

#[test]
fn the_segmenter_passes_its_tests() {
    passes("test_masks", &["torch", "torchvision", "cv2", "numpy", "onnx", "onnxruntime"]);
}

#[test]
fn what_is_no_instrument_passes_its_tests() {
    passes("test_empty", &["torch", "cv2", "numpy", "onnx", "onnxruntime"]);
}

#[test]
fn maps_of_tips_are_learned_and_inserted() {
    passes("test_tips", &["torch", "cv2", "numpy", "onnx", "onnxruntime"]);
}

#[test]
fn the_stereo_network_passes_its_tests() {
    passes_in("../stereo/training", "test_matcher", &["torch", "cv2", "numpy", "onnx", "onnxruntime"]);
}
