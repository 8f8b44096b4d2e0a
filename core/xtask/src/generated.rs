//! Files that tests compare with and can write anew: the C header and the expected outputs.

use std::process::Command;

use anyhow::{Result, ensure};

use crate::build::{Built, Profile, build};
use crate::packages::Purpose;
use crate::process;
use crate::setup;
use crate::workspace::Workspace;

/// With this variable set, tests write what they would compare with.
const BLESS: &str = "PANOSCOPE_BLESS";

/// Writes core/abi/panoscope.h anew.
pub fn header(workspace: &Workspace) -> Result<()> {
    process::run(workspace.cargo().args(["test", "--quiet", "--package", "panoscope-abi"]).env(BLESS, "1"))?;
    let header = workspace.root.join("core/abi/panoscope.h");
    ensure!(header.is_file(), "the tests of core/abi wrote no {}", header.display());
    show_changes(workspace, "core/abi")
}

/// Writes all expected outputs anew. They are to be read before they are committed.
pub fn bless(workspace: &Workspace) -> Result<()> {
    setup::ensure(&[Purpose::Build, Purpose::Test])?;
    let built = build(workspace, Profile::Dev)?;
    let mut cargo = workspace.cargo();
    test_environment(&mut cargo, workspace, &built);
    process::run(cargo.args(["test", "--quiet", "--workspace", "--no-fail-fast"]).env(BLESS, "1"))?;
    show_changes(workspace, ".")
}

/// What tests are told about the build.
pub fn test_environment(cargo: &mut Command, workspace: &Workspace, built: &Built) {
    cargo
        .env("PANOSCOPE_PLUGIN_PATH", &built.plugin_dir)
        .env("PANOSCOPE_BIN", &built.program)
        .env("PANOSCOPE_DATA", workspace.data_dir());
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
