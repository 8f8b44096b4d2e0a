//! Mistakes of a node's author, and what the compiler says about them. `TRYBUILD=overwrite` renews the expected messages.
//!
//! `compile_fail` holds messages that the derives word themselves. Those in `compile_fail_rustc` come through rustc, whose frame
//! around our words changes from version to version: they are compared on the version that they were recorded with.

use std::process::Command;

const RECORDED_WITH: &str = "rustc 1.95.";

#[test]
fn mistakes_are_named() {
    let cases = trybuild::TestCases::new();
    cases.pass("tests/compile_pass/*.rs");
    cases.compile_fail("tests/compile_fail/*.rs");
    let rustc = std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    let version =
        Command::new(rustc).arg("--version").output().map(|o| String::from_utf8_lossy(&o.stdout).into_owned());
    match version {
        Ok(version) if version.starts_with(RECORDED_WITH) => cases.compile_fail("tests/compile_fail_rustc/*.rs"),
        other => {
            panoscope_testing::skipped!("compile_fail_rustc was recorded with {RECORDED_WITH}x, this is {other:?}")
        }
    }
}
