//! Shared by the tests that involve several crates: where things are, and how a graph is run inside a test.

#![forbid(unsafe_code)]

mod disturbed;
pub mod machines;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use panoscope_engine::{Engine, Options, Outcome, Report};
use panoscope_graph::{Catalog, Graph, GraphOptions, GraphText};
use panoscope_host::loader::Loader;
use panoscope_host::loader::graph_file::{self, Ready};

pub use disturbed::{DisturbedRun, run_disturbed};

/// Root of the repository.
pub fn root() -> PathBuf {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    here.parent().unwrap_or(here).to_owned()
}

/// The documents for users and contributors, relative to the root.
pub const DOCUMENTS: [&str; 17] = [
    "README.md",
    "core/CONTRIBUTING.md",
    "core/README.md",
    "core/SECURITY.md",
    "core/contract/abi/README.md",
    "core/cli/README.md",
    "core/vision/imaging/README.md",
    "core/runtime/host/README.md",
    "core/python/README.md",
    "core/runtime/record/README.md",
    "core/runtime/remote/README.md",
    "editor/README.md",
    "graphs/README.md",
    "plugins/README.md",
    "plugins/stereo/training/README.md",
    "plugins/tools/training/README.md",
    "tests/README.md",
];

/// The text of a document.
///
/// # Panics
/// The document cannot be read.
pub fn document(name: &str) -> String {
    std::fs::read_to_string(root().join(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
}

/// A graph that writes rendered stereo frames' registration and wide image; `isolate` is more TOML, such as a table `[isolate]`.
pub fn panorama(folder: &Path, isolate: &str) -> String {
    let folder = folder.display();
    format!(
        r#"
mode = "batch"
plugins = ["phantom", "stitch", "sinks"]
[nodes.scope]
type = "phantom"
params = {{ scene = "bowel", seed = 7, width = 320, height = 240 }}
[nodes.register]
type = "register_surf"
inputs = {{ left = "scope.left", right = "scope.right" }}
[nodes.wide]
type = "composite"
inputs = {{ left = "scope.left", right = "scope.right", homography = "register.homography" }}
[nodes.pictures]
type = "write_raw"
inputs = {{ image = "wide.panorama" }}
params = {{ path = "{folder}/wide_{{seq}}.raw" }}
[nodes.maps]
type = "write_table"
inputs = {{ homography = "register.homography", roi = "register.roi_left" }}
params = {{ path = "{folder}/maps.jsonl" }}
{isolate}
"#
    )
}

/// Whether Python with NumPy is installed; reports why a test is skipped.
pub fn has_python() -> bool {
    match std::process::Command::new("python3").args(["-c", "import numpy"]).output() {
        Ok(output) if output.status.success() => true,
        Ok(output) => {
            panoscope_testing::skipped!("no NumPy: {}", String::from_utf8_lossy(&output.stderr).trim());
            false
        }
        Err(error) => {
            panoscope_testing::skipped!("no python3: {error}");
            false
        }
    }
}

/// Runs the unit tests of a file in `tests/python` with the package of this build. `modules`: modules of other packages that they import, which
/// `cargo xtask test` fetches; without them the test is skipped.
///
/// # Panics
/// A test fails.
pub fn run_python_tests(file: &str, modules: &str) {
    run_python(file, &[], modules);
}

/// As [`run_python_tests`], for one class of the file that imports no other package.
///
/// # Panics
/// A test fails, or there is no such class.
pub fn run_python_class(file: &str, class: &str) {
    run_python(file, &[class], "");
}

/// As [`run_python_tests`], of some classes of the file.
///
/// # Panics
/// When a test fails, or there is no such class.
pub fn run_python_classes(file: &str, classes: &[&str], modules: &str) {
    run_python(file, classes, modules);
}

fn run_python(file: &str, classes: &[&str], modules: &str) {
    if !has_python() {
        return;
    }
    let Some(program) = std::env::var_os("PANOSCOPE_BIN").map(PathBuf::from) else {
        return panoscope_testing::skipped!("PANOSCOPE_BIN names no program; `cargo xtask test` sets it");
    };
    let package = program.with_file_name("python").into_os_string();
    let peers = std::env::var_os("PANOSCOPE_PYTHON_PEERS").filter(|_| !modules.is_empty());
    let path = [Some(package), peers, std::env::var_os("PYTHONPATH")].into_iter().flatten().collect::<Vec<_>>();
    let python = || {
        let mut python = std::process::Command::new("python3");
        python.env("PYTHONPATH", path.join(":".as_ref())).env("PANOSCOPE_BIN", &program);
        python.env_remove("PANOSCOPE_PYTHON");
        python
    };
    if !modules.is_empty() {
        let found = python().args(["-c", &format!("import {modules}")]).output().expect("python3 starts");
        if !found.status.success() {
            let words = String::from_utf8_lossy(&found.stderr);
            return panoscope_testing::skipped!("a package is missing: {}", words.lines().last().unwrap_or(""));
        }
    }
    let mut tests = python();
    let output = tests.arg(root().join("tests/python").join(file)).arg("-v").args(classes).output();
    let output = output.expect("python3 starts");
    let words = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{words}");
    // A test of Python that is not found is no test that passed.
    assert!(words.contains("OK") && !words.contains("Ran 0 tests"), "{words}");
}

/// A new folder for the files of one test.
///
/// # Panics
/// The folder cannot be created.
pub fn scratch(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("panoscope-{}-{name}", std::process::id()));
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).expect("a folder for temporary files");
    folder
}

