//! Nodes in separate processes: the same bytes as in the process of the graph, and faults stay inside their process.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use panoscope_engine::fault::{Action, Cause, Fault};
use panoscope_engine::{Engine, Options, Outcome, Report};
use panoscope_host::loader::Live;
use panoscope_record::compare::compare;
use panoscope_record::{Digests, RecordOptions, Recorder, Recording, Replay, ReplayOptions, head};
use panoscope_tests::{await_end, files, isolated_processes, load, panorama, ready, run, scratch, wait_until};

const PATIENCE: Duration = Duration::from_secs(120);

/// Threads that run a test or wait for their turn. They start while another test counts threads.
static TESTS: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

/// This thread, as the system lists it.
fn this_thread() -> PathBuf {
    let link = std::fs::read_link("/proc/thread-self").expect("the system lists this thread");
    PathBuf::from("/proc").join(link)
}

/// Threads of this process that run no test.
fn threads() -> usize {
    let all = std::fs::read_dir(format!("/proc/{}/task", std::process::id())).expect("the system lists threads");
    let tests = TESTS.lock().unwrap_or_else(PoisonError::into_inner);
    all.flatten().filter(|entry| !tests.contains(&entry.path())).count()
}

/// Runs one test at a time: they count processes, files and memory of this process.
fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    TESTS.lock().unwrap_or_else(PoisonError::into_inner).insert(this_thread());
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

#[test]
fn isolated_nodes_make_the_same_bytes() {
    let _alone = alone();
    let every = "[isolate]\nphantom = \"renderer\"\nstitch = \"stitching\"\nsinks = \"files\"";
    let one = "[isolate]\nstitch = \"a\"\nphantom = \"a\"";
    let mut first: Option<Vec<(String, Vec<u8>)>> = None;
    for (name, isolate) in [("none", ""), ("one", one), ("every", every)] {
        let folder = scratch(&format!("isolated-{name}"));
        let done = run(&folder.join("graph.toml"), &panorama(&folder, isolate), 8, 2);
        assert_eq!((done.report.frames, &done.outcome), (8, &Outcome::Done), "{name}: {:?}", done.log);
        assert!(done.report.nodes.values().all(|n| n.faults == 0), "{name}: {:?}", done.log);
        let made = files(&folder);
        assert_eq!(made.len(), 9, "{name}: 8 pictures and a table");
        match &first {
            None => first = Some(made),
            Some(first) => {
                for (a, b) in first.iter().zip(&made) {
                    assert_eq!(a.0, b.0);
                    assert!(a.1 == b.1, "{} differs: {name}", a.0);
                }
            }
        }
        let _ = std::fs::remove_dir_all(&folder);
    }
}

/// A finished run of a graph text, with its faults.
struct Ran {
    report: Report,
    outcome: Outcome,
    faults: Vec<Fault>,
}

fn started(folder: &Path, text: &str, options: Options) -> (Engine, Arc<Mutex<Vec<Fault>>>) {
    let (graph, catalog, loader) =
        load(&folder.join("graph.toml"), text).unwrap_or_else(|mistakes| panic!("{mistakes}"));
    let faults = Arc::new(Mutex::new(Vec::new()));
    let told = Arc::clone(&faults);
    let hear = move |fault: &Fault| told.lock().expect("no panic").push(fault.clone());
    let options = Options { threads: 2, graph_dir: folder.to_owned(), faults: Some(Box::new(hear)), ..options };
    let engine = Engine::start(graph, &catalog, &loader, options).unwrap_or_else(|error| panic!("{error}"));
    (engine, faults)
}

fn ran(folder: &Path, text: &str, options: Options) -> Ran {
    let (engine, faults) = started(folder, text, options);
    await_end(&engine, |_| {});
    let outcome = engine.close(Duration::from_secs(30));
    let report = engine.report();
    drop(engine);
    let faults = faults.lock().expect("no panic").clone();
    Ran { report, outcome, faults }
}

