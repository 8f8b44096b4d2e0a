//! Everything that the documents name exists: plugins, graphs, environment variables, training scripts with their arguments.

use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;

use panoscope_host::loader::{self as loader, Loader};
use panoscope_tests::{DOCUMENTS, document, root};

#[test]
fn the_table_of_plugins_has_every_plugin_and_node_that_ships() {
    let text = document("plugins/README.md");
    let loader = Loader::search(&loader::search_path(&[]));
    let mut count = 0;
    for found in loader.found() {
        let plugin = &found.note.name;
        let folder = root().join("plugins").join(plugin);
        if !folder.is_dir() {
            continue; // A test plugin, or one of the user's own in the same folder.
        }
        let row = text.lines().find(|line| line.starts_with(&format!("| `{plugin}` |")));
        let row = row.unwrap_or_else(|| panic!("plugins/README.md has no row for the plugin `{plugin}`"));
        let cell = row.split('|').nth(2).expect("a row has cells");
        let named: BTreeSet<&str> = cell.split('`').skip(1).step_by(2).collect();
        let has: BTreeSet<&str> = found.note.node_types.iter().map(String::as_str).collect();
        assert_eq!(named, has, "the row of `{plugin}` and its nodes");
        count += 1;
    }
    let folders = std::fs::read_dir(root().join("plugins")).expect("plugins").flatten().filter(|f| f.path().is_dir());
    assert_eq!(count, folders.count(), "plugins built and folders in plugins/ differ");
}

#[test]
fn graphs_that_the_documents_name_ship() {
    let mut count = 0;
    for document in DOCUMENTS {
        let text = panoscope_tests::document(document);
        let names = text.split(|c: char| !(c.is_alphanumeric() || "_./".contains(c)));
        for name in names.filter(|n| n.starts_with("graphs/") && n.ends_with(".toml") && !n.contains("NAME")) {
            assert!(root().join(name).is_file(), "{document} names {name}, which does not ship");
            count += 1;
        }
    }
    assert!(count > 30, "only {count} graphs are named");
}

#[test]
fn the_gallery_shows_each_graph_that_ships_and_no_other() {
    let folder = root().join("graphs");
    let text = document("graphs/README.md");
    let gallery = text.split("\n## ").find(|section| section.starts_with("Gallery")).expect("a gallery");
    let files = std::fs::read_dir(&folder).expect("graphs").flatten().map(|file| file.file_name());
    let graphs: BTreeSet<String> =
        files.filter_map(|name| name.to_string_lossy().strip_suffix(".toml").map(str::to_owned)).collect();
    assert!(graphs.len() > 20, "{graphs:?}");
    for graph in &graphs {
        let picture = format!("pictures/gallery/{graph}.jpg");
        let row = gallery.lines().find(|line| line.starts_with(&format!("| `{graph}.toml` |")));
        let row = row.unwrap_or_else(|| panic!("the gallery has no row for {graph}.toml"));
        assert!(row.contains(&format!("]({picture})")), "the row of {graph}.toml shows no {picture}");
        let bytes = std::fs::metadata(folder.join(&picture)).unwrap_or_else(|e| panic!("{picture}: {e}")).len();
        assert!((1_000..=30_000).contains(&bytes), "{picture} has {bytes} bytes");
        let (width, height) = image::image_dimensions(folder.join(&picture)).expect("a picture");
        assert!(width <= 320 && height <= 180, "{picture} is {width}x{height}");
    }
    for name in text.split('`').filter(|name| name.ends_with(".toml") && !name.contains([' ', '/', '*'])) {
        let is_named = graphs.contains(name.trim_end_matches(".toml"));
        // The tutorial's own files are written by the reader.
        let is_written = text.contains(&format!("<!-- file: {name} -->"));
        assert!(is_named || is_written, "graphs/README.md names {name}, which does not ship");
    }
    for kind in ["parts", "sources"] {
        for file in std::fs::read_dir(folder.join(kind)).expect("parts and sources").flatten() {
            let name = format!("`{kind}/{}`", file.file_name().to_string_lossy());
            let row = text.lines().find(|line| line.starts_with("| `") && line.contains(&name));
            assert!(row.is_some(), "graphs/README.md has no row for {name}");
        }
    }
    for name in text.split('`').filter(|name| name.starts_with("sources/") && name.ends_with(".toml")) {
        assert!(folder.join(name).is_file(), "graphs/README.md names {name}, which does not ship");
    }
    let pictures = std::fs::read_dir(folder.join("pictures/gallery")).expect("pictures").flatten().count();
    assert_eq!(pictures, graphs.len(), "the gallery has pictures of no graph");
}

