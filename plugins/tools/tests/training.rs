//! The training scripts' own tests, which need no more than Python.

use std::path::Path;
use std::process::Command;

#[test]
fn the_reader_of_via_annotations_passes_its_tests() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("training");
    let mut python = Command::new("python3");
    python.current_dir(folder).args(["-B", "-m", "unittest", "-v", "test_via"]);
    match python.output() {
        Err(error) => panoscope_testing::skipped!("no python3: {error}"),
        Ok(output) => {
            let said = String::from_utf8_lossy(&output.stderr);
            assert!(output.status.success() && said.contains("... ok"), "{said}");
        }
    }
}
