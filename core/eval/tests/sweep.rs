//! A parameter is swept: every frame counts, nothing is written, mistakes are named.

use crate::common;
use std::path::PathBuf;
use std::sync::Arc;

use crate::common::{loader, scratch};
use panoscope_engine::{Options, Outcome};
use panoscope_eval::sweep::{Point, Request, Sweep, SweepError, csv};
use panoscope_record::{RecordOptions, Recorder, Recording, head};

/// Pictures whose mean is known, and a sink that must not act.
fn graph() -> String {
    let ledger = scratch("swept.jsonl");
    format!(
        r#"mode = "live"
plugins = ["flow", "fixtures"]
[nodes.source]
type = "frames"
params = {{ width_px = 16, height_px = 8, pattern = "ramp", format = "gray8", rate_hz = 30.0 }}
[nodes.level]
type = "level"
inputs = {{ image = "source.image" }}
[nodes.shut]
type = "gate"
inputs = {{ image = "source.image" }}
[nodes.kept]
type = "ledger"
inputs = {{ images = ["shut.image"] }}
params = {{ path = "{}" }}
[nodes.heap]
type = "allocate"
inputs = {{ image = "source.image" }}
[preset]
views = ["source.image"]
pinned = [{{ param = "level.gain", range = [0.0, 2.0] }}]
"#,
        ledger.display()
    )
}

fn request(param: &str, measure: &str) -> Request {
    Request {
        path: PathBuf::from("swept.toml"),
        text: graph(),
        settings: Vec::new(),
        param: param.to_owned(),
        from: Some(0.0),
        to: Some(2.0),
        steps: 3,
        measure: measure.to_owned(),
        frames: 20,
        recording: None,
        threads: 1,
    }
}

fn points(request: Request) -> Vec<Point> {
    let sweep = Sweep::new(request, Arc::new(loader())).unwrap_or_else(|e| panic!("{e}"));
    let mut points = Vec::new();
    sweep.run(&|| false, |point| points.push(point)).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(points.len(), sweep.len());
    points
}

fn means(points: &[Point]) -> Vec<f64> {
    points.iter().map(|p| p.result.as_ref().unwrap_or_else(|why| panic!("{why}")).mean).collect()
}

#[test]
fn a_column_a_scalar_and_a_told_number_follow_the_parameter() {
    let column = points(request("level.gain", "level.levels.mean"));
    assert!(column.iter().all(|p| p.result.as_ref().is_ok_and(|s| (s.count, s.missing) == (20, 0))), "{column:?}");
    let values: Vec<&str> = column.iter().map(|p| p.value.as_str()).collect();
    assert_eq!(values, ["0.0", "1.0", "2.0"]);
    let mean = means(&column);
    assert_eq!(mean[0], 0.0);
    assert!(mean[1] > 5.0 && (mean[2] - 2.0 * mean[1]).abs() < 1e-9, "{mean:?}");
    assert_eq!(means(&points(request("level.gain", "level.level"))), mean, "the scalar says the same");
    assert_eq!(points(request("level.gain", "level.levels.mean")), column, "and the next time, too");
    let count = points(request("level.gain", "level.count"));
    assert_eq!(means(&count), [20.0, 20.0, 20.0], "a counter counts once, at the end");
    // A told number counts tick by tick, not once at the end: 1, 2, ... 20.
    let told = points(Request { from: Some(1.0), ..request("heap.count", "heap.allocated") });
    for (factor, point) in [1.0, 2.0].into_iter().zip(&told) {
        let summary = point.result.as_ref().unwrap_or_else(|why| panic!("{why}"));
        let seen = (summary.count, summary.mean, summary.min, summary.max);
        assert_eq!(seen, (20, 10.5 * factor, factor, 20.0 * factor));
    }
    assert_eq!(told.len(), 2);
    assert!(!scratch("swept.jsonl").exists(), "what acts on the world is left out");
    let csv = csv("level.gain", "level.levels.mean", &column);
    assert_eq!(csv.lines().count(), 4);
    assert!(csv.lines().nth(1).is_some_and(|l| l.starts_with("\"0.0\",0,0,0,0,0,20,0,")), "{csv}");
}

