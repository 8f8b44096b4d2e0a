//! Ages by the host's clock: whatever delays a frame, its reported age is true, and the arm does not follow an old one.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use panoscope_base::packet::Table;
use panoscope_engine::{Engine, Listener, Options};
use panoscope_host::loader::Live;
use panoscope_tests::{ready, scratch};

const PATIENCE: Duration = Duration::from_secs(120);
/// Number of the cause "the tip is too old" in the arm's table.
const OLD_TIP: f64 = 9.0;

/// The rows of a table output, by tick.
type Rows = Arc<Mutex<BTreeMap<u64, Vec<f64>>>>;

fn rows_of(rows: &Rows) -> BTreeMap<u64, Vec<f64>> {
    rows.lock().unwrap_or_else(PoisonError::into_inner).clone()
}

/// A running graph, with the rows of some table outputs.
struct Run {
    live: Live,
    rows: Vec<Rows>,
}

fn start(text: &str, listen: &[(&str, &str)]) -> Run {
    let path = Path::new("ages.toml");
    let ready = ready(path, text).unwrap_or_else(|mistakes| panic!("{mistakes}"));
    let rows: Vec<Rows> = listen.iter().map(|_| Rows::default()).collect();
    let listener = |((node, output), rows): (&(&str, &str), &Rows)| {
        let rows = Arc::clone(rows);
        let hear = move |frame: &panoscope_engine::memory::FrameRef| {
            let table = Table::parse(frame.bytes()).expect("a table");
            let row = table.values().collect();
            rows.lock().unwrap_or_else(PoisonError::into_inner).insert(frame.tick().seq, row);
        };
        Listener { node: (*node).to_owned(), output: (*output).to_owned(), hear: Arc::new(hear) }
    };
    let listen = listen.iter().zip(&rows).map(listener).collect();
    let options = Options { threads: 2, listen, ..Options::default() };
    Run { live: ready.start(options).unwrap_or_else(|error| panic!("{error}")), rows }
}

impl Run {
    fn engine(&self) -> &Engine {
        self.live.engine()
    }

    /// Waits until a row fulfils a condition, and returns its tick.
    fn until(&self, what: &str, table: usize, is: impl Fn(u64, &[f64]) -> bool) -> u64 {
        let end = Instant::now() + PATIENCE;
        loop {
            let rows = rows_of(&self.rows[table]);
            if let Some((seq, _)) = rows.iter().find(|(seq, row)| is(**seq, row)) {
                return *seq;
            }
            let last = || rows.iter().next_back().map(|(seq, row)| (*seq, row.clone()));
            assert!(Instant::now() < end, "{what}: {:?} {:?}", last(), self.engine().recent_log());
            std::thread::sleep(Duration::from_millis(2));
        }
    }
}

/// A graph with tips of light of an age, and the arm that follows them.
fn arm(age_ms: f64, more: &str) -> String {
    format!(
        r#"
mode = "live"
plugins = ["fixtures", "arm", "flow"]
[nodes.scope]
type = "aged"
params = {{ age_ms = {age_ms:?}, media_ms = 20.0 }}
[nodes.pid]
type = "arm_pid"
inputs = {{ tip = "scope.tip", joints = {{ from = "arm.joints", delay = 1 }}, setpoint = {{ from = "arm.setpoint", delay = 1 }} }}
[nodes.arm]
type = "arm_sim"
inputs = {{ joints = "pid.joints", tip = "scope.tip" }}
{more}
"#
    )
}

#[test]
fn a_stream_that_buffers_is_as_old_as_its_light() {
    let ages = "[nodes.ages]\ntype = \"ages\"\ninputs = { image = \"scope.image\", tip = \"scope.tip\" }\n";
    let fresh = start(&arm(0.0, ages), &[("arm", "table")]);
    fresh.until("fresh light is followed", 0, |_, row| row[0] == 1.0);
    fresh.engine().close(PATIENCE);

    let run = start(&arm(2000.0, ages), &[("arm", "table"), ("ages", "table")]);
    run.until("half a second", 0, |seq, _| seq >= 25);
    run.engine().close(PATIENCE);
    let (arm, ages) = (rows_of(&run.rows[0]), rows_of(&run.rows[1]));
    assert!(arm.values().all(|row| row[0] == 0.0), "the arm never follows light of 2 s ago");
    assert!(arm.values().any(|row| row[1] == OLD_TIP), "{arm:?}");
    assert!(ages.values().all(|row| row[..3].iter().all(|ms| (2000.0..60_000.0).contains(ms))), "{ages:?}");
    let report = run.engine().report();
    let path = &report.paths["ages"];
    assert!(path.age_p50_ms >= 1900.0 && path.age_max_ms >= 2000.0, "{path:?}");
}

