//! Every call into a plugin has a limit, and what has nothing to do with a call that does not return goes on.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, mpsc};
use std::time::{Duration, Instant};

use crate::common::{PATIENCE, ledger, ready, scratch};
use panoscope_engine::fault::{Action, Cause};
use panoscope_engine::log::Level;
use panoscope_engine::{Engine, Listener, Options, Outcome};
use panoscope_graph::ParamValue;
use panoscope_host::loader::Live;
use panoscope_host::loader::graph_file::RunError;
use panoscope_record::{Output, RecordOptions, Recorder, head};

/// Longer than any limit here, but not than a test that waits for a call instead of leaving it behind.
const HANGS_MS: &str = "hang_ms = 600000.0";

/// Two paths from two sources: `bad` on the one, `other` at the end of the other, whose readers need the pool.
fn graph(bad: &str, params: &str) -> String {
    format!(
        r#"
mode = "live"
plugins = ["flow", "fixtures"]
[nodes.a]
type = "frames"
params = {{ width_px = 16, height_px = 8, format = "gray8", rate_hz = 200.0 }}
[nodes.bad]
type = "{bad}"
inputs = {{ image = {{ from = "a.image", queue = 200 }} }}
params = {{ {params} }}
[nodes.end]
type = "drain"
inputs = {{ image = "bad.image" }}
[nodes.b]
type = "frames"
params = {{ width_px = 16, height_px = 8, format = "gray8", rate_hz = 200.0 }}
[nodes.left]
type = "pass"
inputs = {{ image = "b.image" }}
[nodes.right]
type = "pass"
inputs = {{ image = "b.image" }}
[nodes.other]
type = "chaos_pair"
inputs = {{ left = "left.image", right = "right.image" }}
[nodes.other_end]
type = "drain"
inputs = {{ image = "other.image" }}
"#
    )
}

/// Limits short enough for a test, long enough for a busy machine.
fn options() -> Options {
    Options {
        threads: 2,
        open_limit: Duration::from_millis(500),
        close_limit: Duration::from_millis(500),
        ..Options::default()
    }
}

/// The engine, and what edits it.
type Running = (Arc<Engine>, Live);

fn try_start(text: &str, options: Options) -> Result<Running, RunError> {
    let live = ready("limits.toml", text).start(options)?;
    Ok((Arc::clone(live.engine()), live))
}

fn start(text: &str, options: Options) -> Running {
    try_start(text, options).unwrap_or_else(|e| panic!("{e}"))
}

fn until(engine: &Engine, what: &str, mut done: impl FnMut() -> bool) {
    let end = Instant::now() + PATIENCE;
    while !done() {
        assert!(Instant::now() < end, "{what}: {:?} {:?}", engine.recent_faults(), engine.recent_log());
        std::thread::sleep(Duration::from_millis(2));
    }
}

fn count(engine: &Engine, node: &str) -> u64 {
    engine.report().nodes[node].count
}

fn goes_on(engine: &Engine, node: &str, what: &str) {
    let before = count(engine, node);
    until(engine, what, || count(engine, node) >= before + 10);
}

fn is_faulty(engine: &Engine, words: &str) -> bool {
    engine.recent_faults().iter().any(|f| f.node == "bad" && f.cause == Cause::Hang && f.words.contains(words))
}

/// Closing takes no longer than the patience, twice, and what threads need to leave.
fn closes_in_time(engine: &Engine) {
    let start = Instant::now();
    engine.close(Duration::from_secs(1));
    assert!(start.elapsed() < PATIENCE / 2, "closing took {:?}", start.elapsed());
}

#[test]
fn a_node_that_does_not_return_from_opening_is_named_at_the_start() {
    for kind in ["chaos_life", "chaos_device"] {
        let params = format!("hangs = \"open\", {HANGS_MS}");
        let error = try_start(&graph(kind, &params), options()).err().expect("it does not start").to_string();
        assert!(error.contains("`bad`") && error.contains("did not return from opening"), "{error}");
    }
}

