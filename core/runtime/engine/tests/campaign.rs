//! The fault campaign: seeded cases of a node that goes wrong in a running graph. Each fault must be seen, named and
//! contained.
//!
//! `PANOSCOPE_FAULT_CASES` sets how many cases are run (200 without it), `PANOSCOPE_FAULT_SEED` which.

use std::fmt::Write as _;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use crate::common::{folders, number};
use panoscope_base::random::SplitMix64;
use panoscope_engine::fault::{Action, Cause, Fault};
use panoscope_engine::{Engine, Options, Outcome};
use panoscope_graph::{GraphText, check};
use panoscope_host::loader::Loader;

const PATIENCE: Duration = Duration::from_secs(60);
/// Time without a budget after which a call counts as hung: that of a program, whatever the environment of the tests
/// says.
const HANG: Duration = Duration::from_secs(2);
/// Attempts of a case whose node was slow, so that its fault did not come.
const ATTEMPTS: usize = 5;
/// Room of the input of the node that goes wrong.
const QUEUE: u64 = 200;
/// Cases that run at a time: each of them mostly waits for its next frame.
const SIDE_BY_SIDE: usize = 6;

/// Harm, type of the node, and the causes that name it.
const HARMS: &[(&str, &[&str], &[Cause])] = &[
    ("error", &["chaos", "chaos_blocking", "chaos_source", "chaos_pose"], &[Cause::Error]),
    ("panic", &["chaos", "chaos_blocking", "chaos_source", "chaos_pose"], &[Cause::Panic]),
    ("hang", &["chaos", "chaos_blocking", "chaos_source", "chaos_pose"], &[Cause::Hang]),
    ("hang_in_loop", &["chaos", "chaos_blocking"], &[Cause::Hang]),
    ("hang_in_nested_loop", &["chaos", "chaos_blocking"], &[Cause::Hang]),
    ("extreme", &["chaos_source"], &[Cause::CaptureTime]),
    ("release_twice", &["chaos", "chaos_blocking"], &[Cause::Release]),
    ("nan", &["chaos", "chaos_blocking", "chaos_source", "chaos_pose"], &[Cause::NotANumber]),
    ("wrong_size", &["chaos", "chaos_blocking"], &[Cause::Size]),
    ("wrong_format", &["chaos", "chaos_blocking", "chaos_source"], &[Cause::Format]),
    ("nothing", &["chaos", "chaos_blocking", "chaos_source"], &[Cause::Silent]),
    ("too_much", &["chaos", "chaos_blocking", "chaos_source"], &[Cause::TooMuch]),
    // A slow call on a busy machine may look hung.
    ("slow", &["chaos", "chaos_blocking", "chaos_source"], &[Cause::Slow, Cause::Hang]),
    ("leak", &["chaos", "chaos_blocking", "chaos_pose"], &[Cause::Leak]),
    ("repeat", &["chaos_source"], &[Cause::CaptureTime]),
    ("reorder", &["chaos_source"], &[Cause::CaptureTime]),
];

struct Case {
    name: String,
    text: String,
    causes: &'static [Cause],
    on_fault: &'static str,
    /// First tick after those that go wrong.
    after: u64,
    /// Node at the end of the path that the fault is on.
    end: &'static str,
}