/// Frames through an isolated node that misbehaves, next to a node of the graph's process and one of another group.
fn harmed(folder: &Path, harm: &str, kind: &str) -> String {
    let folder = folder.display();
    format!(
        r#"
mode = "batch"
plugins = ["flow", "fixtures"]
[nodes.source]
type = "frames"
params = {{ width_px = 64, height_px = 48, format = "gray8", pattern = "ramp" }}
[nodes.bad]
type = "{kind}"
isolate = "wild"
inputs = {{ image = "source.image" }}
params = {{ harm = "{harm}", first = 10, ticks = 1, hang_ms = 600000.0 }}
[nodes.neighbour]
type = "pass"
isolate = "quiet"
inputs = {{ image = "source.image" }}
[nodes.seen]
type = "ledger"
inputs = {{ images = ["bad.image", "neighbour.image", "source.image"] }}
params = {{ path = "{folder}/ledger.jsonl" }}
"#
    )
}

/// The inputs of each tick: the tick's number, or nothing.
fn ledger(folder: &Path) -> Vec<Vec<Option<u64>>> {
    let text = std::fs::read_to_string(folder.join("ledger.jsonl")).expect("the ledger");
    let of = |line: &str| {
        let line: serde_json::Value = serde_json::from_str(line).expect("a line of JSON");
        line["inputs"].as_array().expect("a list").iter().map(serde_json::Value::as_u64).collect()
    };
    text.lines().map(of).collect()
}

#[test]
fn whatever_a_process_dies_of_is_one_fault_of_its_node() {
    let _alone = alone();
    const FRAMES: u64 = 40;
    let cases = [
        ("segv", "SIGSEGV"),
        ("segv_in_loop", "SIGSEGV"),
        ("abort", "SIGABRT"),
        ("stack_overflow", "SIGSEGV"),
        ("exit", "exit(3)"),
        ("exit_at_once", "exit(0)"),
        ("wild_write", "SIGSEGV"),
        ("out_of_memory", "SIGABRT"),
    ];
    for (harm, words) in cases {
        let folder = scratch(&format!("isolated-{harm}"));
        let options = Options { frames: Some(FRAMES), group_memory_bytes: 1 << 30, ..Options::default() };
        let Ran { report, outcome, faults } = ran(&folder, &harmed(&folder, harm, "chaos"), options);
        assert_eq!(outcome, Outcome::Done, "{harm}: {faults:?}");
        let told: Vec<_> = faults.iter().map(|f| (f.node.as_str(), f.cause, f.done, f.seq)).collect();
        assert_eq!(told, [("bad", Cause::Crash, Action::Restart, Some(10))], "{harm}: {faults:?}");
        for part in ["group `wild`", "node `bad`", words] {
            assert!(faults[0].words.contains(part), "{harm}: `{}` does not say {part}", faults[0].words);
        }
        assert_eq!((report.nodes["bad"].faults, report.nodes["bad"].restarts), (1, 1), "{harm}");
        let seen = ledger(&folder);
        assert_eq!(seen.len() as u64, FRAMES, "{harm}");
        for (seq, inputs) in (0..).zip(&seen) {
            let own = (seq != 10).then_some(seq);
            assert_eq!(*inputs, [own, Some(seq), Some(seq)], "{harm} at {seq}");
        }
        let _ = std::fs::remove_dir_all(&folder);
    }
}

#[test]
fn a_hang_is_killed_and_the_node_comes_back() {
    let _alone = alone();
    for (harm, kind) in [("hang", "chaos"), ("hang_in_loop", "chaos"), ("hang", "chaos_blocking")] {
        let folder = scratch(&format!("isolated-{harm}-{kind}"));
        // In batch a call hangs after 30 times this.
        let options = Options { frames: Some(30), hang: Duration::from_millis(20), ..Options::default() };
        let Ran { report, outcome, faults } = ran(&folder, &harmed(&folder, harm, kind), options);
        assert_eq!(outcome, Outcome::Done, "{faults:?}");
        let told: Vec<_> = faults.iter().map(|f| (f.node.as_str(), f.cause, f.seq)).collect();
        assert_eq!(told, [("bad", Cause::Hang, Some(10))], "{faults:?}");
        assert!(faults[0].words.contains("its process was ended"), "{}", faults[0].words);
        assert_eq!(report.nodes["bad"].restarts, 1);
        let missing: Vec<u64> =
            (0..).zip(ledger(&folder)).filter(|(_, i)| i[0].is_none()).map(|(seq, _)| seq).collect();
        assert_eq!(missing, [10], "one tick is lost");
        assert!(isolated_processes().is_empty(), "no process stays behind");
        let _ = std::fs::remove_dir_all(&folder);
    }
}