/// The program that PANOSCOPE_BIN names; `None`, with the reason of the skip, if it names none.
pub fn named_program() -> Option<PathBuf> {
    let program = std::env::var_os("PANOSCOPE_BIN").map(PathBuf::from);
    if program.is_none() {
        panoscope_testing::skipped!("PANOSCOPE_BIN names no program; `cargo xtask test` sets it");
    }
    program
}

/// Ids of the processes of isolated nodes that this process started. Those that only describe a plugin are left out: they belong to no group and leave
/// when nobody asks them any more.
///
/// # Panics
/// The system does not list processes.
pub fn isolated_processes() -> BTreeSet<i32> {
    let own = std::process::id();
    let entries = std::fs::read_dir("/proc").expect("the system lists processes").flatten();
    let is_own = |process: &i32| {
        let read = |file: &str| std::fs::read_to_string(format!("/proc/{process}/{file}")).unwrap_or_default();
        let parent = read("stat").rsplit_once(") ").and_then(|(_, rest)| rest.split(' ').nth(1)?.parse().ok());
        let command = read("cmdline");
        parent == Some(own) && command.contains("isolated-nodes") && !command.contains("\0describes ")
    };
    entries.filter_map(|entry| entry.file_name().to_str()?.parse().ok()).filter(is_own).collect()
}

