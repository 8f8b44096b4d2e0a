//! What the README names is there: plugins, graphs, environment variables, training scripts with their arguments.

use std::path::Path;
use std::process::Command;

use panoscope_loader::{self as loader, Loader};

fn readme() -> String {
    std::fs::read_to_string(panoscope_tests::root().join("README.md")).expect("README.md")
}

#[test]
fn readme_lists_every_plugin_and_node() {
    let readme = readme();
    let loader = Loader::search(&loader::search_path(&[]));
    let mut count = 0;
    for found in loader.found() {
        let plugin = &found.note.name;
        let folder = panoscope_tests::root().join("plugins").join(plugin);
        if !folder.is_dir() {
            continue; // Somebody's own plugin lies in the same folder.
        }
        let row = readme.lines().find(|line| line.starts_with(&format!("| `{plugin}` |")));
        let row = row.unwrap_or_else(|| panic!("README.md has no row for the plugin `{plugin}`"));
        for node in &found.note.node_types {
            assert!(row.contains(&format!("`{node}`")), "the row of `{plugin}` does not name its node `{node}`");
        }
        count += 1;
    }
    let folders = std::fs::read_dir(panoscope_tests::root().join("plugins")).expect("plugins").flatten().count();
    assert_eq!(count, folders, "plugins built and folders in plugins/ differ");
}

#[test]
fn graphs_that_the_readme_names_ship() {
    let readme = readme();
    let names = readme.split(|c: char| !(c.is_alphanumeric() || "_./".contains(c)));
    let mut count = 0;
    for name in names.filter(|n| n.starts_with("graphs/") && n.ends_with(".toml")) {
        assert!(panoscope_tests::root().join(name).is_file(), "README.md names {name}, which does not ship");
        count += 1;
    }
    assert!(count > 10, "only {count} graphs are named");
}

#[test]
fn the_list_of_graphs_names_each_that_ships_and_no_other() {
    let folder = panoscope_tests::root().join("graphs");
    let list = std::fs::read_to_string(folder.join("README.md")).expect("graphs/README.md");
    let files = std::fs::read_dir(&folder).expect("graphs").flatten().map(|file| file.file_name());
    let mut graphs: Vec<String> = files.map(|name| name.to_string_lossy().into_owned()).collect();
    graphs.retain(|name| name.ends_with(".toml"));
    // A row may name the first and the last of numbered graphs.
    let is_between = |name: &str| name.starts_with("thesis_chapter");
    for name in &graphs {
        assert!(list.contains(&format!("`{name}`")) || is_between(name), "graphs/README.md does not name {name}");
    }
    for name in list.split('`').filter(|name| name.ends_with(".toml") && !name.contains([' ', '/'])) {
        assert!(graphs.iter().any(|graph| graph == name), "graphs/README.md names {name}, which does not ship");
    }
}

#[test]
fn environment_variables_of_users_are_documented() {
    for name in [loader::PLUGIN_PATH_VARIABLE, "ORT_DYLIB_PATH"] {
        assert!(readme().contains(&format!("`{name}`")), "README.md does not say what {name} is for");
    }
}

/// A training script's own words about its arguments; needs no more than Python.
fn help_of(script: &Path) -> Option<String> {
    let output = match Command::new("python3").arg("-B").arg(script).arg("--help").output() {
        Ok(output) => output,
        Err(error) => {
            panoscope_testing::skipped!("no python3: {error}");
            return None;
        }
    };
    let why = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{} does not tell its arguments: {why}", script.display());
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    Some(said)
}

#[test]
fn training_commands_of_the_readme_have_scripts_and_arguments() {
    let readme = readme();
    let folder = panoscope_tests::root().join("plugins/tools/training");
    let commands: Vec<&str> = readme.lines().filter_map(|l| l.strip_prefix("python3 ")).collect();
    assert!(commands.len() >= 5, "{commands:?}");
    for command in commands {
        let words: Vec<&str> = command.split('#').next().unwrap_or_default().split_whitespace().collect();
        let script = folder.join(words[0]);
        let source = std::fs::read_to_string(&script).unwrap_or_else(|e| panic!("{}: {e}", script.display()));
        let options = words.iter().filter(|w| w.starts_with("--"));
        for option in options {
            assert!(source.contains(&format!("\"{option}\"")), "{} takes no {option}", words[0]);
        }
    }
}

#[test]
fn training_starts_from_weights_that_ship() {
    let folder = panoscope_tests::root().join("plugins/tools/training");
    let script = folder.join("train_detector.py");
    let Some(help) = help_of(&script) else { return };
    // Where the line is broken depends on the terminal.
    let in_one = |text: &str| -> String { text.split_whitespace().collect() };
    let help = in_one(&help);
    let shipped = folder.parent().expect("a folder").join("models/instruments.onnx");
    assert!(shipped.is_file() && help.contains(&in_one(&format!("(default: {})", shipped.display()))), "{help}");

    let scratch = panoscope_tests::scratch("training");
    let run = |arguments: &[&str]| {
        let output = Command::new("python3").arg("-B").arg(&script).args(arguments).current_dir(&scratch).output();
        let output = output.expect("it ran before");
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    // The README's command on a folder that is not there: said before PyTorch is looked for.
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