#[test]
fn a_change_whose_node_does_not_open_is_refused_and_everything_goes_on() {
    for kind in ["chaos_life", "chaos_device"] {
        for hangs in ["open", "open_in_loop"] {
            let text = graph(kind, HANGS_MS);
            let (engine, mut live) = start(&text, options());
            goes_on(&engine, "end", "at first");
            let error = live.set_param("bad", "hangs", &hangs.into()).expect_err("it does not open").to_string();
            assert!(error.contains("`bad`") && error.contains("did not return from opening"), "{error}");
            assert_eq!(live.text(), text, "the text is as before");
            goes_on(&engine, "end", "the old instance has its place again");
            goes_on(&engine, "other_end", "the pool works");
            closes_in_time(&engine);
        }
    }
}

#[test]
fn a_parameter_that_reopens_a_node_is_refused_when_it_does_not_open() {
    let (engine, _live) = start(&graph("chaos_life", &format!("quick_opens = 1, {HANGS_MS}")), options());
    let engine = &*engine;
    goes_on(engine, "end", "at first");
    // `hangs` is the first parameter; set through the engine, as the panel of a preset does.
    let choice = ParamValue::Choice { index: 1, name: "open".to_owned() };
    let error = engine.set_param("bad", "hangs", choice).expect_err("it does not open").to_string();
    assert!(error.contains("`bad`") && error.contains("did not return from opening"), "{error}");
    goes_on(engine, "end", "the old value stays");
    closes_in_time(engine);
}

#[test]
fn a_state_that_is_not_handed_over_in_time_leaves_the_rest_alone() {
    // Where the node is closed for its successor the change is refused; beside the hot path it is made, and the node begins anew.
    for (hangs, what) in
        [("save", "from saving its state"), ("load", "from taking over a state"), ("close", "from closing")]
    {
        for kind in ["chaos_life", "chaos_device"] {
            let at_first = if hangs == "load" { "never" } else { hangs };
            let (engine, mut live) = start(&graph(kind, &format!("hangs = \"{at_first}\", {HANGS_MS}")), options());
            goes_on(&engine, "end", "at first");
            let then = if hangs == "load" { "load" } else { "never" };
            let changed = live.edit(|d| {
                d.set_param("bad", "hangs", &then.into())?;
                d.set_param("bad", "turn", &1.into())
            });
            if kind == "chaos_device" {
                let error = changed.expect_err("it is refused").to_string();
                assert!(error.contains("`bad`") && error.contains(what), "{error}");
            } else {
                changed.expect("the new instance waits for its turn");
                until(&engine, "the call is left behind", || is_faulty(&engine, what));
            }
            goes_on(&engine, "other_end", "what has nothing to do with it goes on");
            goes_on(&engine, "end", "the node is open again");
            closes_in_time(&engine);
        }
    }
}

#[test]
fn a_failed_source_whose_position_is_not_kept_or_taken_over_in_time_is_opened_again() {
    for mode in ["live", "batch"] {
        for (hangs, what) in [("save", "from saving its state"), ("load", "from taking over a state")] {
            let camera = format!(
                r#"mode = "{mode}"
plugins = ["flow", "fixtures"]
[nodes.bad]
type = "chaos_camera"
params = {{ hangs = "{hangs}", {HANGS_MS}, fails_at = 20 }}
[nodes.end]
type = "drain"
inputs = {{ image = "bad.image" }}
"#
            );
            let (engine, _live) = start(&camera, options());
            until(&engine, "the call is left behind", || is_faulty(&engine, what));
            let faults = engine.recent_faults();
            let told = faults.iter().any(|f| f.cause == Cause::Error && f.words.contains("told to fail at tick 20"));
            assert!(told, "{mode}, {hangs}: {faults:?}");
            until(&engine, "it is opened again", || engine.report().nodes["bad"].restarts == 1);
            goes_on(&engine, "end", "it works again");
            closes_in_time(&engine);
        }
    }
}

#[test]
fn a_removed_node_that_does_not_close_is_left_behind() {
    let (engine, mut live) = start(&graph("chaos_life", &format!("hangs = \"close\", {HANGS_MS}")), options());
    goes_on(&engine, "end", "at first");
    live.edit(|d| {
        d.remove_node("end")?;
        d.remove_node("bad")
    })
    .expect("the node is gone");
    let told = || engine.recent_log().iter().any(|(_, node, words)| node == "bad" && words.contains("from closing"));
    until(&engine, "it is told of", told);
    goes_on(&engine, "other_end", "the rest goes on");
    live.add_node("more", "drain", &[("image", &["a.image"])]).expect("the next change is made");
    goes_on(&engine, "more", "the next change");
    closes_in_time(&engine);
}

