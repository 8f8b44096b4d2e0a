//! The demo graph live, with fifty changes while it runs, and a replay of the run: not a byte differs.
//!
//! `PANOSCOPE_RECORD_FRAMES` and `PANOSCOPE_RECORD_WIDTH` make the run longer and the frames larger.

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use panoscope_engine::Options;
use panoscope_graph::edit::GraphEdit;
use panoscope_host::loader::Live;
use panoscope_record::compare::compare;
use panoscope_record::{Digests, Event, RecordOptions, Recorder, Recording, Replay, ReplayOptions, head};
use panoscope_tests::{await_end, ready, root, scratch};

const PATIENCE: Duration = Duration::from_secs(600);
const CHANGES: u64 = 50;

fn number(variable: &str, default: u64) -> u64 {
    std::env::var(variable).ok().and_then(|v| v.parse().ok()).unwrap_or(default)
}

/// `graphs/panorama.toml` without its files, with smaller frames.
fn demo(width: u64) -> String {
    let file = root().join("graphs/panorama.toml");
    let text = std::fs::read_to_string(file).expect("the demo graph");
    let mut edit = GraphEdit::parse(&text).expect("TOML");
    let set = |edit: &mut GraphEdit| {
        edit.remove_node("video")?;
        edit.remove_node("still")?;
        edit.add_plugin("flow")?;
        edit.set_param("scope", "width", &toml::Value::Integer(width as i64))?;
        edit.set_param("scope", "height", &toml::Value::Integer((width * 3 / 4) as i64))?;
        // Faster than the graph can follow, so that ticks are dropped.
        edit.set_param("scope", "rate_hz", &toml::Value::Float(120.0))?;
        edit.add_node("end", "drain")?;
        edit.set_input("end", "image", &["wide.panorama"])
    };
    set(&mut edit).expect("nodes of the demo graph");
    edit.text()
}

/// Changes values, adds and removes a node, and moves inputs from one output to another.
fn change(live: &mut Live, number: u64) {
    let id = format!("extra{}", number / 5);
    let done = match number % 5 {
        0 => live.set_param("wide/composite", "blend_px", &toml::Value::Integer((number % 40) as i64)),
        1 => live.edit(|d| {
            d.add_node(&id, "pass")?;
            d.set_input(&id, "image", &["wide/composite.panorama"])?;
            d.add_node(&format!("{id}_end"), "drain")?;
            d.set_input(&format!("{id}_end"), "image", &[&format!("{id}.image")])
        }),
        2 => live.connect(&id, "image", &["scope.right"]),
        3 => live.set_param("wide/register", "scale", &toml::Value::Integer(1 + (number / 5 % 2) as i64)),
        _ => live.edit(|d| {
            d.remove_node(&format!("{id}_end"))?;
            d.remove_node(&id)
        }),
    };
    done.unwrap_or_else(|e| panic!("change {number}: {e}"));
}

fn record(file: &Path, frames: u64, width: u64) -> Digests {
    let path = root().join("graphs/recorded.toml");
    let text = demo(width);
    let ready = ready(&path, &text).unwrap_or_else(|mistakes| panic!("{mistakes}"));
    let options = RecordOptions {
        file: Some(file.to_owned()),
        digests: true,
        all_source_ports: false,
        ..RecordOptions::default()
    };
    let recorder = Recorder::start(options, head(&ready)).unwrap_or_else(|e| panic!("{e}"));
    let options = Options { frames: Some(frames), observer: Some(Arc::clone(&recorder) as _), ..Options::default() };
    let mut live = ready.start(options).unwrap_or_else(|e| panic!("{e}"));
    let engine = Arc::clone(live.engine());
    let begin = Instant::now();
    for number in 0..CHANGES {
        // Spread over the first nine tenths of the run.
        let at = number * frames * 9 / 10 / CHANGES;
        while engine.report().nodes["scope"].count < at {
            assert!(begin.elapsed() < PATIENCE, "the source makes no progress");
            std::thread::sleep(Duration::from_millis(1));
        }
        change(&mut live, number);
    }
    assert!(engine.wait(Some(PATIENCE)));
    drop(live);
    engine.close(PATIENCE);
    let report = engine.report();
    let recorded = recorder.finish();
    assert_eq!((recorded.gaps, recorded.failed), (0, None));
    println!(
        "recorded {} frames of {width} px in {:.1} s, {} dropped, {:.0} MB",
        report.frames,
        report.seconds,
        report.nodes["scope"].dropped,
        recorded.bytes as f64 / 1e6
    );
    recorded.digests.expect("fingerprints")
}

fn play(recording: &Arc<Recording>, threads: usize) -> Digests {
    let options = ReplayOptions {
        record: Some(RecordOptions { digests: true, ..RecordOptions::default() }),
        engine: Options { threads, ..Options::default() },
        act: true,
        ..ReplayOptions::default()
    };
    let replay = Replay::start(recording, options).unwrap_or_else(|e| panic!("{e}"));
    std::thread::scope(|scope| {
        let follows = scope.spawn(|| replay.follow());
        await_end(replay.engine(), |_| {});
        replay.engine().stop();
        follows.join().expect("no panic").unwrap_or_else(|e| panic!("{e}"));
    });
    replay.engine().close(PATIENCE);
    replay.verdict().unwrap_or_else(|e| panic!("{e}"));
    println!("{threads} threads: {:.1} s", replay.engine().report().seconds);
    replay.recorder().expect("it is recorded").finish().digests.expect("fingerprints")
}

#[test]
fn hundreds_of_frames_of_the_demo_with_fifty_changes_replay_to_the_byte() {
    let (frames, width) = (number("PANOSCOPE_RECORD_FRAMES", 500), number("PANOSCOPE_RECORD_WIDTH", 192));
    let folder = scratch("record");
    let file = folder.join("demo.mcap");
    let original = record(&file, frames, width);
    let recording = Arc::new(Recording::open(&file).unwrap_or_else(|e| panic!("{e}")));
    let edits = recording.events.iter().filter(|e| matches!(e, Event::Edit { .. })).count() as u64;
    assert_eq!(edits, CHANGES);
    for threads in [1, 2, 8] {
        let again = play(&recording, threads);
        let differing: Vec<_> = compare(&original, &again).into_iter().filter(|d| !d.is_nothing()).collect();
        assert!(differing.is_empty(), "on {threads} threads: {differing:#?}");
        assert_eq!(original.ports, again.ports);
    }
    println!("{} packets on {} ports, {edits} changes", original.packets(), original.ports.len());
    let _ = std::fs::remove_dir_all(&folder);
}
