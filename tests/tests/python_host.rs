//! The Python package, tested in Python: each test runs a file of `tests/python`, or a class of one.

use panoscope_tests::{root, run_python_class, run_python_classes, run_python_tests};

#[test]
fn graphs_from_python_are_those_of_the_command() {
    run_python_class("host.py", "CommandTest");
}

#[test]
fn runs_and_recordings_from_python() {
    run_python_class("host.py", "RunTest");
}

#[test]
fn sweeps_files_and_notebooks_from_python() {
    run_python_class("host.py", "StudyTest");
}

#[test]
fn nodes_in_python() {
    run_python_class("host.py", "PluginTest");
}

#[test]
fn graphs_are_built_in_python() {
    run_python_class("building.py", "Building");
}

#[test]
fn every_class_of_host_py_is_run_above() {
    let text = std::fs::read_to_string(root().join("tests/python/host.py")).expect("a file");
    let classes = text.lines().filter_map(|line| line.strip_prefix("class "));
    let names: Vec<&str> = classes.filter_map(|class| class.strip_suffix("(HostCase):")).collect();
    assert_eq!(names, ["CommandTest", "RunTest", "StudyTest", "PluginTest"]);
}

#[test]
fn odd_files_give_the_right_values_or_are_refused() {
    run_python_tests("odd_files.py", "cv2, mcap, PIL, rosbags");
}

#[test]
fn lengths_of_a_fisheye_are_as_good_as_those_of_a_pinhole() {
    run_python_class("fisheye.py", "Fisheye");
}

#[test]
fn a_matcher_of_opencv_in_python_gives_the_bytes_of_the_plugin() {
    run_python_tests("opencv_matcher.py", "cv2");
}

#[test]
fn a_stereo_network_gives_the_values_of_onnx_runtime_in_python() {
    run_python_tests("any_network.py", "onnxruntime");
}

#[test]
fn the_tutorial_runs() {
    run_python_classes("tutorial.py", &["Tutorial"], "ipykernel, nbclient");
}

#[test]
fn the_notebook_of_own_data_runs() {
    run_python_classes("tutorial.py", &["OwnData"], "ipykernel, nbclient");
}

#[test]
fn the_notebook_of_an_own_network_runs() {
    run_python_classes("tutorial.py", &["OwnNetwork"], "ipykernel, nbclient");
}