#[test]
fn closing_finishes_all_files_but_those_of_a_node_that_does_not_close() {
    let path = scratch("limits_close.jsonl");
    let file = format!(
        "[nodes.file]\ntype = \"ledger\"\ninputs = {{ images = [\"bad.image\"] }}\nparams = {{ path = \"{}\" }}\n",
        path.display()
    );
    // `bad` is closed before `file`.
    let (engine, _live) = start(&(graph("chaos_life", &format!("hangs = \"close\", {HANGS_MS}")) + &file), options());
    let engine = &*engine;
    goes_on(engine, "file", "at first");
    closes_in_time(engine);
    assert_eq!(ledger(&path).len() as u64, count(engine, "file"), "the file is whole");
    let log = engine.recent_log();
    assert!(log.iter().any(|(level, node, _)| *level == Level::Error && node == "bad"), "{log:?}");
    assert!(!log.iter().any(|(_, node, _)| node == "file"), "{log:?}");
}

#[test]
fn a_change_that_hangs_does_not_hold_up_closing() {
    let options = Options { open_limit: Duration::from_secs(600), ..options() };
    let (engine, mut live) = start(&graph("chaos_life", &format!("quick_opens = 1, {HANGS_MS}")), options);
    goes_on(&engine, "end", "at first");
    let begun = Arc::new(AtomicBool::new(false));
    let beginning = Arc::clone(&begun);
    let changing = std::thread::spawn(move || {
        beginning.store(true, Ordering::Release);
        live.set_param("bad", "hangs", &"open".into()).map(|_| ()).map_err(|e| e.to_string())
    });
    until(&engine, "the change begins", || begun.load(Ordering::Acquire));
    // Inside the change, which holds its lock as long as the node opens: previews are not ended meanwhile.
    std::thread::sleep(Duration::from_millis(50));
    closes_in_time(&engine);
    let error = changing.join().expect("no panic").expect_err("it is given up");
    assert!(error.contains("`bad`") || error.contains("does not run any more"), "{error}");
}

#[test]
fn slow_openings_do_not_switch_a_node_off() {
    // The first opening is quick, the next six take twice as long as they may, one after the other; then all is well.
    let params = "hangs = \"open\", hang_ms = 400.0, quick_opens = 1, slow_opens = 6, fails_at = 20";
    let options = Options { open_limit: Duration::from_millis(200), ..options() };
    let (engine, _live) = start(&graph("chaos_life", params), options);
    let engine = &*engine;
    until(engine, "it is opened again", || engine.report().nodes["bad"].restarts == 1);
    goes_on(engine, "end", "it works again");
    let faults = engine.recent_faults();
    let hangs = faults.iter().filter(|f| f.node == "bad" && f.cause == Cause::Hang);
    assert_eq!(hangs.filter(|f| f.done == Action::Abandon).count(), 6, "{faults:?}");
    closes_in_time(engine);
}

#[test]
fn an_opening_after_a_fault_that_hangs_in_a_loop_frees_the_pool() {
    let params = format!("hangs = \"open_in_loop\", {HANGS_MS}, quick_opens = 1, slow_opens = 2, fails_at = 20");
    let (engine, _live) = start(&graph("chaos_life", &params), options());
    let engine = &*engine;
    until(engine, "it is left behind", || is_faulty(engine, "from opening"));
    until(engine, "it is opened again", || engine.report().nodes["bad"].restarts == 1);
    goes_on(engine, "end", "it works again");
    goes_on(engine, "other_end", "the pool works");
    closes_in_time(engine);
}

#[test]
fn nodes_share_the_pool_while_they_open() {
    let params = format!("hangs = \"open_alone\", {HANGS_MS}");
    let options = Options { open_limit: Duration::from_secs(20), ..options() };
    let (engine, _live) = start(&graph("chaos_life", &params), options);
    goes_on(&engine, "end", "it opened");
    closes_in_time(&engine);
}

