//! A model that crashes the process that opens it ends no run, no change and no window: it is first opened in a separate process.

use std::path::PathBuf;
use std::process::Command;
use std::sync::Arc;
use std::time::{Duration, Instant};

use panoscope_engine::{Engine, Options};
use panoscope_graph::ParamValue;
use panoscope_host::loader::trial::try_node;
use panoscope_host::loader::{Loader, search_path};
use panoscope_tests::{load, ready, scratch};

/// A folder with one file for each behaviour of a model.
fn models(name: &str) -> PathBuf {
    let folder = scratch(name);
    for text in ["good", "abort", "stack", "memory", "hang", "refuse"] {
        std::fs::write(folder.join(format!("{text}.onnx")), text).expect("a file");
    }
    folder
}

/// A graph that reads a model; `node` is added to the node that does.
fn graph_with(model: &str, node: &str) -> String {
    format!(
        "mode = \"live\"\nplugins = [\"flow\", \"fixtures\"]\n[nodes.camera]\ntype = \"frames\"\nparams = {{ width_px = 16, height_px = 8, rate_hz = 100.0 }}\n\
         [nodes.net]\ntype = \"model_reader\"\n{node}\ninputs = {{ image = \"camera.image\" }}\nparams = {{ model = \"{model}\" }}\n\
         [nodes.end]\ntype = \"drain\"\ninputs = {{ image = \"net.image\" }}\n"
    )
}

fn graph(model: &str) -> String {
    graph_with(&format!("{model}.onnx"), "")
}

#[test]
fn a_trial_refuses_what_crashes_hangs_or_exhausts_its_process() {
    let folder = models("trial");
    let refusal = |model: &str| {
        let begun = Instant::now();
        let (graph, catalog, loader) =
            load(&folder.join("graph.toml"), &graph(model)).unwrap_or_else(|mistakes| panic!("{mistakes}"));
        let node = graph.node("net").expect("a node");
        let refusal = try_node(&graph, node, &catalog, &loader, &folder).err();
        (refusal.map(|error| error.to_string()).unwrap_or_default(), begun.elapsed())
    };
    assert_eq!(refusal("good").0, "");
    for (model, words) in [
        ("abort", "in node `net`: SIGABRT (abort, or out of memory); it wrote: the reader gives up"),
        ("stack", "in node `net`: SIGSEGV"),
        ("memory", "in node `net`: SIGABRT"),
        ("refuse", "refuse.onnx is no model"),
        ("hang", "did not return"),
    ] {
        let (reason, took) = refusal(model);
        assert!(reason.contains(words), "{model}: {reason}");
        assert!(took < Duration::from_secs(60), "{model}: {took:?}");
    }
    std::fs::remove_dir_all(folder).expect("removed");
}

#[test]
fn commands_refuse_a_model_that_would_end_them() {
    let Some(program) = std::env::var_os("PANOSCOPE_BIN").map(PathBuf::from) else {
        panoscope_testing::skipped!("PANOSCOPE_BIN names no program; `cargo xtask test` sets it");
        return;
    };
    let folder = models("trial-commands");
    let file = folder.join("graph.toml");
    // A model is one whatever its name ends in.
    std::fs::copy(folder.join("abort.onnx"), folder.join("abort.bin")).expect("a file");
    for (model, code, check_code, words) in [
        ("good.onnx", 0, 0, "net"),
        ("abort.onnx", 1, 2, "SIGABRT"),
        ("abort.bin", 1, 2, "SIGABRT"),
        ("refuse.onnx", 1, 2, "is no model"),
    ] {
        std::fs::write(&file, graph_with(model, "")).expect("a file");
        for (arguments, code) in [(&["run", "--headless", "--frames", "5"][..], code), (&["check"], check_code)] {
            let output = Command::new(&program).args(arguments).arg(&file).output().expect("it starts");
            let text = String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
            assert_eq!(output.status.code(), Some(code), "{arguments:?} {model}: {text}");
            // What the process wrote is in the reason, and nowhere else.
            let said = text.matches("the reader gives up").count();
            assert_eq!(said, usize::from(model.starts_with("abort")), "{arguments:?} {model}: {text}");
            let words = if code == 0 { "" } else { words };
            assert!(text.contains(words) && (code == 0 || text.contains("net")), "{arguments:?} {model}: {text}");
        }
    }
    std::fs::remove_dir_all(folder).expect("removed");
}

