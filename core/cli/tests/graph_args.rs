//! Arguments, parts and overlays of graphs from outside: options, help, exit codes, recordings.

use std::process::{Command, Output};

use crate::common::plugins;
use panoscope_testing::Folder;

/// Starts the program in a folder.
fn run(folder: &Folder, arguments: &str) -> (i32, String, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_panoscope"));
    let Output { status, stdout, stderr } =
        command.current_dir(folder.path()).args(arguments.split(' ')).output().expect("the program starts");
    let text = |bytes| String::from_utf8(bytes).expect("UTF-8");
    (status.code().unwrap_or(-1), text(stdout), text(stderr))
}

fn json(folder: &Folder, file: &str) -> serde_json::Value {
    serde_json::from_str(&folder.read(file)).expect("JSON")
}

fn has_flow() -> bool {
    plugins(&["flow"]).is_some()
}

const GRAPH: &str = r#"mode = "batch"
plugins = ["flow"]

[args.width]
type = "whole"
doc = "Width of the pictures"
unit = "px"
range = [16, 640]

[args.rate]
type = "number"
doc = "Pictures per second"
unit = "Hz"
default = 200.0

[nodes.source]
type = "frames"
params = { width_px = { arg = "width" }, height_px = 48, rate_hz = { arg = "rate" } }

[nodes.chain]
graph = "parts/chain.toml"
inputs = { image = "source.image" }

[nodes.sink]
type = "drain"
inputs = { image = "chain.image" }
"#;

const CHAIN: &str = r#"plugins = ["flow"]

[part]
inputs = { image = "first.image" }
outputs = { image = "second.image" }

[nodes.first]
type = "pass"

[nodes.second]
type = "pass"
inputs = { image = "first.image" }
"#;

const FLAT: &str = r#"mode = "batch"
plugins = ["flow"]

[nodes.source]
type = "frames"
params = { width_px = 64, height_px = 48, rate_hz = 200.0 }

[nodes."chain/first"]
type = "pass"
inputs = { image = "source.image" }

[nodes."chain/second"]
type = "pass"
inputs = { image = "chain/first.image" }

[nodes.sink]
type = "drain"
inputs = { image = "chain/second.image" }
"#;

fn files(name: &str) -> Folder {
    let over = "plugins = [\"flow\"]\n[args.width]\ndefault = 128\n[nodes.source]\ntype = \"frames\"\n\
                params = { width_px = { arg = \"width\" }, height_px = 32, rate_hz = 100.0 }\n";
    let all = [("g.toml", GRAPH), ("parts/chain.toml", CHAIN), ("flat.toml", FLAT), ("sources/other.toml", over)];
    Folder::new(name, &all)
}

#[test]
fn a_graph_takes_its_arguments_as_options() {
    if !has_flow() {
        return;
    }
    let folder = files("options");
    let (code, out, err) = run(&folder, "run --frames 5 g.toml --width 64 --headless --report r.json");
    assert_eq!(code, 0, "{out}{err}");
    let report = json(&folder, "r.json");
    for node in ["source", "chain/first", "chain/second", "sink"] {
        assert_eq!(report["nodes"][node]["count"], 5, "{node}: {out}");
    }
    let (code, _, err) = run(&folder, "run g.toml --headless");
    assert_eq!(code, 2);
    for words in
        ["error[missing-arg]: argument `width` is not given", "g.toml:4:7", "Width of the pictures", "--width WHOLE"]
    {
        assert!(err.contains(words), "no {words} in {err}");
    }
    let (code, _, err) = run(&folder, "run g.toml --headless --width 1000");
    assert_eq!(code, 2);
    assert!(
        err.contains("argument `width` is 1000 px; it must be 16 to 640 px") && err.contains("command line:1:9"),
        "{err}"
    );
    let (code, _, err) = run(&folder, "run g.toml --wdth 64");
    assert_eq!(code, 2);
    assert!(err.contains("--wdth") && err.contains("--width <WHOLE>"), "{err}");
    let (code, _, err) = run(&folder, "run g.toml --width");
    assert_eq!((code, err.trim()), (2, "error: --width needs a value: --width WHOLE"));
}

