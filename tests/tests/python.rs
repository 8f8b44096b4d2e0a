//! Nodes written in Python: their inputs and outputs, how they fail, and how they are replaced while a graph runs.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use panoscope_engine::fault::Cause;
use panoscope_engine::memory::FrameRef;
use panoscope_engine::{Engine, Listener, Options, Outcome};
use panoscope_host::loader::live::{Changed, FileWatch};
use panoscope_tests::machines::program;
use panoscope_tests::{DisturbedRun, has_python, load, ready, root, run_disturbed, scratch};

const MAX_RUN: Duration = Duration::from_secs(120);

/// A folder with the test plugin in Python.
fn folder(name: &str) -> PathBuf {
    let folder = scratch(name);
    let plugin = root().join("tests/plugins/python/turned.py");
    std::fs::copy(plugin, folder.join("turned.py")).expect("the test plugin");
    folder
}

/// Runs a graph whose plugins are in `folder`.
fn run(folder: &Path, text: &str, frames: u64) -> DisturbedRun {
    run_with(folder, text, Options { frames: Some(frames), ..Options::default() })
}

fn run_with(folder: &Path, text: &str, options: Options) -> DisturbedRun {
    run_disturbed(folder, &format!("plugin_paths = [\".\"]\n{text}"), options, |_| ())
}

const PICTURES: &str = r#"
mode = "batch"
plugins = ["phantom", "flow", "turned"]
[nodes.scope]
type = "phantom"
params = { width = 160, height = 120 }
"#;