#[test]
fn a_path_of_its_own_goes_on_while_all_workers_hang() {
    for harm in ["hang_in_loop", "hang_in_nested_loop"] {
        let params = format!("harm = \"{harm}\", first = 20, ticks = 1, {HANGS_MS}");
        // The watchdog has a minute; the other path has to go on before.
        let options = Options { hang: Duration::from_secs(60), ..options() };
        let (engine, _live) = start(&graph("chaos", &params), options);
        let engine = &*engine;
        until(engine, "it hangs", || count(engine, "bad") == 20);
        for _ in 0..5 {
            goes_on(engine, "other_end", "during the hang");
        }
        assert_eq!((count(engine, "bad"), engine.recent_faults().len()), (20, 0), "it hangs still");
        closes_in_time(engine);
    }
}

#[test]
fn nobody_gives_back_what_is_not_his() {
    for harm in ["release_twice", "release_twice_elsewhere"] {
        let params = format!("harm = \"{harm}\", first = 20, ticks = 5");
        let (engine, _live) = start(&graph("chaos", &params), options());
        let engine = &*engine;
        until(engine, "it is refused", || {
            let faults = engine.recent_faults();
            let named = faults.iter().any(|f| f.node == "bad" && f.cause == Cause::Release);
            let told = engine.recent_log().iter().any(|(_, node, words)| node == "engine" && words.contains("refused"));
            if harm == "release_twice" { named } else { told }
        });
        goes_on(engine, "end", "the node goes on");
        engine.stop();
        assert!(engine.wait(Some(PATIENCE)));
        let report = engine.report();
        assert_eq!(report.nodes["end"].count, report.nodes["a"].count, "no frame was lost");
        closes_in_time(engine);
    }
}

#[test]
fn a_panic_in_a_thread_of_the_host_is_told_and_ends_the_run() {
    // Whoever listens runs on threads of the engine: that of a source, and a worker.
    for (node, thread) in [("a", "a"), ("other", "pool-")] {
        let hear: Arc<panoscope_engine::HearFn> = Arc::new(|frame| assert!(frame.tick().seq < 20, "no more of this"));
        let listen = vec![Listener { node: node.to_owned(), output: "image".to_owned(), hear }];
        // `left` waits, so that it is a worker that joins it with `right`.
        let text = graph("chaos", "").replace(
            "type = \"pass\"\ninputs = { image = \"b.image\" }\n[nodes.right]",
            "type = \"pass_blocking\"\ninputs = { image = \"b.image\" }\nparams = { wait_ms = 1.0 }\n[nodes.right]",
        );
        let (engine, _live) = start(&text, Options { listen, ..options() });
        let engine = &*engine;
        assert!(engine.wait(Some(PATIENCE)), "the run does not wait for a thread that is gone");
        let Outcome::Failed(reason) = engine.close(Duration::from_secs(1)) else { panic!("the run failed") };
        assert!(reason.contains("panicked") && reason.contains("no more of this"), "{reason}");
        assert!(reason.contains(thread) || node != "a", "{reason}");
        let log = engine.recent_log();
        assert!(log.iter().any(|(level, _, words)| *level == Level::Error && *words == reason), "{log:?}");
    }
}

/// A disk whose driver panics once, on the recorder's thread.
#[derive(Default)]
struct Broken(bool);

