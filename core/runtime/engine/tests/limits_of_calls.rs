//! How long a call may take: budgets in both modes, at the end of a run, and while the machine sleeps. What a call may
//! write.

use std::process::Command;
use std::time::{Duration, Instant};

use crate::common::{PATIENCE, folders};
use panoscope_engine::fault::{Action, Cause, Fault};
use panoscope_engine::{Engine, Options, Outcome};
use panoscope_graph::{GraphText, check};
use panoscope_host::loader::Loader;

/// `source` -> `bad` of the type `chaos` -> `end`.
fn start(mode: &str, kind: &str, settings: &str, options: Options) -> Engine {
    let text = format!(
        "mode = \"{mode}\"\nplugins = [\"flow\", \"fixtures\"]\n\
         [nodes.source]\ntype = \"frames\"\n\
         params = {{ width_px = 32, height_px = 24, format = \"gray8\", rate_hz = 100.0 }}\n\
         [nodes.bad]\ntype = \"{kind}\"\ninputs = {{ image = {{ from = \"source.image\", queue = 200 }} }}\n{settings}\n\
         [nodes.end]\ntype = \"drain\"\ninputs = {{ image = \"bad.image\" }}\n"
    );
    start_graph(&text, options)
}

fn start_graph(text: &str, options: Options) -> Engine {
    let text = GraphText::parse("limits.toml".as_ref(), text);
    let loader = Loader::search(folders());
    let catalog = loader.catalog(&text.plugins());
    let (graph, _) = check(&text, &catalog).into_result().unwrap_or_else(|d| panic!("{}", d.render(false)));
    Engine::start(graph, &catalog, &loader, Options { threads: 2, ..options }).expect("it starts")
}

fn until(engine: &Engine, what: &str, mut done: impl FnMut() -> bool) {
    let end = Instant::now() + PATIENCE;
    while !done() {
        assert!(Instant::now() < end, "{what}: {:?} {:?}", engine.recent_faults(), engine.recent_log());
        std::thread::sleep(Duration::from_millis(2));
    }
}

fn hang(engine: &Engine) -> Option<Fault> {
    engine.recent_faults().into_iter().find(|f| f.node == "bad" && f.cause == Cause::Hang)
}

const HANGS: &str = "params = { harm = \"hang\", first = 5, hang_ms = 600000.0 }";

#[test]
fn a_budget_is_the_same_in_batch_and_live() {
    for mode in ["batch", "live"] {
        let engine = start(mode, "chaos", &format!("budget_ms = 300.0\n{HANGS}"), Options::default());
        let begun = Instant::now();
        until(&engine, "the hang is noticed", || hang(&engine).is_some());
        let fault = hang(&engine).expect("it was seen");
        assert_eq!((fault.done, fault.seq), (Action::Abandon, Some(5)), "{mode}");
        assert!(begun.elapsed() < Duration::from_secs(30), "{mode}: {:?}", begun.elapsed());
        let before = engine.report().nodes["end"].count;
        until(&engine, "the graph goes on", || engine.report().nodes["end"].count > before + 10);
        engine.stop();
        assert!(engine.wait(Some(PATIENCE)), "{mode}");
        engine.close(Duration::from_secs(1));
    }
}

#[test]
fn a_run_that_is_to_end_waits_for_no_budget() {
    let hang_limit = Duration::from_millis(500);
    for (mode, budget) in [("batch", ""), ("batch", "budget_ms = 600000.0"), ("live", "budget_ms = 600000.0")] {
        let options = Options { hang: hang_limit, ..Options::default() };
        let engine = start(mode, "chaos", &format!("{budget}\n{HANGS}"), options);
        until(&engine, "the call begins", || engine.report().nodes["bad"].count >= 5);
        // In batch without a budget the limit is 30 times as long.
        std::thread::sleep(hang_limit);
        assert!(hang(&engine).is_none(), "{mode} {budget}");
        let asked = Instant::now();
        engine.stop();
        assert!(engine.wait(Some(PATIENCE)), "{mode} {budget}: {:#?}", engine.report());
        let took = asked.elapsed();
        assert!(took >= hang_limit && took < 20 * hang_limit, "{mode} {budget}: {took:?}");
        assert_eq!(hang(&engine).map(|f| f.done), Some(Action::Bypass), "{mode} {budget}");
        engine.close(Duration::from_secs(1));
    }
}

