//! Batch mode: nothing is lost, and the bytes do not depend on the number of threads.

use crate::common;
use crate::common::{ledger, options, run, scratch};
use panoscope_engine::{Options, Outcome};

/// Noise through a fan-out, threads of its own, thinning, and a join of all branches.
fn wide(ledger: &std::path::Path) -> String {
    format!(
        r#"
[nodes.source]
type = "frames"
params = {{ width_px = 64, height_px = 48, pattern = "noise" }}
[nodes.a]
type = "pass"
inputs = {{ image = "source.image" }}
[nodes.b]
type = "pass_blocking"
inputs = {{ image = "source.image" }}
[nodes.c]
type = "every_nth"
inputs = {{ image = "b.image" }}
params = {{ n = 3 }}
[nodes.d]
type = "pass"
inputs = {{ image = "a.image" }}
[nodes.join]
type = "ledger"
inputs = {{ images = ["c.image", "d.image", {{ from = "b.image", delay = 1 }}] }}
params = {{ path = "{}" }}
[nodes.digest_c]
type = "drain"
inputs = {{ image = "c.image" }}
params = {{ digest = true }}
[nodes.digest_d]
type = "drain_blocking"
inputs = {{ image = "d.image" }}
params = {{ digest = true }}
"#,
        ledger.display()
    )
}

#[test]
fn bytes_do_not_depend_on_the_number_of_threads() {
    let mut first: Option<(String, Vec<f64>)> = None;
    for (round, threads) in [1, 2, 8, 8, 2, 1].into_iter().enumerate() {
        let path = scratch(&format!("wide_{round}.jsonl"));
        let (report, outcome) = run("batch", &wide(&path), options(threads, 300));
        assert_eq!(outcome, Outcome::Done);
        assert_eq!(report.nodes["join"].count, 300);
        assert_eq!(report.nodes["digest_d"].count, 300);
        assert_eq!(report.nodes["digest_c"].count, 100);
        assert_eq!(report.nodes["digest_c"].skipped, 200);
        assert!(report.nodes.values().all(|n| n.dropped == 0 && n.faults == 0 && n.copies == 0), "{report:#?}");
        let digests = ["digest_c", "digest_d"].map(|n| report.nodes[n].metrics["digest"]).to_vec();
        let lines = std::fs::read_to_string(&path).expect("a ledger");
        let seen = (lines, digests);
        match &first {
            None => first = Some(seen),
            Some(first) => assert_eq!(*first, seen, "{threads} threads"),
        }
    }
}

#[test]
fn the_branches_of_a_diamond_meet_at_the_same_tick() {
    let path = scratch("diamond.jsonl");
    run("batch", &wide(&path), options(4, 100));
    for (seq, inputs) in ledger(&path) {
        let thinned = (seq % 3 == 0).then_some(seq);
        assert_eq!(inputs, [thinned, Some(seq), seq.checked_sub(1)], "tick {seq}");
    }
}

#[test]
fn an_empty_required_input_skips_the_node_and_all_after_it() {
    let nodes = r#"
[nodes.source]
type = "frames"
params = { width_px = 8, height_px = 8 }
[nodes.thin]
type = "every_nth"
inputs = { image = "source.image" }
params = { n = 10 }
[nodes.after]
type = "pass"
inputs = { image = "thin.image" }
[nodes.own_thread]
type = "pass_blocking"
inputs = { image = "after.image" }
[nodes.sink]
type = "drain"
inputs = { image = "own_thread.image" }
"#;
    let (report, _) = run("batch", nodes, options(2, 100));
    assert_eq!(report.nodes["thin"].count, 100);
    for node in ["after", "own_thread", "sink"] {
        assert_eq!((report.nodes[node].count, report.nodes[node].skipped), (10, 90), "{node}");
    }
}