#[test]
fn a_picture_turned_twice_is_the_picture() {
    if !has_python() {
        return;
    }
    let folder = folder("python-turn");
    let text = format!(
        "{PICTURES}[nodes.once]\ntype = \"turn\"\ninputs = {{ image = \"scope.left\" }}\n\
         [nodes.twice]\ntype = \"turn\"\ninputs = {{ image = \"once.image\" }}\n\
         [nodes.same]\ntype = \"pass_on\"\ninputs = {{ image = \"once.image\" }}\n\
         [nodes.end]\ntype = \"drain\"\ninputs = {{ image = \"twice.image\" }}\n\
         [nodes.end_same]\ntype = \"drain\"\ninputs = {{ image = \"same.image\" }}\n"
    );
    let run = run(&folder, &text, 8);
    assert_eq!(run.outcome, Outcome::Done, "{:?}", run.faults);
    assert_eq!(run.port("twice.image"), run.port("scope.left"));
    assert_ne!(run.port("once.image"), run.port("scope.left"));
    assert_eq!(run.port("same.image"), run.port("once.image"));
    // All three share the process of their plugin, and nothing was copied on the way.
    assert_eq!(run.report.groups["turned"].processes, 1);
    assert!(run.report.nodes.values().all(|node| node.copies == 0), "{:?}", run.report.nodes);
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn parameters_numbers_texts_and_tables_cross() {
    if !has_python() {
        return;
    }
    let folder = folder("python-params");
    let text = format!(
        "{PICTURES}[nodes.gain]\ntype = \"gain_py\"\ninputs = {{ image = \"scope.left\" }}\n\
         params = {{ gain = 0.5, invert = true, rounds = 2, how = \"wrap\", label = \"mine\", curve = [0.0, 0.5, 1.0] }}\n\
         [nodes.numbers]\ntype = \"numbers\"\n\
         inputs = {{ calibration = \"scope.calibration\", detections = \"scope.detections\", images = [\"scope.left\", \"scope.right\"] }}\n"
    );
    // Nodes that nobody reads do not run.
    let end = "[nodes.end]\ntype = \"reads\"\n[nodes.end.inputs]\nlabel = \"gain.label\"\nstats = \"gain.stats\"\n\
        calibration = \"numbers.calibration\"\nboxes = \"numbers.boxes\"\ncount = \"numbers.count\"\n";
    let text = format!("{text}{end}");
    let path = folder.join("graph.toml");
    let given = format!("plugin_paths = [\".\"]\n{text}");
    let (graph, catalog, loader) = load(&path, &given).unwrap_or_else(|mistakes| panic!("{mistakes}"));
    let node_type = catalog.node_types.iter().find(|node_type| node_type.name == "gain_py").expect("described");
    let names: Vec<&str> = node_type.params.iter().map(|param| param.name.as_str()).collect();
    assert_eq!(names, ["gain", "invert", "rounds", "how", "label", "curve", "file"]);
    assert_eq!((node_type.inputs[0].doc.as_str(), node_type.outputs.len()), ("What is brightened", 4));
    assert_eq!(node_type.doc, "Brightens a picture, and says by how much.");
    let labels = Arc::new(Mutex::new(Vec::new()));
    let heard = Arc::clone(&labels);
    let hear = move |frame: &FrameRef| heard.lock().expect("no panic").push(frame.bytes().to_vec());
    let listener = Listener { node: "gain".into(), output: "label".into(), hear: Arc::new(hear) };
    let options = Options { frames: Some(3), listen: vec![listener], ..Options::default() };
    let engine = Engine::start(graph, &catalog, &loader, options).expect("starts");
    assert!(engine.wait(Some(MAX_RUN)), "{:?}", engine.recent_log());
    let outcome = engine.close(Duration::from_secs(30));
    assert_eq!(outcome, Outcome::Done, "{:?}", engine.recent_faults());
    drop(engine);
    assert_eq!(*labels.lock().expect("no panic"), [b"mine [0.0, 0.5, 1.0] gain"; 3]);
    let run = run(&folder, &text, 3);
    assert_eq!(run.outcome, Outcome::Done, "{:?}", run.faults);
    let read = &run.report.nodes["end"].metrics;
    assert_eq!((read["columns"], read["count"], read["baseline_mm"]), (2.0, 2.0, 15.0), "{read:?}");
    assert_eq!(run.port("numbers.calibration"), run.port("scope.calibration"));
    assert_eq!(run.port("numbers.boxes"), run.port("scope.detections"));
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn a_frame_that_a_node_keeps_stays_as_it_was() {
    if !has_python() {
        return;
    }
    let folder = folder("python-keep");
    let text = "mode = \"batch\"\nplugins = [\"flow\", \"turned\"]\n\
         [nodes.count]\ntype = \"count\"\nparams = { last = 40 }\n\
         [nodes.keep]\ntype = \"keep\"\ninputs = { image = \"count.image\" }\n\
         [nodes.end]\ntype = \"drain\"\ninputs = { image = \"keep.image\" }\n";
    let run = run(&folder, text, 100);
    assert_eq!(run.outcome, Outcome::Done, "{:?}", run.faults);
    let (made, kept) = (run.port("count.image"), run.port("keep.image"));
    assert_eq!(made.len(), 40, "the source ends by itself");
    assert_eq!(kept[0], made[0]);
    assert_eq!(kept[1..], made[..39]);
    let _ = std::fs::remove_dir_all(&folder);
}

fn failing(how: &str) -> String {
    format!(
        "{PICTURES}[nodes.fails]\ntype = \"fails\"\ninputs = {{ image = \"scope.left\" }}\nparams = {{ how = \"{how}\", at = 3 }}\n\
         budget_ms = 300\n[nodes.end]\ntype = \"drain\"\ninputs = {{ image = \"fails.image\" }}\n"
    )
}

#[test]
fn an_exception_is_a_fault_with_its_traceback() {
    if !has_python() {
        return;
    }
    let folder = folder("python-raise");
    let run = run(&folder, &failing("raise"), 10);
    let [fault] = &run.faults[..] else { panic!("{:?}", run.faults) };
    let words = &fault.words;
    assert!(
        words.contains("ZeroDivisionError") && words.contains("in divide") && words.contains("turned.py"),
        "{words}"
    );
    assert!(!words.contains("runner.py"), "frames of the package are noise: {words}");
    assert_eq!(run.report.nodes["fails"].count, 10);
    assert!(
        words.starts_with("ZeroDivisionError") && words.lines().next().is_some_and(|line| line.contains("in divide")),
        "{words}"
    );
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn a_wrong_result_is_named_with_what_is_wanted() {
    if !has_python() {
        return;
    }
    let folder = folder("python-shape");
    let run = run(&folder, &failing("shape"), 6);
    let words = &run.faults.first().expect("a fault").words;
    assert!(words.contains("output `image`") && words.contains("uint8") && words.contains("float64"), "{words}");
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn a_node_that_returns_nothing_is_told_what_to_return() {
    if !has_python() {
        return;
    }
    let folder = folder("python-nothing");
    let text = format!(
        "{PICTURES}[nodes.one]\ntype = \"forgets\"\ninputs = {{ image = \"scope.left\" }}\n\
         [nodes.one_end]\ntype = \"drain\"\ninputs = {{ image = \"one.image\" }}\n\
         [nodes.both]\ntype = \"forgets_both\"\ninputs = {{ image = \"scope.left\" }}\n\
         [nodes.both_end]\ntype = \"drain\"\ninputs = {{ image = \"both.image\" }}\n\
         [nodes.second]\ntype = \"every_second\"\ninputs = {{ image = \"scope.left\" }}\n\
         [nodes.end]\ntype = \"drain\"\ninputs = {{ image = \"second.image\" }}\n"
    );
    let run = run(&folder, &text, 6);
    let said = |node: &str| run.faults.iter().find(|f| f.node == node).map_or("", |f| f.words.as_str());
    let one = said("one");
    assert!(one.contains("returned None instead of its output `image`") && one.contains("Optional"), "{one}");
    let both = said("both");
    assert!(both.contains("returned None instead of a dict {\"image\": ..., \"mean\": ...}"), "{both}");
    assert_eq!(said("second"), "", "it says that it may have no output");
    assert_eq!(run.port("second.image").len(), 3);
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn an_interpreter_without_numpy_is_named_with_the_remedy() {
    if !has_python() {
        return;
    }
    let folder = folder("python-no-numpy");
    // An environment of its own has no package but the standard library.
    let made =
        std::process::Command::new("python3").args(["-m", "venv", "--without-pip"]).arg(folder.join(".venv")).output();
    if !made.as_ref().is_ok_and(|made| made.status.success()) {
        return panoscope_testing::skipped!("python3 makes no environment: {made:?}");
    }
    let Some(program) = program() else { return panoscope_testing::skipped!("there is no program `panoscope`") };
    let text = "plugin_paths = [\".\"]\nplugins = [\"turned\"]\n[nodes.a]\ntype = \"count\"\n";
    std::fs::write(folder.join("graph.toml"), text).expect("a file");
    let mut check = std::process::Command::new(program);
    check.current_dir(&folder).args(["check", "graph.toml", "--trust-plugins"]);
    panoscope_testing::own_settings(&mut check, &folder);
    // NumPy of the tests is not that of the environment.
    let output = check.env_remove("PYTHONPATH").output().expect("it starts");
    let mistakes = String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success(), "{mistakes}");
    assert!(mistakes.contains("NumPy is missing in") && mistakes.contains(".venv"), "{mistakes}");
    assert!(mistakes.contains("-m pip install numpy") && mistakes.contains("PANOSCOPE_PYTHON"), "{mistakes}");
    assert!(!mistakes.contains("replace the plugin"), "{mistakes}");
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn a_process_that_dies_or_hangs_is_a_fault_and_comes_back() {
    if !has_python() {
        return;
    }
    for (how, cause) in [("segv", Cause::Crash), ("exit", Cause::Crash), ("loop", Cause::Hang)] {
        let folder = folder(&format!("python-{how}"));
        let mut options = Options { frames: Some(30), ..Options::default() };
        if cause == Cause::Hang {
            // In batch a call hangs after 30 times this.
            options.hang = Duration::from_millis(100);
        }
        let run = run_with(&folder, &failing(how), options);
        let fault = run.faults.first().unwrap_or_else(|| panic!("{how}: no fault"));
        assert_eq!((fault.node.as_str(), fault.cause), ("fails", cause), "{how}: {}", fault.words);
        assert_eq!(run.report.groups["turned"].processes, 2, "{how}: {:?}", run.faults);
        assert!(run.port("fails.image").len() > 20, "{how}: frames after the fault");
        let _ = std::fs::remove_dir_all(&folder);
    }
}

#[test]
fn too_much_memory_is_an_exception() {
    if !has_python() {
        return;
    }
    let folder = folder("python-memory");
    let run = run(&folder, &failing("memory"), 6);
    let words = &run.faults.first().expect("a fault").words;
    assert!(words.contains("MemoryError"), "{words}");
    assert_eq!(run.port("fails.image").len(), 5, "all but that one");
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn a_saved_file_is_swapped_in_and_state_is_kept() {
    if !has_python() {
        return;
    }
    let folder = folder("python-swap");
    let path = folder.join("graph.toml");
    let text = "mode = \"live\"\nplugin_paths = [\".\"]\nplugins = [\"flow\", \"turned\"]\n\
         [nodes.other]\ntype = \"frames\"\nparams = { rate_hz = 100.0 }\n\
         [nodes.other_end]\ntype = \"drain\"\ninputs = { image = { from = \"other.image\", queue = 64 } }\n\
         [nodes.count]\ntype = \"count\"\nparams = { last = 1000000 }\nmax_rate_hz = 50\n\
         [nodes.end]\ntype = \"drain\"\ninputs = { image = \"count.image\" }\n";
    let ready = ready(&path, text).unwrap_or_else(|mistakes| panic!("{mistakes}"));
    let mut live = ready.start(Options::default()).expect("starts");
    let engine = Arc::clone(live.engine());
    let counted = |engine: &Engine| engine.report().nodes["count"].count;
    let wait = |until: &dyn Fn() -> bool| {
        let end = Instant::now() + MAX_RUN;
        while !until() {
            assert!(Instant::now() < end, "{:?}", engine.recent_log());
            std::thread::sleep(Duration::from_millis(5));
        }
    };
    wait(&|| counted(&engine) > 20);
    let file = folder.join("turned.py");
    let source = std::fs::read_to_string(&file).expect("the plugin");
    let watch = std::cell::RefCell::new(FileWatch::new(&path, live.loader()));
    (0..3).for_each(|_| assert_eq!(watch.borrow_mut().poll(), Changed::default(), "nothing was saved"));
    let changed = source.replace(
        "picture[:] = self.count % 256",
        "picture[:] = 1000 < self.count\n        ps.metric(\"state\", self.count)",
    );
    std::fs::write(&file, changed.replace("ps.empty((4, 6))", "ps.empty((4, 8))")).expect("saved");
    let before = counted(&engine);
    wait(&|| watch.borrow_mut().poll().plugins);
    let applied = live.reload_plugins().unwrap_or_else(|error| panic!("{error}"));
    assert!(!applied.is_nothing());
    wait(&|| engine.report().nodes["count"].count > 3 && engine.report().nodes["count"].metrics.contains_key("state"));
    let state = engine.report().nodes["count"].metrics["state"];
    assert!(state > before as f64, "the count goes on: {state} after {before}");
    // A file with a mistake is refused, and the old code runs on.
    std::fs::write(
        &file,
        "import panoscope as ps\n@ps.node()\nclass Count:\n    def process(self, image) -> ps.Gray8: pass\n",
    )
    .expect("saved");
    wait(&|| watch.borrow_mut().poll().plugins);
    let error = live.reload_plugins().expect_err("a mistake").to_string();
    assert!(error.contains("`image` needs a packet type"), "{error}");
    std::fs::write(&file, source.replace("picture[:] = self.count % 256", "picture[:] = (")).expect("saved");
    wait(&|| watch.borrow_mut().poll().plugins);
    let error = live.reload_plugins().expect_err("no Python").to_string();
    assert!(error.contains("SyntaxError") && error.contains("correct the file"), "{error}");
    let counted_then = counted(&engine);
    wait(&|| counted(&engine) > counted_then + 5);
    assert_eq!(engine.report().nodes["other_end"].dropped + engine.report().nodes["other"].faults, 0);
    engine.stop();
    assert_eq!(engine.close(Duration::from_secs(30)), Outcome::Done);
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn nodes_of_python_and_of_a_library_do_not_share_a_group() {
    if !has_python() {
        return;
    }
    let folder = folder("python-groups");
    let text = format!(
        "plugin_paths = [\".\"]\n{PICTURES}[nodes.once]\ntype = \"turn\"\nisolate = \"both\"\ninputs = {{ image = \"scope.left\" }}\n\
         [nodes.passes]\ntype = \"pass\"\nisolate = \"both\"\ninputs = {{ image = \"once.image\" }}\n"
    );
    let mistakes = load(&folder.join("graph.toml"), &text).err().expect("two programs");
    assert!(mistakes.contains("different programs run them") && mistakes.contains("python3"), "{mistakes}");
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn an_interpreter_that_is_missing_is_named_with_the_remedy() {
    let folder = scratch("python-missing");
    let plugin = "# /// script\n# [tool.panoscope]\n# python = \"env/bin/python\"\n# ///\nimport panoscope as ps\n@ps.node()\nclass Turn:\n    pass\n";
    std::fs::write(folder.join("mine.py"), plugin).expect("a file");
    let text = "plugin_paths = [\".\"]\nplugins = [\"mine\"]\n[nodes.a]\ntype = \"turn\"\n";
    let mistakes = load(&folder.join("graph.toml"), text).err().expect("no interpreter");
    assert!(mistakes.contains("env/bin/python does not exist") && mistakes.contains("[tool.panoscope]"), "{mistakes}");
    let _ = std::fs::remove_dir_all(&folder);
}
