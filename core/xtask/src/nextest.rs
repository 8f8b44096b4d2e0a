//! cargo-nextest, which runs each test in a process of its own.

use std::path::PathBuf;
use std::process::Command;

use anyhow::{Context, Result};

use crate::process;
use crate::sanitizer::Sanitizer;
use crate::workspace::{LINT_VARIABLES, Workspace};

/// Its program, for [`crate::tool::ensure`].
pub const PROGRAM: &str = "cargo-nextest";
/// The profile in `.config/nextest.toml`.
pub const PROFILE: &str = "default";

/// Where a run writes its results, in JUnit's format.
pub fn report_file(workspace: &Workspace, sanitizer: Option<Sanitizer>) -> PathBuf {
    let target = sanitizer.map_or(workspace.target.clone(), |sanitizer| workspace.target.join(sanitizer.folder()));
    target.join("nextest").join(PROFILE).join("junit.xml")
}

/// A run of tests. They do not see the lints that their own compilation had: some of them compile, too.
///
/// # Errors
/// The compiler does not name its target.
pub fn run(cargo: &mut Command) -> Result<&mut Command> {
    let version = process::capture(Command::new("rustc").arg("-vV"))?;
    let target = version.lines().find_map(|line| line.strip_prefix("host: ")).context("`rustc -vV` names no host")?;
    let runner = format!("CARGO_TARGET_{}_RUNNER", target.to_uppercase().replace('-', "_"));
    let removed = LINT_VARIABLES.map(|name| format!("-u {name}")).join(" ");
    cargo.env(runner, format!("env {removed}"));
    Ok(cargo.args(["nextest", "run", "--no-fail-fast", "--profile", PROFILE]))
}