fn case(number: usize, seed: u64) -> Case {
    let mut dice = SplitMix64(seed.wrapping_mul(1_000_003).wrapping_add(number as u64));
    let (harm, kinds, causes) = HARMS[number % HARMS.len()];
    let kind = kinds[dice.below(kinds.len())];
    let on_fault = ["restart", "restart", "bypass"][dice.below(3)];
    let (first, ticks) = (
        5 + dice.below(20),
        match harm {
            "nothing" => 40,
            "leak" => 150,
            "hang" | "hang_in_loop" | "hang_in_nested_loop" => 1,
            "too_much" | "nan" => 1 + dice.below(15),
            _ => 1 + dice.below(3),
        },
    );
    let hang_ms = [400, 60_000][dice.below(2)];
    let mut text = "mode = \"live\"\nplugins = [\"flow\", \"fixtures\"]\n".to_owned();
    let params = format!(
        "params = {{ harm = \"{harm}\", first = {first}, ticks = {ticks}, seed = {number}, hang_ms = {hang_ms}.0, slow_ms = 14.0 }}"
    );
    let manners = format!("on_fault = \"{on_fault}\"\nbudget_ms = 8.0\n{params}\n");
    let picture = "params = { width_px = 32, height_px = 24, format = \"gray8\", rate_hz = 200.0 }";
    let _ = write!(text, "[nodes.source]\ntype = \"frames\"\n{picture}\n");
    text.push_str("[nodes.good]\ntype = \"pass\"\ninputs = { image = \"source.image\" }\n");
    text.push_str("[nodes.other]\ntype = \"drain\"\ninputs = { image = \"good.image\" }\n");
    // With room, so that the tick that goes wrong is not dropped on a busy machine.
    let input = format!("inputs = {{ image = {{ from = \"source.image\", queue = {QUEUE} }} }}\n");
    let input = if kind == "chaos_source" { "" } else { &input };
    let _ = write!(text, "[nodes.bad]\ntype = \"{kind}\"\n{input}{manners}");
    let mut end = "bad";
    if kind != "chaos_pose" {
        text.push_str("[nodes.tail]\ntype = \"chaos\"\ninputs = { image = \"bad.image\" }\n");
        let mut last = "tail";
        if kind != "chaos_source" {
            text.push_str(
                "[nodes.pair]\ntype = \"chaos_pair\"\ninputs = { left = \"bad.image\", right = \"good.image\" }\n",
            );
            last = "pair";
        }
        let _ = write!(text, "[nodes.sink]\ntype = \"drain\"\ninputs = {{ image = \"{last}.image\" }}\n");
        end = "sink";
    }
    let after = (first + ticks) as u64;
    Case { name: format!("{number}: {harm} in {kind}, {on_fault}"), text, causes, on_fault, after, end }
}

/// What a case showed.
#[derive(Default)]
struct Seen {
    late_ms: Vec<f64>,
    recovery_ms: Vec<f64>,
}

fn until(what: &str, mut done: impl FnMut() -> bool) -> Result<(), String> {
    let end = Instant::now() + PATIENCE;
    while !done() {
        if Instant::now() > end {
            return Err(what.to_owned());
        }
        std::thread::sleep(Duration::from_millis(3));
    }
    Ok(())
}

/// How a case ended.
enum Ending {
    Shown(Seen),
    /// On a busy machine a call took longer than the node's budget: the node was left out before its fault came, or was
    /// abandoned in that call.
    FaultMissed,
}

fn run(case: &Case) -> Result<Ending, String> {
    let text = GraphText::parse("campaign.toml".as_ref(), &case.text);
    let loader = Loader::search(folders());
    let catalog = loader.catalog(&text.plugins());
    let (graph, _) = check(&text, &catalog).into_result().map_err(|d| d.render(false))?;
    let options = Options { threads: 2, hang: HANG, ..Options::default() };
    let engine = Engine::start(graph, &catalog, &loader, options).map_err(|e| e.to_string())?;
    let named = |f: &Fault| f.node == "bad" && case.causes.contains(&f.cause);
    let count = |node: &str| engine.report().nodes[node].count;
    let any = |is: &dyn Fn(&Fault) -> bool| engine.recent_faults().iter().any(is);
    let missed = || {
        let passed = count("other") > case.after + QUEUE;
        any(&|f| {
            f.node == "bad" && [Cause::Slow, Cause::Hang].contains(&f.cause) && (passed || f.done == Action::Bypass)
        })
    };
    until("the fault was not seen", || any(&named) || missed())
        .map_err(|e| format!("{e}: {:?}", engine.recent_faults()))?;
    if !any(&named) {
        engine.stop();
        engine.close(Duration::from_secs(2));
        return Ok(Ending::FaultMissed);
    }
    let other = count("other");
    until("the healthy branch stands still", || count("other") > other + 10)?;
    let left_out = engine.recent_faults().iter().any(|f| f.node == "bad" && f.done == Action::Bypass);
    if !left_out {
        let good = count(case.end);
        until("no good frame came after the fault", || count(case.end) > good + 10)?;
    }
    let report = engine.report();
    engine.stop();
    if !engine.wait(Some(PATIENCE)) {
        return Err("the graph does not come to its end".to_owned());
    }
    if let Outcome::Failed(reason) = engine.close(Duration::from_secs(2)) {
        return Err(format!("the engine went down: {reason}"));
    }
    let faults = engine.recent_faults();
    // Whoever failed on a picture of the wrong size says so too; nobody else has anything to complain of.
    let innocent = faults.iter().find(|f| f.node != "bad" && !(f.node == "pair" && case.causes.contains(&Cause::Size)));
    if let Some(fault) = innocent {
        return Err(format!("the wrong node was named: {fault:?}"));
    }
    if case.on_fault == "bypass" && faults.iter().any(|f| f.node == "bad" && f.done == Action::Restart) {
        return Err("a node to be left out was opened again".to_owned());
    }
    let late_ms = faults.iter().filter_map(|f| f.late_ms).collect();
    let recovery = report.nodes["bad"].recovery_max_ms;
    Ok(Ending::Shown(Seen { late_ms, recovery_ms: if recovery > 0.0 { vec![recovery] } else { Vec::new() } }))
}

