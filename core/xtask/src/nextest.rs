//! cargo-nextest, which runs each test in a separate process.

use std::path::PathBuf;
use std::process::Command;

use anyhow::{Context, Result};

use crate::process;
use crate::sanitizer::Sanitizer;
use crate::workspace::{LINT_VARIABLES, Workspace};

/// Name of its program, for [`crate::tool::ensure`].
pub const PROGRAM: &str = "cargo-nextest";
/// The profile in `.config/nextest.toml`.
pub const PROFILE: &str = "default";

/// Path of a run's results in JUnit format.
pub fn report_file(workspace: &Workspace, sanitizer: Option<Sanitizer>) -> PathBuf {
    let target = sanitizer.map_or(workspace.target.clone(), |sanitizer| workspace.target.join(sanitizer.folder()));
    target.join("nextest").join(PROFILE).join("junit.xml")
}

/// Command for a run of tests. It removes the variables of clippy, because some tests compile code.
///
/// # Errors
/// The compiler does not name its target.
pub fn run(cargo: &mut Command) -> Result<&mut Command> {
    let version = process::capture(Command::new("rustc").arg("-vV"))?;
    let target = version.lines().find_map(|line| line.strip_prefix("host: ")).context("`rustc -vV` printed no host")?;
    let runner = format!("CARGO_TARGET_{}_RUNNER", target.to_uppercase().replace('-', "_"));
    let removed = LINT_VARIABLES.map(|name| format!("-u {name}")).join(" ");
    cargo.env(runner, format!("env {removed}"));
    // NumPy's threads spin while they wait for work: several tests in Python share the cores.
    cargo.env("OPENBLAS_NUM_THREADS", "1");
    Ok(cargo.args(["nextest", "run", "--no-fail-fast", "--profile", PROFILE]))
}
