//! A fault stays in its node, and the graph does what it was told to do then.

use crate::common::{PATIENCE, options, run, start};
use panoscope_engine::log::Level;
use panoscope_engine::{Options, Outcome};

fn nodes(fault: &str, params: &str) -> String {
    format!(
        r#"
[nodes.source]
type = "frames"
params = {{ width_px = 8, height_px = 8 }}
[nodes.bad]
type = "failing"
inputs = {{ image = "source.image" }}
on_fault = "{fault}"
params = {{ {params} }}
[nodes.sink]
type = "drain"
inputs = {{ image = "bad.image" }}
[nodes.other]
type = "drain"
inputs = {{ image = "source.image" }}
"#
    )
}

#[test]
fn restart_opens_the_node_again() {
    for how in ["error", "panic"] {
        let params = format!("how = \"{how}\", first = 10, ticks = 1");
        let (report, outcome) = run("batch", &nodes("restart", &params), options(2, 100));
        assert_eq!(outcome, Outcome::Done);
        let bad = &report.nodes["bad"];
        assert_eq!((bad.faults, bad.restarts), (1, 1), "{how}");
        assert_eq!(report.nodes["sink"].count, 99, "one tick is empty");
        assert_eq!(report.nodes["other"].count, 100, "the other branch does not notice");
    }
}

#[test]
fn repeated_faults_wait_longer_and_longer() {
    let (report, outcome) = run("batch", &nodes("restart", "first = 0, ticks = 1000000"), options(2, 2_000));
    assert_eq!(outcome, Outcome::Done);
    let bad = &report.nodes["bad"];
    assert!(bad.faults >= 2 && bad.faults < 1_000, "backs off: {bad:#?}");
    assert_eq!(report.nodes["other"].count, 2_000);
    assert_eq!(report.nodes["sink"].count, 0);
}

#[test]
fn bypass_leaves_the_node_out() {
    let (report, outcome) = run("batch", &nodes("bypass", "first = 10"), options(2, 100));
    assert_eq!(outcome, Outcome::Done);
    let bad = &report.nodes["bad"];
    assert_eq!((bad.faults, bad.restarts, bad.count), (1, 0, 11));
    assert_eq!(report.nodes["sink"].count, 10);
    assert_eq!(report.nodes["other"].count, 100);
}

#[test]
fn stop_ends_the_run_and_names_the_node() {
    for how in ["error", "panic"] {
        let engine = start("batch", &nodes("stop", &format!("how = \"{how}\", first = 10")), Options::default())
            .expect("it starts");
        assert!(engine.wait(Some(PATIENCE)), "it ends by itself");
        let Outcome::Failed(reason) = engine.close(PATIENCE) else { panic!("the run failed") };
        assert!(reason.contains("`bad`"), "{reason}");
        let log = engine.recent_log();
        let words = log.iter().find(|(level, node, _)| *level == Level::Error && node == "bad");
        let words = &words.expect("the node's words are in the log").2;
        let expected = if how == "error" { "told to fail at tick 10" } else { "told to panic at tick 10" };
        assert!(words.contains(expected), "{words}");
    }
}

#[test]
fn a_node_that_does_not_open_is_named_with_its_words() {
    let error = start("batch", &nodes("restart", "how = \"open\""), options(2, 10)).err().expect("it does not start");
    assert_eq!(error, "node `bad` (failing) did not open: told not to open");
}
