//! Graphs and recordings from Python: runs `tests/python/host.py` with the package of this build.

use std::path::Path;
use std::process::Command;

use panoscope_tests::{has_python, root};

#[test]
fn graphs_and_recordings_from_python() {
    if !has_python() {
        return;
    }
    let Some(program) = std::env::var_os("PANOSCOPE_BIN") else {
        return panoscope_testing::skipped!("PANOSCOPE_BIN names no program; `cargo xtask test` sets it");
    };
    let package = Path::new(&program).with_file_name("python");
    let paths = [Some(package.into_os_string()), std::env::var_os("PYTHONPATH")];
    let path = paths.into_iter().flatten().collect::<Vec<_>>().join(":".as_ref());
    let mut python = Command::new("python3");
    python.arg(root().join("tests/python/host.py")).arg("-v").env("PYTHONPATH", path).env("PANOSCOPE_BIN", &program);
    let output = python.output().expect("python3 starts");
    let words = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{words}");
    // A test of Python that is not found is no test that passed.
    assert!(words.contains("OK") && !words.contains("Ran 0 tests"), "{words}");
}