#[test]
fn help_and_check_name_the_arguments() {
    if !has_flow() {
        return;
    }
    let folder = files("help");
    let (code, out, _) = run(&folder, "run g.toml --help");
    assert_eq!(code, 0);
    assert!(out.contains("Arguments of g.toml:"), "{out}");
    assert!(out.contains("--width <WHOLE>  Width of the pictures [16 to 640 px, required]"), "{out}");
    assert!(out.contains("--rate <NUMBER>  Pictures per second [in Hz, default: 200.0]"), "{out}");
    let (code, out, _) = run(&folder, "check g.toml parts/chain.toml");
    assert_eq!(code, 0, "{out}");
    assert!(out.contains("g.toml: ok (4 nodes, 3 connections; to run it needs --width)"), "{out}");
    let (code, out, _) = run(&folder, "check g.toml --width 7");
    assert_eq!(code, 2, "{out}");
    let (code, out, _) = run(&folder, "dot g.toml");
    assert!(code == 0 && out.contains("subgraph \"cluster_chain\""), "{out}");
    // With argument and overlay.
    let (code, out, err) = run(&folder, "dot g.toml --width 64 --with sources/other.toml");
    assert!(code == 0 && out.contains("subgraph \"cluster_chain\""), "{out}{err}");
    let (code, _, err) = run(&folder, "dot g.toml --width 7");
    assert!(code == 2 && err.contains("it must be 16 to 640"), "{err}");
}

#[test]
fn the_schema_knows_arguments_parts_and_what_is_optional() {
    if !has_flow() {
        return;
    }
    let folder = files("schema");
    let (code, out, err) = run(&folder, "schema");
    assert_eq!(code, 0, "{err}");
    let schema: serde_json::Value = serde_json::from_str(&out).expect("JSON");
    for key in ["args", "part", "nodes", "preset"] {
        assert!(schema["properties"][key].is_object(), "no `{key}` in the schema");
    }
    for key in ["aligned", "view", "pin"] {
        assert_eq!(schema["$defs"][key]["properties"]["optional"]["type"], "boolean", "{key}");
    }
    let node = schema["$defs"]["node"].to_string();
    assert!(node.contains("\"graph\"") && node.contains("\"frames\""), "parts and plugins are nodes");
}

/// The mean of a picture, measured in a part.
const BRIGHT: &str = r#"plugins = ["flow"]
[part]
inputs = { image = "level.image" }
outputs = { level = "level.level" }
params = { gain = "level.gain" }
[nodes.level]
type = "level"
"#;

#[test]
fn a_parameter_of_a_part_is_swept_on_the_source_of_an_overlay() {
    if !has_flow() {
        return;
    }
    let folder = files("sweep");
    let graph = GRAPH.replace(
        "[nodes.sink]",
        "[nodes.bright]\ngraph = \"parts/bright.toml\"\ninputs = { image = \"chain.image\" }\n[nodes.sink]",
    );
    folder.write("g.toml", &graph);
    folder.write("parts/bright.toml", BRIGHT);
    let gray = "plugins = [\"flow\"]\n[args.format]\ntype = \"choice\"\nchoices = [\"gray8\", \"bgr8\"]\n[nodes.source]\ntype = \"frames\"\n\
                params = { width_px = { arg = \"width\" }, format = { arg = \"format\" }, rate_hz = 100.0 }\n";
    folder.write("sources/gray.toml", gray);
    let sweep = "--param bright.gain --from 0 --to 2 --steps 3 --measure bright.level --frames 4 --json s.json";
    let (code, out, err) =
        run(&folder, &format!("sweep g.toml --width 64 --with sources/gray.toml --format gray8 {sweep}"));
    assert_eq!(code, 0, "{out}{err}");
    let text = folder.read("s.json");
    let means: Vec<f64> = json(&folder, "s.json")
        .as_array()
        .unwrap_or_else(|| panic!("{text}"))
        .iter()
        .filter_map(|point| point["mean"].as_f64())
        .collect();
    let [none, one, two] = means[..] else { panic!("{text}") };
    assert!(none == 0.0 && one > 1.0 && (two - 2.0 * one).abs() < 1e-6, "{means:?}");
    // A mistake of the part stands in its file.
    folder.write("parts/bright.toml", &BRIGHT.replace("type = \"level\"", "type = \"levl\""));
    let (code, _, err) =
        run(&folder, &format!("sweep g.toml --width 64 --with sources/gray.toml --format gray8 {sweep}"));
    assert!(code == 2 && err.contains("parts/bright.toml:7:"), "{err}");
}

