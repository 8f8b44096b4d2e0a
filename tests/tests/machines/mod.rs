//! Nodes on other machines: the same bytes, and what happens to a graph when the machine or the network fails.

mod faults;
mod h264;
mod keys;
mod namespaces;
mod refusals;

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use panoscope_engine::{Options, Outcome};
use panoscope_tests::machines::{Machine, Relay, free_port};
use panoscope_tests::{DisturbedRun, run_disturbed, scratch};

/// On the other machine: a filter that forwards, one that makes frames, one that writes to its input's pixels, one that asks for ages, and a source
/// with a clock. Here: one filter between two of the other machine.
const FILTERS: &str = r#"
mode = "batch"
plugins = ["flow", "phantom", "stereo", "overlay", "fixtures"]
[nodes.scope]
type = "phantom"
params = { width = 160, height = 120 }
[nodes.passes]
type = "pass"
on = "rack"
inputs = { image = "scope.left" }
[nodes.rectify]
type = "rectify"
on = "rack"
inputs = { left = "scope.left", right = "scope.right", calibration = "scope.calibration" }
[nodes.marks]
type = "overlay"
on = "rack"
inputs = { image = "passes.image", detections = "scope.detections" }
[nodes.here]
type = "pass"
inputs = { image = "rectify.left" }
[nodes.old]
type = "ages"
on = "rack"
inputs = { image = "here.image" }
[nodes.far]
type = "phantom"
on = "rack"
params = { width = 96, height = 64, seed = 3 }
[nodes.end]
type = "drain"
inputs = { image = "marks.image" }
[nodes.end_far]
type = "drain"
inputs = { image = "far.right" }
"#;

const ONE: &str = r#"
mode = "live"
plugins = ["flow", "phantom"]
[nodes.scope]
type = "phantom"
params = { width = 96, height = 64 }
[nodes.far]
type = "pass"
on = "rack"
inputs = { image = { from = "scope.left", align = "latest" } }
[nodes.end]
type = "drain"
inputs = { image = "scope.right" }
[nodes.end_far]
type = "drain"
inputs = { image = "far.image" }
"#;

/// Maximum time to wait for a condition.
const PATIENCE: Duration = Duration::from_secs(60);
/// Timeout for a loaded machine, on which a connection may take seconds.
const PATIENT: &str = "timeout_ms = 5000";

fn machine(address: &str, more: &str) -> String {
    format!("[machines.rack]\naddress = \"{address}\"\n{more}\n")
}

fn at_home(text: &str) -> String {
    text.lines().filter(|line| !line.starts_with("on =")).map(|line| format!("{line}\n")).collect()
}

fn options(frames: u64) -> Options {
    Options { frames: Some(frames), ..Options::default() }
}

/// A machine without encryption on this computer; `None` if there is no program.
fn plain_machine(folder: &Path) -> Option<(Machine, u16)> {
    let port = free_port();
    let machine = Machine::start(&[], "rack", &format!("tcp/127.0.0.1:{port}"), &[], folder);
    if machine.is_none() {
        panoscope_testing::skipped!("there is no program `panoscope`");
    }
    Some((machine?, port))
}