/// Waits until a condition holds.
///
/// # Panics
/// It does not hold within two minutes; names `what`.
pub fn wait_until(what: &str, mut done: impl FnMut() -> bool) {
    let end = Instant::now() + Duration::from_secs(120);
    while !done() {
        assert!(Instant::now() < end, "{what}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// A finished run.
pub struct Run {
    /// Counters and times.
    pub report: Report,
    /// How it ended.
    pub outcome: Outcome,
    /// Warnings and errors of nodes, one line each.
    pub log: Vec<String>,
}

/// Checks a graph text as if it were the file `path`; `Err` contains the rendered errors.
pub fn ready(path: &Path, text: &str) -> Result<Ready, String> {
    graph_file::ready(&GraphText::parse(path, text)).map_err(|mistakes| mistakes.render(false))
}

/// As [`ready`], for a test that starts the engine itself.
pub fn load(path: &Path, text: &str) -> Result<(Graph, Catalog, Arc<Loader>), String> {
    ready(path, text).map(|Ready { graph, catalog, loader, .. }| (graph, catalog, loader))
}

/// Time without any call of a node after which a graph stands still.
const MAX_STANDSTILL: Duration = Duration::from_secs(120);

/// Waits until a graph with a limited number of frames ends, however long its calls take on a busy machine; `meanwhile` is called every few milliseconds.
///
/// # Panics
/// The graph stands still: no node finishes a call for two minutes.
pub fn await_end(engine: &Engine, mut meanwhile: impl FnMut(&Engine)) {
    let calls = || engine.report().nodes.values().map(|node| node.count).sum::<u64>();
    let (mut so_far, mut since) = (0, Instant::now());
    while !engine.wait(Some(Duration::from_millis(2))) {
        if since.elapsed() > MAX_STANDSTILL {
            let now = calls();
            assert!(now > so_far, "the graph stands still: {:?}", engine.recent_log());
            (so_far, since) = (now, Instant::now());
        }
        meanwhile(engine);
    }
}

/// Runs a graph text to its end on a number of threads.
///
/// # Panics
/// The graph is invalid, does not start, or stands still.
pub fn run(path: &Path, text: &str, frames: u64, threads: usize) -> Run {
    let ready = ready(path, text).unwrap_or_else(|mistakes| panic!("{mistakes}"));
    let run = start(ready, frames, threads).unwrap_or_else(|error| panic!("{error}"));
    assert!(run.is_some(), "{} needs ONNX Runtime", path.display());
    run.unwrap_or_else(|| unreachable!("asserted above"))
}

/// Runs a graph file with overlays, arguments and settings to its end. `None` if it needs ONNX Runtime, which is not installed: the test is skipped.
///
/// # Panics
/// The graph is invalid, does not start, or stands still.
pub fn run_file(path: &Path, options: &GraphOptions, frames: u64) -> Option<Run> {
    let text = std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    run_with(path, &text, options, frames)
}

/// As [`run_file`], with this text in place of the file's.
///
/// # Panics
/// As [`run_file`].
pub fn run_with(path: &Path, text: &str, options: &GraphOptions, frames: u64) -> Option<Run> {
    let text = GraphText::parse_with(path, text, options);
    let ready = graph_file::ready(&text).unwrap_or_else(|mistakes| panic!("{}", mistakes.render(false)));
    start(ready, frames, 2).unwrap_or_else(|error| panic!("{error}"))
}

fn start(ready: Ready, frames: u64, threads: usize) -> Result<Option<Run>, String> {
    let log = std::sync::Arc::new(Mutex::new(Vec::new()));
    let lines = std::sync::Arc::clone(&log);
    let options = Options {
        frames: Some(frames),
        threads,
        paced: false,
        log: Some(Box::new(move |level, node, words| {
            if level <= panoscope_engine::log::Level::Warn
                && let Ok(mut lines) = lines.lock()
            {
                lines.push(format!("{level:?} {node}: {words}"));
            }
        })),
        ..Options::default()
    };
    let live = match ready.start(options) {
        Ok(live) => live,
        Err(error) if error.to_string().contains("ONNX Runtime's shared library was not found") => {
            panoscope_testing::skipped!("{error}");
            return Ok(None);
        }
        Err(error) => return Err(error.to_string()),
    };
    let engine = live.engine();
    await_end(engine, |_| {});
    let outcome = engine.close(Duration::from_secs(30));
    let report = engine.report();
    let log = log.lock().map(|l| l.clone()).unwrap_or_default();
    Ok(Some(Run { report, outcome, log }))
}

/// Calibration of the phantom's cameras at 640x480, as `panoscope calibrate` would write it.
pub const CALIBRATION: &str = "%YAML:1.0
---
image_width: 640
image_height: 480
M1: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 750., 0., 319.5, 0., 750., 239.5, 0., 0., 1. ]
D1: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ 0., 0., 0., 0., 0. ]
M2: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 750., 0., 319.5, 0., 750., 239.5, 0., 0., 1. ]
D2: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ 0., 0., 0., 0., 0. ]
R: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 1., 0., 0., 0., 1., 0., 0., 0., 1. ]
T: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [ -15., 0., 0. ]
";

/// All files of a folder with their bytes, by name.
///
/// # Panics
/// The folder cannot be read.
pub fn files(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let mut found: Vec<_> = std::fs::read_dir(folder)
        .expect("the folder of a test")
        .flatten()
        .filter(|e| e.path().is_file())
        .map(|e| (e.file_name().to_string_lossy().into_owned(), std::fs::read(e.path()).expect("a file of a test")))
        .collect();
    found.sort();
    found
}
