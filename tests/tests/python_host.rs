//! What the Python package does, in Python: each test runs a file of `tests/python`.

use panoscope_tests::run_python_tests;

#[test]
fn graphs_and_recordings_from_python() {
    run_python_tests("host.py", "");
}

#[test]
fn a_matcher_of_opencv_in_python_gives_the_bytes_of_the_plugin() {
    run_python_tests("opencv_matcher.py", "cv2");
}

#[test]
fn the_tutorial_runs() {
    run_python_tests("tutorial.py", "ipykernel, nbclient");
}
