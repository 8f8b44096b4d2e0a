//! What several tests of the command need.

use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// The program under test.
const PROGRAM: &str = env!("CARGO_BIN_EXE_panoscope");

fn has(folder: &Path, name: &str) -> bool {
    [format!("lib{name}.so"), format!("libpanoscope_{name}.so")].iter().any(|file| folder.join(file).is_file())
}

/// Folder that holds all these plugins. `None`, with a report that the test is skipped, where there is none.
pub fn plugins(names: &[&str]) -> Option<PathBuf> {
    let given = std::env::var_os("PANOSCOPE_PLUGIN_PATH").unwrap_or_default();
    let beside = Path::new(PROGRAM).parent().map(Path::to_owned);
    let found = std::env::split_paths(&given).chain(beside).find(|folder| names.iter().all(|name| has(folder, name)));
    if found.is_none() {
        panoscope_testing::skipped!(
            "the plugins {} are not built together; `cargo xtask test` builds them",
            names.join(", ")
        );
    }
    found
}

/// Whether the folders of a search path hold all these plugins between them.
pub fn has_plugins(path: &OsStr, names: &[&str]) -> bool {
    names.iter().all(|name| std::env::split_paths(path).any(|folder| has(&folder, name)))
}

/// Search path with these plugins: `PANOSCOPE_PLUGIN_PATH` if it has all of them, else the folder that cargo builds
/// them into now.
pub fn built_plugins(names: &[&str]) -> OsString {
    let given = std::env::var_os("PANOSCOPE_PLUGIN_PATH").unwrap_or_default();
    if has_plugins(&given, names) {
        return given;
    }
    let profile_dir = Path::new(PROGRAM).parent().expect("a folder");
    let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or("cargo".into()));
    cargo.args(["build", "--quiet", "--manifest-path"]);
    cargo.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("../../Cargo.toml"));
    cargo.arg("--target-dir").arg(profile_dir.parent().expect("a target folder"));
    for name in names {
        cargo.args(["--package", &format!("panoscope-{name}")]);
    }
    if profile_dir.ends_with("release") {
        cargo.arg("--release");
    }
    assert!(cargo.status().expect("cargo runs").success(), "the plugins do not build");
    profile_dir.into()
}

/// Runs the command with these plugins: its exit code, what it printed and its messages.
pub fn run(plugins: &[&str], arguments: &[&str]) -> (i32, String, String) {
    let mut command = Command::new(PROGRAM);
    let Output { status, stdout, stderr } = command
        .env("PANOSCOPE_PLUGIN_PATH", built_plugins(plugins))
        .args(arguments)
        .output()
        .expect("the program starts");
    let text = |bytes| String::from_utf8(bytes).expect("UTF-8");
    (status.code().unwrap_or(-1), text(stdout), text(stderr))
}
