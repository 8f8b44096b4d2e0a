//! Format and lints.

use std::path::PathBuf;
use std::process::Command;

use anyhow::{Result, bail};

use crate::process;
use crate::workspace::Workspace;

/// Checks the format of every file, without building anything.
pub fn format(workspace: &Workspace) -> Result<()> {
    require(workspace, "fmt", "rustfmt")?;
    process::run(workspace.cargo().args(["fmt", "--all", "--check"]))
}

/// Environment variables by which clippy compiles, and by which it gets its arguments.
pub const VARIABLES: [&str; 2] = ["RUSTC_WORKSPACE_WRAPPER", "CLIPPY_ARGS"];

/// Lets clippy compile the packages of the workspace, so that lints cost no second pass; a warning is an error. Without clippy nothing is linted.
pub fn deny_warnings(cargo: &mut Command) {
    // Rustup puts a program of this name into PATH also where clippy is not installed.
    let works = |driver: &PathBuf| process::capture(Command::new(driver).arg("--version")).is_ok();
    if let Some(driver) = process::find_program("clippy-driver").filter(works) {
        let [wrapper, arguments] = VARIABLES;
        // How `cargo clippy` hands its arguments to the driver.
        cargo.env(wrapper, driver).env(arguments, "-D__CLIPPY_HACKERY__warnings__CLIPPY_HACKERY__");
    }
}

/// Installs clippy unless it is there.
pub fn require_clippy(workspace: &Workspace) -> Result<()> {
    require(workspace, "clippy", "clippy")
}

/// Sees to it that a part of the toolchain is there: minimal installations leave these out.
fn require(workspace: &Workspace, subcommand: &str, component: &str) -> Result<()> {
    if process::capture(workspace.cargo().args([subcommand, "--version"])).is_ok() {
        return Ok(());
    }
    if process::find_program("rustup").is_none() {
        bail!("`cargo {subcommand}` is missing: install {component} for this Rust toolchain");
    }
    println!("Installing {component} with rustup");
    process::capture(Command::new("rustup").args(["component", "add", component]).current_dir(&workspace.root))
        .map(drop)
}
