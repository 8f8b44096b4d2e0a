//! No plugin that only tests use is shipped, and no test reports a skip in its own way.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;

use panoscope_host::loader::{self as loader, Loader};
use panoscope_tests::root;

/// Node types by plugin name of every plugin crate in a folder of the repository.
fn crates(folder: &str) -> BTreeSet<String> {
    let entries = std::fs::read_dir(root().join(folder)).expect("a folder of the repository").flatten();
    let is_crate = |path: &PathBuf| path.join("Cargo.toml").is_file();
    entries.map(|e| e.path()).filter(is_crate).map(|p| p.file_name().expect("named").to_string_lossy().into()).collect()
}

#[test]
fn the_program_lists_no_plugin_that_only_tests_use() {
    let Some(program) = std::env::var_os("PANOSCOPE_BIN").map(PathBuf::from) else {
        return panoscope_testing::skipped!("PANOSCOPE_BIN names no program; `cargo xtask test` sets it");
    };
    let test_crates = crates("tests/plugins");
    assert!(test_crates.contains("fixtures"), "{test_crates:?}");
    // The tests see them, so their names are known.
    let seen_by_tests = Loader::search(&loader::search_path(&[]));
    let test_types: BTreeSet<String> = seen_by_tests
        .found()
        .filter(|found| test_crates.contains(&found.note.name))
        .flat_map(|found| found.note.node_types.clone())
        .collect();
    assert!(
        ["chaos", "ledger", "failing", "allocate", "device"].iter().all(|t| test_types.contains(*t)),
        "{test_types:?}"
    );

    // The program as its user starts it.
    let output = Command::new(&program).args(["list", "--json"]).env_remove(loader::PLUGIN_PATH_VARIABLE).output();
    let output = output.expect("the program starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let list: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let plugins = list["plugins"].as_array().expect("plugins");
    let names: BTreeSet<String> = plugins.iter().filter_map(|p| p["plugin"].as_str()).map(str::to_owned).collect();
    let types: BTreeSet<String> = plugins
        .iter()
        .flat_map(|p| p["node_types"].as_array().into_iter().flatten())
        .filter_map(|t| t.as_str())
        .map(str::to_owned)
        .collect();
    assert_eq!(names, crates("plugins"), "the plugins that ship are those of plugins/");
    assert!(types.len() > 50 && types.contains("phantom") && types.contains("frames"), "{types:?}");
    let leaked: Vec<&String> = types.intersection(&test_types).collect();
    assert!(leaked.is_empty(), "node types for tests that ship: {leaked:?}");
}

/// Rust files below a folder.
fn sources(folder: &Path, into: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).expect("a folder of the repository").flatten() {
        let (path, name) = (entry.path(), entry.file_name());
        if path.is_dir() && name != "target" && !name.to_string_lossy().starts_with('.') {
            sources(&path, into);
        } else if path.extension().is_some_and(|e| e == "rs") {
            into.push(path);
        }
    }
}

#[test]
fn skips_are_reported_where_plain_cargo_test_shows_them() {
    let mut files = Vec::new();
    ["core", "plugins", "editor", "tests"].iter().for_each(|folder| sources(&root().join(folder), &mut files));
    let hidden = ["println!(\"", "skipped:"].concat();
    let mut users = 0;
    for file in files {
        let text = std::fs::read_to_string(&file).expect("a source file");
        users += usize::from(text.contains("panoscope_testing::skipped!("));
        let is_helper = file.ends_with("tests/support/src/lib.rs");
        assert!(is_helper || !text.contains(&hidden), "{}: use panoscope_testing::skipped!", file.display());
    }
    assert!(users > 20, "{users} files report skips");
}
