//! What `--version` says, and files that version 0.1.0 wrote.

use std::path::Path;
use std::process::{Command, Output};

use crate::common;

fn panoscope(arguments: &[&str]) -> (i32, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_panoscope"));
    command.env("PANOSCOPE_PLUGIN_PATH", common::built_plugins(&["flow"])).args(arguments);
    let Output { status, stdout, stderr } = command.output().expect("the program starts");
    let text = [stdout, stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned()).concat();
    (status.code().unwrap_or(-1), text)
}

#[test]
fn the_version_names_the_commit_and_what_fits_it() {
    let number = concat!("panoscope ", env!("CARGO_PKG_VERSION"), "\n");
    assert_eq!(panoscope(&["-V"]), (0, number.to_owned()));
    let (code, text) = panoscope(&["--version"]);
    assert!(code == 0 && text.starts_with(number), "{text}");
    for line in ["commit: ", "plugins: contract 1.0 to 1.", "recordings: formats 1 to ", "kernels: "] {
        assert!(text.lines().any(|found| found.starts_with(line)), "{line} is not in\n{text}");
    }
}

#[test]
fn a_graph_and_a_recording_of_version_0_1_run_and_give_the_same_bytes() {
    let old = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/version_0_1");
    let [graph, recording] = ["graph.toml", "run.mcap"].map(|name| old.join(name).display().to_string());
    let folder = std::env::temp_dir().join(format!("panoscope_versions_{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("temporary files can be written");
    let new = folder.join("new.mcap").display().to_string();
    for arguments in [&["check", &graph][..], &["replay", &recording], &["record", &graph, "-o", &new]] {
        let (code, text) = panoscope(arguments);
        assert_eq!(code, 0, "{arguments:?}: {text}");
    }
    let (code, text) = panoscope(&["compare", &recording, &new]);
    assert!(code == 0 && text.contains("4 packets"), "{text}");
    std::fs::remove_dir_all(folder).expect("the folder goes");
}