impl std::io::Write for Broken {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let first = std::thread::current().name() == Some("record") && !std::mem::replace(&mut self.0, true);
        assert!(!first, "no such sector");
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

impl std::io::Seek for Broken {
    fn seek(&mut self, _: std::io::SeekFrom) -> std::io::Result<u64> {
        Ok(0)
    }
}

impl Output for Broken {
    fn cut(&mut self, _: u64) -> std::io::Result<()> {
        Ok(())
    }
}

#[test]
fn a_panic_in_the_recorders_thread_is_told_at_once_and_the_run_goes_on() {
    let text = graph("chaos", "");
    let head = head(&ready("limits.toml", &text));
    let recorder =
        Recorder::start_on(Some(Box::new(Broken::default())), RecordOptions::default(), head).expect("it begins");
    let (engine, _live) = start(&text, Options { observer: Some(Arc::clone(&recorder) as _), ..options() });
    let told =
        || engine.recent_log().iter().any(|(_, node, words)| node == "record" && words.contains("no such sector"));
    until(&engine, "it is told", told);
    goes_on(&engine, "end", "the run goes on");
    assert_eq!(engine.close(Duration::from_secs(1)), Outcome::Done);
    let failed = recorder.finish().failed.expect("the recording is not whole");
    assert!(failed.contains("thread `record` panicked"), "{failed}");
}

#[test]
fn a_terminal_that_nobody_reads_stops_neither_watchdog_nor_nodes() {
    let (go, gate) = mpsc::channel::<()>();
    let gate = Mutex::new(gate);
    let blocked = Arc::new(AtomicBool::new(false));
    let mark = Arc::clone(&blocked);
    let log: Box<panoscope_engine::log::LogFn> = Box::new(move |_, _, _| {
        mark.store(true, Ordering::Release);
        let _ = gate.lock().unwrap_or_else(std::sync::PoisonError::into_inner).recv();
    });
    let params = format!("harm = \"hang\", first = 20, ticks = 1, {HANGS_MS}");
    let (engine, _live) =
        start(&graph("chaos", &params), Options { hang: Duration::from_millis(300), log: Some(log), ..options() });
    let engine = &*engine;
    until(engine, "the hang is seen", || is_faulty(engine, "did not return"));
    until(engine, "its words are on their way", || blocked.load(Ordering::Acquire));
    goes_on(engine, "end", "the node works again");
    goes_on(engine, "other_end", "the rest works");
    closes_in_time(engine);
    drop(go);
}

/// A source that waits for what comes of its last tick does not wait for a tick that it never made.
#[test]
fn a_source_in_a_loop_goes_on_after_a_call_that_failed_or_did_not_return() {
    for harm in ["hang", "error"] {
        let text = format!(
            r#"
mode = "live"
plugins = ["flow", "fixtures"]
[nodes.bad]
type = "chaos_source"
inputs = {{ before = {{ from = "back.image", delay = 1 }} }}
params = {{ harm = "{harm}", first = 20, ticks = 1, {HANGS_MS} }}
[nodes.back]
type = "pass"
inputs = {{ image = "bad.image" }}
[nodes.end]
type = "drain"
inputs = {{ image = "back.image" }}
"#
        );
        let (engine, _live) = start(&text, Options { hang: Duration::from_millis(300), ..options() });
        let engine = &*engine;
        until(engine, "the fault is seen", || engine.recent_faults().iter().any(|f| f.node == "bad"));
        goes_on(engine, "end", "the source makes ticks again");
        closes_in_time(engine);
    }
}

#[test]
fn wires_on_which_packets_wait_for_their_time_have_a_bound() {
    let text = r#"
mode = "live"
plugins = ["flow", "fixtures"]
[nodes.slow]
type = "frames"
params = { width_px = 16, height_px = 8, format = "gray8", rate_hz = 0.6 }
[nodes.fast]
type = "frames"
params = { width_px = 16, height_px = 8, format = "gray8", rate_hz = 500.0 }
[nodes.near]
type = "chaos_pair"
inputs = { left = "slow.image", right = { from = "fast.image", align = "nearest", tolerance_ms = 5 } }
[nodes.near_end]
type = "drain"
inputs = { image = "near.image" }
[nodes.late]
type = "chaos_pair"
inputs = { left = "slow.image", right = { from = "fast.image", align = "latest", delay = 1, queue = 5 } }
[nodes.late_end]
type = "drain"
inputs = { image = "late.image" }
[nodes.fast_end]
type = "drain"
inputs = { image = "fast.image" }
"#;
    let (engine, _live) = start(text, options());
    let engine = &*engine;
    let mut window = panoscope_engine::Window::default();
    until(engine, "frames flow", || count(engine, "fast_end") > 300);
    let nodes = engine.window(&mut window);
    for (node, most) in [("near", 32), ("late", 5)] {
        let queue = nodes[node].queues.iter().find(|q| q.port == 1).expect("the second input");
        assert!(queue.waiting <= most && queue.most <= most, "{node}: {queue:?}");
        assert!(queue.dropped > 0, "{node}: {queue:?}");
        let report = engine.report();
        let [wire] = &report.nodes[node].dropped_on[..] else { panic!("one wire: {report:?}") };
        assert_eq!(wire.input, "right");
        assert!(report.nodes[node].dropped >= wire.dropped && wire.dropped >= queue.dropped);
        let log = engine.recent_log();
        assert!(log.iter().any(|(_, n, words)| n == node && words.contains("`right`") && words.contains("dropped")));
    }
    closes_in_time(engine);
}
