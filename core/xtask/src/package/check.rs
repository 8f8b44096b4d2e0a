//! Installs a package into a minimal Debian and uses it there.

use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result};

use crate::process::{capture, find_program, run};
use crate::workspace::Workspace;

/// Installs the package in a chroot below `dir`, runs its programs as an unprivileged user, upgrades and purges it. The
/// chroot stays for the next check, and `dir/screens` has screenshots of both windows. If the check is impossible, a
/// line gives the reason.
///
/// # Errors
/// A step failed; its output is above.
pub fn check(workspace: &Workspace, package: &Path, dir: &Path) -> Result<()> {
    if let Some(reason) = obstacle(&["debootstrap", "unshare", "chroot", "dpkg-deb"]) {
        println!("not checked, the package was not installed: {reason}");
        return Ok(());
    }
    let script = workspace.root.join("core/xtask/package/check.sh");
    // A mount namespace of its own: what the script mounts is gone when it ends.
    let mut command = Command::new("unshare");
    command.args(["--mount", "sh", "-eu"]).arg(&script).arg(package).arg(dir);
    run(&mut command).context("the package failed its check")
}

/// The reason for which a check in a minimal Debian, which needs these programs, is impossible here.
pub fn obstacle(programs: &[&str]) -> Option<String> {
    if let Some(missing) = programs.iter().find(|program| find_program(program).is_none()) {
        return Some(format!("there is no `{missing}`"));
    }
    let id = capture(Command::new("id").arg("-u")).unwrap_or_default();
    if id.trim() != "0" {
        return Some("it needs root for a chroot".to_owned());
    }
    capture(Command::new("unshare").args(["--mount", "true"])).err().map(|_| "mounts are not allowed here".to_owned())
}
