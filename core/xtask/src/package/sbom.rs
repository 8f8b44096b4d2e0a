//! The software bill of materials of a package: what its programs are made of, as CycloneDX 1.5 in JSON.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use anyhow::{Context, Result};
use serde_json::{Value, json};

use crate::linked::{Crate, linked};
use crate::onnxruntime;
use crate::workspace::Workspace;

/// Name of the file in a package's documents.
pub const FILE: &str = "panoscope.cdx.json";

/// The text of the bill: all linked crates with versions, licences, checksums and what each needs, ONNX Runtime, the font, and the
/// models of the plugins. The same commit gives the same text.
///
/// # Errors
/// `cargo metadata` fails, or `Cargo.lock` cannot be read.
pub fn bill(workspace: &Workspace) -> Result<String> {
    let lock = fs::read_to_string(workspace.root.join("Cargo.lock")).context("cannot read Cargo.lock")?;
    let crates = linked(workspace)?;
    let models = model_names(workspace);
    Ok(serde_json::to_string_pretty(&document(&crates, &checksums(&lock)?, &models))?)
}

fn document(crates: &[Crate], checksums: &BTreeMap<(String, String), String>, models: &[String]) -> Value {
    let reference = |one: &Crate| format!("pkg:cargo/{}@{}", one.name, one.version);
    let mut components: Vec<Value> = crates
        .iter()
        .map(|one| {
            let reference = reference(one);
            let mut component = json!({
                "type": "library", "bom-ref": reference, "purl": reference, "name": one.name, "version": one.version,
            });
            if let Some(licence) = &one.licence {
                component["licenses"] = json!([{"expression": spdx(licence)}]);
            }
            if let Some(sum) = checksums.get(&(one.name.clone(), one.version.clone())) {
                component["hashes"] = json!([{"alg": "SHA-256", "content": sum}]);
            }
            component
        })
        .collect();
    components.push(json!({
        "type": "library", "bom-ref": "onnxruntime", "name": "ONNX Runtime", "version": onnxruntime::VERSION,
        "licenses": [{"expression": "MIT"}],
    }));
    components.push(json!({
        "type": "file", "bom-ref": "font", "name": "Roboto Medium", "version": "2.138",
        "licenses": [{"expression": "Apache-2.0"}],
    }));
    let version = env!("CARGO_PKG_VERSION");
    components.extend(models.iter().map(|name| {
        json!({"type": "machine-learning-model", "bom-ref": format!("model:{name}"), "name": name, "version": version})
    }));
    let program = format!("panoscope@{version}");
    let all: Vec<&Value> = components.iter().map(|component| &component["bom-ref"]).collect();
    let mut dependencies = vec![json!({"ref": program, "dependsOn": all})];
    dependencies.extend(crates.iter().map(|one| {
        let needs: Vec<String> = one.needs.iter().map(|index| reference(&crates[*index])).collect();
        json!({"ref": reference(one), "dependsOn": needs})
    }));
    json!({
        "bomFormat": "CycloneDX", "specVersion": "1.5", "version": 1,
        "metadata": {"component": {
            "type": "application", "bom-ref": program, "name": "panoscope", "version": version,
            "licenses": [{"expression": env!("CARGO_PKG_LICENSE")}],
        }},
        "components": components, "dependencies": dependencies,
    })
}

/// The licence as an expression of SPDX: old manifests separate alternatives by `/`.
pub fn spdx(licence: &str) -> String {
    licence.split('/').map(str::trim).collect::<Vec<_>>().join(" OR ")
}

/// SHA-256 of each crate's archive, by name and version.
fn checksums(lock: &str) -> Result<BTreeMap<(String, String), String>> {
    let lock: toml::Table = lock.parse().context("Cargo.lock")?;
    let packages = lock.get("package").and_then(toml::Value::as_array);
    let sum = |package: &toml::Value| {
        let text = |key: &str| package.get(key).and_then(toml::Value::as_str).map(str::to_owned);
        Some(((text("name")?, text("version")?), text("checksum")?))
    };
    Ok(packages.into_iter().flatten().filter_map(sum).collect())
}

/// Names of the models that plugins ship, sorted.
fn model_names(workspace: &Workspace) -> Vec<String> {
    let files = workspace.plugins.iter().filter_map(|plugin| fs::read_dir(plugin.folder.join("models")).ok());
    let mut names: Vec<String> = files
        .flat_map(|folder| folder.flatten())
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .filter(|name| Path::new(name).extension().is_some_and(|extension| extension == "onnx"))
        .collect();
    names.sort();
    names
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn the_bill_names_every_linked_crate_with_its_checksum_and_each_reference_is_there_once() {
        let workspace = Workspace::locate().unwrap();
        let bill: Value = serde_json::from_str(&bill(&workspace).unwrap()).unwrap();
        let components = bill["components"].as_array().unwrap();
        let references: BTreeSet<&str> = components.iter().filter_map(|one| one["bom-ref"].as_str()).collect();
        assert_eq!(references.len(), components.len());
        let crates = linked(&workspace).unwrap();
        assert!(crates.len() > 300, "{}", crates.len());
        for one in &crates {
            let reference = format!("pkg:cargo/{}@{}", one.name, one.version);
            let component = components.iter().find(|component| component["bom-ref"] == reference).unwrap();
            assert_eq!(component["hashes"][0]["content"].as_str().map(str::len), Some(64), "{reference}");
        }
        for edge in bill["dependencies"].as_array().unwrap() {
            for need in edge["dependsOn"].as_array().unwrap() {
                assert!(need.as_str().is_some_and(|need| references.contains(need)), "{need}");
            }
        }
        for name in ["onnxruntime", "font", "model:instruments.onnx", "model:instrument_masks.onnx"] {
            assert!(references.contains(name), "{name}");
        }
    }

    #[test]
    fn alternatives_of_old_manifests_become_expressions() {
        assert_eq!(spdx("MIT/Apache-2.0"), "MIT OR Apache-2.0");
        assert_eq!(spdx("(MIT OR Apache-2.0) AND Unicode-3.0"), "(MIT OR Apache-2.0) AND Unicode-3.0");
    }
}
