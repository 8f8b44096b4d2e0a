//! Ages of packets through every kind of edge, and edges that set a limit to them.

use std::path::Path;
use std::time::Duration;

use crate::common::{PATIENCE, ledger, options, run, scratch, start};
use panoscope_engine::fault::Cause;
use panoscope_engine::{Outcome, Report};

/// A source at 200 Hz, a branch whose last node is `branch`, and a sink that reads both, the branch as `edge` says.
fn beside_a_branch(path: &Path, branch: &str, edge: &str) -> String {
    format!(
        r#"
[nodes.source]
type = "frames"
params = {{ width_px = 16, height_px = 16, rate_hz = 200.0 }}
{branch}
[nodes.join]
type = "ledger"
inputs = {{ images = ["source.image", {{ from = "branch.image", {edge} }}] }}
params = {{ path = "{}" }}
"#,
        path.display()
    )
}

/// The branch makes 4 packets a second.
fn slow_branch(path: &Path, edge: &str) -> String {
    let branch = r#"
[nodes.branch]
type = "pass"
inputs = { image = { from = "source.image", align = "latest" } }
max_rate_hz = 4"#;
    beside_a_branch(path, branch, edge)
}

/// Median and highest age of the oldest light at the sink, and the median of the newest, ms.
fn ages(report: &Report) -> (f64, f64, f64) {
    let path = report.paths["join"];
    (path.age_p50_ms, path.age_max_ms, path.newest_age_p50_ms)
}

#[test]
fn a_sink_is_as_old_as_the_oldest_light_of_any_input() {
    for edge in ["align = \"latest\"", "align = \"latest\", delay = 1"] {
        let path = scratch("light.jsonl");
        let (report, outcome) = run("live", &slow_branch(&path, edge), options(2, 200));
        assert_eq!(outcome, Outcome::Done);
        let (p50, max, newest) = ages(&report);
        // The branch makes a packet every 250 ms.
        assert!(p50 > 40.0 && max > 180.0, "{edge}: {:?}", report.paths);
        assert!(newest < p50, "the source's own image is new; {edge}: {:?}", report.paths);
    }
}

#[test]
fn an_input_beyond_its_age_counts_as_absent_and_the_report_says_so() {
    let path = scratch("too_old.jsonl");
    let engine = start("live", &slow_branch(&path, "align = \"latest\", max_age_ms = 100"), options(2, 200));
    let engine = engine.unwrap_or_else(|e| panic!("{e}"));
    assert!(engine.wait(Some(PATIENCE)), "{:#?}", engine.report());
    engine.close(Duration::from_secs(10));
    let report = engine.report();
    let lines = ledger(&path);
    let absent = lines.iter().filter(|(seq, inputs)| *seq > 20 && inputs[1].is_none()).count();
    assert!((40..180).contains(&absent), "more than half of the time: {absent}");
    let [wire] = &report.nodes["join"].too_old_on[..] else { panic!("{:?}", report.nodes["join"]) };
    assert_eq!((wire.input.as_str(), wire.index), ("images", 1));
    assert!(wire.ticks >= absent as u64, "{wire:?}");
    assert_eq!(report.nodes["join"].faults, 0, "the node itself works");
    let fault = engine.recent_faults().into_iter().find(|f| f.cause == Cause::TooOld).expect("it says so");
    assert!(fault.words.contains("`images` was older than `max_age_ms = 100`"), "{fault:?}");
    // Half a period late, at most, on a loaded machine.
    assert!(ages(&report).0 < 110.0, "{:?}", report.paths);
}

#[test]
fn a_source_of_one_packet_adds_no_age_and_a_stream_that_ended_does() {
    let p50_ms = |count: u32| {
        let path = scratch("constant.jsonl");
        let branch = format!(
            r#"
[nodes.still]
type = "frames"
params = {{ width_px = 16, height_px = 16, rate_hz = 200.0, count = {count} }}
[nodes.branch]
type = "pass"
inputs = {{ image = "still.image" }}"#
        );
        let nodes = beside_a_branch(&path, &branch, "align = \"latest\"");
        let (report, outcome) = run("live", &nodes, options(2, 200));
        assert_eq!(outcome, Outcome::Done);
        assert!(ledger(&path).last().is_some_and(|(_, inputs)| inputs[1].is_some()), "it is there to the end");
        ages(&report).0
    };
    let (one, two) = (p50_ms(1), p50_ms(2));
    assert!(two > 300.0 && one < 0.5 * two, "one packet {one} ms, two packets {two} ms");
}

#[test]
fn in_batch_the_limit_counts_capture_times() {
    let edge = "align = \"latest\", max_age_ms = 100";
    let lines: Vec<_> = [1, 2]
        .map(|threads| {
            let path = scratch("too_old_in_batch.jsonl");
            let (report, _) = run("batch", &slow_branch(&path, edge), options(threads, 200));
            // 5 ms from tick to tick: 21 of 50 are at most 100 ms old.
            assert_eq!(report.nodes["join"].too_old_on[0].ticks, 4 * 29, "{:?}", report.nodes["join"]);
            ledger(&path)
        })
        .into();
    assert_eq!(lines[0], lines[1], "whatever the number of threads");
}

#[test]
fn a_packet_of_a_tick_that_is_long_gone_exceeds_every_limit() {
    let path = scratch("forgotten.jsonl");
    // Made of the first tick only.
    let branch = r#"
[nodes.branch]
type = "pass"
inputs = { image = { from = "source.image", align = "latest" } }
max_rate_hz = 0.01"#;
    let nodes = beside_a_branch(&path, branch, "align = \"latest\", max_age_ms = 3600000");
    let (_, outcome) = run("live", &nodes.replace("rate_hz = 200.0", "rate_hz = 4000.0"), options(2, 5000));
    assert_eq!(outcome, Outcome::Done);
    let lines = ledger(&path);
    let has_branch = |from: u64, to: u64| -> Vec<bool> {
        lines.iter().filter(|(seq, _)| (from..to).contains(seq)).map(|(_, inputs)| inputs[1].is_some()).collect()
    };
    let (kept, forgotten) = (has_branch(100, 4000), has_branch(4200, 5000));
    assert!(!kept.is_empty() && kept.iter().all(|is_there| *is_there), "an hour is allowed");
    assert!(!forgotten.is_empty() && forgotten.iter().all(|is_there| !is_there), "nobody knows how old it is");
}
