//! Studies of many inputs, in Python: each test runs a class of `tests/python/batches.py`.

use panoscope_tests::{run_python_classes, run_python_tests};

/// What the classes import.
const MODULES: &str = "PIL, fsspec, polars, pyarrow";

#[test]
fn studies_are_planned_run_and_reported() {
    run_python_classes("batches.py", &["Plans", "Runs", "Reports"], MODULES);
}

#[test]
fn a_study_that_is_killed_goes_on_to_the_same_bytes() {
    run_python_classes("batches.py", &["Kills"], MODULES);
}

#[test]
fn clusters_lose_no_run() {
    run_python_tests("clusters.py", "PIL, distributed, pyarrow");
}