#[test]
fn a_graph_makes_the_same_bytes_wherever_its_nodes_run() {
    let folder = scratch("machines-bytes");
    let Some((_rack, port)) = plain_machine(&folder) else { return };
    let home = run_disturbed(&folder, &at_home(FILTERS), options(12), |_| ());
    assert!(home.packets.values().map(BTreeMap::len).sum::<usize>() > 12 * 5);
    for pixels in ["raw", "lz4"] {
        let address = format!("tcp/127.0.0.1:{port}");
        let text = FILTERS.to_owned() + &machine(&address, &format!("pixels = \"{pixels}\"\n{PATIENT}"));
        let DisturbedRun { report, outcome, faults, packets } = run_disturbed(&folder, &text, options(12), |_| ());
        assert_eq!(outcome, Outcome::Done, "{faults:?}");
        assert!(faults.is_empty(), "{faults:?}");
        assert_eq!(packets, home.packets, "{pixels}");
        assert_eq!(report.nodes["marks"].copies, home.report.nodes["marks"].copies, "copies are counted as at home");
        assert_eq!(report.groups["rack"].processes, 1);
    }
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn refused_connections_are_logged_and_keep_no_host_out() {
    use std::io::Write;
    let folder = scratch("machines-refused");
    let Some((rack, port)) = plain_machine(&folder) else { return };
    for _ in 0..20 {
        let mut stranger = std::net::TcpStream::connect(("127.0.0.1", port)).expect("it listens");
        let _ = stranger.write_all(b"GET / HTTP/1.1\r\nHost: rack\r\n\r\n");
    }
    let text = FILTERS.to_owned() + &machine(&format!("tcp/127.0.0.1:{port}"), PATIENT);
    let run = run_disturbed(&folder, &text, options(2), |_| ());
    assert_eq!(run.outcome, Outcome::Done, "{:?}", run.faults);
    let end = Instant::now() + PATIENCE;
    while !rack.log().iter().any(|line| line.contains("refused: ")) {
        assert!(Instant::now() < end, "{:?}", rack.log());
        std::thread::sleep(Duration::from_millis(10));
    }
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn a_slow_and_lossy_network_changes_no_byte() {
    let folder = scratch("machines-slow");
    let Some((_rack, port)) = plain_machine(&folder) else { return };
    let home = run_disturbed(&folder, &at_home(FILTERS), options(8), |_| ());
    let relay = Relay::start(([127, 0, 0, 1], port).into(), 1);
    relay.weather.delay_us.store(2_000, Ordering::Relaxed);
    relay.weather.jitter_us.store(4_000, Ordering::Relaxed);
    relay.weather.loses_one_of.store(100, Ordering::Relaxed);
    let text = FILTERS.to_owned() + &machine(&format!("tcp/{}", relay.address), PATIENT);
    let run = run_disturbed(&folder, &text, options(8), |_| std::thread::sleep(Duration::from_millis(20)));
    assert_eq!((run.outcome, run.packets), (Outcome::Done, home.packets), "{:?}", run.faults);
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn ages_of_light_from_another_machine_count_its_way_here() {
    let folder = scratch("machines-ages");
    let Some((_rack, port)) = plain_machine(&folder) else { return };
    let relay = Relay::start(([127, 0, 0, 1], port).into(), 1);
    const DELAY_US: u64 = 40_000;
    relay.weather.delay_us.store(DELAY_US, Ordering::Relaxed);
    let text = format!(
        "mode = \"live\"\nplugins = [\"flow\", \"phantom\"]\n[nodes.far]\ntype = \"phantom\"\non = \"rack\"\n\
         params = {{ width = 96, height = 64 }}\n[nodes.end]\ntype = \"drain\"\ninputs = {{ image = \"far.left\" }}\n{}",
        machine(&format!("tcp/{}", relay.address), PATIENT)
    );
    let run = run_disturbed(&folder, &text, options(30), |_| ());
    assert_eq!(run.outcome, Outcome::Done, "{:?}", run.faults);
    let youngest_ms = run.report.paths["end"].age_p50_ms;
    assert!(youngest_ms >= DELAY_US as f64 / 1e3 * 0.9, "{youngest_ms} ms");
    let link = run.report.groups["rack"].link.clone().expect("also after the end of the connection");
    // Both clocks are one here.
    let offset_ns = link.clock_offset_ns.expect("it was measured");
    assert!(offset_ns.unsigned_abs() <= link.clock_uncertainty_ns, "{link:?}");
    assert!(link.clock_uncertainty_ns >= DELAY_US * 1000 && link.round_trip_ns >= 2 * DELAY_US * 1000, "{link:?}");
    assert!(link.received_bytes > 30 * 96 * 64 * 3, "{link:?}");
    let _ = std::fs::remove_dir_all(&folder);
}
