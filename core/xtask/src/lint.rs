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

/// Installs clippy unless it is there.
pub fn require_clippy(workspace: &Workspace) -> Result<()> {
    require(workspace, "clippy", "clippy")
}

/// Installs a component of the toolchain unless it is there; minimal installations lack these.
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