#[test]
fn the_report_of_a_run_gives_the_age_of_the_light() {
    let Some(program) = std::env::var_os("PANOSCOPE_BIN") else {
        return panoscope_testing::skipped!("PANOSCOPE_BIN names no program; `cargo xtask test` sets it");
    };
    let folder = scratch("ages_report");
    let (graph, report) = (folder.join("g.toml"), folder.join("report.json"));
    let text = "mode = \"live\"\nplugins = [\"fixtures\", \"flow\"]\n\
                [nodes.scope]\ntype = \"aged\"\nparams = { age_ms = 2000.0 }\n\
                [nodes.sink]\ntype = \"drain\"\ninputs = { image = \"scope.image\" }\n";
    std::fs::write(&graph, text).expect("a graph");
    let mut run = std::process::Command::new(program);
    let done = run.arg("run").arg(&graph).args(["--frames", "20", "--report"]).arg(&report).output();
    let done = done.expect("it starts");
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let report: serde_json::Value = serde_json::from_slice(&std::fs::read(&report).expect("a report")).expect("JSON");
    let age_ms = report["paths"]["sink"]["age_p50_ms"].as_f64().expect("a number");
    assert!((2000.0..60_000.0).contains(&age_ms), "{report}");
}

#[test]
fn ticks_kept_during_a_live_edit_look_as_old_as_they_are() {
    let folder = scratch("ages");
    let opened = folder.join("opened");
    let device = "[nodes.device]\ntype = \"device\"\ninputs = { image = \"scope.image\" }\n\
                  [nodes.ages]\ntype = \"ages\"\ninputs = { image = \"device.image\", tip = \"scope.tip\" }\n";
    let mut run = start(&arm(-1.0, device), &[("arm", "table"), ("ages", "table")]);
    run.until("the arm follows", 0, |_, row| row[0] == 1.0);
    // The device is closed, its successor takes its time: the region waits and keeps the ticks of its source.
    let name = opened.to_str().expect("text").to_owned();
    let rows = [Arc::clone(&run.rows[0]), Arc::clone(&run.rows[1])];
    let begin = Instant::now();
    std::thread::scope(|scope| {
        let watch = scope.spawn(|| {
            let mut last = (None, begin);
            // Until nothing has come out for 600 ms: 30 ticks are kept.
            loop {
                let newest = rows_of(&rows[0]).keys().next_back().copied();
                if newest != last.0 {
                    last = (newest, Instant::now());
                }
                if last.1.elapsed() >= Duration::from_millis(600) {
                    break;
                }
                assert!(begin.elapsed() < PATIENCE, "the edit holds nothing back");
                std::thread::sleep(Duration::from_millis(5));
            }
            let held = rows_of(&rows[0]).keys().next_back().copied().expect("a tick");
            std::fs::write(&opened, "").expect("a file");
            held
        });
        run.live.edit(|d| d.set_param("device", "open_when", &name.as_str().into())).expect("a good change");
        let held = watch.join().expect("no panic");
        let again = run.until("the arm follows again", 0, |seq, row| seq > held + 10 && row[0] == 1.0);
        run.until("ages too", 1, |seq, _| seq >= again);
        let (arm, ages) = (rows_of(&rows[0]), rows_of(&rows[1]));
        let old: Vec<u64> = ages.range(held + 1..).filter(|(_, row)| row[2] > 200.0).map(|(seq, _)| *seq).collect();
        assert!(old.len() >= 10, "they look fresh: {:?}", ages.range(held + 1..held + 40).collect::<Vec<_>>());
        let oldest = ages.range(held + 1..).map(|(_, row)| row[2]).fold(0.0, f64::max);
        assert!(oldest >= 500.0, "the first was kept for more than half a second: {oldest} ms");
        // Reported after 25 ms of media time: from the second tick on.
        for seq in old.iter().filter(|seq| **seq > held + 2) {
            assert_eq!(arm[seq][..2], [0.0, OLD_TIP], "tick {seq}, {:?}", ages[seq]);
        }
    });
    run.engine().close(PATIENCE);
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn values_of_earlier_ticks_keep_the_age_of_their_light() {
    let text = r#"
mode = "live"
plugins = ["fixtures", "flow"]
[nodes.scope]
type = "aged"
params = { age_ms = 0.0, media_ms = 20.0 }
[nodes.hold]
type = "hold"
params = { every = 1000000 }
inputs = { image = "scope.image" }
[nodes.says]
type = "hold"
params = { every = 1000000 }
inputs = { image = "scope.image" }
[nodes.pass]
type = "pass"
inputs = { image = "hold.image" }
[nodes.held]
type = "ages"
inputs = { image = "pass.image", tip = "scope.tip" }
[nodes.declared]
type = "ages"
inputs = { image = "says.copy" }
[nodes.before]
type = "ages"
inputs = { image = { from = "pass.image", delay = 1 }, tip = "scope.tip" }
"#;
    let run = start(text, &[("held", "table"), ("declared", "table"), ("before", "table")]);
    let last = run.until("40 ticks", 2, |seq, _| seq >= 40);
    run.engine().close(PATIENCE);
    let media_ms = |seq: u64| seq as f64 * 20.0;
    let held = rows_of(&run.rows[0]);
    for (seq, row) in held.iter().filter(|(seq, _)| **seq >= 10 && **seq <= last) {
        // The picture is that of the first tick, forwarded again and again, through another node.
        assert!(row[1] - row[2] > 0.5 * media_ms(*seq), "tick {seq}: {row:?}");
        assert!(row[0] == row[2], "the tip is of this tick: {row:?}");
    }
    for (seq, row) in rows_of(&run.rows[1]).iter().filter(|(seq, _)| **seq >= 10) {
        assert!((row[1] - row[0] - media_ms(*seq)).abs() < 0.02, "tick {seq}: the node said so: {row:?}");
    }
    for (seq, row) in rows_of(&run.rows[2]).iter().filter(|(seq, _)| **seq >= 10) {
        assert!(row[1] > row[2] + 0.5 * media_ms(*seq), "the delayed picture of tick {seq}: {row:?}");
    }
}

/// Mean distance of the camera behind an instrument that moves to and fro at 12 mm/s, mm, while it does not turn, and the maximum time between two
/// frames in which its tip is found, ms. `rate` limits the node that finds it.
fn behind_mm(rate: &str) -> (f64, f64) {
    const TICKS: u64 = 480;
    let text = format!(
        r#"
mode = "batch"
plugins = ["phantom", "tools", "arm"]
[nodes.scope]
type = "phantom"
inputs = {{ camera_pose = {{ from = "arm.camera_pose", delay = 1 }} }}
params = {{ seed = 7, distance_mm = 85.0, width = 160, height = 120, tools = 1, tool_kinds = "grasper", tool_motion = "ramp" }}
[nodes.find]
type = "tool_tip"
inputs = {{ instances = "scope.instances", depth = "scope.depth", calibration = "scope.calibration" }}
{rate}
[nodes.follow]
type = "tip_track"
inputs = {{ tip = [{{ from = "find.tip", align = "latest" }}], camera_pose = {{ from = "arm.camera_pose", delay = 1 }}, calibration = "scope.calibration" }}
[nodes.pid]
type = "arm_pid"
inputs = {{ tip = "follow.tip", joints = {{ from = "arm.joints", delay = 1 }}, setpoint = {{ from = "arm.setpoint", delay = 1 }}, calibration = "scope.calibration" }}
[nodes.arm]
type = "arm_sim"
inputs = {{ joints = "pid.joints", tip = "follow.tip" }}
params = {{ max_age_ms = 300.0 }}
[nodes.judge]
type = "evaluate_arm"
inputs = {{ tip = "scope.lead", arm = "arm.table", track = "follow.table", calibration = "scope.calibration" }}
"#
    );
    let run = start(&text, &[("judge", "table")]);
    run.until("the instrument went to and fro", 0, |seq, _| seq >= TICKS);
    run.engine().close(PATIENCE);
    let rows = rows_of(&run.rows[0]);
    let (mut sum_mm, mut count, mut gap_ms) = (0.0, 0.0, 0.0_f64);
    for row in rows.range(120..=TICKS).map(|(_, row)| row) {
        assert_eq!(row.len(), 13, "one row per tick");
        // The phantom turns round every 3 s; the arm needs a while to follow.
        let phase = ((row[0] - 2.0) / 6.0 + 0.25).fract();
        let to_right = if phase < 0.5 { 1.0 } else { -1.0 };
        gap_ms = gap_ms.max(row[11]);
        if phase % 0.5 > 0.2 && row[2].is_finite() {
            sum_mm += to_right * row[2] * 66.0 / 187.5;
            count += 1.0;
        }
    }
    assert!(count > 100.0, "{count} rows");
    (sum_mm / count, gap_ms)
}

#[test]
fn the_time_since_a_tip_was_seen_is_predicted_once() {
    let (always, gap_ms) = behind_mm("");
    assert!(gap_ms < 1.0 && always.abs() < 0.8, "{always} mm, {gap_ms} ms");
    let (seldom, gap_ms) = behind_mm("max_rate_hz = 5");
    // Twice would lead by the way of 80 ms, the mean time since the tip was seen: 1 mm.
    assert!(gap_ms > 150.0 && (seldom - always).abs() < 0.5, "{seldom} mm at 5 Hz, {always} mm in every picture");
}
