//! A run is recorded and replayed: every port has the same bytes, whatever happened to the graph meanwhile.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::common::{PATIENCE, loader, ready, scratch};
use panoscope_engine::Options;
use panoscope_graph::{GraphText, ParamValue, check};
use panoscope_host::loader::Live;
use panoscope_record::compare::compare;
use panoscope_record::{
    Digests, Event, RecordOptions, Recorded, Recorder, Recording, Replay, ReplayError, ReplayOptions, head,
};

/// A running graph that is recorded.
pub(crate) struct Run {
    pub(crate) live: Live,
    recorder: Arc<Recorder>,
}

pub(crate) fn start(text: &str, file: Option<PathBuf>, options: Options, all_ports: bool) -> Run {
    start_with(text, options, RecordOptions { file, digests: true, all_ports, ..RecordOptions::default() })
}

pub(crate) fn start_with(text: &str, options: Options, record: RecordOptions) -> Run {
    let ready = ready("recorded.toml", text);
    let recorder = Recorder::start(record, head(&ready)).expect("the file can be written");
    let options = Options { observer: Some(Arc::clone(&recorder) as _), ..options };
    Run { live: ready.start(options).expect("it starts"), recorder }
}

impl Run {
    fn made(&self, node: &str) -> u64 {
        self.live.engine().report().nodes.get(node).map_or(0, |n| n.count)
    }

