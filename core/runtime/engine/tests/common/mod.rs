//! Graphs of the plugins `flow` and `fixtures`, run by the real engine.
#![allow(dead_code, reason = "each test binary uses a part")]

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;
use std::time::Duration;

use panoscope_engine::{Engine, Options, Outcome, Report};
use panoscope_graph::{GraphText, check};
use panoscope_host::loader::Loader;
use panoscope_host::loader::graph_file::{self, Ready};

/// Longest that any graph here may take.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// Plugins that the tests here use: `flow` ships, `fixtures` is in `tests/plugins`.
const PLUGINS: [&str; 2] = ["flow", "fixtures"];

/// The library of the `flow` plugin.
pub fn flow_plugin() -> &'static Path {
    static FILE: OnceLock<PathBuf> = OnceLock::new();
    FILE.get_or_init(|| {
        let loader = loader();
        loader.found().find(|f| f.note.name == "flow").expect("`folders` has it").file.clone()
    })
}

/// A loader that sees the built plugins.
pub fn loader() -> Loader {
    Loader::search(folders())
}

/// A graph with a text as if it were the file `path`, checked with the built plugins.
pub fn ready(path: impl AsRef<Path>, text: &str) -> Ready {
    let ready = graph_file::ready_with(&GraphText::parse(path.as_ref(), text), loader());
    ready.unwrap_or_else(|mistakes| panic!("{}", mistakes.render(false)))
}

/// Starts a graph of `flow` and `fixtures` nodes: `mode`, then the node tables.
pub fn start(mode: &str, nodes: &str, options: Options) -> Result<Engine, String> {
    let text = format!("mode = \"{mode}\"\nplugins = [\"flow\", \"fixtures\"]\n{nodes}");
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

/// A number that the environment sets.
pub fn number(variable: &str, default: u64) -> u64 {
    std::env::var(variable).ok().and_then(|v| v.parse().ok()).unwrap_or(default)
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

/// Folders of the built plugins: those of `PANOSCOPE_PLUGIN_PATH`, or where cargo builds them now.
pub fn folders() -> &'static [PathBuf] {
    static FOLDERS: OnceLock<Vec<PathBuf>> = OnceLock::new();
    FOLDERS.get_or_init(|| {
        let path = std::env::var_os("PANOSCOPE_PLUGIN_PATH").unwrap_or_default();
        let given: Vec<PathBuf> = std::env::split_paths(&path).filter(|p| p.is_dir()).collect();
        let loader = Loader::search(&given);
        let has = |plugin: &&str| loader.found().any(|f| f.note.name == **plugin);
        if PLUGINS.iter().all(has) { given } else { vec![build()] }
    })
}

/// Builds the plugins and returns the folder that holds them.
fn build() -> PathBuf {
    let test = std::env::current_exe().expect("a test has a file");
    let profile_dir = test.parent().and_then(Path::parent).expect("tests lie in <target>/<profile>/deps");
    let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or("cargo".into()));
    cargo.args(["build", "--quiet", "--manifest-path"]);
    cargo.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../Cargo.toml"));
    cargo.arg("--target-dir").arg(profile_dir.parent().expect("a target folder"));
    for plugin in PLUGINS {
        cargo.args(["--package", &format!("panoscope-{plugin}")]);
    }
    if profile_dir.ends_with("release") {
        cargo.arg("--release");
    }
    assert!(cargo.status().expect("cargo runs").success(), "the plugins do not build");
    profile_dir.to_owned()
}
