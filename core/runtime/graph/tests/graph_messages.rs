//! Every bad graph of the repository's `tests/bad_graphs` gives exactly the message beside it. `PANOSCOPE_BLESS=1 cargo
//! nextest run -p panoscope-graph graph_messages::` writes the messages anew; read them after that.

use crate::common;
use panoscope_graph::{GraphOptions, GraphText, check};
use std::path::{Path, PathBuf};

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../tests/bad_graphs")
}

fn bad_graphs() -> Vec<PathBuf> {
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder())
        .expect("tests/bad_graphs")
        .map(|entry| entry.expect("an entry").path())
        .filter(|path| path.extension().is_some_and(|e| e == "toml"))
        .collect();
    files.sort();
    files
}

/// The options of a graph whose first line is `# given: --with FILE --name value`.
fn given(path: &Path) -> GraphOptions {
    let mut options = GraphOptions::default();
    let text = std::fs::read_to_string(path).unwrap_or_default();
    let Some(words) = text.lines().next().and_then(|line| line.strip_prefix("# given: ")) else { return options };
    let mut words = words.split(' ').peekable();
    while let Some(option) = words.next() {
        let value = words.next_if(|word| !word.starts_with("--")).unwrap_or_default().to_owned();
        match option.trim_start_matches("--") {
            "with" => options.with.push(folder().join(value)),
            "set" => options.set.push(value),
            name => options.args.push((name.to_owned(), value)),
        }
    }
    options
}

/// The message, with the file named without its folder so that it does not depend on where the tests run.
fn message(path: &Path) -> String {
    let catalog = common::catalog();
    let diagnostics = match GraphText::load_with(path, &given(path)) {
        Ok(text) => check(&text, &catalog).diagnostics,
        Err(diagnostics) => diagnostics,
    };
    let shown = path.display().to_string();
    let folder = format!("{}{}", folder().display(), std::path::MAIN_SEPARATOR);
    let here = std::env::current_dir().expect("a folder").display().to_string();
    diagnostics.render(false).replace(&shown, &shown[folder.len()..]).replace(&folder, "").replace(&here, "HERE")
}

#[test]
fn messages_are_as_written() {
    let bless = std::env::var_os("PANOSCOPE_BLESS").is_some();
    let files = bad_graphs();
    assert!(files.len() >= 45, "only {} bad graphs", files.len());
    let mut wrong = Vec::new();
    for path in files {
        let expected_path = path.with_extension("txt");
        let got = message(&path);
        assert!(!got.is_empty(), "{} is no bad graph", path.display());
        if bless {
            std::fs::write(&expected_path, &got).expect("the message can be written");
            continue;
        }
        let expected = std::fs::read_to_string(&expected_path).unwrap_or_default();
        if expected != got {
            wrong.push(format!("{}\nexpected:\n{expected}\ngot:\n{got}", path.display()));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn every_message_has_its_graph() {
    for entry in std::fs::read_dir(folder()).expect("tests/bad_graphs") {
        let path = entry.expect("an entry").path();
        if path.extension().is_some_and(|e| e == "txt") {
            assert!(path.with_extension("toml").exists(), "{} has no graph", path.display());
        }
    }
}
