//! A program without plugins and programs beside it, as a plain `cargo build` leaves it.

use std::path::{Path, PathBuf};
use std::process::Command;

/// A folder with nothing but the program, and the program.
fn alone(name: &str) -> (PathBuf, PathBuf) {
    let folder = std::env::temp_dir().join(format!("panoscope_{name}_{}", std::process::id()));
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).expect("temporary files can be written");
    let (built, program) = (Path::new(env!("CARGO_BIN_EXE_panoscope")), folder.join("panoscope"));
    std::fs::hard_link(built, &program).or_else(|_| std::fs::copy(built, &program).map(drop)).expect("a program");
    (folder, program)
}

#[test]
fn without_any_plugin_the_error_says_how_to_get_them() {
    let (folder, program) = alone("no_plugins");
    let graph = folder.join("g.toml");
    let text = "plugins = [\"phantom\", \"sinks\"]\n[nodes.scope]\ntype = \"phantom\"\n[nodes.out]\ntype = \"preview\"\ninputs = { image = \"scope.left\" }\n";
    std::fs::write(&graph, text).expect("a graph");
    for command in ["run", "check"] {
        let output = Command::new(&program).arg(command).arg(&graph).env_remove("PANOSCOPE_PLUGIN_PATH").output();
        let output = output.expect("it starts");
        let said = String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{said}");
        for words in
            ["cargo xtask build", "cargo xtask install DIR", "PANOSCOPE_PLUGIN_PATH", "no plugin was found at all"]
        {
            assert_eq!(said.matches(words).count(), 1, "`{words}` in what `{command}` says:\n{said}");
        }
    }
    std::fs::remove_dir_all(folder).expect("removed");
}

#[test]
fn without_the_program_of_a_command_the_error_says_how_to_get_it() {
    let (folder, program) = alone("no_programs");
    let cases: [(&[&str], &str); 3] = [
        (&["eval", "stitch", "--help"], "panoscope-lab"),
        (&["tune", "--graph-arg"], "panoscope-lab"),
        (&["edit", "g.toml"], "panoscope-editor"),
    ];
    for (words, missing) in cases {
        let output = Command::new(&program).args(words).current_dir(&folder).output().expect("it starts");
        let said = String::from_utf8_lossy(&output.stderr);
        let file = folder.join(missing).display().to_string();
        assert_eq!(output.status.code(), Some(1), "{said}");
        assert!(said.contains(&file) && said.contains("`cargo xtask build` builds it"), "{words:?}: {said}");
    }
    std::fs::remove_dir_all(folder).expect("removed");
}
