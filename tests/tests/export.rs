//! Recordings exported to files of other programs: what `panoscope export` writes, read by others, and what it refuses.

use std::path::Path;
use std::process::{Command, Output};

use panoscope_tests::{named_program, run_python_tests, scratch};

#[test]
fn exported_recordings_are_read_by_others() {
    run_python_tests("export.py", "foxglove, mcap, mcap_protobuf, PIL, rerun");
}

const GRAPH: &str = "mode = \"batch\"\nplugins = [\"phantom\", \"flow\"]\n\
    [nodes.scope]\ntype = \"phantom\"\nparams = { width = 64, height = 48 }\n\
    [nodes.end]\ntype = \"drain\"\ninputs = { image = \"scope.left\" }\n";

fn run(program: &Path, words: &[&std::ffi::OsStr]) -> Output {
    Command::new(program).args(words).output().expect("the program starts")
}

#[test]
fn what_cannot_be_exported_is_refused_with_a_remedy() {
    let Some(program) = named_program() else { return };
    let folder = scratch("export-refused");
    let (graph, recording) = (folder.join("graph.toml"), folder.join("run.mcap"));
    std::fs::write(&graph, GRAPH).expect("written");
    let record = ["record".as_ref(), graph.as_os_str(), "-o".as_ref(), recording.as_os_str()];
    let record = [&record[..], &["--frames", "3", "--all-ports", "--headless"].map(AsRef::as_ref)].concat();
    let done = run(&program, &record);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let export = |file: &Path, words: &[&str]| {
        let mut command = Command::new(&program);
        let done = command.arg("export").arg(file).args(words).current_dir(&folder).output().expect("starts");
        (done.status.code(), String::from_utf8_lossy(&done.stderr).into_owned())
    };
    let (code, words) = export(&recording, &["--folder", "out"]);
    assert_eq!(code, Some(0), "{words}");
    assert!(folder.join("out/scope.left/000002.png").is_file());
    let bytes = std::fs::read(&recording).expect("a recording");
    std::fs::write(folder.join("other.mcap"), &bytes[..bytes.len() / 2]).expect("written");
    std::fs::write(folder.join("none.txt"), "text").expect("written");
    for (file, words, code, error) in [
        ("run.mcap", &["--folder", "out"][..], 2, "out already exists: choose another one, or replace it with --force"),
        ("run.mcap", &["--foxglove", "run.mcap", "--force"], 2, "run.mcap is the recording itself"),
        ("run.mcap", &["--folder", "new", "--ports", "scope.lefft"], 2, "no packets of `scope.lefft`; it has scope."),
        ("run.mcap", &["--folder", "new", "--from", "7"], 2, "it has ticks 0 to 2"),
        ("run.mcap", &["--folder", "new", "--from", "2", "--to", "1"], 2, "--to is before --from"),
        ("run.mcap", &[], 2, "--folder"),
        ("run.mcap", &["--foxglove", "missing/new.mcap"], 1, "missing/new.mcap cannot be written"),
        ("none.txt", &["--folder", "new"], 2, "is not a recording"),
    ] {
        let (got, stderr) = export(&folder.join(file), words);
        assert!(got == Some(code) && stderr.contains(error), "{file} {words:?}: {got:?}\n{stderr}");
    }
    assert!(!folder.join("new").exists() && !folder.join("missing").exists());
    // What a recording that was cut off holds is exported, with a warning.
    let (code, words) = export(&folder.join("other.mcap"), &["--foxglove", "cut.mcap", "--folder", "out", "--force"]);
    assert!(code == Some(0) && words.contains("exporting what is before"), "{words}");
    assert!(folder.join("cut.mcap").is_file() && !folder.join("cut.mcap.part").exists());
    let _ = std::fs::remove_dir_all(&folder);
}