/// Two sources of different rates: 10 and 25 frames per second of media time.
fn two_rates(ledger: &std::path::Path, edge: &str) -> String {
    format!(
        r#"
[nodes.slow]
type = "frames"
params = {{ width_px = 8, height_px = 8, rate_hz = 10.0, count = 20 }}
[nodes.fast]
type = "frames"
params = {{ width_px = 8, height_px = 8, rate_hz = 25.0, count = 60 }}
[nodes.join]
type = "ledger"
inputs = {{ images = ["slow.image", {{ from = "fast.image", {edge} }}] }}
params = {{ path = "{}" }}
"#,
        ledger.display()
    )
}

#[test]
fn latest_is_the_newest_not_after_the_tick() {
    for threads in [1, 2, 8] {
        let path = scratch(&format!("latest_{threads}.jsonl"));
        run("batch", &two_rates(&path, "align = \"latest\""), Options { threads, ..Options::default() });
        let lines = ledger(&path);
        assert_eq!(lines.len(), 20);
        for (seq, inputs) in lines {
            // 100 ms per slow tick, 40 ms per fast one.
            assert_eq!(inputs, [Some(seq), Some(seq * 100 / 40)], "tick {seq}, {threads} threads");
        }
    }
}

#[test]
fn nearest_is_the_closest_within_the_tolerance() {
    let path = scratch("nearest.jsonl");
    run("batch", &two_rates(&path, "align = \"nearest\", tolerance_ms = 15"), Options::default());
    let lines = ledger(&path);
    assert_eq!(lines.len(), 20);
    for (seq, inputs) in lines {
        let time_ms = seq as i64 * 100;
        let closest = (0..60).filter(|k| (k * 40 - time_ms).abs() <= 15).min_by_key(|k| (k * 40 - time_ms).abs());
        assert_eq!(inputs[1], closest.map(|k| k as u64), "tick {seq}");
    }
}

#[test]
fn a_fan_out_to_readers_copies_nothing() {
    let mut nodes = "[nodes.source]\ntype = \"frames\"\n".to_owned();
    for index in 0..4 {
        nodes.push_str(&format!("[nodes.sink{index}]\ntype = \"drain\"\ninputs = {{ image = \"source.image\" }}\n"));
    }
    let (report, _) = run("batch", &nodes, options(2, 50));
    assert!(report.nodes.values().all(|n| n.copies == 0 && n.conversions == 0));
    assert!((0..4).all(|i| report.nodes[&format!("sink{i}")].count == 50));
}

#[test]
fn a_long_chain_and_many_readers_run() {
    let mut nodes = "[nodes.source]\ntype = \"frames\"\nparams = { width_px = 8, height_px = 8 }\n".to_owned();
    let mut last = "source".to_owned();
    for index in 0..100 {
        let node = if index % 10 == 9 { "pass_blocking" } else { "pass" };
        nodes.push_str(&format!("[nodes.n{index}]\ntype = \"{node}\"\ninputs = {{ image = \"{last}.image\" }}\n"));
        nodes.push_str(&format!("[nodes.s{index}]\ntype = \"drain\"\ninputs = {{ image = \"n{index}.image\" }}\n"));
        last = format!("n{index}");
    }
    let (report, outcome) = run("batch", &nodes, options(2, 200));
    assert_eq!(outcome, Outcome::Done);
    assert!(report.nodes.values().all(|n| n.count == 200), "{report:#?}");
}

/// A loop: the filter reads its own output of the tick before, partly through a thread of its own.
const LOOP: &str = r#"
[nodes.source]
type = "frames"
params = { width_px = 32, height_px = 24, pattern = "noise" }
[nodes.filter]
type = "smooth"
inputs = { image = "source.image", past = { from = "back.image", delay = 1 } }
[nodes.back]
type = "pass_blocking"
inputs = { image = "filter.image" }
[nodes.second]
type = "smooth"
inputs = { image = "filter.image", past = { from = "second.image", delay = 1 } }
[nodes.sink]
type = "drain"
inputs = { image = "second.image" }
params = { digest = true }
"#;

