//! Live mode: whole ticks are dropped where they enter, and every drop is counted.

use std::time::Duration;

use crate::common::{PATIENCE, ledger, options, run, scratch, start};
use panoscope_engine::fault::Cause;
use panoscope_engine::{Options, Outcome};

#[test]
fn a_slow_branch_drops_whole_ticks_at_the_entrance() {
    let path = scratch("live.jsonl");
    let nodes = format!(
        r#"
[nodes.source]
type = "frames"
params = {{ width_px = 16, height_px = 16, rate_hz = 1000.0 }}
[nodes.quick]
type = "pass"
inputs = {{ image = "source.image" }}
[nodes.slow]
type = "pass_blocking"
inputs = {{ image = "source.image" }}
params = {{ wait_ms = 10.0 }}
[nodes.join]
type = "ledger"
inputs = {{ images = ["quick.image", "slow.image"] }}
params = {{ path = "{}" }}
"#,
        path.display()
    );
    let (report, outcome) = run("live", &nodes, options(2, 300));
    assert_eq!(outcome, Outcome::Done);
    let lines = ledger(&path);
    let dropped: u64 = report.nodes.values().map(|n| n.dropped).sum();
    assert!(dropped > 100, "{dropped}");
    assert_eq!(lines.len() as u64 + dropped, 300, "every tick is joined or counted as dropped");
    assert_eq!(report.nodes["source"].dropped, dropped, "dropped where they enter");
    for (seq, inputs) in &lines {
        assert_eq!(inputs, &[Some(*seq), Some(*seq)], "the branches keep the same ticks");
    }
    assert_eq!(lines.last().map(|l| l.0), Some(299), "the newest frame wins");
}

#[test]
fn a_latest_reader_does_not_hold_up_the_rest() {
    let nodes = r#"
[nodes.source]
type = "frames"
params = { width_px = 16, height_px = 16, rate_hz = 500.0 }
[nodes.slow]
type = "pass_blocking"
inputs = { image = { from = "source.image", align = "latest" } }
params = { wait_ms = 20.0 }
[nodes.slow_sink]
type = "drain"
inputs = { image = "slow.image" }
[nodes.sink]
type = "drain"
inputs = { image = "source.image" }
"#;
    let (report, _) = run("live", nodes, options(2, 200));
    let slow = &report.nodes["slow"];
    assert_eq!(report.nodes["sink"].count + report.nodes["source"].dropped, 200);
    assert!(slow.count < 100 && slow.dropped > 50, "{slow:#?}");
    assert_eq!(report.nodes["slow_sink"].count, slow.count);
}

#[test]
fn stopping_ends_sources_and_finishes_files() {
    let path = scratch("stopped.jsonl");
    let nodes = format!(
        r#"
[nodes.source]
type = "frames"
params = {{ width_px = 16, height_px = 16, rate_hz = 200.0 }}
[nodes.file]
type = "ledger"
inputs = {{ images = ["source.image"] }}
params = {{ path = "{}" }}
"#,
        path.display()
    );
    let engine = start("live", &nodes, Options::default()).expect("it starts");
    assert!(!engine.wait(Some(Duration::from_millis(200))), "without a number of frames it does not end by itself");
    engine.stop();
    assert!(engine.wait(Some(PATIENCE)), "it ends when asked to");
    assert_eq!(engine.close(PATIENCE), Outcome::Done);
    let report = engine.report();
    let lines = ledger(&path);
    assert!(!lines.is_empty());
    assert_eq!(lines.len() as u64, report.nodes["file"].count, "the last line is whole");
}

#[test]
fn a_parameter_changes_between_two_ticks() {
    let nodes = r#"
[nodes.source]
type = "frames"
params = { width_px = 16, height_px = 16, rate_hz = 500.0 }
[nodes.gate]
type = "gate"
inputs = { image = "source.image" }
params = { open = false }
[nodes.sink]
type = "drain"
inputs = { image = "gate.image" }
"#;
    let engine = start("live", nodes, Options::default()).expect("it starts");
    std::thread::sleep(Duration::from_millis(50));
    assert_eq!(engine.report().nodes["sink"].count, 0);
    engine.set_param("gate", "open", panoscope_graph::ParamValue::Bool(true)).expect("a fine value");
    let until = std::time::Instant::now() + PATIENCE;
    while engine.report().nodes["sink"].count == 0 {
        assert!(std::time::Instant::now() < until, "the gate did not open");
        std::thread::sleep(Duration::from_millis(5));
    }
    let wrong = engine.set_param("gate", "open", panoscope_graph::ParamValue::Int(3)).unwrap_err().to_string();
    assert!(wrong.contains("gate.open"), "{wrong}");
    let wrong = engine.set_param("gat", "open", panoscope_graph::ParamValue::Bool(true)).unwrap_err().to_string();
    assert!(wrong.contains("`gat`"), "{wrong}");
    engine.close(PATIENCE);
}

