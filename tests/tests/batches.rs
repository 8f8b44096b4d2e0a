//! Studies of many inputs, in Python: each test runs a class of `tests/python/batches.py`.

use panoscope_tests::{run_python_class_with, run_python_tests};

/// What the classes import.
const MODULES: &str = "PIL, polars, pyarrow";

#[test]
fn tables_and_patterns_become_runs() {
    run_python_class_with("batches.py", "Plans", MODULES);
}

#[test]
fn runs_are_done_once_and_within_limits() {
    run_python_class_with("batches.py", "Runs", MODULES);
}

#[test]
fn a_study_that_is_killed_goes_on_to_the_same_bytes() {
    run_python_class_with("batches.py", "Kills", MODULES);
}

#[test]
fn reports_and_worst_runs() {
    run_python_class_with("batches.py", "Reports", MODULES);
}

#[test]
fn clusters_lose_no_run() {
    run_python_tests("clusters.py", "PIL, distributed, pyarrow");
}
