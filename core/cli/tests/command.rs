//! The command from outside: words, exit codes, files.

use crate::common;
use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

const PROGRAM: &str = env!("CARGO_BIN_EXE_panoscope");

/// Search path with the plugins that most tests here use.
fn plugin_path() -> &'static OsStr {
    static PATH: OnceLock<OsString> = OnceLock::new();
    PATH.get_or_init(|| common::built_plugins(&["flow", "fixtures", "sinks"]))
}

fn panoscope() -> Command {
    let mut command = Command::new(PROGRAM);
    command.env("PANOSCOPE_PLUGIN_PATH", plugin_path());
    command
}

fn run(arguments: &[&str]) -> (i32, String, String) {
    let Output { status, stdout, stderr } = panoscope().args(arguments).output().expect("the program starts");
    let text = |bytes| String::from_utf8(bytes).expect("UTF-8");
    (status.code().unwrap_or(-1), text(stdout), text(stderr))
}

/// A file in a folder of this test process.
fn file(name: &str, text: &str) -> String {
    let folder = std::env::temp_dir().join(format!("panoscope_command_{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("temporary files can be written");
    let path = folder.join(name);
    std::fs::write(&path, text).expect("a file");
    path.display().to_string()
}

/// `frames` -> `middle` -> `drain`.
fn graph(mode: &str, middle: &str, more: &str) -> String {
    format!(
        r#"
mode = "{mode}"
plugins = ["flow", "fixtures"]
[nodes.source]
type = "frames"
params = {{ width_px = 64, height_px = 48, rate_hz = 200.0 }}
[nodes.middle]
type = "{middle}"
inputs = {{ image = "source.image" }}
{more}
[nodes.sink]
type = "drain"
inputs = {{ image = "middle.image" }}
"#
    )
}

fn json(path: &str) -> serde_json::Value {
    serde_json::from_str(&std::fs::read_to_string(path).expect("the report")).expect("JSON")
}

#[test]
fn a_run_writes_its_report() {
    let graph = file("pass.toml", &graph("batch", "pass", ""));
    let report = file("pass.json", "");
    let (code, out, err) = run(&["run", &graph, "--frames", "400", "--report", &report, "--headless"]);
    assert_eq!(code, 0, "{err}");
    assert!(out.contains("pass: 400 frames") && out.contains("middle"), "{out}");
    let report = json(&report);
    assert_eq!(report["frames"], 400);
    assert_eq!(report["nodes"]["middle"]["count"], 400);
    for key in ["p50_ms", "p99_ms", "max_ms", "dropped", "faults", "copies"] {
        assert!(report["nodes"]["middle"][key].is_number(), "{key}");
    }
    for key in ["age_p50_ms", "age_p99_ms", "age_max_ms"] {
        assert!(report["paths"]["sink"][key].is_number(), "{key}");
    }
    assert!(report["machine"]["cores"].is_number());
}

#[test]
fn a_run_writes_a_trace_of_its_threads() {
    let graph = file("traced.toml", &graph("batch", "pass", ""));
    let trace = file("trace.json", "");
    let (code, _, err) = run(&["run", &graph, "--frames", "50", "--trace", &trace, "--headless"]);
    assert_eq!(code, 0, "{err}");
    let trace = json(&trace);
    let events = trace.as_array().expect("a list of events");
    let slices = |node: &str| events.iter().filter(|e| e["ph"] == "X" && e["name"] == node).collect::<Vec<_>>();
    // 64 x 48 pixels of three bytes.
    for (node, read_bytes, made_bytes) in [("middle", 9216, 9216), ("sink", 9216, 0)] {
        let slices = slices(node);
        assert_eq!(slices.len(), 50, "{node}");
        let ticks: Vec<_> = slices.iter().filter_map(|slice| slice["args"]["tick"].as_u64()).collect();
        assert_eq!(ticks, (0..50).collect::<Vec<_>>(), "{node}");
        let bytes = |key: &str| slices[7]["args"][key].as_u64();
        assert_eq!((bytes("read_bytes"), bytes("made_bytes")), (Some(read_bytes), Some(made_bytes)), "{node}");
    }
    assert!(events.iter().any(|e| e["name"] == "thread_name"), "threads have names");
    let graph = file("traced.toml", &self::graph("batch", "pass", ""));
    let (code, out, err) = run(&["run", &graph, "--frames", "5", "--trace", "/proc/no/trace.json", "--headless"]);
    assert_eq!(code, 1, "{out}{err}");
    assert!(format!("{out}{err}").contains("/proc/no/trace.json"), "{out}{err}");
}

#[test]
fn allocations_of_a_plugin_are_counted() {
    if !cfg!(all(target_os = "linux", target_env = "gnu")) {
        panoscope_testing::skipped!("allocations are counted on Linux with glibc only");
        return;
    }
    let graph = file("allocate.toml", &graph("batch", "allocate", "params = { count = 3 }"));
    let report = file("allocate.json", "");
    let per_frame = |count: &str| {
        let set = format!("middle.count={count}");
        let (code, _, err) =
            run(&["run", &graph, "--frames", "2000", "--threads", "1", "--set", &set, "--report", &report]);
        assert_eq!(code, 0, "{err}");
        let report = json(&report);
        let by_node = report["nodes"]["middle"]["allocations"].as_f64().expect("counted") / 2000.0;
        (report["allocations_per_frame"].as_f64().expect("counted"), by_node)
    };
    let (process, node) = per_frame("3");
    assert!((process - 3.0).abs() < 0.1 && (node - 3.0).abs() < 0.1, "{process} {node}");
    let (process, node) = per_frame("0");
    assert!(process < 0.05 && node < 0.05, "the engine itself allocates nothing: {process} {node}");
}

#[test]
fn wrong_graphs_and_arguments_are_2_and_failed_runs_1() {
    let wrong = file("wrong.toml", &graph("batch", "pas", "").replace("rate_hz", "rate"));
    let (code, _, err) = run(&["run", &wrong]);
    assert_eq!(code, 2, "{err}");
    assert!(err.contains("did you mean \"pass\"?") && err.contains("`rate`"), "all mistakes at once: {err}");
    let (code, out, _) = run(&["check", &wrong]);
    assert_eq!(code, 2);
    assert!(out.contains("2 errors"), "{out}");
    assert_eq!(run(&["run"]).0, 2);
    assert_eq!(run(&["run", "there_is_no_such.toml"]).0, 2);
    let fine = file("fine.toml", &graph("batch", "pass", ""));
    assert_eq!(run(&["run", &fine, "--set", "middle.nothing=1"]).0, 2);
    assert_eq!(run(&["run", &fine, "--left", "a.png"]).0, 2, "no node of type `capture`");

    let failing = file("failing.toml", &graph("batch", "failing", "on_fault = \"stop\"\nparams = { first = 5 }"));
    let (code, _, err) = run(&["run", &failing, "--frames", "50"]);
    assert_eq!(code, 1);
    assert!(err.contains("`middle`") && err.contains("told to fail at tick 5"), "{err}");
    let (code, _, err) = run(&["run", &failing, "--set", "middle.how=open"]);
    assert_eq!(code, 1);
    assert!(err.contains("told not to open"), "{err}");
    let once = file("once.toml", &graph("batch", "failing", "params = { first = 5 }"));
    let (code, _, err) = run(&["run", &once, "--frames", "50"]);
    assert_eq!(code, 1, "a fault that lost a tick fails the run: {err}");
    assert!(err.contains("error: node `middle` failed once: told to fail at tick 5"), "{err}");
}

/// Frames of a video that was completed: the size in its head is that of the file.
fn frames_of(path: &Path) -> u64 {
    let bytes = std::fs::read(path).expect("the video");
    let find = |what: [u8; 4], from: usize| bytes[from..].windows(4).position(|w| w == what).map(|at| from + at);
    let size = |at: usize| u64::from_be_bytes(bytes[at + 4..at + 12].try_into().expect("a size")) & !(0xFF << 56);
    let segment = find([0x18, 0x53, 0x80, 0x67], 0).expect("a segment");
    assert_eq!(segment as u64 + 12 + size(segment), bytes.len() as u64, "it was not completed");
    let (mut at, mut frames) = (find([0x1F, 0x43, 0xB6, 0x75], 0), 0);
    while let Some(cluster) = at {
        frames += 1;
        let next = cluster + 12 + size(cluster) as usize;
        at = (bytes.get(next..next + 4) == Some(&[0x1F, 0x43, 0xB6, 0x75])).then_some(next);
    }
    frames
}

#[test]
fn a_disk_that_fills_up_fails_the_run_and_keeps_what_was_written() {
    let folder = std::env::temp_dir().join(format!("panoscope_command_full_{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let library = folder.join("disk_faults.so");
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/c/disk_faults.c");
    let mut cc = Command::new("cc");
    cc.args(["-O1", "-shared", "-fPIC", "-fvisibility=hidden", "-o"]).args([&library, &source]);
    assert!(cc.status().expect("a C compiler").success());
    let (disk, report) = (folder.join("disk"), folder.join("report.json"));
    let video = disk.join("v.mkv");
    let sink = format!(
        "[nodes.out]\ntype = \"write_video\"\ninputs = {{ image = \"source.image\" }}\nparams = {{ path = \"{}\" }}",
        video.display()
    );
    let text = graph("batch", "pass", &sink).replace("\"fixtures\"]", "\"fixtures\", \"sinks\"]");
    let graph = file("fills_up.toml", &text);
    let full_from = |operation: u32| {
        let _ = std::fs::remove_dir_all(&disk);
        let mut command = panoscope();
        command.env("LD_PRELOAD", &library).env("PANOSCOPE_DISK_FAULT", format!("1 {operation} {}", disk.display()));
        command.args(["run", &graph, "--headless", "--frames", "100", "--report"]).arg(&report);
        let Output { status, stderr, .. } = command.output().expect("the program starts");
        (status.code(), String::from_utf8(stderr).expect("UTF-8"))
    };
    let (code, said) = full_from(1_000_000);
    assert_eq!((code, frames_of(&video)), (Some(0), 100), "{said}");
    let (code, said) = full_from(40);
    assert_eq!(code, Some(1), "{said}");
    assert!(said.contains("`out` lost data") && said.contains("the disk is full"), "{said}");
    let report = json(&report.display().to_string());
    assert!(report["stopped"]["out"].as_str().is_some_and(|words| words.contains("the disk is full")), "{report}");
    let node = &report["nodes"]["out"];
    assert_eq!((node["faults"].as_u64(), node["restarts"].as_u64()), (Some(1), Some(0)), "{report}");
    let calls = node["count"].as_u64().expect("a count");
    assert!(calls > 5 && frames_of(&video) == calls - 1, "{calls} calls, {} frames", frames_of(&video));
    assert_eq!(std::fs::read_dir(&disk).expect("the folder").count(), 1, "one file, not one per attempt");
    assert_eq!(report["nodes"]["sink"]["count"], 100, "the others go on");
    // A disk that is full before the run begins.
    let (code, said) = full_from(1);
    assert!(code == Some(1) && said.contains("`out`") && said.contains("the disk is full"), "{said}");
    std::fs::remove_dir_all(folder).expect("it is removed");
}

#[test]
fn check_tells_in_json() {
    let fine = file("check_fine.toml", &graph("live", "pass", ""));
    let wrong = file("check_wrong.toml", &graph("live", "pas", ""));
    let (code, out, _) = run(&["check", "--json", &fine, &wrong]);
    assert_eq!(code, 2);
    let lines: Vec<serde_json::Value> = out.lines().map(|l| serde_json::from_str(l).expect("JSON")).collect();
    assert_eq!((lines[0]["ok"].as_bool(), lines[1]["ok"].as_bool()), (Some(true), Some(false)));
    assert_eq!(lines[1]["diagnostics"][0]["line"], 8);
}

#[test]
fn list_describe_dot_and_schema_tell_what_there_is() {
    let (code, out, _) = run(&["list", "--json"]);
    assert_eq!(code, 0);
    let list: serde_json::Value = serde_json::from_str(&out).expect("JSON");
    let flow =
        list["plugins"].as_array().expect("plugins").iter().find(|p| p["plugin"] == "flow").expect("flow").clone();
    assert!(flow["node_types"].as_array().expect("types").iter().any(|t| t == "every_nth"));

    let (code, out, _) = run(&["describe", "every_nth"]);
    assert_eq!(code, 0);
    assert!(out.contains("n = 2 (1 to 1000000): a whole number") && out.contains("One frame in this many"), "{out}");
    let (code, _, err) = run(&["describe", "evry_nth"]);
    assert_eq!(code, 2);
    assert!(err.contains("did you mean `every_nth`?"), "{err}");

    let fine = file("dot.toml", &graph("live", "pass", ""));
    let (code, out, _) = run(&["dot", &fine]);
    assert!(code == 0 && out.starts_with("digraph"), "{out}");
    let (code, out, _) = run(&["schema"]);
    let schema: serde_json::Value = serde_json::from_str(&out).expect("JSON");
    assert!(code == 0 && schema["$schema"].is_string() && out.contains("every_nth"));
}

#[test]
fn an_interrupt_ends_clean_with_files_finished() {
    let ledger = file("interrupted.jsonl", "");
    let text = graph("live", "pass", "").replace("[nodes.sink]", "[nodes.file]").replace("\"drain\"", "\"ledger\"");
    let text = text.replace("{ image = \"middle.image\" }", "{ images = [\"middle.image\"] }")
        + &format!("params = {{ path = \"{ledger}\" }}\n");
    let graph = file("interrupted.toml", &text);
    let mut child = panoscope().args(["run", &graph]).stderr(std::process::Stdio::null()).spawn().expect("it starts");
    std::thread::sleep(Duration::from_millis(700));
    let sent = Command::new("kill").args(["-INT", &child.id().to_string()]).status().expect("kill runs");
    assert!(sent.success());
    let until = Instant::now() + Duration::from_secs(30);
    let status = loop {
        if let Some(status) = child.try_wait().expect("a child") {
            break status;
        }
        assert!(Instant::now() < until, "it did not end");
        std::thread::sleep(Duration::from_millis(20));
    };
    assert_eq!(status.code(), Some(0));
    let lines = std::fs::read_to_string(&ledger).expect("the ledger");
    assert!(lines.ends_with("}\n") && lines.lines().count() > 2, "the last line is whole");
}

#[test]
fn calibrate_names_what_is_wrong_with_its_arguments() {
    for (arguments, words) in [
        (["--left", "a", "--right", "b", "--board", "chess:9x6"], "kind is unknown"),
        (["--left", "no/l?.png", "--right", "no/r?.png", "--board", "chessboard:9x6:25mm"], "no picture matches"),
        (["--left", "scope", "--graph", "g.toml", "--right", "scope.right"], "--board"),
    ] {
        let (code, _, said) = run(&[&["calibrate"], &arguments[..]].concat());
        assert!(code == 2 && said.contains(words), "{code}: {said}");
    }
}

#[test]
fn calibrate_refuses_too_few_pairs_before_it_runs() {
    let pictures: Vec<String> = ["l", "r"]
        .iter()
        .flat_map(|side| (0..4).map(move |index| format!("few_pairs_{side}{index}.png")))
        .map(|name| file(&name, ""))
        .collect();
    let pattern = |index: usize| format!("{}?.png", &pictures[index][..pictures[index].len() - "0.png".len()]);
    let (code, _, said) =
        run(&["calibrate", "--left", &pattern(0), "--right", &pattern(4), "--board", "chessboard:9x6:25mm"]);
    assert!(code == 2 && said.contains("4 pairs of views are too few") && !said.contains(".toml"), "{code}: {said}");
}

#[test]
fn calibrate_solves_opencvs_pairs_and_writes_what_capture_reads() {
    let data = Path::new("/usr/share/doc/opencv-doc/examples/data");
    if !data.join("left01.jpg").exists() {
        panoscope_testing::skipped!("Debian's opencv-doc is not installed");
        return;
    }
    if !common::has_plugins(plugin_path(), &["opencv", "capture"]) {
        panoscope_testing::skipped!("the plugins opencv and capture are not built beside flow");
        return;
    }
    let out = file("scope.yml", "");
    let pattern = |side: &str| data.join(format!("{side}??.jpg")).display().to_string();
    let (left, right) = (pattern("left"), pattern("right"));
    let (code, said, errors) =
        run(&["calibrate", "--left", &left, "--right", &right, "--board", "chessboard:9x6:25mm", "-o", &out]);
    assert_eq!(code, 0, "{errors}");
    assert!(said.contains("left01.jpg right01.jpg") && said.contains("13 of 13 views"), "{said}");
    let found = panoscope_data::calibration::read(&[PathBuf::from(&out)]).expect("the result is a calibration");
    assert!(found.rms_px < 0.4 && (found.baseline_mm - 83.3).abs() < 1.0, "{found:?}");
    assert!((found.left.fx / found.left.fy - 1.0).abs() < 0.005, "{found:?}");
    // The fewest views are enough for a refusal.
    let few = |side: &str| {
        let views = (1..=5).map(|view| data.join(format!("{side}0{view}.jpg")));
        let folder = Path::new(&out).with_file_name(side);
        std::fs::create_dir_all(&folder).expect("temporary files can be written");
        for view in views {
            std::fs::copy(&view, folder.join(view.file_name().expect("a name"))).expect("a copy");
        }
        folder.join("*.jpg").display().to_string()
    };
    let (left, right) = (few("left"), few("right"));
    let (code, _, errors) =
        run(&["calibrate", "--left", &right, "--right", &left, "--board", "chessboard:9x6:25mm", "-o", &out]);
    assert!(code == 1 && errors.contains("left and right look exchanged"), "{code}: {errors}");
    // With another board nothing is found; every view is named.
    let (code, _, errors) =
        run(&["calibrate", "--left", &left, "--right", &right, "--board", "chessboard:13x4:25mm", "-o", &out]);
    assert!(code == 1 && errors.contains("left out: left02.jpg right02.jpg: no board was found"), "{code}: {errors}");
}

#[test]
fn a_locked_graph_tells_what_has_changed() {
    let text = graph("live", "pass", "");
    let path = file("locked.toml", &text);
    let _ = std::fs::remove_file(format!("{path}.lock"));
    let (code, _, told) = run(&["lock", &path, "--verify"]);
    assert!(code == 2 && told.contains("is not locked"), "{told}");
    let (code, said, told) = run(&["lock", &path]);
    assert!(code == 0 && said.contains("files locked") && said.contains("flow"), "{said}{told}");
    assert_eq!(run(&["lock", &path, "--verify"]).0, 0);
    std::fs::write(&path, format!("# changed\n{text}")).expect("written");
    let (code, _, told) = run(&["lock", &path, "--verify"]);
    assert!(code == 1 && told.contains("graph `locked.toml` has changed since the graph was locked"), "{told}");
    let (code, _, told) = run(&["lock", &file("wrong.toml", "[nodes.a]\ntype = \"nothing\"\n")]);
    assert!(code == 2 && told.contains("nothing"), "{told}");
}

#[test]
fn a_sweep_writes_a_row_per_value() {
    let level = "[nodes.level]\ntype = \"level\"\ninputs = { image = \"source.image\" }";
    let graph = file("sweep.toml", &graph("live", "pass", level));
    let (rows, table) = (file("sweep.json", ""), file("sweep.csv", ""));
    let arguments = ["--param", "level.gain", "--from", "1", "--to", "2", "--steps", "3", "--frames", "5"];
    let files = ["--measure", "level.levels.max", "--json", &rows, "--csv", &table];
    let (code, out, err) = run(&[&["sweep", &graph], &arguments[..], &files[..]].concat());
    assert_eq!(code, 0, "{out}{err}");
    let written = json(&rows);
    let written = written.as_array().expect("rows");
    assert_eq!(written.len(), 3);
    assert_eq!((written[1]["value"].as_str(), written[1]["count"].as_u64()), (Some("1.5"), Some(5)));
    let means: Vec<f64> = written.iter().filter_map(|row| row["mean"].as_f64()).collect();
    assert!(means[0] > 0.0 && (means[2] - 2.0 * means[0]).abs() < 1e-9, "{means:?}");
    assert_eq!(std::fs::read_to_string(&table).expect("it was written").lines().count(), 4);
    assert!(out.contains("level.gain") && out.contains("deviation"), "{out}");
    let (code, _, err) = run(&["sweep", &graph, "--param", "level.gian", "--measure", "level.level"]);
    assert!(code == 2 && err.contains("it has gain, window, spots"), "{code}: {err}");
    // What only a run can tell is told after its first packet, and nothing more is run.
    let wrong = ["--measure", "level.levels.median"];
    let (code, out, err) = run(&[&["sweep", &graph], &arguments[..], &wrong].concat());
    assert!(code == 2 && err.contains("columns are mean, min, max, spots") && out.is_empty(), "{code}: {out}{err}");
}
