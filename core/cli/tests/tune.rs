//! `panoscope tune`: gains, fragment, plot and JSON; a graph's own parameters; what it says of graphs that cannot be
//! tuned.

use std::path::PathBuf;
use std::process::{Command, Output};

use crate::common::plugins;
use serde_json::Value;

fn run(arguments: &[&str]) -> (i32, String, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_panoscope"));
    if let Some(folder) = plugins(&["phantom", "arm"]) {
        command.env("PANOSCOPE_PLUGIN_PATH", folder);
    }
    let output = command.arg("tune").args(arguments).output();
    let Output { status, stdout, stderr } = output.expect("the program starts");
    let text = |bytes| String::from_utf8(bytes).expect("UTF-8");
    (status.code().unwrap_or(-1), text(stdout), text(stderr))
}

fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("panoscope_tune_{}_{name}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    folder
}

const GRAPH: &str = r#"
plugins = ["phantom", "arm"]
[nodes.scope]
type = "phantom"
params = { tools = 1 }
[nodes.pid]
type = "arm_pid"
inputs = { tip = "scope.tip", joints = { from = "arm.joints", delay = 1 } }
params = { picture_p = 2.5, filter_s = 0.05 }
[nodes.arm]
type = "arm_sim"
inputs = { joints = "pid.joints", tip = "scope.tip" }
params = { latency_ms = 120.0 }
"#;

#[test]
fn a_graphs_own_arm_and_controller_are_tuned_and_the_fragment_is_read_back() {
    if plugins(&["phantom", "arm"]).is_none() {
        return;
    }
    let home = folder("graph");
    let (graph, json, plot) = (home.join("graph.toml"), home.join("tune.json"), home.join("tune.png"));
    std::fs::write(&graph, GRAPH).expect("a file");
    let paths = [&graph, &json, &plot].map(|path| path.display().to_string());
    let (code, out, err) = run(&[
        &paths[0],
        "--node",
        "pid",
        "--method",
        "relay",
        "--rule",
        "tyreus-luyben",
        "--json",
        &paths[1],
        "--plot",
        &paths[2],
    ]);
    assert_eq!(code, 0, "{out}{err}");
    for words in ["Ziegler-Nichols", "AMIGO", "rise s", "overshoot %", "settling s", "steady mm", "as it is"] {
        assert!(out.contains(words), "{out} lacks {words}");
    }
    // The fragment is TOML, of this node, with the filter that it has.
    let fragment: toml::Table = out[out.find("[nodes.").expect("a fragment")..].parse().expect("TOML");
    let params = &fragment["nodes"]["pid"]["params"];
    assert_eq!(
        (fragment["nodes"]["pid"]["type"].as_str(), params["filter_s"].as_float()),
        (Some("arm_pid"), Some(0.05))
    );
    let text = std::fs::read_to_string(&json).expect("the JSON");
    let value: Value = serde_json::from_str(&text).expect("JSON");
    let picture = &value["channels"][0];
    let (gain, period_s) = (&picture["ultimate_gain"], &picture["ultimate_period_s"]);
    let (gain, period_s) = (gain.as_f64().expect("a number"), period_s.as_f64().expect("a number"));
    // An arm that is 120 ms late swings with at least four times that.
    assert!(period_s > 0.6 && period_s < 1.3, "{picture}");
    assert_eq!(picture["now"]["proportional"], 2.5);
    assert_eq!(picture["found"].as_array().map(Vec::len), Some(2), "the rule has no P");
    let found = params["picture_p"].as_float().expect("a number");
    assert!((found - gain / 2.2).abs() < 0.01, "{found} of {gain}");
    let size = image::image_dimensions(&plot).expect("a picture");
    assert!(size.0 > 1000 && size.1 > 500, "{size:?}");
    // What was found is accepted as parameters.
    let tuned = GRAPH.replace("params = { picture_p = 2.5, filter_s = 0.05 }", &format!("params = {params}"));
    std::fs::write(&graph, tuned).expect("a file");
    let (code, out, err) = run(&[&paths[0], "--method", "relay"]);
    assert_eq!(code, 0, "{out}{err}");
    std::fs::remove_dir_all(home).expect("the folder goes");
}

#[test]
fn the_search_beats_the_plain_rule_on_the_shipped_arm() {
    let home = folder("search");
    let json = home.join("tune.json").display().to_string();
    let cost = |arguments: &[&str]| -> Vec<f64> {
        let (code, out, err) = run(&[arguments, &["--json", &json]].concat());
        assert_eq!(code, 0, "{out}{err}");
        let value: Value = serde_json::from_str(&std::fs::read_to_string(&json).expect("the JSON")).expect("JSON");
        let last = |channel: &Value| channel["found"].as_array().and_then(|all| all.last()?["cost"].as_f64());
        value["channels"].as_array().expect("channels").iter().filter_map(last).collect()
    };
    let (ruled, searched) = (cost(&["--method", "relay"]), cost(&[]));
    assert_eq!((ruled.len(), searched.len()), (2, 2));
    for (ruled, searched) in ruled.iter().zip(&searched) {
        assert!(searched < ruled, "{searched} by the search, {ruled} by the rule");
    }
    std::fs::remove_dir_all(home).expect("the folder goes");
}

#[test]
fn graphs_without_a_controller_and_wrong_numbers_are_refused() {
    if plugins(&["phantom", "arm"]).is_none() {
        return;
    }
    let home = folder("wrong");
    let graph = home.join("graph.toml");
    std::fs::write(&graph, GRAPH).expect("a file");
    let path = graph.display().to_string();
    let (code, _, err) = run(&[&path, "--node", "steer"]);
    assert!(code == 2 && err.contains("`steer` is not an `arm_pid`; the graph has `pid`"), "{code} {err}");
    std::fs::write(&graph, "plugins = [\"phantom\"]\n[nodes.scope]\ntype = \"phantom\"\n").expect("a file");
    let (code, _, err) = run(&[&path]);
    assert!(code == 2 && err.contains("no node of type `arm_pid`"), "{code} {err}");
    std::fs::write(&graph, "[nodes.scope]\ntype = \"no_such\"\n").expect("a file");
    let (code, _, err) = run(&[&path]);
    assert!(code == 2 && err.contains("no_such"), "{code} {err}");
    for (option, value) in [("--overshoot", "-3"), ("--feed-forward", "1.5")] {
        let (code, _, err) = run(&[&format!("{option}={value}")]);
        assert!(code == 2 && err.contains(option), "{code} {err}");
    }
    std::fs::remove_dir_all(home).expect("the folder goes");
}