#[test]
fn a_run_with_failed_calls_says_how_many() {
    let level = "[nodes.level]\ntype = \"level\"\ninputs = { image = \"source.image\" }";
    let failing = "[nodes.fails]\ntype = \"failing\"\nparams = { first = 5 }\ninputs = { image = \"source.image\" }\n";
    let text = graph().replace(level, &format!("{failing}{}", level.replace("source.image", "fails.image")));
    let faulty = points(Request { text, ..request("level.gain", "level.levels.mean") });
    let failed = |p: &Point| p.result.as_ref().ok().map(|s| s.failed_calls);
    assert!(faulty.iter().all(|p| failed(p) == Some(1)), "{faulty:?}");
    let table = csv("level.gain", "level.levels.mean", &faulty);
    let mut lines = table.lines();
    assert!(lines.next().is_some_and(|head| head.ends_with(",last,failed_calls,failed")), "{table}");
    assert!(lines.all(|line| line.ends_with(",1,")), "{table}");
    assert!(points(request("level.gain", "level.levels.mean")).iter().all(|p| failed(p) == Some(0)));
}

#[test]
fn a_recording_stands_in_for_the_sources() {
    let text = graph().replace("rate_hz = 30.0", "rate_hz = 30.0, count = 12").replace("swept.jsonl", "acted.jsonl");
    let ready = common::ready("swept.toml", &text);
    let file = scratch("swept.mcap");
    let record = RecordOptions { file: Some(file.clone()), ..RecordOptions::default() };
    let recorder = Recorder::start(record, head(&ready)).expect("the file can be written");
    let options = Options { observer: Some(Arc::clone(&recorder) as _), ..Options::default() };
    let live = ready.start(options).expect("it starts");
    assert!(live.engine().wait(Some(common::PATIENCE)));
    assert_eq!(live.engine().close(common::PATIENCE), Outcome::Done);
    drop(live);
    recorder.finish();
    let recording = Arc::new(Recording::open(&file).expect("a recording"));
    let found = points(Request { recording: Some(recording), ..request("level.gain", "level.levels.max") });
    assert!(found.iter().all(|p| p.result.as_ref().is_ok_and(|s| s.count == 12)), "{found:?}");
    assert!(means(&found)[2] > means(&found)[1]);
}

#[test]
fn mistakes_are_named_before_anything_runs() {
    let refused = |param: &str, measure: &str| {
        let sweep = Sweep::new(request(param, measure), Arc::new(loader()));
        sweep.err().unwrap_or_else(|| panic!("{param} and {measure} are taken")).to_string()
    };
    assert!(
        refused("levl.gain", "level.level").contains("there is no node `levl`; nodes are source, level, shut, kept")
    );
    assert!(refused("level.gian", "level.level").contains("it has gain, window, spots"));
    assert!(refused("level.window", "level.level").contains("a list of numbers cannot be swept"));
    assert!(refused("level.gain", "level.levels").contains("name a column"));
    assert!(refused("level.gain", "source.image").contains("packets are image, without numbers"));
    assert!(refused("shut.open", "level.level").contains("`shut` is not upstream of"));
    assert!(refused("shut.open", "kept.count").contains("has side effects"));
    let far = Request { to: Some(9.0), ..request("level.gain", "level.level") };
    assert!(Sweep::new(far, Arc::new(loader())).is_err_and(|e| e.to_string().contains("outside 0 to 8")));
    let broken = Request { text: "nodes = 3".to_owned(), ..request("level.gain", "level.level") };
    assert!(matches!(Sweep::new(broken, Arc::new(loader())), Err(SweepError::Check(_))));
    assert!(refused("level.gain", "level.levels.mean[0]").contains("mean[1] for the first one"));
    // What only a run can tell ends the sweep at the first packet: the first run is not made to its end, the others not at all.
    let wrong = |measure: &str| {
        let endless = Request { frames: u64::MAX, ..request("level.gain", measure) };
        let sweep = Sweep::new(endless, Arc::new(loader())).unwrap_or_else(|e| panic!("{e}"));
        let mut points = 0;
        let error = sweep.run(&|| false, |_| points += 1).expect_err("there is no such measure");
        assert_eq!(points, 0);
        error.to_string()
    };
    assert!(wrong("level.levels.median").contains("columns are mean, min, max, spots"));
    let told =
        Sweep::new(request("level.gain", "level.sharpness"), Arc::new(loader())).unwrap_or_else(|e| panic!("{e}"));
    let error = told.run(&|| false, |_| panic!("nothing was measured")).expect_err("no such number").to_string();
    assert!(error.contains("reports no number `sharpness`; it reports level, p50_ms"), "{error}");
}

#[test]
fn a_sweep_ends_when_it_is_told_to() {
    let endless = Request { frames: u64::MAX, ..request("level.gain", "level.level") };
    let sweep = Sweep::new(endless, Arc::new(loader())).unwrap_or_else(|e| panic!("{e}"));
    let since = std::time::Instant::now();
    let mut points = 0;
    sweep.run(&|| since.elapsed().as_millis() > 300, |_| points += 1).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(points, 0);
    assert!(since.elapsed() < common::PATIENCE);
}
