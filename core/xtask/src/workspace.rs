//! Paths of the workspace, its target folder and its plugins.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};
use serde_json::Value;

use crate::process;

/// Environment variables for compiling with clippy, and for its arguments.
pub const LINT_VARIABLES: [&str; 2] = ["RUSTC_WORKSPACE_WRAPPER", "CLIPPY_ARGS"];

/// A plugin crate: a folder under `plugins/`, or under `tests/plugins/` if only tests use it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Plugin {
    /// The folder's name, which is the plugin's name in a graph.
    pub name: String,
    /// The folder of its `Cargo.toml`.
    pub folder: PathBuf,
    /// The cargo package in it.
    pub package: String,
}

/// The repository, from `cargo metadata`.
#[derive(Debug)]
pub struct Workspace {
    pub root: PathBuf,
    pub target: PathBuf,
    /// The shipped plugins, sorted by name.
    pub plugins: Vec<Plugin>,
    /// The plugins that only tests use, sorted by name. No command but `build`, `test` and `bless` builds them.
    pub test_plugins: Vec<Plugin>,
}

impl Workspace {
    /// Asks cargo, so that CARGO_TARGET_DIR and configuration files are respected.
    pub fn locate() -> Result<Self> {
        // `cargo run` sets it each time, so a repository that was moved is still found.
        let crate_dir =
            std::env::var_os("CARGO_MANIFEST_DIR").map_or(PathBuf::from(env!("CARGO_MANIFEST_DIR")), PathBuf::from);
        let root = crate_dir.ancestors().nth(2).context("core/xtask has no workspace above it")?;
        let text = process::capture(cargo(root).args(["metadata", "--no-deps", "--format-version", "1"]))?;
        Self::from_metadata(&text)
    }

    fn from_metadata(text: &str) -> Result<Self> {
        let metadata: Value = serde_json::from_str(text).context("`cargo metadata` wrote no JSON")?;
        let path = |key: &str| {
            metadata[key].as_str().map(PathBuf::from).with_context(|| format!("`cargo metadata` reports no {key}"))
        };
        let root = path("workspace_root")?;
        let packages = metadata["packages"].as_array().context("`cargo metadata` lists no packages")?;
        let plugins_in = |plugin_root: PathBuf| {
            let mut plugins: Vec<Plugin> = packages
                .iter()
                .filter_map(|package| {
                    let folder = Path::new(package["manifest_path"].as_str()?).parent()?;
                    (folder.parent()? == plugin_root).then_some(())?;
                    Some(Plugin {
                        name: folder.file_name()?.to_str()?.to_owned(),
                        folder: folder.to_owned(),
                        package: package["name"].as_str()?.to_owned(),
                    })
                })
                .collect();
            plugins.sort_by(|a, b| a.name.cmp(&b.name));
            plugins
        };
        let (plugins, test_plugins) = (plugins_in(root.join("plugins")), plugins_in(root.join("tests/plugins")));
        Ok(Self { target: path("target_directory")?, root, plugins, test_plugins })
    }

    /// Cargo in the workspace's root.
    pub fn cargo(&self) -> Command {
        cargo(&self.root)
    }

    /// Cargo for builds in the development profile: workspace packages are linted in the pass that compiles them.
    pub fn cargo_dev(&self) -> Command {
        let mut cargo = self.cargo();
        deny_warnings(&mut cargo);
        cargo
    }

    /// Cargo for release builds, whose `--version` names the commit.
    pub fn cargo_release(&self) -> Command {
        let mut cargo = self.cargo();
        if let Some(commit) = self.commit() {
            cargo.env("PANOSCOPE_COMMIT", commit);
        }
        cargo
    }

    /// The commit that is checked out, with a `+` if files differ from it. `None` outside a repository.
    pub fn commit(&self) -> Option<String> {
        let git = |args: &[&str]| process::capture(Command::new("git").current_dir(&self.root).args(args)).ok();
        let commit = git(&["rev-parse", "--short=12", "HEAD"])?;
        let differs = git(&["status", "--porcelain", "--untracked-files=no"]).is_none_or(|files| !files.is_empty());
        Some(format!("{}{}", commit.trim(), if differs { "+" } else { "" }))
    }

    /// Files fetched for tests and benches.
    pub fn data_dir(&self) -> PathBuf {
        self.target.join("data")
    }
}

/// Compiles the packages of the workspace with clippy, so that lints need no second pass; warnings are errors. Without
/// clippy nothing is linted.
fn deny_warnings(cargo: &mut Command) {
    // Rustup puts a program of this name into PATH also where clippy is not installed.
    let works = |driver: &PathBuf| process::capture(Command::new(driver).arg("--version")).is_ok();
    if let Some(driver) = process::find_program("clippy-driver").filter(works) {
        let [wrapper, arguments] = LINT_VARIABLES;
        // How `cargo clippy` hands its arguments to the driver.
        cargo.env(wrapper, driver).env(arguments, "-D__CLIPPY_HACKERY__warnings__CLIPPY_HACKERY__");
    }
}

/// Cargo without the variables that `cargo run` set for this program, which would differ from the user's own
/// calls and make build scripts that watch them run again.
fn cargo(dir: &Path) -> Command {
    let mut command = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    command.current_dir(dir);
    for (name, _) in std::env::vars_os() {
        let Some(text) = name.to_str() else { continue };
        if text.starts_with("CARGO_PKG_") || text.starts_with("CARGO_MANIFEST_") {
            command.env_remove(name);
        }
    }
    command
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_folders_under_plugins_are_plugins() {
        let text = r#"{"workspace_root": "/r", "target_directory": "/t", "packages": [
            {"name": "panoscope-stitch", "manifest_path": "/r/plugins/stitch/Cargo.toml"},
            {"name": "panoscope-capture", "manifest_path": "/r/plugins/capture/Cargo.toml"},
            {"name": "panoscope-cli", "manifest_path": "/r/core/cli/Cargo.toml"},
            {"name": "panoscope-fixtures", "manifest_path": "/r/tests/plugins/fixtures/Cargo.toml"},
            {"name": "helper", "manifest_path": "/r/plugins/stitch/helper/Cargo.toml"}]}"#;
        let workspace = Workspace::from_metadata(text).unwrap();
        let names =
            |plugins: &[Plugin]| -> Vec<_> { plugins.iter().map(|p| (p.name.clone(), p.package.clone())).collect() };
        let named = |name: &str| (name.to_owned(), format!("panoscope-{name}"));
        assert_eq!(names(&workspace.plugins), [named("capture"), named("stitch")]);
        assert_eq!(names(&workspace.test_plugins), [named("fixtures")]);
        assert_eq!(workspace.test_plugins[0].folder, Path::new("/r/tests/plugins/fixtures"));
        assert_eq!(workspace.target, Path::new("/t"));
    }

    #[test]
    fn metadata_without_a_root_is_an_error() {
        let error = Workspace::from_metadata(r#"{"packages": []}"#).unwrap_err();
        assert!(error.to_string().contains("workspace_root"), "{error}");
    }

    #[test]
    fn this_workspace_is_found() {
        let workspace = Workspace::locate().unwrap();
        assert!(workspace.root.join("core/xtask/Cargo.toml").is_file());
        assert!(workspace.plugins.iter().any(|plugin| plugin.name == "phantom"));
        assert!(workspace.test_plugins.iter().any(|plugin| plugin.name == "fixtures"));
    }
}