#[test]
fn a_graph_with_argument_part_and_overlay_is_soaked() {
    if !has_flow() {
        return;
    }
    let folder = files("soak");
    let live = GRAPH.replace("mode = \"batch\"", "mode = \"live\"");
    folder.write("g.toml", &live);
    let (code, out, err) = run(
        &folder,
        "soak g.toml --width 64 --with sources/other.toml --headless --minutes 0.06 --csv s.csv --report r.json",
    );
    // Whether memory grew in so short a time says nothing.
    assert!(code == 0 || out.contains("MB per hour"), "{code} {out}{err}");
    let report = json(&folder, "r.json");
    assert!(report["nodes"]["chain/second"]["count"].as_u64().is_some_and(|n| n > 100), "{report}");
    assert!(folder.read("s.csv").lines().count() > 3, "{}", folder.read("s.csv"));
}

#[test]
fn a_soaked_graph_is_edited_and_its_processes_are_killed() {
    if !has_flow() {
        return;
    }
    let folder = files("soak_disturbed");
    let isolated = GRAPH.replace("mode = \"batch\"", "mode = \"live\"") + "\n[isolate]\nflow = \"inner\"\n";
    folder.write("g.toml", &isolated);
    let disturbed = "--minutes 0.1 --edit-every 0.5 --kill-every 1 --csv s.csv --report r.json";
    let (code, out, err) = run(&folder, &format!("soak g.toml --width 64 --headless {disturbed}"));
    let done = out.lines().find(|line| line.contains(" edits, ")).unwrap_or_else(|| panic!("{code} {out}{err}"));
    let counts: Vec<u64> = done.split(|c: char| !c.is_ascii_digit()).filter_map(|n| n.parse().ok()).collect();
    let [edits, refused, kills, processes] = counts[..] else { panic!("{done}") };
    assert!(edits >= 2 && refused == 0 && kills >= 3 && processes >= kills, "{done}\n{out}{err}");
    assert!(out.contains("threads: ") && out.contains("open files: "), "{out}");
    assert!(err.contains("warning: node `chain/first` failed"), "kills are expected: {err}");
    let samples = folder.read("s.csv");
    assert!(samples.starts_with("seconds,") && samples.contains(",processes\n"), "{samples}");
}

#[test]
fn the_controller_of_a_part_is_tuned_with_the_arguments_of_its_graph() {
    let Some(built) = plugins(&["phantom", "arm"]) else { return };
    let part = r#"plugins = ["arm"]
[part]
inputs = { tip = ["pid.tip", "arm.tip"] }
outputs = { pose = "arm.camera_pose" }
params = { latency_ms = "arm.latency_ms" }
[nodes.pid]
type = "arm_pid"
inputs = { joints = { from = "arm.joints", delay = 1 } }
[nodes.arm]
type = "arm_sim"
inputs = { joints = "pid.joints" }
"#;
    let graph = r#"plugins = ["phantom"]
[args.late]
type = "number"
unit = "ms"
default = 30.0
[nodes.scope]
type = "phantom"
params = { tools = 1 }
[nodes.loop]
graph = "loop.toml"
inputs = { tip = "scope.tip" }
params = { latency_ms = { arg = "late" } }
"#;
    let over = "plugins = [\"phantom\"]\n[args.late]\ndefault = 120.0\n[nodes.scope]\ntype = \"phantom\"\nparams = { tools = 2 }\n";
    let folder = Folder::new("tune", &[("g.toml", graph), ("loop.toml", part), ("over.toml", over)]);
    let period_s = |arguments: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_panoscope"));
        let words = format!("tune g.toml --node loop/pid --method relay --json t.json{arguments}");
        let output =
            command.current_dir(folder.path()).env("PANOSCOPE_PLUGIN_PATH", &built).args(words.split(' ')).output();
        let output = output.expect("the program starts");
        assert!(output.status.success(), "{words}: {}", String::from_utf8_lossy(&output.stderr));
        json(&folder, "t.json")["channels"][0]["ultimate_period_s"].as_f64().expect("a number")
    };
    // An arm that is later swings more slowly.
    let (fast, slow, over) = (period_s(""), period_s(" --late 120"), period_s(" --with over.toml"));
    assert!(slow > 1.5 * fast, "{fast} and {slow}");
    assert_eq!(slow, over, "the overlay gives the same latency");
}

