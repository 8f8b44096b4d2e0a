//! Graphs of the `flow` plugin, run by the real engine.
#![allow(dead_code, reason = "each test binary uses a part")]

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;
use std::time::Duration;

use panoscope_engine::{Engine, Options, Outcome, Report};
use panoscope_graph::{GraphText, check};
use panoscope_loader::Loader;

/// Longest that any graph here may take.
pub const PATIENCE: Duration = Duration::from_secs(60);

const NAMES: [&str; 2] = ["libflow.so", "libpanoscope_flow.so"];

/// The built `flow` plugin: out of `PANOSCOPE_PLUGIN_PATH`, else built now.
pub fn flow_plugin() -> &'static Path {
    static FILE: OnceLock<PathBuf> = OnceLock::new();
    FILE.get_or_init(|| {
        let path = std::env::var_os("PANOSCOPE_PLUGIN_PATH").unwrap_or_default();
        let given = std::env::split_paths(&path).flat_map(|folder| NAMES.map(|name| folder.join(name)));
        given.into_iter().find(|file| file.is_file()).unwrap_or_else(build)
    })
}

fn build() -> PathBuf {
    let test = std::env::current_exe().expect("a test has a file");
    let profile_dir = test.parent().and_then(Path::parent).expect("tests lie in <target>/<profile>/deps");
    let release = profile_dir.ends_with("release");
    let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or("cargo".into()));
    cargo.args(["build", "--quiet", "--package", "panoscope-flow", "--manifest-path"]);
    cargo.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("../../Cargo.toml"));
    cargo.arg("--target-dir").arg(profile_dir.parent().expect("a target folder"));
    if release {
        cargo.arg("--release");
    }
    assert!(cargo.status().expect("cargo runs").success(), "panoscope-flow does not build");
    let file = profile_dir.join(NAMES[1]);
    assert!(file.is_file(), "{} was not built", file.display());
    file
}

/// A loader that sees the folder of the `flow` plugin only.
pub fn loader() -> Loader {
    Loader::search(&[flow_plugin().parent().expect("a folder").to_owned()])
}

/// Starts a graph of `flow` nodes: `mode`, then the node tables.
pub fn start(mode: &str, nodes: &str, options: Options) -> Result<Engine, String> {
    let text = format!("mode = \"{mode}\"\nplugins = [\"flow\"]\n{nodes}");
    let text = GraphText::parse(&scratch_dir().join("test.toml"), &text);
    let loader = loader();
    let catalog = loader.catalog(&text.plugins());
    let (graph, _) = check(&text, &catalog).into_result().map_err(|d| d.render(false))?;
    Engine::start(graph, &catalog, &loader, options).map_err(|e| e.to_string())
}

/// Runs a graph to its end.
pub fn run(mode: &str, nodes: &str, options: Options) -> (Report, Outcome) {
    let engine = start(mode, nodes, options).unwrap_or_else(|e| panic!("{e}"));
    assert!(engine.wait(Some(PATIENCE)), "the graph did not end; so far: {:#?}", engine.report());
    let outcome = engine.close(PATIENCE);
    (engine.report(), outcome)
}

/// Options for so many pool threads and ticks.
pub fn options(threads: usize, frames: u64) -> Options {
    Options { threads, frames: Some(frames), ..Options::default() }
}

/// A folder for files of this test process.
pub fn scratch_dir() -> PathBuf {
    let folder = std::env::temp_dir().join(format!("panoscope_engine_{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("temporary files can be written");
    folder
}

/// A file name that no other test uses.
pub fn scratch(name: &str) -> PathBuf {
    scratch_dir().join(name)
}

/// The lines of a ledger: tick number and what each input held.
pub fn ledger(path: &Path) -> Vec<(u64, Vec<Option<u64>>)> {
    let text = std::fs::read_to_string(path).expect("the ledger was written");
    text.lines()
        .map(|line| {
            let line: serde_json::Value = serde_json::from_str(line).expect("a whole line");
            let inputs = line["inputs"].as_array().expect("inputs").iter().map(|v| v.as_u64()).collect();
            (line["seq"].as_u64().expect("seq"), inputs)
        })
        .collect()
}

/// The built plugins: out of `PANOSCOPE_PLUGIN_PATH`, else built now.
pub fn folders() -> &'static [PathBuf] {
    static FOLDERS: OnceLock<Vec<PathBuf>> = OnceLock::new();
    FOLDERS.get_or_init(|| {
        let path = std::env::var_os("PANOSCOPE_PLUGIN_PATH").unwrap_or_default();
        let given: Vec<PathBuf> = std::env::split_paths(&path).filter(|p| p.is_dir()).collect();
        let has = |plugin: &str| Loader::search(&given).found().any(|f| f.note.name == plugin);
        if has("flow") && has("chaos") { given } else { vec![build_both()] }
    })
}

fn build_both() -> PathBuf {
    let test = std::env::current_exe().expect("a test has a file");
    let profile_dir = test.parent().and_then(Path::parent).expect("tests lie in <target>/<profile>/deps");
    let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or("cargo".into()));
    cargo.args(["build", "--quiet", "--package", "panoscope-flow", "--package", "panoscope-chaos", "--manifest-path"]);
    cargo.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("../../Cargo.toml"));
    cargo.arg("--target-dir").arg(profile_dir.parent().expect("a target folder"));
    if profile_dir.ends_with("release") {
        cargo.arg("--release");
    }
    assert!(cargo.status().expect("cargo runs").success(), "the plugins do not build");
    profile_dir.to_owned()
}
