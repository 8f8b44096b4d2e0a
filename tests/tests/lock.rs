//! A graph with a neural network runs under its lock: ONNX Runtime, the model and the names of its classes come from sealed copies.

use std::path::{Path, PathBuf};
use std::process::Command;

use panoscope_tests::scratch;

const GRAPH: &str = r#"
mode = "batch"
plugins = ["phantom", "tools", "sinks"]
[nodes.scope]
type = "phantom"
params = { width = 160, height = 120 }
[nodes.find]
type = "yolo"
inputs = { image = "scope.left" }
params = { labels = "names.txt" }
[nodes.table]
type = "write_table"
inputs = { detections = "find.detections" }
params = { path = "out.json" }
"#;

/// Exit code and all output of the program.
fn run(program: &Path, folder: &Path, runtime: Option<&Path>, words: &str) -> (i32, String) {
    let mut command = Command::new(program);
    command.current_dir(folder).args(words.split_whitespace());
    panoscope_testing::own_settings(&mut command, folder);
    if let Some(runtime) = runtime {
        command.env("ORT_DYLIB_PATH", runtime);
    }
    let output = command.output().expect("the program starts");
    let text = String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
    (output.status.code().unwrap_or(-1), text)
}

#[test]
fn a_network_runs_under_a_lock_that_has_all_it_needs() {
    let Some(program) = std::env::var_os("PANOSCOPE_BIN").map(PathBuf::from) else {
        return panoscope_testing::skipped!("PANOSCOPE_BIN names no program; `cargo xtask test` sets it");
    };
    let runtime = panoscope_base::onnx::runtime_candidates().into_iter().find(|file| file.is_file());
    let beside = || {
        let folders = program.ancestors().skip(1).take(4).map(|folder| folder.join("onnxruntime"));
        let files = folders.filter_map(|folder| std::fs::read_dir(folder).ok()).flatten().flatten();
        files
            .map(|entry| entry.path())
            .find(|file| file.display().to_string().contains("libonnxruntime.so.") && !file.is_symlink())
    };
    let Some(runtime) = runtime.or_else(beside) else {
        return panoscope_testing::skipped!("ONNX Runtime's library is not there");
    };
    let folder = scratch("lock");
    // A copy, so that it can be damaged.
    let own = folder.join("libonnxruntime.so.1");
    std::fs::copy(&runtime, &own).expect("copied");
    std::fs::write(folder.join("g.toml"), GRAPH).expect("written");
    std::fs::write(folder.join("names.txt"), "a\nb\nc\nd\ne\nf\ng\n").expect("written");
    let (code, said) = run(&program, &folder, Some(&own), "lock g.toml");
    assert_eq!(code, 0, "{said}");
    let lock = std::fs::read_to_string(folder.join("g.toml.lock")).expect("the lock");
    let has = |kind: &str, name: &str| lock.contains(&format!("kind = \"{kind}\"\nname = \"{name}\"\n"));
    for (kind, name) in [
        ("graph", "g.toml"),
        ("plugin", "tools"),
        ("plugin", "sinks"),
        ("library", "libc.so.6"),
        ("program", "panoscope"),
        ("program", "panoscope-arm"),
        ("program", "panoscope-theatre"),
        ("model", "find.model"),
        ("file", "find.labels"),
        ("runtime", "onnxruntime"),
    ] {
        assert!(has(kind, name), "{kind} {name}: {said}");
    }
    let locked_run = "run g.toml --lock --frames 3 --headless";
    let (code, said) = run(&program, &folder, Some(&own), locked_run);
    assert_eq!(code, 0, "{said}");
    // Another ONNX Runtime, though it would work.
    let mut bytes = std::fs::read(&own).expect("the library");
    bytes.push(0);
    std::fs::write(&own, bytes).expect("written");
    let (code, said) = run(&program, &folder, Some(&own), locked_run);
    assert!(code == 2 && said.contains("runtime `onnxruntime` has changed since the graph was locked"), "{said}");
    assert_eq!(run(&program, &folder, Some(&own), "run g.toml --frames 3 --headless").0, 0, "it does work");
    std::fs::copy(&runtime, &own).expect("copied");
    assert_eq!(run(&program, &folder, Some(&own), locked_run).0, 0);
    std::fs::write(folder.join("names.txt"), "b\na\nc\nd\ne\nf\ng\n").expect("written");
    let (code, said) = run(&program, &folder, Some(&own), locked_run);
    assert!(code == 2 && said.contains("file `find.labels` has changed"), "{said}");
    let _ = std::fs::remove_dir_all(folder);
}

#[test]
fn every_view_of_a_capture_is_locked() {
    let Some(program) = std::env::var_os("PANOSCOPE_BIN").map(PathBuf::from) else {
        return panoscope_testing::skipped!("PANOSCOPE_BIN names no program; `cargo xtask test` sets it");
    };
    let folder = scratch("lock_views");
    let picture = |name: &str, level: u8| {
        let header = b"P5 16 8 255\n".to_vec();
        std::fs::write(folder.join(name), [header, vec![level; 128]].concat()).expect("written");
    };
    for (level, name) in ["a.pgm", "b.pgm", "c.pgm"].into_iter().enumerate() {
        picture(name, level as u8);
    }
    let graph = "mode = \"batch\"\nplugins = [\"capture\", \"flow\"]\n[nodes.scope]\ntype = \"capture\"\nparams = { views = \"a.pgm; b.pgm; c.pgm\" }\n[nodes.sink]\ntype = \"drain\"\ninputs = { image = \"scope.left\" }\n";
    std::fs::write(folder.join("g.toml"), graph).expect("written");
    let (code, said) = run(&program, &folder, None, "lock g.toml");
    assert_eq!(code, 0, "{said}");
    let lock = std::fs::read_to_string(folder.join("g.toml.lock")).expect("the lock");
    for name in ["scope.views", "scope.views;2", "scope.views;3"] {
        assert!(lock.contains(&format!("kind = \"input\"\nname = \"{name}\"\n")), "{name}: {lock}");
    }
    let locked_run = "run g.toml --lock --headless";
    let (code, said) = run(&program, &folder, None, locked_run);
    assert_eq!(code, 0, "{said}");
    picture("c.pgm", 9);
    let (code, said) = run(&program, &folder, None, locked_run);
    assert!(code == 2 && said.contains("input `scope.views;3` has changed since the graph was locked"), "{said}");
    let _ = std::fs::remove_dir_all(folder);
}
