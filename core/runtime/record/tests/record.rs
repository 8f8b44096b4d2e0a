//! A run is recorded and replayed: every port has the same bytes, whatever happened to the graph meanwhile.

use crate::common;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::common::{PATIENCE, loader, scratch};
use panoscope_engine::{Engine, Options};
use panoscope_graph::{GraphText, ParamValue, check};
use panoscope_host::loader::Live;
use panoscope_record::compare::{compare, compare_recordings};
use panoscope_record::{
    Coding, Digests, Event, RecordOptions, Recorded, Recorder, Recording, RecordingError, Replay, ReplayError,
    ReplayOptions, head,
};

/// A running graph that is recorded.
pub(crate) struct Run {
    pub(crate) live: Live<Box<Engine>>,
    recorder: Arc<Recorder>,
}

pub(crate) fn start(text: &str, file: Option<PathBuf>, options: Options, all_ports: bool) -> Run {
    start_with(text, options, RecordOptions { file, digests: true, all_ports, ..RecordOptions::default() })
}

fn start_with(text: &str, options: Options, record: RecordOptions) -> Run {
    let path = Path::new("recorded.toml");
    let parsed = GraphText::parse(path, text);
    let loader = loader();
    let catalog = loader.catalog(&parsed.plugins());
    let (graph, _) = check(&parsed, &catalog).into_result().unwrap_or_else(|d| panic!("{}", d.render(false)));
    let mut head = head(&graph, &catalog, &loader, path, text, &[]);
    head.all_ports = record.all_ports;
    let recorder = Recorder::start(record, head).expect("the file can be written");
    let options = Options { observer: Some(Arc::clone(&recorder) as _), ..options };
    let engine = Engine::start(graph, &catalog, &loader, options).expect("it starts");
    Run { live: Live::new(Box::new(engine), path, text.to_owned(), Vec::new(), loader), recorder }
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

/// A short recording, as bytes.
fn short() -> Vec<u8> {
    let text = [HEAD, &source("a", 400.0), &node("end", "drain", "a.image")].concat();
    let file = scratch(&format!("short_{:?}.mcap", std::thread::current().id()));
    let run = start(&text, Some(file.clone()), Options { threads: 2, ..Options::default() }, false);
    run.until("a", 30);
    run.end();
    std::fs::read(&file).expect("it was written")
}

#[test]
fn a_recording_cut_off_anywhere_opens_up_to_its_last_whole_frame() {
    let whole = short();
    let file = scratch("cut.mcap");
    std::fs::write(&file, &whole).expect("written");
    let all = Recording::open(&file).expect("whole");
    let ends: Vec<u64> = all.ports["a.image"].iter().map(|p| p.at + p.head.len).collect();
    let ticks = all.sources["a"].len();
    assert_eq!(ends.len(), ticks);
    let mut opened = 0;
    for len in (0..whole.len()).filter(|l| *l < 200 || l % 97 == 0 || ends.iter().any(|e| e.abs_diff(*l as u64) < 3)) {
        std::fs::write(&file, &whole[..len]).expect("written");
        match Recording::open(&file) {
            Ok(cut) => {
                opened += 1;
                let frames = ends.iter().filter(|end| **end <= len as u64).count();
                assert_eq!(cut.ports.get("a.image").map_or(0, Vec::len), frames, "cut at {len}");
                let known = cut.sources.get("a").map_or(0, Vec::len);
                assert!(known == frames || known + 1 == frames, "cut at {len}: the last tick may have lost its end");
                for packet in cut.ports.values().flatten() {
                    cut.bytes("a.image", packet).unwrap_or_else(|e| panic!("cut at {len}: {e}"));
                }
                // The end mark may be whole already when the index behind it is cut.
                assert!(cut.cut.is_some() || known == ticks, "cut at {len}");
            }
            Err(RecordingError::Empty { bytes, .. }) => assert_eq!(bytes, len as u64),
            Err(error) => panic!("cut at {len}: {error}"),
        }
    }
    assert!(opened > 100);
    // One of them is also replayed, which says that it is not whole.
    std::fs::write(&file, &whole[..ends[ticks / 2] as usize + 400]).expect("written");
    let recording = Arc::new(Recording::open(&file).expect("a part"));
    let engine = Options { threads: 2, ..Options::default() };
    let options = ReplayOptions { engine, act: true, ..ReplayOptions::default() };
    let played = Replay::start(&recording, options).unwrap_or_else(|e| panic!("{e}"));
    assert!(played.engine().wait(Some(PATIENCE)), "the replay ends");
    played.engine().close(PATIENCE);
    assert!(played.engine().report().nodes["end"].count >= ticks as u64 / 2);
    let error = played.verdict().expect_err("the end is missing").to_string();
    assert!(error.contains("is cut off at byte"), "{error}");
}

#[test]
fn damaged_bytes_are_named_or_end_the_recording() {
    let whole = short();
    let file = scratch("damaged.mcap");
    std::fs::write(&file, &whole).expect("written");
    let all = Recording::open(&file).expect("whole");
    // Read now, before other bytes are written to the file.
    assert!(all.verify().is_ok() && all.checked);
    let mut dice = 1u64;
    for _ in 0..400 {
        dice = dice.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let at = (dice >> 33) as usize % whole.len();
        let mut bytes = whole.clone();
        bytes[at] ^= 1 << (dice >> 20 & 7);
        std::fs::write(&file, &bytes).expect("written");
        let Ok(opened) = Recording::open(&file) else { continue };
        for (port, packet) in opened.ports.iter().flat_map(|(port, list)| list.iter().map(move |p| (port, p))) {
            match opened.bytes(port, packet) {
                Ok(_) | Err(RecordingError::Damaged { .. }) => {}
                Err(error) => panic!("byte {at}: {error}"),
            }
        }
    }
    let packet = all.ports["a.image"][3];
    let mut bytes = whole;
    bytes[packet.at as usize + 20] ^= 1;
    std::fs::write(&file, &bytes).expect("written");
    let error = replay(&file, 2).expect_err("a damaged frame is not shown as if it were whole");
    assert!(error.to_string().contains("is damaged at byte") && error.to_string().contains("a.image"), "{error}");
}

/// The report of damage: an error of `open`, an early end, or an error at a packet. `None` when nothing was reported.
fn reported_damage(file: &Path) -> Option<String> {
    match Recording::open(file) {
        Err(error) => Some(error.to_string()),
        Ok(recording) => match recording.verify() {
            Err(error) => Some(error.to_string()),
            Ok(()) => recording.cut.filter(|cut| cut.damaged).map(|cut| cut.reason),
        },
    }
}

/// A recording of pictures that are packed, and of a node that hands them on, which are stored as references.
fn packed() -> Vec<u8> {
    let text = [
        HEAD,
        &source("a", 400.0).replace("width_px = 16, height_px = 8", "width_px = 64, height_px = 48"),
        &node("same", "pass", "a.image"),
        &node("end", "drain", "same.image"),
    ];
    let file = scratch("packed.mcap");
    let run = start(&text.concat(), Some(file.clone()), Options { threads: 2, ..Options::default() }, true);
    run.until("a", 12);
    run.end();
    let recording = Recording::open(&file).expect("whole");
    let sizes = |port: &str| recording.ports[port].iter().map(|p| (p.coding, p.stored)).collect::<Vec<_>>();
    let (made, same) = (sizes("a.image"), sizes("same.image"));
    assert!(made.iter().all(|(coding, stored)| *coding == Coding::Packed && *stored < 64 * 48 / 2), "{made:?}");
    assert!(!same.is_empty() && same == made[..same.len()], "{same:?}");
    let ats = |port: &str| recording.ports[port].iter().map(|p| p.at).collect::<Vec<_>>();
    assert_eq!(ats("same.image"), ats("a.image")[..same.len()], "stored once");
    std::fs::read(&file).expect("it was written")
}

#[test]
fn a_flipped_bit_anywhere_is_reported_and_never_read_as_other_data() {
    for whole in [short(), packed()] {
        let file = scratch("flipped.mcap");
        std::fs::write(&file, &whole).expect("written");
        assert_eq!(reported_damage(&file), None);
        let all = Recording::open(&file).expect("whole");
        // All of the beginning (header, channel, head, first ticks) and of the end; a sample of what repeats between them.
        let first = all.ports["a.image"][2].at as usize + 8;
        let (mut flipped, mut step) = (0, 0u64);
        let mut at = 0;
        while at < whole.len() {
            let mut bytes = whole.clone();
            step += 1;
            bytes[at] ^= 1 << (step % 8);
            std::fs::write(&file, &bytes).expect("written");
            assert!(reported_damage(&file).is_some(), "bit {} of byte {at} of {}: not reported", step % 8, whole.len());
            flipped += 1;
            at += if at < first || at + 800 > whole.len() { 1 } else { 13 };
        }
        assert!(flipped > 3000, "{flipped}");
    }
}

#[test]
fn a_compressed_recording_has_the_same_packets_in_less_space() {
    let text = [
        HEAD,
        &source("a", 400.0).replace("width_px = 16, height_px = 8", "width_px = 64, height_px = 48"),
        &node("same", "pass", "a.image"),
        &node("end", "drain", "same.image"),
    ];
    let record = |name: &str, compresses: bool| {
        let file = scratch(name);
        let record =
            RecordOptions { file: Some(file.clone()), all_ports: true, compresses, ..RecordOptions::default() };
        let options = Options { threads: 2, frames: Some(20), ..Options::default() };
        let run = start_with(&text.concat().replace("\"live\"", "\"batch\""), options, record);
        run.until("end", 20);
        (run.end().bytes, Recording::open(&file).expect("whole"))
    };
    let ((less, small), (more, large)) = (record("small.mcap", true), record("large.mcap", false));
    assert!(less < more / 3, "{less} and {more} bytes");
    let compared = compare_recordings(&small, &large, 0.0).expect("both are whole");
    assert!(compared.iter().all(|port| port.is_nothing()), "{compared:?}");
    for port in ["a.image", "same.image"] {
        assert_eq!(small.ports[port].len(), 20);
        for (a, b) in small.ports[port].iter().zip(&large.ports[port]) {
            assert_eq!(small.bytes(port, a).expect("whole"), large.bytes(port, b).expect("whole"));
        }
    }
}

#[test]
fn a_damaged_recording_fails_a_replay_and_a_comparison() {
    let whole = short();
    let [good, bad] = ["good.mcap", "bad.mcap"].map(scratch);
    std::fs::write(&good, &whole).expect("written");
    let all = Recording::open(&good).expect("whole");
    // The description of a packet in the middle: source, tick, time and size stand there.
    let packet = all.ports["a.image"][10];
    let mut bytes = whole.clone();
    bytes[packet.at as usize - 72 + 33] ^= 4;
    std::fs::write(&bad, &bytes).expect("written");
    let cut = Recording::open(&bad).expect("good up to there").cut.expect("it is damaged");
    assert!(cut.damaged && cut.at < packet.at, "{cut:?}");
    let error = replay(&bad, 2).expect_err("the rest is lost").to_string();
    assert!(error.contains("is damaged at byte") && error.contains("description of a packet"), "{error}");
    // Bytes of a picture: the fingerprints are equal.
    let mut bytes = whole;
    bytes[packet.at as usize + 5] ^= 1;
    std::fs::write(&bad, &bytes).expect("written");
    let damaged = Recording::open(&bad).expect("its messages are whole");
    let error = compare_recordings(&all, &damaged, 0.0).expect_err("it is not called equal").to_string();
    assert!(error.contains("is damaged at byte") && error.contains("packet 10 of `a.image`"), "{error}");
}

/// Records a source until it made 30 pictures, with packets as they are in memory: as formats before 4 have them.
fn record_uncompressed(file: &Path) -> Recorded {
    let text = [HEAD, &source("a", 400.0), &node("end", "drain", "a.image")].concat();
    let record =
        RecordOptions { file: Some(file.to_owned()), digests: true, compresses: false, ..RecordOptions::default() };
    let run = start_with(&text, Options { threads: 2, ..Options::default() }, record);
    run.until("a", 30);
    run.end()
}

/// MCAP's own library reads the chunks, their indices, the schemas and the checksums; so may any other program.
#[test]
fn other_programs_can_seek_in_a_recording() {
    // More than one chunk of 4 MiB: 24 pictures of 640 x 480 as they are.
    let text = [HEAD, &source("a", 400.0), &node("end", "drain", "a.image")].concat();
    let text = text.replace("width_px = 16, height_px = 8", "width_px = 640, height_px = 480");
    let file = scratch("seek.mcap");
    let record = RecordOptions { file: Some(file.clone()), compresses: false, ..RecordOptions::default() };
    let run = start_with(&text, Options { threads: 2, ..Options::default() }, record);
    run.until("a", 24);
    run.end();
    let ours = Recording::open(&file).expect("whole");
    ours.verify().expect("sound");
    let bytes = std::fs::read(&file).expect("written");
    let summary = mcap::Summary::read(&bytes).expect("sound").expect("a summary");
    let statistics = summary.stats.as_ref().expect("statistics");
    let packets = ours.ports["a.image"].len();
    assert!(summary.chunk_indexes.len() >= 2 && statistics.chunk_count as usize == summary.chunk_indexes.len());
    let channel = summary.channels.values().find(|channel| channel.topic == "a.image").expect("its channel");
    assert_eq!(channel.schema.as_ref().expect("a schema").name, "panoscope.Packet");
    assert_eq!(statistics.channel_message_counts[&channel.id], packets as u64);
    let mut found = 0;
    for chunk in &summary.chunk_indexes {
        let indices = summary.read_message_indexes(&bytes, chunk).expect("indices");
        for entry in indices.iter().filter(|(of, _)| of.id == channel.id).flat_map(|(_, entries)| entries) {
            let message = summary.seek_message(&bytes, chunk, entry).expect("a message");
            assert_eq!((message.log_time, &message.channel.topic[..]), (entry.log_time, "a.image"));
            assert!((chunk.message_start_time..=chunk.message_end_time).contains(&entry.log_time));
            let packet = &ours.ports["a.image"][found];
            assert_eq!(&message.data[72..], &bytes[packet.at as usize..][..packet.stored as usize]);
            found += 1;
        }
    }
    assert_eq!(found, packets);
    // Without the summary, with all checksums.
    let stream: Result<Vec<_>, _> = mcap::MessageStream::new(&bytes).expect("sound").collect();
    assert_eq!(stream.expect("sound").len() as u64, statistics.message_count);
    // A run that is killed leaves its last chunk open; what stands there is read all the same, by everybody.
    let last = &ours.ports["a.image"][packets - 3];
    let end = (last.at + last.stored) as usize;
    let open = summary.chunk_indexes.iter().find(|chunk| chunk.chunk_start_offset + chunk.chunk_length > end as u64);
    let mut killed = bytes[..end].to_vec();
    let head = open.expect("its chunk").chunk_start_offset as usize;
    killed[head + 1..head + 49].fill(0);
    killed[head + 1] = 40;
    std::fs::write(&file, &killed).expect("written");
    let cut = Recording::open(&file).expect("a part");
    assert_eq!((cut.ports["a.image"].len(), cut.cut.expect("not finished").damaged), (packets - 2, false));
    killed.extend(mcap::MAGIC);
    let read = mcap::MessageStream::new(&killed).expect("sound").map_while(Result::ok);
    assert_eq!(read.filter(|message| message.channel.topic == "a.image").count(), packets - 2);
}

/// The recording in format 1, without chunks, schemas and checksums.
fn without_checksums(recording: &Path) -> Vec<u8> {
    let whole = std::fs::read(recording).expect("it was written");
    let mut out = Vec::from(mcap::MAGIC);
    let mut at = mcap::MAGIC.len();
    let mut packets = std::collections::HashSet::new();
    while whole[at] != mcap::records::op::DATA_END {
        let len = u64::from_le_bytes(whole[at + 1..at + 9].try_into().expect("eight")) as usize;
        if whole[at] == mcap::records::op::CHUNK {
            // Its records follow its head.
            at += 9 + 40;
            continue;
        }
        let (kind, mut body) = (whole[at], whole[at + 9..at + 9 + len].to_vec());
        at += 9 + len;
        if [mcap::records::op::SCHEMA, mcap::records::op::MESSAGE_INDEX].contains(&kind) {
            continue;
        }
        let channel = u16::from_le_bytes([body[0], body[1]]);
        if kind == mcap::records::op::CHANNEL {
            body[2..4].fill(0);
        }
        if kind == mcap::records::op::CHANNEL && String::from_utf8_lossy(&body).contains("panoscope.packet") {
            packets.insert(channel);
        }
        if kind == mcap::records::op::MESSAGE {
            if packets.contains(&channel) {
                body.drain(22 + 56..22 + 72);
            } else {
                body.truncate(body.len() - 27);
                body.push(b'}');
                let json = String::from_utf8(body.split_off(22)).expect("JSON");
                body.extend(json.replacen("\"format\":5", "\"format\":1", 1).into_bytes());
            }
        }
        out.push(kind);
        out.extend((body.len() as u64).to_le_bytes());
        out.extend(body);
    }
    out.extend(&whole[at..at + 9]);
    // No checksum of the data.
    out.extend([0; 4]);
    out.extend(&whole[at + 13..]);
    out
}

#[test]
fn recordings_of_format_1_replay_with_a_warning_about_missing_checksums() {
    let file = scratch("new_format.mcap");
    let original = record_uncompressed(&file).digests.expect("fingerprints");
    let old = scratch("old_format.mcap");
    std::fs::write(&old, without_checksums(&file)).expect("written");
    let recording = Arc::new(Recording::open(&old).expect("an old recording"));
    assert_eq!((recording.head.format, recording.checked), (1, false));
    let replay = Replay::start(&recording, ReplayOptions::default()).unwrap_or_else(|e| panic!("{e}"));
    assert!(replay.warnings.iter().any(|w| w.contains("carry no checksums")), "{:?}", replay.warnings);
    drop(replay);
    assert_same("format 1", &original, &self::replay(&old, 2).unwrap_or_else(|e| panic!("{e}")));
}

/// A recording whose packets are described otherwise than its source declares them.
#[test]
fn a_recorded_packet_that_its_source_may_not_put_out_is_withheld() {
    let file = scratch("misfit.mcap");
    record_uncompressed(&file);
    // Rows that do not lie inside the packet, in a format without checksums: what a reader would take for its own memory.
    let mut bytes = without_checksums(&file);
    let old = scratch("misfit_old.mcap");
    std::fs::write(&old, &bytes).expect("written");
    let recording = Recording::open(&old).expect("an old recording");
    let packet = recording.ports["a.image"][7];
    let head = packet.at as usize - 56;
    // The stride, which the packet's own fingerprint does not cover for one row of pixels after the other.
    bytes[head + 16..head + 20].copy_from_slice(&3u32.to_le_bytes());
    std::fs::write(&old, &bytes).expect("written");
    let recording = Arc::new(Recording::open(&old).expect("an old recording"));
    let options = ReplayOptions { act: true, ..ReplayOptions::default() };
    let replay = Replay::start(&recording, options).unwrap_or_else(|e| panic!("{e}"));
    assert!(replay.engine().wait(Some(PATIENCE)));
    replay.engine().close(PATIENCE);
    let report = replay.engine().report();
    let ticks = recording.sources["a"].iter().filter(|t| t.admitted).count() as u64;
    assert_eq!((report.nodes["a"].faults, report.nodes["end"].count), (1, ticks - 1), "{:?}", report.nodes);
    let faults = replay.engine().recent_faults();
    assert!(faults.iter().any(|f| f.node == "a" && f.words.contains("3 bytes per row does not match")), "{faults:?}");
}

#[test]
fn files_that_are_not_recordings_are_errors() {
    let file = scratch("text.mcap");
    std::fs::write(&file, "name = \"panorama\"\n").expect("written");
    assert!(matches!(Recording::open(&file), Err(RecordingError::NoMcap { .. })));
    assert!(matches!(Recording::open(Path::new("nowhere.mcap")), Err(RecordingError::Unreadable { .. })));
    assert!(matches!(Recording::open(&common::scratch_dir()), Err(RecordingError::Unreadable { .. })));
    let foreign = mcap::WriteOptions::new().compression(None).create(std::io::Cursor::new(Vec::new()));
    let mut foreign = foreign.expect("memory");
    foreign.finish().expect("memory");
    std::fs::write(&file, foreign.into_inner().into_inner()).expect("written");
    let error = Recording::open(&file).expect_err("of another program");
    assert!(matches!(error, RecordingError::Foreign { .. }), "{error}");
}

/// A disk that becomes full.
struct Small {
    bytes: Arc<std::sync::Mutex<Vec<u8>>>,
    room: usize,
}

impl std::io::Write for Small {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let mut held = self.bytes.lock().expect("no panic");
        let n = bytes.len().min(self.room - held.len());
        if n == 0 && !bytes.is_empty() {
            return Err(std::io::Error::from(std::io::ErrorKind::StorageFull));
        }
        held.extend_from_slice(&bytes[..n]);
        Ok(n)
    }
    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

impl std::io::Seek for Small {
    fn seek(&mut self, _: std::io::SeekFrom) -> std::io::Result<u64> {
        Ok(self.bytes.lock().expect("no panic").len() as u64)
    }
}

impl panoscope_record::Output for Small {
    fn cut(&mut self, len: u64) -> std::io::Result<()> {
        self.bytes.lock().expect("no panic").truncate(len as usize);
        Ok(())
    }
}

#[test]
fn a_full_disk_is_reported_at_once_and_the_run_goes_on() {
    let text = [HEAD, &source("a", 400.0), &node("end", "drain", "a.image")].concat();
    let parsed = GraphText::parse("full.toml".as_ref(), &text);
    let loader = loader();
    let catalog = loader.catalog(&parsed.plugins());
    let (graph, _) = check(&parsed, &catalog).into_result().unwrap_or_else(|d| panic!("{}", d.render(false)));
    let head = head(&graph, &catalog, &loader, "full.toml".as_ref(), &text, &[]);
    let bytes = Arc::new(std::sync::Mutex::new(Vec::new()));
    let disk = Small { bytes: Arc::clone(&bytes), room: 12_345 };
    let recorder = Recorder::start_on(Some(Box::new(disk)), RecordOptions::default(), head).expect("it begins");
    let options = Options { observer: Some(Arc::clone(&recorder) as _), threads: 2, ..Options::default() };
    let engine = Engine::start(graph, &catalog, &loader, options).expect("it starts");
    let end = Instant::now() + PATIENCE;
    while !engine.recent_faults().iter().any(|f| f.node == "record") {
        assert!(Instant::now() < end, "the full disk is not reported");
        std::thread::sleep(Duration::from_millis(1));
    }
    assert!(engine.recent_log().iter().any(|(_, node, words)| node == "record" && words.contains("the run goes on")));
    let before = engine.report().nodes["end"].count;
    while engine.report().nodes["end"].count < before + 50 {
        assert!(Instant::now() < end, "the picture stands still");
        std::thread::sleep(Duration::from_millis(1));
    }
    engine.stop();
    assert!(engine.wait(Some(PATIENCE)));
    engine.close(PATIENCE);
    let recorded = recorder.finish();
    assert!(recorded.failed.is_some());
    let file = scratch("full.mcap");
    std::fs::write(&file, &*bytes.lock().expect("no panic")).expect("written");
    let recording = Recording::open(&file).expect("readable up to there");
    assert!(recording.cut.is_some() && recording.sources["a"].len() > 3, "{:?}", recording.cut);
    assert_eq!(bytes.lock().expect("no panic").len() as u64, recorded.bytes, "an incomplete message is removed");
}

#[test]
fn a_slow_disk_leaves_counted_gaps_and_never_blocks_the_run() {
    // A queue of all frames: a busy machine must not drop any of them.
    let end = node("end", "drain", "FROM").replace("\"FROM\"", "{ from = \"a.image\", queue = 60 }");
    let text = [HEAD, &source("a", 400.0), &end].concat();
    let parsed = GraphText::parse("gaps.toml".as_ref(), &text);
    let loader = loader();
    let catalog = loader.catalog(&parsed.plugins());
    let (graph, _) = check(&parsed, &catalog).into_result().unwrap_or_else(|d| panic!("{}", d.render(false)));
    let head = head(&graph, &catalog, &loader, "gaps.toml".as_ref(), &text, &[]);
    let file = scratch("gaps.mcap");
    // The queue holds nothing, so every tick is a gap.
    let record = RecordOptions { file: Some(file.clone()), max_queued_bytes: 0, ..RecordOptions::default() };
    let recorder = Recorder::start(record, head).expect("it begins");
    let options =
        Options { observer: Some(Arc::clone(&recorder) as _), threads: 2, frames: Some(50), ..Options::default() };
    let engine = Engine::start(graph, &catalog, &loader, options).expect("it starts");
    assert!(engine.wait(Some(PATIENCE)));
    engine.close(PATIENCE);
    assert_eq!(engine.report().nodes["end"].count, 50);
    assert!(engine.recent_faults().iter().any(|f| f.node == "record" && f.words.contains("too slow")));
    assert_eq!(recorder.finish().gaps, 50);
    let recording = Recording::open(&file).expect("readable");
    assert!(recording.sources["a"].iter().all(|t| t.gap));
    assert!(replay(&file, 2).expect("there is nothing to play").ports.is_empty());
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
