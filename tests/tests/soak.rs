//! Hours of a graph in minutes: `panoscope soak` runs cheap nodes as fast as possible, changes parameters, removes and adds sinks, kills an isolated
//! process, and has a window attached that never reads. Memory, threads, open files and waiting frames stay constant.
//!
//! `PANOSCOPE_SOAK_MINUTES` sets the duration; ten minutes make the ticks of more than twelve hours at 60 Hz.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::process::Command;

use panoscope_host::attach::message::Wanted;
use panoscope_host::attach::{Attachment, Target};
use panoscope_tests::machines::{free_port, program};
use panoscope_tests::scratch;
use std::time::Duration;

/// A graph with every kind of edge, an isolated node, sinks that begin parts, and an arm that is evaluated.
const GRAPH: &str = r#"mode = "live"
plugins = ["flow", "phantom", "arm", "tools", "sinks"]

[nodes.camera]
type = "frames"
params = { width_px = 32, height_px = 24 }
[nodes.isolated]
type = "pass"
isolate = "own"
inputs = { image = { from = "camera.image", align = "latest" } }
[nodes.calm]
type = "smooth"
inputs = { image = "camera.image" }
[nodes.third]
type = "every_nth"
inputs = { image = "calm.image" }
[nodes.end]
type = "drain"
inputs = { image = "third.image" }
[nodes.other_end]
type = "drain"
inputs = { image = "isolated.image" }

[nodes.scope]
type = "phantom"
params = { width = 64, height = 48, tools = 2 }
inputs = { camera_pose = { from = "arm.camera_pose", delay = 1 } }
[nodes.follow]
type = "tip_track"
inputs = { tip = ["scope.tip"], camera_pose = { from = "arm.camera_pose", delay = 1 }, calibration = "scope.calibration" }
[nodes.steer]
type = "arm_pid"
[nodes.steer.inputs]
tip = "follow.tip"
calibration = "scope.calibration"
joints = { from = "arm.joints", delay = 1 }
setpoint = { from = "arm.setpoint", delay = 1 }
[nodes.arm]
type = "arm_sim"
inputs = { tip = "follow.tip", joints = "steer.joints" }
[nodes.judge]
type = "evaluate_arm"
inputs = { tip = "scope.lead", arm = "arm.table", track = "follow.table", calibration = "scope.calibration" }
[nodes.boxes]
type = "write_table"
inputs = { detections = "scope.detections" }
params = { path = "boxes.json" }
[nodes.tips]
type = "write_table"
inputs = { tip = "follow.tip", table = "follow.table" }
params = { path = "tips.jsonl" }
[nodes.marks]
type = "write_table"
inputs = { table = "judge.table" }
params = { path = "marks.csv" }
"#;

/// Number of bytes after which a window stops reading.
const READ_BYTES: usize = 64 << 10;
const MINUTES: f64 = 0.15;
/// Memory of the phantom's scene.
const SCENE_MB: f64 = 40.0;
/// Number of samples that includes some without an edit.
const MIN_SAMPLES: usize = 30;

/// Forwards everything from windows to `to`, and only the beginning of the other direction.
fn relay_that_stops(listener: TcpListener, to: u16) {
    for window in listener.incoming().map_while(Result::ok) {
        let Ok(run) = TcpStream::connect(("127.0.0.1", to)) else { continue };
        let (Ok(mut from_window), Ok(mut to_run)) = (window.try_clone(), run.try_clone()) else { continue };
        std::thread::spawn(move || std::io::copy(&mut from_window, &mut to_run));
        std::thread::spawn(move || {
            let mut window = window;
            let (mut left, mut buffer) = (READ_BYTES, [0; 4096]);
            while left > 0 {
                match (&run).read(&mut buffer) {
                    Ok(count) if count > 0 && window.write_all(&buffer[..count]).is_ok() => {
                        left = left.saturating_sub(count)
                    }
                    _ => return,
                }
            }
            // Both connections stay open.
            loop {
                std::thread::park();
            }
        });
    }
}

/// State of a run at one time.
struct Sample {
    resident_mb: f64,
    frames: u64,
    waiting_mb: f64,
    threads: u32,
    open_files: u32,
}

