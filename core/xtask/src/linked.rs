//! The external crates that the programs and plugins are linked with.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use serde_json::Value;

use crate::process::capture;
use crate::workspace::Workspace;

/// A linked crate.
#[derive(Debug)]
pub struct Crate {
    pub name: String,
    pub version: String,
    /// As its manifest states it.
    pub licence: Option<String>,
    /// Folder of its source.
    pub folder: PathBuf,
    /// Linked crates that it needs at run time, as indexes of the list.
    pub needs: Vec<usize>,
}

impl Crate {
    /// Name and version.
    pub fn title(&self) -> String {
        format!("{} {}", self.name, self.version)
    }
}

/// Crates of a registry that members of the workspace, other than tests and this program, need at run time, sorted by
/// name.
///
/// # Errors
/// `cargo metadata` fails.
pub fn linked(workspace: &Workspace) -> Result<Vec<Crate>> {
    let mut cargo = workspace.cargo();
    cargo.args(["metadata", "--format-version", "1", "--locked"]);
    let metadata: Value = serde_json::from_str(&capture(&mut cargo)?).context("`cargo metadata` wrote no JSON")?;
    from_metadata(&metadata).context("`cargo metadata` lists no dependencies")
}

fn from_metadata(metadata: &Value) -> Option<Vec<Crate>> {
    let nodes: BTreeMap<&str, &Value> =
        metadata["resolve"]["nodes"].as_array()?.iter().filter_map(|node| Some((node["id"].as_str()?, node))).collect();
    let packages: BTreeMap<&str, &Value> = metadata["packages"]
        .as_array()?
        .iter()
        .filter_map(|package| Some((package["id"].as_str()?, package)))
        .collect();
    let ships = |id: &&str| {
        let manifest = packages.get(id).and_then(|p| p["manifest_path"].as_str()).unwrap_or_default();
        !manifest.contains("/tests/") && !manifest.contains("/xtask/")
    };
    let needs_of = |id: &str| -> Vec<&str> {
        let needs = nodes.get(id).and_then(|node| node["deps"].as_array());
        let at_run_time = |need: &&Value| {
            need["dep_kinds"].as_array().is_some_and(|kinds| kinds.iter().any(|kind| kind["kind"].is_null()))
        };
        needs.into_iter().flatten().filter(at_run_time).filter_map(|need| need["pkg"].as_str()).collect()
    };
    let mut waiting: Vec<&str> =
        metadata["workspace_members"].as_array()?.iter().filter_map(Value::as_str).filter(ships).collect();
    let mut reached: BTreeSet<&str> = waiting.iter().copied().collect();
    while let Some(id) = waiting.pop() {
        waiting.extend(needs_of(id).into_iter().filter(|need| reached.insert(need)));
    }
    let foreign = |id: &&&str| packages.get(**id).is_some_and(|package| !package["source"].is_null());
    let mut ids: Vec<&str> = reached.iter().filter(foreign).copied().collect();
    ids.sort_by_key(|id| (packages[id]["name"].as_str(), packages[id]["version"].as_str()));
    let index: BTreeMap<&str, usize> = ids.iter().enumerate().map(|(index, id)| (*id, index)).collect();
    let crate_of = |id: &&str| {
        let package = packages[id];
        let text = |key: &str| package[key].as_str().map(str::to_owned);
        Some(Crate {
            name: text("name")?,
            version: text("version")?,
            licence: text("license"),
            folder: Path::new(package["manifest_path"].as_str()?).parent()?.to_owned(),
            needs: needs_of(id).into_iter().filter_map(|need| index.get(need).copied()).collect(),
        })
    };
    ids.iter().map(crate_of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_is_linked_into_programs_is_listed() {
        let text = r#"{"workspace_members": ["cli", "xtask", "t"],
            "packages": [
                {"id": "cli", "name": "cli", "version": "1", "manifest_path": "/r/core/cli/Cargo.toml", "source": null},
                {"id": "xtask", "name": "xtask", "version": "1", "manifest_path": "/r/core/xtask/Cargo.toml", "source": null},
                {"id": "t", "name": "t", "version": "1", "manifest_path": "/r/tests/Cargo.toml", "source": null},
                {"id": "a", "name": "a", "version": "1", "license": "MIT", "manifest_path": "/c/a/Cargo.toml", "source": "registry"},
                {"id": "b", "name": "b", "version": "2", "license": null, "manifest_path": "/c/b/Cargo.toml", "source": "registry"},
                {"id": "build", "name": "build", "version": "1", "manifest_path": "/c/build/Cargo.toml", "source": "registry"},
                {"id": "test", "name": "test", "version": "1", "manifest_path": "/c/test/Cargo.toml", "source": "registry"}],
            "resolve": {"nodes": [
                {"id": "cli", "deps": [{"pkg": "b", "dep_kinds": [{"kind": null}]}, {"pkg": "build", "dep_kinds": [{"kind": "build"}]}]},
                {"id": "b", "deps": [{"pkg": "a", "dep_kinds": [{"kind": "dev"}, {"kind": null}]}]},
                {"id": "t", "deps": [{"pkg": "test", "dep_kinds": [{"kind": null}]}]}]}}"#;
        let crates = from_metadata(&serde_json::from_str(text).unwrap()).unwrap();
        let found: Vec<_> = crates.iter().map(|c| (c.title(), c.licence.as_deref(), c.needs.clone())).collect();
        assert_eq!(found, [("a 1".to_owned(), Some("MIT"), vec![]), ("b 2".to_owned(), None, vec![0])]);
        assert!(from_metadata(&serde_json::json!({})).is_none());
    }
}