#[test]
fn environment_variables_of_users_are_documented() {
    for name in [loader::PLUGIN_PATH_VARIABLE, "ORT_DYLIB_PATH"] {
        let text = document("core/cli/README.md");
        assert!(text.contains(&format!("`{name}`")), "core/cli/README.md does not explain {name}");
    }
}

/// The `--help` of a training script; needs only Python.
fn help_of(script: &Path) -> Option<String> {
    let output = match Command::new("python3").arg("-B").arg(script).arg("--help").output() {
        Ok(output) => output,
        Err(error) => {
            panoscope_testing::skipped!("no python3: {error}");
            return None;
        }
    };
    let why = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{} has no --help: {why}", script.display());
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    Some(said)
}

#[test]
fn training_commands_of_the_documents_have_scripts_and_arguments() {
    let text = document("plugins/README.md") + &document("plugins/tools/training/README.md");
    let commands = check_training_commands(&text, "plugins/tools/training");
    assert!(commands >= 7, "{commands} commands");
    let commands = check_training_commands(&document("plugins/stereo/training/README.md"), "plugins/stereo/training");
    assert!(commands >= 3, "{commands} commands");
}

/// Checks the scripts and arguments of the commands in a text; gives their number.
fn check_training_commands(text: &str, folder: &str) -> usize {
    let folder = root().join(folder);
    let command = |line: &'_ str| {
        line.trim_start().strip_prefix("venv/bin/python ").or(line.strip_prefix("python3 ")).map(str::to_owned)
    };
    let commands: Vec<String> = text.lines().filter_map(command).filter(|c| !c.starts_with("-m ")).collect();
    for command in &commands {
        let words: Vec<&str> = command.split('#').next().unwrap_or_default().split_whitespace().collect();
        let script = folder.join(words[0]);
        let source = std::fs::read_to_string(&script).unwrap_or_else(|e| panic!("{}: {e}", script.display()));
        let options = words.iter().filter(|w| w.starts_with("--"));
        for option in options {
            assert!(source.contains(&format!("\"{option}\"")), "{} takes no {option}", words[0]);
        }
    }
    commands.len()
}

#[test]
fn training_starts_from_weights_that_ship() {
    let folder = root().join("plugins/tools/training");
    let script = folder.join("train_detector.py");
    let Some(help) = help_of(&script) else { return };
    // Where the line is broken depends on the terminal.
    let in_one = |text: &str| -> String { text.split_whitespace().collect() };
    let help = in_one(&help);
    let shipped = folder.join("weights/instruments.pt");
    assert!(shipped.is_file() && help.contains(&in_one(&format!("(default: {})", shipped.display()))), "{help}");

    let scratch = panoscope_tests::scratch("training");
    let run = |arguments: &[&str]| {
        let output = Command::new("python3").arg("-B").arg(&script).args(arguments).current_dir(&scratch).output();
        let output = output.expect("it ran before");
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    // The document's command on a folder that is not there: refused before PyTorch is imported.
    let (code, said) = run(&["--data", "my/frames", "--out", "detector"]);
    assert!(code == Some(2) && said.contains("--data: there is no my/frames"), "{said}");
    std::fs::create_dir_all(scratch.join("my/frames")).expect("a folder");
    let (code, said) = run(&["--data", "my/frames", "--start", "yolox_nano.onnx", "--out", "detector"]);
    assert!(code == Some(2) && said.contains("--start: there is no yolox_nano.onnx"), "{said}");
    // With all named files there the arguments are right: what is missing now is PyTorch, or frames.
    for start in [&[][..], &["--start", "none"]] {
        let (code, said) = run(&[&["--data", "my/frames", "--out", "detector"], start].concat());
        assert!(code != Some(0) && code != Some(2), "{said}");
    }
    std::fs::remove_dir_all(scratch).expect("removed");
}