#[test]
fn a_live_change_refuses_a_model_that_would_end_the_run() {
    // In a group, the model would end the other nodes of the group.
    for node in ["", "isolate = \"networks\""] {
        let folder = models("trial-live");
        let text_of = |model: &str| graph_with(&format!("{model}.onnx"), node);
        let (file, text) = (folder.join("graph.toml"), text_of("good"));
        let ready = ready(&file, &text).unwrap_or_else(|mistakes| panic!("{mistakes}"));
        let mut live = ready.start(Options::default()).expect("a good model");
        let engine = Arc::clone(live.engine());
        let path = |name: &str| ParamValue::Path(folder.join(name));
        for bad in ["abort", "stack", "refuse"] {
            let error = live.apply_text(&text_of(bad)).expect_err(bad).to_string();
            assert!(error.contains(&format!("{bad}.onnx")), "{error}");
            let error = engine.set_param("net", "model", path(&format!("{bad}.onnx"))).expect_err(bad).to_string();
            assert!(error.contains(&format!("{bad}.onnx")), "{error}");
            assert!(!engine.is_finished(), "the old model keeps running");
        }
        std::fs::write(folder.join("other.onnx"), "good").expect("a file");
        live.apply_text(&text_of("other")).expect("a good model");
        let before = engine.ticks();
        let until = Instant::now() + Duration::from_secs(60);
        while engine.ticks() <= before && Instant::now() < until {
            assert!(!engine.wait(Some(Duration::from_millis(10))), "it runs on");
        }
        let report = engine.report();
        assert!(engine.ticks() > before && report.nodes["net"].faults == 0, "{:?}", engine.recent_faults());
        engine.close(Duration::from_secs(10));
        std::fs::remove_dir_all(folder).expect("removed");
    }
}

#[test]
fn a_model_is_tried_once_for_each_version_of_its_file() {
    let folder = models("trial-once");
    let (file, model) = (folder.join("graph.toml"), folder.join("good.onnx"));
    let log = folder.join("good.onnx.log");
    // Processes that opened the model, in order; true for this one.
    let start = || {
        std::fs::write(&log, "").expect("a file");
        let (checked, catalog, loader) = load(&file, &graph("good")).unwrap_or_else(|mistakes| panic!("{mistakes}"));
        let options = Options { frames: Some(1), graph_dir: folder.clone(), ..Options::default() };
        let started = Engine::start(checked, &catalog, &loader, options).map(drop).map_err(|error| error.to_string());
        let text = std::fs::read_to_string(&log).expect("it is there");
        let me = std::process::id().to_string();
        (started, text.lines().map(|line| line == me).collect::<Vec<bool>>())
    };
    assert_eq!(start(), (Ok(()), vec![false, true]), "tried elsewhere, then opened here");
    assert_eq!(start(), (Ok(()), vec![true]), "the same version is not tried again");
    std::fs::write(&model, "good again").expect("a file");
    assert_eq!(start(), (Ok(()), vec![false, true]), "another version is");
    std::fs::write(&model, "abort").expect("a file");
    let (started, opened) = start();
    assert!(started.is_err_and(|words| words.contains("good.onnx") && words.contains("SIGABRT")));
    assert_eq!(opened, [false], "it never opened here");
    std::fs::remove_dir_all(folder).expect("removed");
}

#[test]
fn a_model_that_came_with_its_plugin_is_not_tried() {
    let folder = scratch("trial-shipped");
    let plugins = folder.join("plugins");
    std::fs::create_dir_all(plugins.join("fixtures")).expect("a folder");
    let loader = Loader::search(&search_path(&[]));
    let library = loader.found().find(|found| found.note.name == "fixtures").expect("built").file.clone();
    std::fs::copy(&library, plugins.join(library.file_name().expect("a file"))).expect("a copy");
    let model = plugins.join("fixtures/good.onnx");
    let log = plugins.join("fixtures/good.onnx.log");
    std::fs::write(&model, "good").expect("a file");
    std::fs::write(&log, "").expect("a file");
    let text = format!("plugin_paths = [\"plugins\"]\n{}", graph_with(&model.display().to_string(), ""));
    let (checked, catalog, loader) =
        load(&folder.join("graph.toml"), &text).unwrap_or_else(|mistakes| panic!("{mistakes}"));
    let options = Options { frames: Some(1), graph_dir: folder.clone(), ..Options::default() };
    Engine::start(checked, &catalog, &loader, options).map(drop).expect("a good model");
    let opened = std::fs::read_to_string(&log).expect("it is there");
    assert_eq!(opened.trim(), std::process::id().to_string());
    std::fs::remove_dir_all(folder).expect("removed");
}