#[test]
fn a_loop_with_a_delay_gives_the_same_bytes_for_any_number_of_threads() {
    let digests: Vec<f64> = [1, 2, 8, 3]
        .into_iter()
        .map(|threads| {
            let (report, _) = run("batch", LOOP, options(threads, 200));
            assert_eq!(report.nodes["sink"].count, 200, "{threads} threads");
            assert!(report.nodes.values().all(|n| n.faults == 0), "{report:#?}");
            report.nodes["sink"].metrics["digest"]
        })
        .collect();
    assert!(digests.windows(2).all(|pair| pair[0] == pair[1]), "{digests:?}");
}

#[test]
fn starting_and_stopping_many_times_leaves_nothing_behind() {
    let before = panoscope_engine::memory::memory().in_use_bytes();
    for round in 0..30 {
        let engine =
            common::start("batch", LOOP, Options { threads: 1 + round % 4, ..Options::default() }).expect("it starts");
        std::thread::sleep(std::time::Duration::from_millis(round as u64 % 5));
        assert_eq!(engine.close(common::PATIENCE), Outcome::Done);
        assert!(engine.is_finished(), "round {round}: {:#?}", engine.report());
    }
    // Other tests of this process hold frames of their own for a moment.
    let until = std::time::Instant::now() + common::PATIENCE;
    while panoscope_engine::memory::memory().in_use_bytes() > before.max(64 << 20) {
        assert!(std::time::Instant::now() < until, "frames were not given back");
        std::thread::sleep(std::time::Duration::from_millis(10));
    }
}

/// 60 ticks a second, every fourth of which has an image of the branch, and a reader at 10 Hz: every sixth tick.
fn limited_reader(path: &std::path::Path, n: u32) -> String {
    format!(
        r#"
[nodes.source]
type = "frames"
params = {{ width_px = 16, height_px = 16, rate_hz = 60.0 }}
[nodes.seldom]
type = "every_nth"
inputs = {{ image = "source.image" }}
params = {{ n = {n} }}
[nodes.record]
type = "ledger"
inputs = {{ images = ["source.image", "seldom.image"] }}
params = {{ path = "{}" }}
max_rate_hz = 10.0
"#,
        path.display()
    )
}

#[test]
fn a_limited_node_takes_ticks_with_all_inputs_that_come_at_lower_rates() {
    let path = scratch("rates.jsonl");
    run("batch", &limited_reader(&path, 4), options(2, 240));
    let lines = ledger(&path);
    assert_eq!(lines.len(), 40, "ten a second: {lines:?}");
    assert!(lines.iter().all(|(_, inputs)| inputs.iter().all(Option::is_some)), "{lines:?}");
    // An input that does not come holds nothing up.
    run("batch", &limited_reader(&path, 1000), options(2, 240));
    assert!((35..=40).contains(&ledger(&path).len()), "{:?}", ledger(&path));
}

/// In a live graph they take turns.
#[test]
fn nodes_of_one_rate_run_at_the_same_ticks() {
    let paths = ["a", "b"].map(|name| scratch(&format!("together-{name}.jsonl")));
    let mut graph = r#"
[nodes.source]
type = "frames"
params = { width_px = 16, height_px = 16, rate_hz = 60.0 }
"#
    .to_owned();
    for (name, path) in ["a", "b"].into_iter().zip(&paths) {
        let path = path.display();
        graph += &format!(
            "[nodes.{name}]\ntype = \"ledger\"\ninputs = {{ images = [\"source.image\"] }}\nparams = {{ path = \"{path}\" }}\nmax_rate_hz = 15.0\n"
        );
    }
    run("batch", &graph, options(2, 120));
    let [a, b] = paths.each_ref().map(|path| ledger(path));
    assert_eq!(a.len(), 30, "{a:?}");
    assert_eq!(a, b);
}
