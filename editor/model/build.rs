//! Embeds the files in `texts/`, and lists the names and variables of the English texts, which the macros check when they are compiled.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::path::{Path, PathBuf};

#[path = "src/texts/syntax.rs"]
mod syntax;

/// The entries of a folder in the order of their names.
fn entries(folder: &Path) -> Vec<PathBuf> {
    println!("cargo:rerun-if-changed={}", folder.display());
    let listed = std::fs::read_dir(folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let mut paths: Vec<PathBuf> = listed.flatten().map(|entry| entry.path()).collect();
    paths.sort();
    paths
}

/// The name of a file or folder without its ending.
fn stem(path: &Path) -> &str {
    path.file_stem().and_then(|name| name.to_str()).unwrap_or_else(|| panic!("{}: no plain name", path.display()))
}

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-changed=src/texts/syntax.rs");
    let root = PathBuf::from(std::env::var_os("CARGO_MANIFEST_DIR").expect("cargo sets it")).join("texts");
    let mut files = String::new();
    let mut declared: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for language in entries(&root) {
        for file in entries(&language).iter().filter(|file| file.extension().is_some_and(|ending| ending == "ftl")) {
            println!("cargo:rerun-if-changed={}", file.display());
            let text = std::fs::read_to_string(file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
            writeln!(files, "    ({:?}, {:?}, {text:?}),", stem(&language), stem(file)).expect("memory takes it");
            if stem(&language) == "en" {
                let all = syntax::texts(&text).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
                declared.extend(all);
            }
        }
    }
    let mut out = format!("pub(crate) const FILES: &[(&str, &str, &str)] = &[\n{files}];\n");
    out.push_str("pub(crate) const DECLARED: &[(&str, &[&str])] = &[\n");
    for (name, variables) in declared {
        let variables: Vec<String> = variables.into_iter().collect();
        writeln!(out, "    ({name:?}, &{variables:?}),").expect("memory takes it");
    }
    out.push_str("];\n");
    let target = PathBuf::from(std::env::var_os("OUT_DIR").expect("cargo sets it")).join("texts.rs");
    std::fs::write(target, out).expect("cargo's folder can be written");
}