    pub(crate) fn until(&self, node: &str, count: u64) {
        let end = Instant::now() + PATIENCE;
        while self.made(node) < count {
            let engine = self.live.engine();
            let state = || format!("{:?} {:?}", engine.recent_log(), engine.report().nodes);
            assert!(Instant::now() < end, "`{node}` stands still at {}: {}", self.made(node), state());
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    pub(crate) fn end(self) -> Recorded {
        let engine = self.live.engine();
        engine.stop();
        assert!(engine.wait(Some(PATIENCE)), "it does not end");
        engine.close(PATIENCE);
        self.recorder.finish()
    }
}

pub(crate) fn replay(file: &Path, threads: usize) -> Result<Digests, ReplayError> {
    replay_with(
        file,
        ReplayOptions { engine: Options { threads, ..Options::default() }, act: true, ..ReplayOptions::default() },
    )
}

fn replay_with(file: &Path, options: ReplayOptions) -> Result<Digests, ReplayError> {
    let recording = Arc::new(Recording::open(file).unwrap_or_else(|e| panic!("{e}")));
    let record = RecordOptions { digests: true, ..RecordOptions::default() };
    let replay = Replay::start(&recording, ReplayOptions { record: Some(record), ..options })?;
    std::thread::scope(|scope| {
        let follows = scope.spawn(|| replay.follow());
        let ended = replay.engine().wait(Some(PATIENCE));
        assert!(ended, "the replay does not end: {:#?}", replay.engine().report().nodes);
        replay.engine().stop();
        follows.join().expect("no panic")
    })?;
    replay.engine().close(PATIENCE);
    replay.verdict()?;
    Ok(replay.recorder().expect("it is recorded").finish().digests.expect("fingerprints"))
}

pub(crate) fn assert_same(what: &str, a: &Digests, b: &Digests) {
    let differing: Vec<_> = compare(a, b).into_iter().filter(|d| !d.is_nothing()).collect();
    assert!(differing.is_empty(), "{what}: {differing:#?}");
    assert!(a.packets() > 0 && a == b, "{what}");
}

pub(crate) const HEAD: &str = "mode = \"live\"\nplugins = [\"flow\", \"fixtures\"]\n";

pub(crate) fn source(id: &str, rate_hz: f64) -> String {
    format!(
        "[nodes.{id}]\ntype = \"frames\"\nparams = {{ width_px = 16, height_px = 8, format = \"gray8\", rate_hz = {rate_hz:?} }}\n"
    )
}

pub(crate) fn node(id: &str, kind: &str, from: &str) -> String {
    format!("[nodes.{id}]\ntype = \"{kind}\"\ninputs = {{ image = \"{from}\" }}\n")
}

/// Two sources, a loop, a slow reader that drops ticks, and inputs that take the newest packet.
fn lively() -> String {
    let color = |id: &str, rate: f64| {
        source(id, rate).replace("gray8", "bgr8").replace("format", "pattern = \"noise\", format")
    };
    [
        HEAD,
        &color("a", 400.0),
        &color("b", 170.0),
        "[nodes.mean]\ntype = \"smooth\"\ninputs = { image = \"a.image\", past = { from = \"mean.image\", delay = 1 } }\n",
        "[nodes.mix]\ntype = \"smooth\"\ninputs = { image = \"mean.image\", past = { from = \"b.image\", align = \"latest\" } }\n",
        &node("mixed", "drain", "mix.image"),
        "[nodes.slow]\ntype = \"pass_blocking\"\nparams = { wait_ms = 7.0 }\ninputs = { image = { from = \"a.image\", align = \"latest\" } }\n",
        "[nodes.late]\ntype = \"smooth\"\ninputs = { image = \"slow.image\", past = { from = \"mix.image\", align = \"latest\" } }\n",
        &node("lately", "drain", "late.image"),
        "[nodes.held_up]\ntype = \"pass_blocking\"\nparams = { wait_ms = 8.0 }\ninputs = { image = \"b.image\" }\n",
        &node("end", "drain", "held_up.image"),
    ]
    .concat()
}

/// Fifty changes of all kinds, spread over the run.
fn fifty_edits(run: &mut Run) {
    for round in 0..50u64 {
        run.until("a", 12 + round * 6);
        let weight = toml::Value::Integer((round * 5) as i64);
        let id = format!("n{}", round / 5);
        let done = match round % 5 {
            0 => run.live.set_param("mean", "past_weight", &weight).map(|_| ()),
            1 => run.live.add_node(&id, "pass", &[("image", &["mix.image"])]).map(|_| ()),
            2 => run.live.connect(&id, "image", &[if round % 2 == 0 { "late.image" } else { "b.image" }]).map(|_| ()),
            3 => {
                let value = ParamValue::Int((255 - round * 3) as i64);
                run.live.engine().set_param("mix", "past_weight", value).expect("a good value");
                let weight = toml::Value::Integer((255 - round * 3) as i64);
                run.live.set_param("mix", "past_weight", &weight).map(|_| ())
            }
            _ if round % 10 == 4 => run.live.remove_node(&id).map(|_| ()),
            _ => run
                .live
                .edit(|d| {
                    d.add_node(&format!("d{id}"), "drain")?;
                    d.set_input(&format!("d{id}"), "image", &[&format!("{id}.image")])
                })
                .map(|_| ()),
        };
        done.unwrap_or_else(|e| panic!("edit {round}: {e}"));
    }
}

#[test]
fn a_live_run_with_fifty_changes_replays_to_the_byte_on_any_number_of_threads() {
    let file = scratch("lively.mcap");
    let mut run = start(&lively(), Some(file.clone()), Options { threads: 3, ..Options::default() }, false);
    fifty_edits(&mut run);
    run.until("a", 360);
    let dropped: u64 = run.live.engine().report().nodes.values().map(|n| n.dropped).sum();
    let recorded = run.end();
    assert_eq!((recorded.gaps, recorded.failed), (0, None));
    let original = recorded.digests.expect("fingerprints");
    let recording = Recording::open(&file).expect("a recording");
    let edits = recording.events.iter().filter(|e| matches!(e, Event::Edit { .. })).count();
    assert!(edits >= 50 && recording.cut.is_none(), "{edits}");
    assert!(dropped > 10, "a run without drops proves little: {dropped}");
    for threads in [1, 2, 8] {
        let again = replay(&file, threads).unwrap_or_else(|e| panic!("{e}"));
        assert_same(&format!("{threads} threads"), &original, &again);
    }
    println!(
        "{} packets on {} ports, {dropped} ticks dropped, {edits} edits",
        original.packets(),
        original.ports.len()
    );
}

#[test]
fn faults_and_restarts_replay_at_their_ticks() {
    let text = [
        HEAD,
        &source("a", 300.0).replace("gray8", "bgr8"),
        "[nodes.bad]\ntype = \"failing\"\nparams = { how = \"panic\", first = 20, ticks = 3 }\ninputs = { image = \"a.image\" }\n",
        "[nodes.mean]\ntype = \"smooth\"\ninputs = { image = \"bad.image\", past = { from = \"mean.image\", delay = 1 } }\n",
        &node("end", "drain", "mean.image"),
    ]
    .concat();
    let file = scratch("faults.mcap");
    let run = start(&text, Some(file.clone()), Options { threads: 2, ..Options::default() }, false);
    run.until("a", 120);
    let recorded = run.end();
    let recording = Recording::open(&file).expect("a recording");
    assert!(recording.events.iter().any(|e| matches!(e, Event::Fault(f) if f.node == "bad")), "the fault is in it");
    assert!(recording.events.iter().any(|e| matches!(e, Event::Opened { node, .. } if node == "bad")));
    let original = recorded.digests.expect("fingerprints");
    for threads in [1, 8] {
        assert_same("faults", &original, &replay(&file, threads).unwrap_or_else(|e| panic!("{e}")));
    }
}

#[test]
fn ages_are_decisions_that_a_replay_repeats() {
    let text = "mode = \"live\"\nplugins = [\"flow\", \"fixtures\"]\n\
        [nodes.a]\ntype = \"aged\"\nparams = { age_ms = 300.0, media_ms = 5.0 }\n\
        [nodes.b]\ntype = \"aged\"\nparams = { age_ms = -1.0, media_ms = 7.0 }\n\
        [nodes.slow]\ntype = \"pass_blocking\"\nparams = { wait_ms = 11.0 }\ninputs = { image = { from = \"b.image\", align = \"latest\" } }\n\
        [nodes.hold]\ntype = \"hold\"\ninputs = { image = \"a.image\" }\n\
        [nodes.ages]\ntype = \"ages\"\ninputs = { image = { from = \"slow.image\", align = \"latest\" }, tip = \"a.tip\" }\n\
        [nodes.young]\ntype = \"ages\"\ninputs = { image = { from = \"slow.image\", align = \"latest\", max_age_ms = 15 }, tip = \"a.tip\" }\n\
        [nodes.held]\ntype = \"ages\"\ninputs = { image = \"hold.image\" }\n";
    let file = scratch("ages.mcap");
    let run = start(text, Some(file.clone()), Options { threads: 2, ..Options::default() }, false);
    run.until("ages", 60);
    run.until("held", 60);
    run.until("young", 60);
    // Its producer takes 11 ms.
    let too_old = run.live.engine().report().nodes["young"].too_old_on.clone();
    assert!(too_old.first().is_some_and(|wire| wire.input == "image" && wire.ticks > 0), "{too_old:?}");
    let original = run.end().digests.expect("fingerprints");
    let recording = Recording::open(&file).expect("whole");
    let asked = recording.events.iter().filter(|e| matches!(e, Event::Ages { .. })).count();
    assert!(asked >= 120, "{asked} answers are recorded");
    // The tables hold the ages, which no other run has: the clock goes on meanwhile, and a replay is as fast as it can.
    for threads in [1, 4] {
        assert_same(
            &format!("{threads} threads"),
            &original,
            &replay(&file, threads).unwrap_or_else(|e| panic!("{e}")),
        );
    }
    let _ = std::fs::remove_file(&file);
}

#[test]
fn batch_runs_replay_too_and_their_settings_can_be_changed() {
    let text = lively()
        .replace("\"live\"", "\"batch\"")
        .replace("wait_ms = 7.0", "wait_ms = 0.0")
        .replace("wait_ms = 8.0", "wait_ms = 0.0");
    let file = scratch("batch.mcap");
    let run = start(&text, Some(file.clone()), Options { threads: 2, frames: Some(100), ..Options::default() }, true);
    assert!(run.live.engine().wait(Some(PATIENCE)));
    let original = run.end().digests.expect("fingerprints");
    assert_same("batch", &original, &replay(&file, 8).unwrap_or_else(|e| panic!("{e}")));
    assert_eq!(
        Recording::open(&file).expect("a recording").digests().ports,
        original.ports,
        "all ports are in the file"
    );
    let settings = vec!["mean.past_weight=7".to_owned()];
    let other =
        replay_with(&file, ReplayOptions { settings, ..ReplayOptions::default() }).unwrap_or_else(|e| panic!("{e}"));
    let differing: Vec<String> =
        compare(&original, &other).into_iter().filter(|d| !d.is_nothing()).map(|d| d.port).collect();
    assert!(
        differing.contains(&"mean.image".to_owned()) && !differing.contains(&"a.image".to_owned()),
        "{differing:?}"
    );
}

#[test]
fn another_graph_runs_on_the_recorded_pictures() {
    let file = scratch("other.mcap");
    let run = start(&lively(), Some(file.clone()), Options { threads: 2, ..Options::default() }, false);
    run.until("a", 60);
    let original = run.end().digests.expect("fingerprints");
    let graph = |text: String| ReplayOptions { graph: Some(("other.toml".into(), text)), ..ReplayOptions::default() };
    let text = [HEAD, &source("a", 1.0), &node("p", "pass", "a.image"), &node("end", "drain", "p.image")].concat();
    let other = replay_with(&file, graph(text)).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(other.ports["a.image"].packets.len(), original.ports["a.image"].packets.len(), "no tick is dropped");
    let hashes = |d: &Digests, port: &str| d.ports[port].packets.iter().map(|p| p.hash).collect::<Vec<_>>();
    assert_eq!(hashes(&other, "p.image"), hashes(&original, "a.image"));
    let text = [HEAD, &source("camera", 1.0), &node("end", "drain", "camera.image")].concat();
    let error = replay_with(&file, graph(text)).expect_err("there is no such source");
    assert!(matches!(&error, ReplayError::NoSource { node, .. } if node == "camera"), "{error}");
    assert!(error.to_string().contains("`a`, `b`"), "{error}");
    let text = "mode = \"live\"\nplugins = [\"nowhere\"]\n[nodes.a]\ntype = \"frames\"\n".to_owned();
    let error = replay_with(&file, graph(text)).expect_err("there is no such plugin");
    assert!(matches!(error, ReplayError::Check(_)) && error.to_string().contains("nowhere"), "{error}");
}

#[test]
fn a_change_switches_at_the_named_tick() {
    // The queues are long enough that a busy machine drops nothing.
    let roomy = |id: &str, kind: &str, from: &str| {
        node(id, kind, "FROM").replace("\"FROM\"", &format!("{{ from = \"{from}\", queue = 200 }}"))
    };
    let text = [HEAD, &source("a", 300.0), &roomy("p", "pass", "a.image"), &node("end", "drain", "p.image")].concat();
    let run = start(&text, None, Options { threads: 2, ..Options::default() }, false);
    run.until("end", 5);
    let new = [text.as_str(), &roomy("q", "pass", "a.image"), &node("q_end", "drain", "q.image")].concat();
    let parsed = GraphText::parse("new.toml".as_ref(), &new);
    let loader = loader();
    let catalog = loader.catalog(&parsed.plugins());
    let (graph, _) = check(&parsed, &catalog).into_result().unwrap_or_else(|d| panic!("{}", d.render(false)));
    let engine = run.live.engine();
    let passed = engine.apply_at(graph.clone(), &catalog, &loader, &[("a".to_owned(), 1)]);
    assert!(passed.is_err_and(|e| e.to_string().contains("has passed")));
    let unknown = engine.apply_at(graph.clone(), &catalog, &loader, &[("nobody".to_owned(), 1)]);
    assert!(unknown.is_err_and(|e| e.to_string().contains("`nobody` is not a source")));
    let at = run.made("a") + 60;
    // The loader is another one, but the plugin's file is the same: its nodes are replaced, which is a change as well.
    let applied = engine.apply_at(graph, &catalog, &loader, &[("a".to_owned(), at)]).expect("a good change");
    assert!(applied.added.contains(&"q".to_owned()), "{applied:?}");
    run.until("q_end", 20);
    let digests = run.end().digests.expect("fingerprints");
    let first = digests.ports["q.image"].packets.first().expect("packets").seq;
    assert_eq!(first, at, "{applied:?}");
    let all: Vec<u64> = digests.ports["p.image"].packets.iter().map(|p| p.seq).collect();
    assert!(all.windows(2).all(|w| w[1] == w[0] + 1), "no tick is lost on the way");
}