#[test]
fn a_preview_sees_the_newest_frame() {
    let nodes = r#"
[nodes.source]
type = "frames"
params = { width_px = 16, height_px = 16, rate_hz = 500.0 }
[nodes.sink]
type = "drain"
inputs = { image = "source.image" }
"#;
    let engine = start("live", nodes, Options::default()).expect("it starts");
    assert!(engine.preview("source", "picture").is_none());
    let preview = engine.preview("source", "image").expect("a port");
    let until = std::time::Instant::now() + PATIENCE;
    let frame = loop {
        if let Some(frame) = preview.take() {
            break frame;
        }
        assert!(std::time::Instant::now() < until, "no frame was shown");
        std::thread::sleep(Duration::from_millis(2));
    };
    assert_eq!((frame.frame().width, frame.frame().height), (16, 16));
    assert_eq!(frame.bytes()[0], frame.tick().seq as u8, "the ramp begins with the tick number");
    engine.close(PATIENCE);
}

/// A slow node and a recorder of the same source.
fn recorder_beside(slow: &str, path: &std::path::Path) -> String {
    format!(
        r#"
[nodes.source]
type = "frames"
params = {{ width_px = 16, height_px = 16, rate_hz = 100.0 }}
[nodes.slow]
type = "pass_blocking"
{slow}
params = {{ wait_ms = 50.0 }}
[nodes.end]
type = "drain"
inputs = {{ image = "slow.image" }}
[nodes.record]
type = "ledger"
inputs = {{ images = ["source.image"] }}
params = {{ path = "{}" }}
"#,
        path.display()
    )
}

#[test]
fn a_recorder_that_lacks_frames_says_so_and_why() {
    let path = scratch("lacking.jsonl");
    let slow = "inputs = { image = \"source.image\" }";
    let engine = start("live", &recorder_beside(slow, &path), options(2, 100)).expect("it starts");
    assert!(engine.wait(Some(PATIENCE)));
    engine.close(PATIENCE);
    let (report, lines) = (engine.report(), ledger(&path).len() as u64);
    let node = &report.nodes["record"];
    assert!(node.lacking > 20, "{}", node.lacking);
    assert_eq!((node.lacking, node.faults), (report.nodes["source"].dropped, 0));
    assert_eq!(lines + node.lacking, 100, "each frame is recorded or counted as lacking");
    let faults = engine.recent_faults();
    let said = faults.iter().rfind(|f| f.node == "record" && f.cause == Cause::Incomplete).expect("it says so");
    assert!(said.words.contains("frames of `source` so far: `slow` takes "), "{}", said.words);
    assert!(said.words.contains("let `slow` read with align = \"latest\""), "{}", said.words);
}

/// What the message recommends.
#[test]
fn a_slow_node_with_a_rate_or_a_latest_input_takes_no_frame_from_a_recorder() {
    let limited = "inputs = { image = \"source.image\" }\nmax_rate_hz = 5.0";
    let latest = "inputs = { image = { from = \"source.image\", align = \"latest\" } }";
    for (name, slow) in [("limited", limited), ("latest", latest)] {
        let path = scratch(&format!("{name}.jsonl"));
        // Room for a busy machine.
        let text =
            recorder_beside(slow, &path).replace("[\"source.image\"]", "[{ from = \"source.image\", queue = 20 }]");
        let (report, _) = run("live", &text, options(2, 100));
        assert_eq!((report.nodes["record"].lacking, ledger(&path).len()), (0, 100), "{name}");
    }
}

/// Two nodes that each take a tick in four would together hold up one tick in four.
#[test]
fn limited_nodes_of_a_live_graph_take_different_ticks() {
    let paths = ["a", "b"].map(|name| scratch(&format!("limited_{name}.jsonl")));
    let limited = |name: &str, path: &std::path::Path| {
        let path = path.display();
        format!(
            "[nodes.{name}]\ntype = \"ledger\"\ninputs = {{ images = [\"source.image\"] }}\nparams = {{ path = \"{path}\" }}\nmax_rate_hz = 15.0\n"
        )
    };
    let source =
        "[nodes.source]\ntype = \"frames\"\nparams = { width_px = 16, height_px = 16, rate_hz = 60.0 }\n".to_owned();
    let text = source + &limited("a", &paths[0]) + &limited("b", &paths[1]);
    for (mode, shared) in [("live", 1), ("batch", 60)] {
        // Without waiting for capture times no tick is dropped.
        run(mode, &text, Options { paced: false, ..options(2, 240) });
        let [a, b] = paths.each_ref().map(|path| ledger(path).into_iter().map(|(seq, _)| seq).collect::<Vec<_>>());
        assert!(a.len() == 60 && (59..=60).contains(&b.len()), "{mode}: {a:?} {b:?}");
        assert_eq!(a.iter().filter(|tick| b.contains(tick)).count(), shared, "{mode}: {a:?} {b:?}");
    }
}
