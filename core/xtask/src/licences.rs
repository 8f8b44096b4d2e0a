//! Licences of the crates linked into the programs.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use serde_json::Value;

use crate::process::capture;
use crate::workspace::Workspace;

/// Prefixes of the names of licence files.
const NAMES: [&str; 6] = ["LICEN", "COPYING", "NOTICE", "COPYRIGHT", "OFL", "UFL"];

/// A linked crate.
struct Crate {
    /// Name and version.
    name: String,
    licence: String,
    folder: PathBuf,
}

/// The licences of all external crates linked into the workspace's programs and plugins: a list, then each text once.
///
/// # Errors
/// `cargo metadata` fails.
pub fn notices(workspace: &Workspace) -> Result<String> {
    let mut cargo = workspace.cargo();
    cargo.args(["metadata", "--format-version", "1", "--locked"]);
    let metadata: Value = serde_json::from_str(&capture(&mut cargo)?).context("`cargo metadata` wrote no JSON")?;
    let crates = linked(&metadata).context("`cargo metadata` lists no dependencies")?;
    let mut texts: BTreeMap<String, Vec<&str>> = BTreeMap::new();
    let mut list =
        String::from("Panoscope's programs are linked with these crates. The texts of their licences follow.\n\n");
    for one in &crates {
        let _ = writeln!(list, "{}: {}", one.name, one.licence);
        for text in terms(&one.folder)? {
            texts.entry(text).or_default().push(&one.name);
        }
    }
    list.push_str("\nThey contain the font Roboto Medium 2.138, reduced to Latin letters: Copyright 2011 Google Inc., Apache License 2.0.\n");
    for (text, users) in texts {
        let _ = write!(list, "\n{}\n{}\n\n{text}\n", "-".repeat(80), users.join(", "));
    }
    Ok(list)
}

/// Crates of a registry that members of the workspace, other than tests and this program, need at run time, sorted by
/// name.
fn linked(metadata: &Value) -> Option<Vec<Crate>> {
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
    let mut waiting: Vec<&str> =
        metadata["workspace_members"].as_array()?.iter().filter_map(Value::as_str).filter(ships).collect();
    let mut reached: BTreeSet<&str> = waiting.iter().copied().collect();
    while let Some(id) = waiting.pop() {
        let needs = nodes.get(id).and_then(|node| node["deps"].as_array());
        for need in needs.into_iter().flatten() {
            let at_run_time =
                need["dep_kinds"].as_array().is_some_and(|kinds| kinds.iter().any(|k| k["kind"].is_null()));
            if let Some(id) = need["pkg"].as_str().filter(|_| at_run_time)
                && reached.insert(id)
            {
                waiting.push(id);
            }
        }
    }
    let foreign = reached.iter().filter_map(|id| packages.get(id)).filter(|package| !package["source"].is_null());
    let mut crates: Vec<Crate> = foreign
        .filter_map(|package| {
            Some(Crate {
                name: format!("{} {}", package["name"].as_str()?, package["version"].as_str()?),
                licence: package["license"].as_str().unwrap_or("see its text").to_owned(),
                folder: Path::new(package["manifest_path"].as_str()?).parent()?.to_owned(),
            })
        })
        .collect();
    crates.sort_by(|a, b| a.name.cmp(&b.name));
    Some(crates)
}

/// The licence texts in a crate's folder, and of its fonts.
fn terms(folder: &Path) -> Result<Vec<String>> {
    let mut texts = Vec::new();
    for (folder, is_fonts) in [(folder.to_owned(), false), (folder.join("fonts"), true)] {
        let mut files: Vec<PathBuf> = fs::read_dir(&folder).into_iter().flatten().flatten().map(|e| e.path()).collect();
        files.sort();
        for file in files.iter().filter(|file| file.is_file()) {
            let name = file.file_name().unwrap_or_default().to_string_lossy().to_uppercase();
            if NAMES.iter().any(|start| name.starts_with(start)) || is_fonts && name.ends_with(".TXT") {
                let bytes = fs::read(file).with_context(|| format!("cannot read {}", file.display()))?;
                texts.push(String::from_utf8_lossy(&bytes).replace('\r', "").trim().to_owned());
            }
        }
    }
    Ok(texts)
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
        let crates = linked(&serde_json::from_str(text).unwrap()).unwrap();
        let names: Vec<_> = crates.iter().map(|c| (c.name.as_str(), c.licence.as_str())).collect();
        assert_eq!(names, [("a 1", "MIT"), ("b 2", "see its text")]);
        assert!(linked(&serde_json::json!({})).is_none());
    }

    #[test]
    fn fonts_and_crates_of_the_windows_have_their_terms() {
        let notices = notices(&Workspace::locate().unwrap()).unwrap();
        for words in [
            "eframe 0.",
            "SIL OPEN FONT LICENSE",
            "UBUNTU FONT LICENCE",
            "Permission is hereby granted, free of charge",
        ] {
            assert!(notices.contains(words), "{words}");
        }
    }
}