fn sample(line: &str) -> Option<Sample> {
    let mut cells = line.split(',').skip(1);
    let resident_mb = cells.next()?.parse().ok()?;
    let frames = cells.next()?.parse().ok()?;
    let waiting_mb = cells.next()?.parse().ok()?;
    let mut cells = cells.skip(2);
    Some(Sample {
        resident_mb,
        frames,
        waiting_mb,
        threads: cells.next()?.parse().ok()?,
        open_files: cells.next()?.parse().ok()?,
    })
}

/// Minimum of some values: a temporary increase by an edit or a new process is not growth.
fn least(samples: &[Sample], value: impl Fn(&Sample) -> f64) -> f64 {
    samples.iter().map(value).fold(f64::INFINITY, f64::min)
}

#[test]
fn hours_leave_memory_threads_files_and_queues_level() {
    let Some(program) = program() else { return panoscope_testing::skipped!("there is no program `panoscope`") };
    let minutes = std::env::var("PANOSCOPE_SOAK_MINUTES").ok().and_then(|text| text.parse().ok()).unwrap_or(MINUTES);
    let folder = scratch("soak");
    std::fs::write(folder.join("graph.toml"), GRAPH).expect("a file");
    let port = free_port();
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let relay_port = listener.local_addr().expect("an address").port();
    std::thread::spawn(move || relay_that_stops(listener, port));
    let mut command = Command::new(program);
    command.current_dir(&folder).args(["soak", "graph.toml", "--headless", "--unpaced", "--csv", "samples.csv"]);
    command.args(["--minutes", &minutes.to_string(), "--edit-every", "0.1", "--kill-every", "0.5"]);
    command.args(["--attachable", &format!("tcp/127.0.0.1:{port}"), "--attachable-name", "rack"]);
    panoscope_testing::own_settings(&mut command, &folder);
    let window = Attachment::open(Target::find(&format!("rack@tcp/127.0.0.1:{relay_port}"), None).expect("a target"));
    let window = window.expect("a thread");
    let wanted =
        |node: &str, port: &str| Wanted { node: node.to_owned(), port: port.to_owned(), max_width: 640, group: 0 };
    window.request_packets(vec![wanted("camera", "image"), wanted("scope", "left")], Duration::from_millis(1));

    let output = command.output().expect("it runs");
    let log = String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
    assert!(!log.contains("panicked") && log.contains(", 0 refused; "), "{log}");
    assert!(log.contains("window"), "no window came: {log}");
    assert!(!log.contains("threads grow") && !log.contains("open files grow"), "{log}");

    let csv = std::fs::read_to_string(folder.join("samples.csv")).expect("a file");
    let samples: Vec<Sample> = csv.lines().skip(1).map(|line| sample(line).expect("numbers")).collect();
    let ticks = samples.last().map_or(0, |last| last.frames);
    println!("{ticks} ticks: {:.1} hours at 60 Hz", ticks as f64 / 60.0 / 3600.0);
    // Heaps and pools reach their size in the first third.
    let (warm, rest) = samples.split_at(samples.len() / 3);
    let (first, last) = rest.split_at(rest.len() / 2);
    assert!(!warm.is_empty() && !first.is_empty(), "{csv}");
    // An edit of the phantom has two scenes in memory while it opens: on a busy machine all samples of a short run may be of such moments.
    let opening_mb = if last.len() < MIN_SAMPLES { SCENE_MB } else { 0.0 };
    for (what, value, tolerated) in [
        ("resident MB", (|s: &Sample| s.resident_mb) as fn(&Sample) -> f64, 0.01 * warm[0].resident_mb + opening_mb),
        // A hundred frames that are on their way.
        ("MB of frames", |s| s.waiting_mb, 0.3),
        // Of a process that is starting. One that stays with each edit or kill would be dozens.
        ("threads", |s| f64::from(s.threads), 3.0),
        ("open files", |s| f64::from(s.open_files), 3.0),
    ] {
        let (before, after) = (least(first, value), least(last, value));
        println!("{what}: {before} to {after}");
        assert!(after <= before + tolerated, "{what}: {before} to {after}\n{csv}\n{log}");
    }
    let _ = std::fs::remove_dir_all(&folder);
}
