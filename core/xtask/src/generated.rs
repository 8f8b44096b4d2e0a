//! Expected files of tests, and their update: the C header and the expected outputs.

use std::path::PathBuf;
use std::process::Command;

use anyhow::{Context, Result, ensure};

use crate::build::{BuiltForTests, Extent, REST, build_for_tests};
use crate::nextest;
use crate::packages::Purpose;
use crate::process;
use crate::setup;
use crate::tool;
use crate::workspace::Workspace;

/// If this variable is set, tests write the expected files instead of comparing.
const BLESS: &str = "PANOSCOPE_BLESS";

/// Updates core/contract/abi/panoscope.h.
pub fn header(workspace: &Workspace) -> Result<()> {
    process::run(workspace.cargo().args(["test", "--quiet", "--package", "panoscope-abi"]).env(BLESS, "1"))?;
    let header = workspace.root.join("core/contract/abi/panoscope.h");
    ensure!(header.is_file(), "the tests of core/contract/abi did not write {}", header.display());
    show_changes(workspace, "core/contract/abi")
}

/// Updates all expected outputs. Review the differences before you commit them.
pub fn bless(workspace: &Workspace) -> Result<()> {
    setup::ensure(&[Purpose::Build, Purpose::Test])?;
    let nextest = tool::ensure(workspace, nextest::PROGRAM)?;
    let built = build_for_tests(workspace, Extent::Workspace)?;
    let mut cargo = workspace.cargo_dev();
    test_environment(&mut cargo, workspace, &built)?;
    nextest.put_into(&mut cargo)?;
    process::run(nextest::run(&mut cargo)?.arg("--workspace").args(REST).env(BLESS, "1"))?;
    show_changes(workspace, ".")
}

/// Environment variables by which tests find the build.
///
/// # Errors
/// The path of a plugin folder contains a colon.
pub fn test_environment(cargo: &mut Command, workspace: &Workspace, tests: &BuiltForTests) -> Result<()> {
    let plugin_path = std::env::join_paths([&tests.built.plugin_dir, &tests.test_plugin_dir])?;
    cargo
        .env("PANOSCOPE_PLUGIN_PATH", plugin_path)
        .env("PANOSCOPE_BIN", &tests.built.program)
        .env("PANOSCOPE_DATA", workspace.data_dir())
        // On a loaded machine a sound call may take seconds; tests of the watchdog set its time themselves.
        .env("PANOSCOPE_HANG_MS", "60000")
        // What a test that starts a program without settings of its own writes: never the audit log of who runs it.
        .env("XDG_STATE_HOME", fresh_state(workspace)?);
    Ok(())
}

/// An empty folder for the state of programs started by tests, see `panoscope_testing::own_settings`.
fn fresh_state(workspace: &Workspace) -> Result<PathBuf> {
    let folder = workspace.target.join("test_state");
    if folder.exists() {
        std::fs::remove_dir_all(&folder).with_context(|| format!("cannot empty {}", folder.display()))?;
    }
    std::fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
    Ok(folder)
}

fn show_changes(workspace: &Workspace, path: &str) -> Result<()> {
    let mut git = Command::new("git");
    git.args(["status", "--short", "--", path]).current_dir(&workspace.root);
    match process::capture(&mut git) {
        Ok(text) if text.is_empty() => println!("Nothing changed."),
        Ok(text) => print!("{text}"),
        // Not in a git repository: the files are written all the same.
        Err(_) => {}
    }
    Ok(())
}
