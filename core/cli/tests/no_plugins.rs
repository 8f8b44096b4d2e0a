//! A program without plugins beside it, as a plain `cargo build` leaves it.

use std::path::Path;
use std::process::Command;

#[test]
fn without_any_plugin_the_error_says_how_to_get_them() {
    let folder = std::env::temp_dir().join(format!("panoscope_no_plugins_{}", std::process::id()));
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).expect("temporary files can be written");
    let (built, program) = (Path::new(env!("CARGO_BIN_EXE_panoscope")), folder.join("panoscope"));
    std::fs::hard_link(built, &program).or_else(|_| std::fs::copy(built, &program).map(drop)).expect("a program");
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