/// Runs a case until its fault comes.
fn attempts(case: &Case) -> Result<Seen, String> {
    for _ in 0..ATTEMPTS {
        if let Ending::Shown(seen) = run(case)? {
            return Ok(seen);
        }
    }
    Err(format!("in {ATTEMPTS} attempts the node was slow and its fault did not come"))
}

fn tell(what: &str, mut times_ms: Vec<f64>) {
    times_ms.sort_by(f64::total_cmp);
    let Some(last) = times_ms.last() else { return };
    let at = |q: f64| times_ms[((times_ms.len() as f64 * q) as usize).min(times_ms.len() - 1)];
    println!("{what}: {} times, p50 {:.1} ms, p99 {:.1} ms, longest {last:.1} ms", times_ms.len(), at(0.5), at(0.99));
}

#[test]
fn every_fault_is_seen_named_and_contained() {
    let (cases, seed) = (number("PANOSCOPE_FAULT_CASES", 200) as usize, number("PANOSCOPE_FAULT_SEED", 1));
    let next = AtomicUsize::new(0);
    let results: Mutex<Vec<(String, Result<Seen, String>)>> = Mutex::new(Vec::new());
    folders();
    std::thread::scope(|scope| {
        for _ in 0..SIDE_BY_SIDE {
            scope.spawn(|| {
                loop {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    if index >= cases {
                        return;
                    }
                    let case = case(index, seed);
                    let seen = attempts(&case);
                    results.lock().expect("no test thread panics").push((case.name, seen));
                }
            });
        }
    });
    let results = results.into_inner().expect("no test thread panics");
    let (mut late_ms, mut recovery_ms, mut failures) = (Vec::new(), Vec::new(), Vec::new());
    for (name, result) in results {
        match result {
            Ok(seen) => {
                late_ms.extend(seen.late_ms);
                recovery_ms.extend(seen.recovery_ms);
            }
            Err(reason) => failures.push(format!("case {name}: {reason}")),
        }
    }
    println!("{cases} cases, {} not as they should be", failures.len());
    tell("from the end of its budget until a hang was seen", late_ms);
    tell("from a fault to the next good frame", recovery_ms);
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

/// One fault alone, after a quiet time: the node is opened again at once, without any back-off.
#[test]
fn an_isolated_fault_is_over_soon() {
    let mut recovery_ms = Vec::new();
    for (harm, cause) in [("panic", Cause::Panic), ("error", Cause::Error), ("hang", Cause::Hang)] {
        for round in 0..4 {
            let text = format!(
                "mode = \"live\"\nplugins = [\"flow\", \"fixtures\"]\n\
                 [nodes.source]\ntype = \"frames\"\n\
                 params = {{ width_px = 32, height_px = 24, format = \"gray8\", rate_hz = 100.0 }}\n\
                 [nodes.bad]\ntype = \"chaos\"\ninputs = {{ image = {{ from = \"source.image\", queue = 200 }} }}\n\
                 budget_ms = 8.0\n\
                 params = {{ harm = \"{harm}\", first = {}, ticks = 1, hang_ms = 60000.0 }}\n\
                 [nodes.sink]\ntype = \"drain\"\ninputs = {{ image = \"bad.image\" }}\n",
                20 + round
            );
            let text = GraphText::parse("isolated.toml".as_ref(), &text);
            let loader = Loader::search(folders());
            let catalog = loader.catalog(&text.plugins());
            let (graph, _) = check(&text, &catalog).into_result().unwrap_or_else(|d| panic!("{}", d.render(false)));
            let options = Options { threads: 2, hang: HANG, ..Options::default() };
            let engine = Engine::start(graph, &catalog, &loader, options).expect("it starts");
            let recovered = || engine.report().nodes["bad"].recovery_max_ms > 0.0;
            until("no good frame came after the fault", recovered).unwrap_or_else(|e| panic!("{harm}: {e}"));
            assert!(engine.recent_faults().iter().any(|f| f.node == "bad" && f.cause == cause), "{harm}");
            assert_eq!(engine.report().nodes["bad"].restarts, 1, "{harm}: opened again once");
            recovery_ms.push(engine.report().nodes["bad"].recovery_max_ms);
            engine.stop();
            engine.close(Duration::from_secs(2));
        }
    }
    tell("from an isolated fault to the next good frame", recovery_ms);
}
