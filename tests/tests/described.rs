//! Plugins whose nodes all run in separate processes: none of their code runs in this process.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use panoscope_engine::{Engine, Options};
use panoscope_graph::{GraphText, check};
use panoscope_host::loader::{Loader, search_path};
use panoscope_tests::{root, scratch};

/// Runs one test at a time: they inspect the memory of this process.
fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Builds `tests/c/constructor.c` into a folder; `None` without a C compiler.
fn built(folder: &Path, flags: &[&str]) -> Option<PathBuf> {
    let library = folder.join("libconstructor.so");
    let output = Command::new("cc")
        .args(["-std=gnu11", "-O1", "-fPIC", "-fvisibility=hidden", "-shared"])
        .args(flags)
        .arg("-I")
        .arg(root().join("core/contract/abi"))
        .arg(root().join("tests/c/constructor.c"))
        .arg("-o")
        .arg(&library)
        .output();
    match output {
        Ok(output) => {
            assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
            Some(library)
        }
        Err(error) => {
            panoscope_testing::skipped!("the C compiler cannot be run ({error})");
            None
        }
    }
}

fn graph(folder: &Path, isolate: &str, odd: u32) -> GraphText {
    GraphText::parse(&folder.join("graph.toml"), &graph_text(folder, isolate, odd))
}

fn graph_text(folder: &Path, isolate: &str, odd: u32) -> String {
    format!(
        r#"
mode = "batch"
plugins = ["flow", "constructor"]
plugin_paths = ["{0}"]
{isolate}
[nodes.source]
type = "frames"
params = {{ width_px = 64, height_px = 48, format = "gray8" }}
[nodes.passes]
type = "passes"
inputs = {{ image = "source.image" }}
params = {{ odd = {odd} }}
[nodes.sink]
type = "drain"
inputs = {{ image = "passes.image" }}
"#,
        folder.display()
    )
}

const ISOLATED: &str = "[isolate]\nconstructor = \"foreign\"";

fn loader(text: &GraphText) -> Loader {
    Loader::search(&search_path(&text.plugin_paths())).describing_within(Duration::from_secs(3))
}

/// Errors of a graph, and the time that it took to find them.
fn mistakes(text: &GraphText) -> (String, Duration) {
    let begin = Instant::now();
    let catalog = loader(text).catalog_of(text);
    let found = check(text, &catalog).diagnostics.render(false);
    (found, begin.elapsed())
}

/// Ids of the processes in which a constructor ran, from the file that it writes.
fn marks(mark: &Path) -> Vec<u32> {
    let text = std::fs::read_to_string(mark).unwrap_or_default();
    text.lines().map(|line| line.parse().expect("a process number")).collect()
}

/// Whether this process has mapped a file of this name.
fn has_mapped(name: &str) -> bool {
    std::fs::read_to_string("/proc/self/maps").expect("the system lists memory").contains(name)
}

