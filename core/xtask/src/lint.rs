//! Format and lints.

use std::process::Command;

use anyhow::{Result, bail};

use crate::process;
use crate::workspace::Workspace;

/// Checks the format of every file, without building anything.
pub fn format(workspace: &Workspace) -> Result<()> {
    require(workspace, "fmt", "rustfmt")?;
    process::run(workspace.cargo().args(["fmt", "--all", "--check"]))
}

/// Runs clippy over everything; a warning is a failure.
pub fn clippy(workspace: &Workspace) -> Result<()> {
    require(workspace, "clippy", "clippy")?;
    process::run(workspace.cargo().args(["clippy", "--workspace", "--all-targets", "--", "-D", "warnings"]))
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