#[test]
fn an_overlay_replaces_the_source() {
    if !has_flow() {
        return;
    }
    let folder = files("overlay");
    let (code, out, err) =
        run(&folder, "record g.toml --with sources/other.toml --frames 3 --headless -o r.mcap --digests d.json");
    assert_eq!(code, 0, "{out}{err}");
    let (code, _, err) = run(&folder, "run g.toml --with sources/othr.toml");
    assert_eq!(code, 2);
    assert!(err.contains("the overlay does not exist") && err.contains("other.toml"), "{err}");
    // The overlay gives `width` a default.
    let (code, out, _) = run(&folder, "check g.toml --with sources/other.toml");
    assert!(code == 0 && out.contains("connections)"), "{out}");
}

#[test]
fn a_graph_with_parts_runs_to_the_same_bytes_as_a_flat_one_and_replays() {
    if !has_flow() {
        return;
    }
    let folder = files("same");
    let all = "--frames 6 --headless --all-ports";
    let (code, out, err) = run(&folder, &format!("record g.toml --width 64 {all} -o parts.mcap --digests parts.json"));
    assert_eq!(code, 0, "{out}{err}");
    let (code, out, err) = run(&folder, &format!("record flat.toml {all} -o flat.mcap --digests flat.json"));
    assert_eq!(code, 0, "{out}{err}");
    let (parts, flat) = (json(&folder, "parts.json"), json(&folder, "flat.json"));
    assert_eq!(parts["ports"], flat["ports"]);
    assert!(parts["ports"].to_string().contains("chain/second.image"), "{parts}");
    // A recording needs none of the files that it was made of.
    for file in ["g.toml", "parts/chain.toml"] {
        std::fs::remove_file(folder.at(file)).expect("it is there");
    }
    let (code, out, err) = run(&folder, "replay parts.mcap --headless --digests again.json");
    assert_eq!(code, 0, "{out}{err}");
    assert_eq!(json(&folder, "again.json")["ports"], parts["ports"]);
}

#[test]
fn a_lock_holds_parts_and_overlays() {
    if !has_flow() {
        return;
    }
    let folder = files("lock");
    let locked = "lock g.toml --with sources/other.toml";
    let (code, out, err) = run(&folder, locked);
    assert_eq!(code, 0, "{out}{err}");
    for words in ["graph        g.toml", "part         parts/chain.toml", "overlay      sources/other.toml"] {
        assert!(out.contains(words), "no {words} in {out}");
    }
    assert_eq!(run(&folder, &format!("{locked} --verify")).0, 0);
    std::fs::write(folder.at("parts/chain.toml"), CHAIN.replace("[nodes.first]", "# changed\n[nodes.first]"))
        .expect("written");
    let (code, _, err) = run(&folder, &format!("{locked} --verify"));
    assert_eq!(code, 1);
    assert!(err.contains("part `parts/chain.toml` has changed since the graph was locked"), "{err}");
}

#[test]
fn mistakes_of_a_part_stand_in_its_file() {
    if !has_flow() {
        return;
    }
    let folder = files("mistakes");
    std::fs::write(
        folder.at("parts/chain.toml"),
        CHAIN.replace("first.image\" }\noutputs", "frist.image\" }\noutputs"),
    )
    .expect("written");
    let (code, _, err) = run(&folder, "run g.toml --width 64");
    assert_eq!(code, 2);
    assert!(err.contains("parts/chain.toml:4:") && err.contains("did you mean `first`?"), "{err}");
}