/// Runs a graph that isolates the plugin; checks that none of its code runs in this process.
fn runs_elsewhere(name: &str, isolate: impl Fn(&Path) -> GraphText) {
    let _alone = alone();
    let folder = scratch(name);
    let mark = folder.join("mark");
    let Some(_) = built(&folder, &[&format!("-DMARK=\"{}\"", mark.display())]) else { return };
    let text = isolate(&folder);
    let loader = loader(&text);
    let catalog = loader.catalog_of(&text);
    let me = std::process::id();
    let described = marks(&mark);
    match panoscope_host::isolate::kernel().landlock {
        Some(_) => assert!(described.is_empty(), "the process that describes it makes no files"),
        None => assert!(!described.contains(&me), "another process ran it"),
    }
    let node_type = catalog.node_types.iter().find(|t| t.name == "passes").expect("described");
    assert_eq!((node_type.plugin.as_str(), node_type.doc.as_str()), ("constructor", "Passes pictures on."));
    assert_eq!(node_type.params[0].doc, "An odd number; `validate` refuses others.");
    let (graph, _) = check(&text, &catalog).into_result().unwrap_or_else(|d| panic!("{}", d.render(false)));
    let options = Options { frames: Some(20), ..Options::default() };
    let engine = Engine::start(graph, &catalog, &loader, options).unwrap_or_else(|error| panic!("{error}"));
    assert!(engine.wait(Some(Duration::from_secs(60))), "it ends");
    engine.close(Duration::from_secs(10));
    let report = engine.report();
    assert_eq!((report.nodes["sink"].count, report.nodes["passes"].faults), (20, 0));
    let ran = marks(&mark);
    assert!(!ran.is_empty() && !ran.contains(&me), "it ran in the process of its group: {ran:?}");
    assert!(!has_mapped("libconstructor"), "this process never mapped the file");
    drop(engine);
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn a_constructor_of_an_isolated_plugin_does_not_run_here() {
    runs_elsewhere("described-mark", |folder| graph(folder, ISOLATED, 1));
}

/// `graph` with `isolate` at the node instead of the plugin; `more` is appended.
fn with_isolated_node(folder: &Path, more: &str) -> GraphText {
    let text = graph_text(folder, "", 1).replace("type = \"passes\"", "type = \"passes\"\nisolate = \"foreign\"");
    GraphText::parse(&folder.join("graph.toml"), &format!("{text}{more}"))
}

#[test]
fn a_constructor_of_a_plugin_whose_nodes_are_isolated_does_not_run_here() {
    runs_elsewhere("described-nodes", |folder| with_isolated_node(folder, ""));
}

#[test]
fn a_plugin_with_one_node_that_is_not_isolated_is_loaded() {
    let _alone = alone();
    let folder = scratch("described-one");
    let mark = folder.join("mark");
    let Some(_) = built(&folder, &[&format!("-DMARK=\"{}\"", mark.display())]) else { return };
    let more = "[nodes.also]\ntype = \"passes\"\ninputs = { image = \"source.image\" }\n";
    let text = with_isolated_node(&folder, more);
    let _ = loader(&text).catalog_of(&text);
    assert_eq!(marks(&mark), [std::process::id()], "its other node runs here");
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn without_isolation_the_constructor_runs_here() {
    let _alone = alone();
    let folder = scratch("described-control");
    let mark = folder.join("mark");
    let Some(_) = built(&folder, &[&format!("-DMARK=\"{}\"", mark.display())]) else { return };
    let text = graph(&folder, "", 1);
    let _ = loader(&text).catalog_of(&text);
    assert_eq!(marks(&mark), [std::process::id()], "otherwise the other tests prove nothing");
    assert!(has_mapped("libconstructor"), "and its file is mapped under this name");
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn a_constructor_that_crashes_is_a_mistake_of_the_graph() {
    let _alone = alone();
    let folder = scratch("described-crash");
    let Some(library) = built(&folder, &["-DCRASH"]) else { return };
    let (found, _) = mistakes(&graph(&folder, ISOLATED, 1));
    let file = library.display().to_string();
    for part in [file.as_str(), "the process that describes it crashed", "SIGSEGV"] {
        assert!(found.contains(part), "`{found}` does not say {part}");
    }
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn a_constructor_that_hangs_is_a_mistake_of_the_graph() {
    let _alone = alone();
    let folder = scratch("described-hang");
    let Some(_) = built(&folder, &["-DHANG"]) else { return };
    let (found, took) = mistakes(&graph(&folder, ISOLATED, 1));
    assert!(found.contains("did not describe itself within 3 s"), "{found}");
    assert!(took < Duration::from_secs(30), "{took:?}");
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn a_plugin_checks_its_parameters_in_its_process() {
    let _alone = alone();
    let folder = scratch("described-validate");
    let Some(_) = built(&folder, &[]) else { return };
    let (found, _) = mistakes(&graph(&folder, ISOLATED, 3));
    assert_eq!(found, "");
    let (found, _) = mistakes(&graph(&folder, ISOLATED, 4));
    for part in ["the number is even", "take an odd one", "odd = 4"] {
        assert!(found.contains(part), "`{found}` does not say {part}");
    }
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn a_description_is_the_same_as_that_of_a_loaded_plugin() {
    let _alone = alone();
    for plugin in ["phantom", "stitch", "stereo", "sinks", "capture", "overlay", "tools"] {
        let text = |isolate: &str| {
            let text = format!("plugins = [\"{plugin}\"]\n{isolate}");
            GraphText::parse(Path::new("/nowhere/graph.toml"), &text)
        };
        let (isolated, plain) = (text(&format!("[isolate]\n{plugin} = \"group\"")), text(""));
        let loader = Loader::search(&search_path(&[]));
        let described = loader.catalog_of(&isolated);
        let loaded = loader.catalog_of(&plain);
        assert!(described.problems.is_empty(), "{plugin}: {:?}", described.problems);
        assert!(!described.node_types.is_empty(), "{plugin}");
        assert_eq!(described, loaded, "{plugin}");
        let checks = |node_types: &[panoscope_graph::NodeType]| -> Vec<bool> {
            node_types.iter().map(|node_type| node_type.validator.is_some()).collect()
        };
        assert_eq!(checks(&described.node_types), checks(&loaded.node_types), "{plugin}");
    }
}