/// Stops this process, as a machine that sleeps or a debugger does, and lets it go on.
#[cfg(target_os = "linux")]
fn sleep_as_a_process(seconds: f64) {
    let me = std::process::id();
    let script = format!("kill -STOP {me}; sleep {seconds}; kill -CONT {me}");
    assert!(Command::new("sh").args(["-c", &script]).status().expect("a shell").success());
}

#[test]
#[cfg(target_os = "linux")]
fn calls_get_back_the_time_that_the_process_slept() {
    for (mode, budget) in [("live", ""), ("live", "budget_ms = 800.0"), ("batch", "budget_ms = 800.0")] {
        let options = Options { hang: Duration::from_secs(1), ..Options::default() };
        let params = "params = { harm = \"slow\", first = 5, ticks = 15, slow_ms = 300.0 }";
        let engine = start(mode, "chaos_blocking", &format!("{budget}\n{params}"), options);
        until(&engine, "slow calls begin", || engine.report().nodes["bad"].count > 5);
        let begun = panoscope_engine::clock::now_ns();
        sleep_as_a_process(2.5);
        let slept_ns = panoscope_engine::clock::now_ns() - begun;
        assert!(slept_ns > 2_400_000_000, "ages count the time asleep: {slept_ns} ns");
        let before = engine.report().nodes["end"].count;
        until(&engine, "the graph goes on", || engine.report().nodes["end"].count > before + 2);
        assert!(hang(&engine).is_none(), "{mode} {budget}: {:?}", engine.recent_faults());
        assert_eq!(engine.report().nodes["bad"].restarts, 0, "{mode} {budget}");
        engine.stop();
        assert!(engine.wait(Some(PATIENCE)));
        assert_eq!(engine.close(PATIENCE), Outcome::Done);
    }
}

#[test]
fn a_node_that_writes_beyond_its_output_is_named() {
    for kind in ["chaos", "chaos_blocking"] {
        let engine = start("live", kind, "params = { harm = \"overrun\", first = 5, ticks = 2 }", Options::default());
        let is_it =
            |f: &Fault| f.cause == Cause::BadOutput && f.words.contains("beyond the 768 bytes of output `image`");
        let named = || engine.recent_faults().iter().any(|f| f.node == "bad" && is_it(f));
        until(&engine, "it is noticed", named);
        let before = engine.report().nodes["end"].count;
        until(&engine, "the graph goes on", || engine.report().nodes["end"].count > before + 10);
        let faults = engine.recent_faults();
        assert!(faults.iter().all(|f| f.node == "bad" && f.seq.is_some_and(|seq| (5..7).contains(&seq))), "{faults:?}");
        engine.stop();
        assert!(engine.wait(Some(PATIENCE)));
        engine.close(PATIENCE);
    }
}

/// A source that has lost its camera goes on without frames.
#[test]
fn ticks_without_a_frame_are_no_frames() {
    let engine = start_graph(
        "mode = \"live\"\nplugins = [\"flow\", \"fixtures\"]\n\
         [nodes.source]\ntype = \"chaos_source\"\nparams = { harm = \"nothing\", first = 20, ticks = 1000000 }\n\
         [nodes.end]\ntype = \"drain\"\ninputs = { image = \"source.image\" }\n",
        Options { paced: false, ..Options::default() },
    );
    until(&engine, "the source goes on", || engine.ticks() > 60);
    let report = engine.report();
    assert_eq!((report.frames, report.nodes["end"].count), (20, 20));
    assert!(report.nodes["source"].made.is_some_and(|made| made > 60), "{report:#?}");
    engine.stop();
    assert!(engine.wait(Some(PATIENCE)));
    engine.close(PATIENCE);
}