#[test]
fn a_panic_in_a_process_keeps_its_words() {
    let _alone = alone();
    let folder = scratch("isolated-panic");
    let options = Options { frames: Some(20), ..Options::default() };
    let Ran { report, faults, .. } = ran(&folder, &harmed(&folder, "panic", "chaos"), options);
    let told: Vec<_> = faults.iter().map(|f| (f.node.as_str(), f.cause, f.words.as_str())).collect();
    assert!(
        matches!(told[..], [("bad", Cause::Panic, words)] if words.contains("told to panic at tick 10")),
        "{told:?}"
    );
    assert_eq!(report.nodes["bad"].restarts, 1);
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn a_node_that_crashes_while_it_opens_is_named() {
    let _alone = alone();
    let folder = scratch("isolated-open");
    let text = harmed(&folder, "segv_in_open", "chaos");
    let (graph, catalog, loader) =
        load(&folder.join("graph.toml"), &text).unwrap_or_else(|mistakes| panic!("{mistakes}"));
    let error =
        Engine::start(graph, &catalog, &loader, Options::default()).err().expect("it does not start").to_string();
    for part in ["node `bad` (chaos) did not open", "group `wild`", "SIGSEGV"] {
        assert!(error.contains(part), "`{error}` does not say {part}");
    }
}

/// Frames, forwarded by an isolated node.
fn passing(params: &str) -> String {
    format!(
        r#"
mode = "live"
plugins = ["flow", "fixtures"]
[nodes.source]
type = "frames"
params = {{ width_px = 64, height_px = 48, format = "gray8", pattern = "ramp", rate_hz = 200.0 }}
[nodes.passes]
type = "chaos"
isolate = "group"
inputs = {{ image = {{ from = "source.image", queue = 200 }} }}
{params}
[nodes.sink]
type = "drain"
inputs = {{ image = {{ from = "passes.image", queue = 200 }} }}
"#
    )
}

#[test]
fn values_nodes_and_groups_change_while_frames_flow() {
    let _alone = alone();
    let folder = scratch("isolated-edits");
    let path = folder.join("graph.toml");
    let text = passing("");
    let ready = ready(&path, &text).unwrap_or_else(|mistakes| panic!("{mistakes}"));
    let live = ready.start(Options { threads: 2, ..Options::default() });
    let mut live = live.unwrap_or_else(|e| panic!("{e}"));
    let sink = |live: &Live| live.engine().report().nodes["sink"].count;
    let flows = |live: &Live| {
        let from = sink(live);
        wait_until("frames flow", || sink(live) > from + 3);
    };
    flows(&live);
    let first = isolated_processes();
    assert_eq!(first.len(), 1, "one process");
    live.set_param("passes", "first", &toml::Value::Integer(3)).expect("a good value");
    flows(&live);
    assert_eq!(isolated_processes(), first, "a value needs no new process");
    // Another node of the group joins its process.
    live.apply_text(&format!("{}\n[nodes.more]\ntype = \"pass\"\nisolate = \"group\"\ninputs = {{ image = \"passes.image\" }}\n[nodes.end]\ntype = \"drain\"\ninputs = {{ image = \"more.image\" }}\n", live.text()))
        .expect("a good change");
    wait_until("the new branch works", || live.engine().report().nodes["end"].count > 3);
    assert_eq!(isolated_processes(), first, "the same process");
    // The node leaves its process, and comes back to another one.
    let inside = live.text().replacen("isolate = \"group\"", "", 1);
    live.apply_text(&inside).expect("a good change");
    flows(&live);
    live.apply_text(&inside.replace("isolate = \"group\"", "isolate = \"other\"")).expect("a good change");
    wait_until("the branch works again", || live.engine().report().nodes["end"].count > 3);
    wait_until("the old process leaves", || isolated_processes().len() == 1 && isolated_processes() != first);
    live.engine().stop();
    assert!(live.engine().wait(Some(PATIENCE)));
    live.engine().close(PATIENCE);
    let report = live.engine().report();
    assert!(report.nodes.values().all(|n| n.faults == 0), "{report:#?}");
    assert_eq!(report.nodes["sink"].count, report.nodes["source"].count, "no frame is lost");
    drop(live);
    assert!(isolated_processes().is_empty(), "no process stays behind");
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn a_rebuilt_plugin_is_swapped_in_its_process() {
    let _alone = alone();
    let folder = scratch("isolated-swap");
    let (_, _, loader) = load(&folder.join("graph.toml"), &passing("")).unwrap_or_else(|mistakes| panic!("{mistakes}"));
    let plugins = folder.join("plugins");
    std::fs::create_dir_all(&plugins).expect("a folder");
    let built = loader.found().find(|f| f.note.name == "fixtures").expect("the plugin").file.clone();
    let copied = plugins.join("fixtures.so");
    std::fs::copy(&built, &copied).expect("a copy");
    let text =
        passing("").replacen("plugins = ", &format!("plugin_paths = [\"{}\"]\nplugins = ", plugins.display()), 1);
    let path = folder.join("graph.toml");
    let ready = ready(&path, &text).unwrap_or_else(|mistakes| panic!("{mistakes}"));
    let live = ready.start(Options { threads: 2, ..Options::default() });
    let mut live = live.unwrap_or_else(|e| panic!("{e}"));
    let sink = |live: &Live| live.engine().report().nodes["sink"].count;
    wait_until("frames flow", || sink(&live) > 5);
    let process = isolated_processes();
    let new = plugins.join("fixtures.new");
    // Another byte behind the end: a file of the same bytes is the same plugin.
    let bytes = [std::fs::read(&built).expect("the plugin"), vec![0]].concat();
    std::fs::write(&new, bytes).expect("a copy");
    std::fs::rename(&new, &copied).expect("replaced");
    let applied = live.reload_plugins().expect("the same nodes");
    assert!(applied.replaced.contains(&"passes".to_owned()), "{applied:?}");
    let from = sink(&live);
    wait_until("frames flow", || sink(&live) > from + 5);
    assert_eq!(isolated_processes(), process, "in the same process");
    live.engine().stop();
    assert!(live.engine().wait(Some(PATIENCE)));
    live.engine().close(PATIENCE);
    let report = live.engine().report();
    assert!(report.nodes.values().all(|n| n.faults == 0), "{report:#?}");
    let _ = std::fs::remove_dir_all(&folder);
}

/// Frames of a recorded run.
const FRAMES: u64 = 40;

fn recorded(folder: &Path, file: &Path) -> Digests {
    let path = folder.join("graph.toml");
    let isolate = "[isolate]\nstitch = \"stitching\"\nfixtures = \"wild\"\n[nodes.bad]\ntype = \"chaos\"\ninputs = { image = \"wide.panorama\" }\nparams = { harm = \"segv\", first = 4, ticks = 1 }\n[nodes.end]\ntype = \"drain\"\ninputs = { image = \"bad.image\" }";
    let mut text = panorama(folder, isolate);
    for output in
        ["scope.left", "scope.right", "register.homography", "register.roi_left", "wide.panorama", "bad.image"]
    {
        // Room for all frames: a busy machine must not drop the one that crashes.
        text = text.replace(&format!("\"{output}\""), &format!("{{ from = \"{output}\", queue = {FRAMES} }}"));
    }
    let text = text
        .replace("\"batch\"", "\"live\"")
        .replace("\"sinks\"]", "\"sinks\", \"fixtures\", \"flow\"]")
        .replace("seed = 7,", "seed = 7, rate_hz = 60.0,");
    let ready = ready(&path, &text).unwrap_or_else(|mistakes| panic!("{mistakes}"));
    let options = RecordOptions {
        file: Some(file.to_owned()),
        digests: true,
        all_source_ports: false,
        ..RecordOptions::default()
    };
    let recorder = Recorder::start(options, head(&ready)).unwrap_or_else(|e| panic!("{e}"));
    let options = Options { frames: Some(FRAMES), observer: Some(Arc::clone(&recorder) as _), ..Options::default() };
    let live = ready.start(options).unwrap_or_else(|e| panic!("{e}"));
    let engine = live.engine();
    assert!(engine.wait(Some(PATIENCE)));
    engine.close(PATIENCE);
    let report = engine.report();
    assert_eq!(report.nodes["scope"].dropped, 0);
    assert_eq!((report.nodes["bad"].faults, report.nodes["bad"].restarts), (1, 1));
    recorder.finish().digests.expect("fingerprints")
}

#[test]
fn a_run_with_a_crash_replays_to_the_byte() {
    let _alone = alone();
    let folder = scratch("isolated-record");
    let file = folder.join("run.mcap");
    let original = recorded(&folder, &file);
    let recording = Arc::new(Recording::open(&file).unwrap_or_else(|e| panic!("{e}")));
    let options = ReplayOptions {
        record: Some(RecordOptions { digests: true, ..RecordOptions::default() }),
        engine: Options { threads: 2, ..Options::default() },
        ..ReplayOptions::default()
    };
    let replay = Replay::start(&recording, options).unwrap_or_else(|e| panic!("{e}"));
    await_end(replay.engine(), |_| {});
    replay.engine().close(PATIENCE);
    replay.verdict().unwrap_or_else(|e| panic!("{e}"));
    let again = replay.recorder().expect("it is recorded").finish().digests.expect("fingerprints");
    let differing: Vec<_> = compare(&original, &again).into_iter().filter(|d| !d.is_nothing()).collect();
    assert!(differing.is_empty(), "{differing:#?}");
    let _ = std::fs::remove_dir_all(&folder);
}

/// Open files of this process that isolation created.
fn shared_files() -> Vec<String> {
    let entries = std::fs::read_dir("/proc/self/fd").expect("the system lists open files").flatten();
    let names = entries.filter_map(|entry| Some(std::fs::read_link(entry.path()).ok()?.display().to_string()));
    names
        .filter(|name| ["memfd:panoscope-frames", "memfd:panoscope-lane", "pidfd"].iter().any(|of| name.contains(of)))
        .collect()
}

/// Mappings of frames and lanes. The code of plugins stays mapped, which is intended.
fn shared_memory() -> Vec<String> {
    let maps = std::fs::read_to_string("/proc/self/maps").expect("the system lists memory");
    let of = |line: &&str| ["memfd:panoscope-frames", "memfd:panoscope-lane"].iter().any(|name| line.contains(name));
    maps.lines().filter(of).map(str::to_owned).collect()
}

#[test]
fn a_closed_graph_leaves_no_process_no_file_and_no_memory() {
    let _alone = alone();
    let folder = scratch("isolated-close");
    let before = threads();
    for _ in 0..3 {
        let options = Options { frames: Some(20), ..Options::default() };
        let (engine, _) = started(&folder, &harmed(&folder, "segv", "chaos"), options);
        assert!(engine.wait(Some(PATIENCE)));
        engine.close(PATIENCE);
        assert!(isolated_processes().is_empty(), "no process stays when the graph is closed");
        drop(engine);
        // A thread of the engine may still be on its way out.
        wait_until("its memory is given back", || shared_memory().is_empty());
        wait_until("its files are closed", || shared_files().is_empty());
    }
    wait_until("its threads leave", || threads() <= before);
    let _ = std::fs::remove_dir_all(&folder);
}
