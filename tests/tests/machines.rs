//! Nodes on other machines: the same bytes, and what happens to a graph when the machine or the network fails.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use panoscope_engine::fault::Fault;
use panoscope_engine::memory::FrameRef;
use panoscope_engine::{Engine, Listener, Options, Outcome, StartError};
use panoscope_tests::machines::{Machine, Namespace, Relay, free_port, program, random};
use panoscope_tests::{DisturbedRun, load, run_disturbed, scratch};

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

/// Starts and closes a graph. Returns why it does not start.
fn refusal(folder: &Path, text: &str) -> String {
    let (graph, catalog, loader) =
        load(&folder.join("graph.toml"), text).unwrap_or_else(|mistakes| panic!("{mistakes}"));
    let options = Options { frames: Some(1), graph_dir: folder.to_owned(), ..Options::default() };
    match Engine::start(graph, &catalog, &loader, options) {
        Ok(engine) => panic!("it starts: {:?}", engine.recent_log()),
        Err(StartError::Open { reason, .. }) => reason,
        Err(other) => other.to_string(),
    }
}

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

#[test]
fn a_machine_that_does_not_answer_is_named() {
    let folder = scratch("machines-silent");
    let address = format!("tcp/127.0.0.1:{}", free_port());
    let begin = Instant::now();
    let words = refusal(&folder, &(ONE.to_owned() + &machine(&address, "")));
    assert!(words.contains("machine `rack` is lost") && words.contains(&address), "{words}");
    assert!(words.contains("is `panoscope serve` running there?"), "{words}");
    assert!(begin.elapsed() < Duration::from_secs(20), "it fails soon");
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn a_graph_with_a_model_on_a_machine_is_checked_without_that_machine() {
    let folder = scratch("machines-check");
    let Some(program) = program() else { return panoscope_testing::skipped!("there is no program `panoscope`") };
    let text = format!(
        "mode = \"live\"\nplugins = [\"phantom\", \"tools\", \"flow\"]\n[nodes.scope]\ntype = \"phantom\"\n[nodes.find]\ntype = \"yolo\"\n\
         on = \"rack\"\ninputs = {{ image = {{ from = \"scope.left\", align = \"latest\" }} }}\n[nodes.end]\ntype = \"drain\"\n\
         inputs = {{ image = \"scope.left\" }}\n{}",
        machine(&format!("tcp/127.0.0.1:{}", free_port()), "")
    );
    let graph = folder.join("graph.toml");
    std::fs::write(&graph, text).expect("a file");
    let done = Command::new(program).arg("check").arg(&graph).output().expect("it runs");
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn another_build_of_a_plugin_is_refused_with_both_hashes() {
    let folder = scratch("machines-plugin");
    let Some(program) = program() else { return panoscope_testing::skipped!("there is no program `panoscope`") };
    let plugins = std::env::var_os("PANOSCOPE_PLUGIN_PATH")
        .and_then(|list| std::env::split_paths(&list).next())
        .unwrap_or_else(|| program.with_file_name("plugins"));
    let other = folder.join("plugins");
    std::fs::create_dir_all(&other).expect("a folder");
    let Some(flow) = std::fs::read_dir(&plugins).ok().and_then(|entries| {
        entries.flatten().map(|entry| entry.path()).find(|path| path.to_string_lossy().ends_with("flow.so"))
    }) else {
        return panoscope_testing::skipped!("there is no plugin `flow` in {}", plugins.display());
    };
    let mut bytes = std::fs::read(&flow).expect("a plugin");
    bytes.push(0);
    std::fs::write(other.join(flow.file_name().expect("a name")), bytes).expect("a plugin");
    let port = free_port();
    let variable = format!("PANOSCOPE_PLUGIN_PATH={}", other.display());
    let _rack = Machine::start(&["env", &variable], "rack", &format!("tcp/127.0.0.1:{port}"), &[], &folder);
    let words = refusal(&folder, &(ONE.to_owned() + &machine(&format!("tcp/127.0.0.1:{port}"), PATIENT)));
    let hashes = words.split(|c: char| !c.is_ascii_hexdigit()).filter(|word| word.len() == 64).count();
    assert!(words.contains("differs") && words.contains("install the same build") && hashes == 2, "{words}");
    let _ = std::fs::remove_dir_all(&folder);
}

/// Creates keys for machines; `None` if there is no program.
fn keys(folder: &Path, names: &[&str]) -> Option<PathBuf> {
    let keys = folder.join("keys");
    let made = Command::new(program()?).arg("keys").arg(&keys).args(names).output().expect("it runs");
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    Some(keys)
}

/// Runs a graph with the keys of a host, in a separate process, because the environment variable belongs to the process.
fn run_as(folder: &Path, keys: &Path, text: &str) -> (bool, String) {
    run_frames_as(folder, keys, text, 20)
}

/// The same with a number of frames.
fn run_frames_as(folder: &Path, keys: &Path, text: &str, frames: u64) -> (bool, String) {
    let graph = folder.join("graph.toml");
    std::fs::write(&graph, text).expect("a file");
    let mut command = Command::new(program().expect("a program"));
    command.args(["run", "--headless", "--frames", &frames.to_string()]).arg(&graph).env("PANOSCOPE_KEYS", keys);
    let done = command.output().expect("it runs");
    (done.status.success(), String::from_utf8_lossy(&done.stdout).into_owned() + &String::from_utf8_lossy(&done.stderr))
}

#[test]
fn only_machines_with_certificates_and_permission_connect() {
    let folder = scratch("machines-keys");
    let Some(keys) = keys(&folder, &["theatre", "ward", "rack=127.0.0.1"]) else {
        return panoscope_testing::skipped!("there is no program `panoscope`");
    };
    let strangers = folder.join("strangers");
    std::fs::create_dir_all(&strangers).expect("a folder");
    let strangers = self::keys(&strangers, &["theatre"]).expect("a program");
    let address = format!("tls/127.0.0.1:{}", free_port());
    let rack = keys.join("rack").display().to_string();
    let machines = ["--allow", "theatre", "--keys", &rack];
    let _rack = Machine::start(&[], "rack", &address, &machines, &folder).expect("a program");
    let text = ONE.to_owned() + &machine(&address, PATIENT);
    let (done, words) = run_as(&folder, &keys.join("theatre"), &text);
    assert!(done, "{words}");
    let (done, words) = run_as(&folder, &keys.join("ward"), &text);
    assert!(!done && words.contains("does not --allow this host"), "{words}");
    let (done, words) = run_as(&folder, &strangers.join("theatre"), &text);
    assert!(!done && words.contains("certificates of one authority"), "{words}");
    let (done, words) = run_as(&folder, &folder, &text);
    assert!(!done && words.contains("panoscope keys"), "{words}");
    let plain = text.replace("tls/", "tcp/");
    let (done, words) = run_as(&folder, &keys.join("theatre"), &plain);
    assert!(!done, "a server with certificates takes no host without: {words}");
    let _ = std::fs::remove_dir_all(&folder);
}

/// zenoh reads and writes a TLS connection from two threads without a lock; with the traffic of this graph that crashed or lost messages.
#[test]
fn many_pictures_pass_both_ways_through_one_encrypted_connection() {
    let folder = scratch("machines-busy-keys");
    let Some(keys) = keys(&folder, &["theatre", "rack=127.0.0.1"]) else {
        return panoscope_testing::skipped!("there is no program `panoscope`");
    };
    let address = format!("tls/127.0.0.1:{}", free_port());
    let rack = keys.join("rack").display().to_string();
    let rack = Machine::start(&[], "rack", &address, &["--allow", "theatre", "--keys", &rack], &folder);
    let mut text = "mode = \"batch\"\nplugins = [\"flow\", \"phantom\"]\n".to_owned();
    text += "[nodes.scope]\ntype = \"frames\"\nparams = { width_px = 640, height_px = 480, rate_hz = 1000.0 }\n";
    for at in 0..4 {
        text += &format!("[nodes.far{at}]\ntype = \"smooth\"\non = \"rack\"\nparams = {{ past_weight = 0 }}\n");
        text += "inputs = { image = \"scope.image\", past = \"scope.image\" }\n";
        text += &format!("[nodes.end{at}]\ntype = \"drain\"\ninputs = {{ image = \"far{at}.image\" }}\n");
    }
    text += &machine(&address, PATIENT);
    let (done, words) = run_frames_as(&folder, &keys.join("theatre"), &text, 100);
    assert!(done, "{words}\n{:?}", rack.expect("a program").log());
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn a_lost_machine_disturbs_no_other_node_and_comes_back() {
    let folder = scratch("machines-lost");
    let Some((rack, port)) = plain_machine(&folder) else { return };
    let address = format!("tcp/127.0.0.1:{port}");
    let text = ONE.to_owned() + &machine(&address, PATIENT);
    let mut rack = Some(rack);
    let (mut lost_at, mut at_return) = (None, None);
    let end = Instant::now() + PATIENCE;
    let run = run_disturbed(&folder, &text, Options::default(), |engine| {
        let count = |node: &str| engine.report().nodes[node].count;
        if lost_at.is_none() && count("end_far") >= 10 {
            // The whole machine goes.
            rack = None;
            lost_at = Some(count("end"));
        } else if rack.is_none() && lost_at.is_some_and(|lost_at| count("end") > lost_at + 60) {
            rack = Machine::start(&[], "rack", &address, &[], &folder);
            at_return = Some(count("end_far"));
        }
        let is_back = at_return.is_some_and(|before| count("end_far") > before + 10);
        if is_back || Instant::now() > end {
            engine.stop();
        }
    });
    assert!(at_return.is_some() && Instant::now() < end, "it came back: {:?}", run.faults);
    assert!(run.faults.iter().all(|fault| fault.node == "far"), "{:?}", run.faults);
    assert!(run.faults.iter().any(|fault| fault.words.contains("machine `rack` is lost")), "{:?}", run.faults);
    let seqs: Vec<u64> = run.packets["scope.right"].keys().copied().collect();
    assert!(seqs.windows(2).all(|pair| pair[1] == pair[0] + 1), "no picture of the main branch is lost: {seqs:?}");
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn what_accepts_and_closes_is_one_fault_for_each_attempt() {
    let folder = scratch("machines-closes");
    let Some((rack, port)) = plain_machine(&folder) else { return };
    const TIMEOUT_MS: f64 = 1000.0;
    let text = ONE.to_owned() + &machine(&format!("tcp/127.0.0.1:{port}"), "timeout_ms = 1000");
    let refused = |fault: &&Fault| fault.words.contains("refuses the connection");
    let (mut rack, end) = (Some(rack), Instant::now() + PATIENCE);
    let run = run_disturbed(&folder, &text, Options::default(), |engine| {
        if rack.is_some() && engine.report().nodes["end_far"].count >= 5 {
            // Something else listens in its place.
            rack = None;
            let listener = std::net::TcpListener::bind(("127.0.0.1", port)).expect("the port is free again");
            std::thread::spawn(move || listener.incoming().for_each(drop));
        }
        if engine.recent_faults().iter().filter(refused).count() >= 4 || Instant::now() > end {
            engine.stop();
        }
    });
    let faults: Vec<&Fault> = run.faults.iter().filter(refused).collect();
    assert!(faults.len() >= 4, "{:?}", run.faults);
    assert!(run.faults.iter().all(|fault| !fault.words.contains(".rs:")), "{:?}", run.faults);
    let pauses_ms: Vec<f64> = faults.windows(2).map(|pair| pair[1].run_ms - pair[0].run_ms).collect();
    assert!(pauses_ms.iter().all(|ms| *ms > 0.7 * TIMEOUT_MS), "{pauses_ms:?}");
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

/// A `panoscope run` without an end, and its log. Killed when dropped.
struct Host {
    child: Child,
    /// Lines of its standard error.
    log: Arc<Mutex<Vec<String>>>,
}

impl Host {
    fn start(command: &mut Command) -> Self {
        let mut child = command.stdin(Stdio::null()).stderr(Stdio::piped()).spawn().expect("it runs");
        let stream = child.stderr.take().expect("a pipe");
        let log = Arc::new(Mutex::new(Vec::new()));
        let lines = Arc::clone(&log);
        std::thread::spawn(move || {
            for line in BufReader::new(stream).lines().map_while(Result::ok) {
                lines.lock().unwrap_or_else(PoisonError::into_inner).push(line);
            }
        });
        Self { child, log }
    }

    fn log(&self) -> Vec<String> {
        self.log.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Waits for a condition while it runs.
    fn until(&mut self, what: &str, holds: impl Fn(&Self) -> bool) {
        let end = Instant::now() + PATIENCE;
        while !holds(self) {
            let ended = self.child.try_wait().expect("a child");
            assert!(ended.is_none() && Instant::now() < end, "{what}: {ended:?}, {:#?}", self.log());
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Interrupts it, as its user does.
    fn interrupt(mut self) -> ExitStatus {
        let sent = Command::new("kill").args(["-TERM", &self.child.id().to_string()]).status();
        assert!(sent.is_ok_and(|status| status.success()), "it takes a signal");
        let end = Instant::now() + PATIENCE;
        loop {
            if let Some(status) = self.child.try_wait().expect("a child") {
                return status;
            }
            assert!(Instant::now() < end, "it does not end: {:#?}", self.log());
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for Host {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Number of images `NAME_000000.png` and so on in a folder.
fn pictures_of(folder: &Path, name: &str) -> usize {
    let files = std::fs::read_dir(folder).expect("a folder").flatten().map(|entry| entry.file_name());
    let mine = |file: &str| file.strip_prefix(name).is_some_and(|rest| rest.starts_with('_') && rest.ends_with(".png"));
    files.filter(|file| mine(&file.to_string_lossy())).count()
}

#[test]
fn three_machines_in_namespaces_survive_a_cut_cable() {
    let folder = scratch("machines-namespaces");
    let (Some(one), Some(two)) = (Namespace::new(1), Namespace::new(2)) else {
        return panoscope_testing::skipped!("this user makes no network namespaces");
    };
    let names = [format!("rack={}", one.address), format!("attic={}", two.address)];
    let Some(keys) = keys(&folder, &["theatre", &names[0], &names[1]]) else {
        return panoscope_testing::skipped!("there is no program `panoscope`");
    };
    let start = |space: &Namespace, name: &str| {
        let own = keys.join(name).display().to_string();
        let address = format!("tls/{}:7447", space.address);
        let machine = Machine::start(&space.words(), name, &address, &["--allow", "theatre", "--keys", &own], &folder);
        (machine.expect("a program"), address)
    };
    let ((_rack, rack), (_attic, attic)) = (start(&one, "rack"), start(&two, "attic"));
    // What comes back is written, so that it can be counted while the graph runs. The queue of the main branch is shorter than the cut, and longer than
    // a loaded machine keeps a thread waiting.
    let text = format!(
        "mode = \"live\"\nplugins = [\"flow\", \"phantom\", \"sinks\"]\n\
         [nodes.scope]\ntype = \"phantom\"\nparams = {{ width = 96, height = 64 }}\n\
         [nodes.far]\ntype = \"pass\"\non = \"rack\"\ninputs = {{ image = {{ from = \"scope.left\", align = \"latest\" }} }}\n\
         [nodes.third]\ntype = \"pass\"\non = \"attic\"\ninputs = {{ image = {{ from = \"far.image\", align = \"latest\" }} }}\n\
         [nodes.end]\ntype = \"drain\"\ninputs = {{ image = {{ from = \"scope.right\", queue = 90 }} }}\n\
         [nodes.end_far]\ntype = \"write_images\"\ninputs = {{ image = \"far.image\" }}\nparams = {{ path = \"far_{{seq}}.png\" }}\n\
         [nodes.end_third]\ntype = \"write_images\"\ninputs = {{ image = \"third.image\" }}\nparams = {{ path = \"third_{{seq}}.png\" }}\n{}{}",
        machine(&rack, PATIENT),
        machine(&attic, PATIENT).replace("machines.rack", "machines.attic")
    );
    // The run takes the keys from the variable of its process.
    let graph = folder.join("graph.toml");
    std::fs::write(&graph, text).expect("a file");
    let report = folder.join("report.json");
    let mut command = Command::new(program().expect("a program"));
    command.args(["run", "--headless", "--report"]).arg(&report).arg(&graph);
    // The calls that the cut holds up end by the time-out of the machine, not by the watchdog.
    command.env("PANOSCOPE_KEYS", keys.join("theatre")).env("PANOSCOPE_HANG_MS", "60000");
    let mut host = Host::start(&mut command);
    let counts = || ["far", "third"].map(|name| pictures_of(&folder, name));
    host.until("30 pictures of each machine", |_| counts().iter().all(|count| *count > 30));
    let cut = Instant::now();
    one.set_joined(false);
    host.until("the loss of the rack, after more than its time-out", |host| {
        let is_lost = host.log().iter().any(|line| line.contains("machine `rack` is lost"));
        is_lost && cut.elapsed() > Duration::from_secs(5)
    });
    let at_loss = counts();
    one.set_joined(true);
    host.until("30 more of each", |_| counts().iter().zip(at_loss).all(|(now, before)| *now > before + 30));
    let status = host.interrupt();
    let report = std::fs::read_to_string(&report).expect("a report");
    let report: serde_json::Value = serde_json::from_str(&report).expect("JSON");
    let number = |node: &str, what: &str| report["nodes"][node][what].as_u64().expect("a number");
    let (made, done) = (number("scope", "made"), number("end", "count"));
    assert_eq!((done, number("scope", "dropped")), (made, 0), "the main branch: {report}");
    assert_eq!(number("third", "faults"), 0, "of the other machine: {report}");
    assert!(number("far", "faults") >= 1 && report["groups"]["rack"]["processes"].as_u64() >= Some(2), "{report}");
    assert!(number("end_far", "count") > 60 && number("end_third", "count") > 60, "{report}");
    assert_eq!(status.code(), Some(1), "a fault is a lost tick");
    let _ = std::fs::remove_dir_all(&folder);
}

/// Frames of an output by tick.
type Pictures = Arc<Mutex<BTreeMap<u64, Vec<u8>>>>;

/// A run with a node on another machine that makes a new frame from each one that arrives: the frames sent and made, and the number of bytes
/// transferred.
struct ColourRun {
    sent: BTreeMap<u64, Vec<u8>>,
    made: BTreeMap<u64, Vec<u8>>,
    bytes: u64,
    faults: usize,
    /// Number of connections that were made.
    connections: u64,
}

impl ColourRun {
    /// Runs until `is_done`, which is given the numbers of frames made so far and of connections.
    fn new(folder: &Path, machine: &str, mut is_done: impl FnMut(usize, u64) -> bool) -> Self {
        // What was made comes back as a second stream.
        let text = format!(
            "mode = \"live\"\nplugins = [\"flow\", \"phantom\"]\n[nodes.scope]\ntype = \"phantom\"\nparams = {{ width = 320, height = 240 }}\n\
             [nodes.far]\ntype = \"smooth\"\non = \"rack\"\nparams = {{ past_weight = 0 }}\n\
             inputs = {{ image = \"scope.left\", past = \"scope.left\" }}\n\
             [nodes.end]\ntype = \"drain\"\ninputs = {{ image = \"far.image\" }}\n{machine}"
        );
        let (graph, catalog, loader) =
            load(&folder.join("graph.toml"), &text).unwrap_or_else(|mistakes| panic!("{mistakes}"));
        let (sent, made) = (Pictures::default(), Pictures::default());
        let listen = [("scope", "left", &sent), ("far", "image", &made)].map(|(node, output, pictures)| {
            let pictures = Arc::clone(pictures);
            let hear = move |frame: &FrameRef| {
                pictures.lock().expect("no panic").insert(frame.tick().seq, frame.bytes().to_vec());
            };
            Listener { node: node.to_owned(), output: output.to_owned(), hear: Arc::new(hear) }
        });
        let options = Options { listen: listen.into(), graph_dir: folder.to_owned(), ..Options::default() };
        let engine = Engine::start(graph, &catalog, &loader, options).unwrap_or_else(|error| panic!("{error}"));
        let (mut link, mut connections) = (None, 0);
        let end = Instant::now() + PATIENCE;
        let _ = engine.watch(Duration::from_millis(20), |engine| {
            let rack = &engine.report().groups["rack"];
            link = rack.link.clone().or(link.take());
            connections = rack.processes;
            let count = made.lock().expect("no panic").len();
            if is_done(count, connections) {
                engine.stop();
            }
            let log = engine.recent_log();
            assert!(Instant::now() < end, "{count} pictures, {connections} connections, then none: {log:?}");
            Ok::<_, ()>(())
        });
        engine.close(Duration::from_secs(30));
        let link = link.expect("a link");
        let take = |pictures: &Pictures| std::mem::take(&mut *pictures.lock().expect("no panic"));
        let (sent, made) = (take(&sent), take(&made));
        let bytes = link.sent_bytes + link.received_bytes;
        Self { sent, made, bytes, faults: engine.recent_faults().len(), connections }
    }

    /// Peak signal-to-noise ratio of the worst frame, dB.
    fn worst_db(&self) -> f64 {
        let psnr_db = |(seq, picture): (&u64, &Vec<u8>)| {
            let pairs = picture.iter().zip(&self.sent[seq]);
            let squares = pairs.map(|(a, b)| u64::from(a.abs_diff(*b)).pow(2)).sum::<u64>();
            10.0 * (255.0 * 255.0 * picture.len() as f64 / squares.max(1) as f64).log10()
        };
        self.made.iter().map(psnr_db).fold(f64::INFINITY, f64::min)
    }
}

#[test]
fn colour_pictures_as_h264_are_close_to_what_was_sent_and_far_fewer_bytes() {
    let folder = scratch("machines-h264");
    let Some(space) = Namespace::new(1) else {
        return panoscope_testing::skipped!("this user makes no network namespaces");
    };
    let address = format!("tcp/{}:7447", space.address);
    let Some(_rack) = Machine::start(&space.words(), "rack", &address, &["--plaintext"], &folder) else {
        return panoscope_testing::skipped!("there is no program `panoscope`");
    };
    let run = |pixels: &str| {
        let more = format!("plaintext = true\ntimeout_ms = 5000\npixels = \"{pixels}\"");
        // However long they take: a live graph on a loaded machine drops some.
        let run = ColourRun::new(&folder, &machine(&address, &more), |made, _| made >= 30);
        assert!(run.made.len() > 20 && run.faults == 0, "{} pictures, {} faults", run.made.len(), run.faults);
        run
    };
    let raw = run("raw");
    assert!(raw.made.iter().all(|(seq, picture)| raw.sent[seq] == *picture), "raw pixels arrive as they are");
    let coded = run("h264");
    let bytes = [&raw, &coded].map(|run| run.bytes / run.made.len() as u64);
    let worst_db = coded.worst_db();
    println!("PSNR {worst_db:.1} dB at least, coded twice; {} bytes per picture, {} as they are", bytes[1], bytes[0]);
    assert!(worst_db > 30.0, "{worst_db} dB");
    assert!(worst_db < 80.0, "truly coded");
    assert!(bytes[1] * 4 < bytes[0], "{bytes:?}");
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn streams_of_h264_begin_anew_with_each_connection() {
    let folder = scratch("machines-h264-lost");
    let Some((_rack, port)) = plain_machine(&folder) else { return };
    let relay = Relay::start(([127, 0, 0, 1], port).into(), 1);
    // Longer than the run: the end of a connection is noticed, not waited for.
    let more = "timeout_ms = 60000\npixels = \"h264\"";
    let (mut at_loss, mut at_return) = (None, None);
    let run = ColourRun::new(&folder, &machine(&format!("tcp/{}", relay.address), more), |made, connections| {
        if at_loss.is_none() && made >= 10 {
            relay.weather.resets.fetch_add(1, Ordering::Relaxed);
            at_loss = Some(made);
        }
        if at_return.is_none() && connections >= 2 {
            at_return = Some(made);
        }
        at_return.is_some_and(|before| made > before + 10)
    });
    let (last, connections) = (run.made.len(), run.connections);
    assert!(
        connections >= 2 && at_loss.is_some_and(|made| last > made + 10),
        "{at_loss:?} of {last}, {connections} connections"
    );
    let worst_db = run.worst_db();
    assert!(worst_db > 30.0, "no picture after the loss is made of one that was lost: {worst_db} dB");
    let _ = std::fs::remove_dir_all(&folder);
}

/// Faults of the network at random moments: each frame that arrives is correct, and every node works again in the end.
///
/// `PANOSCOPE_NETWORK_FAULTS` is their number, `PANOSCOPE_NETWORK_SEED` selects others.
#[test]
fn no_fault_of_the_network_makes_a_wrong_picture() {
    let number =
        |name: &str, otherwise: u64| std::env::var(name).ok().and_then(|n| n.parse().ok()).unwrap_or(otherwise);
    let (faults, seed) = (number("PANOSCOPE_NETWORK_FAULTS", 6), number("PANOSCOPE_NETWORK_SEED", 1));
    const FRAMES: u64 = 60;
    const AT_ONCE: u64 = 6;
    let folder = scratch("machines-campaign");
    let Some((_rack, port)) = plain_machine(&folder) else { return };
    let home = run_disturbed(&folder, &at_home(FILTERS), options(FRAMES), |_| ());
    let (mut made, mut state, mut delivered, mut lost) = (0, seed, 0, 0);
    while made < faults {
        let relay = Relay::start(([127, 0, 0, 1], port).into(), state);
        let pixels = if random(&mut state).is_multiple_of(2) { "raw" } else { "lz4" };
        let more = format!("pixels = \"{pixels}\"\ntimeout_ms = 300");
        let text = FILTERS.to_owned() + &machine(&format!("tcp/{}", relay.address), &more);
        let case = format!("seed {seed}, after {made} faults");
        let begin = made;
        let mut next = Instant::now() + Duration::from_millis(random(&mut state) % 200);
        let run = run_disturbed(&folder, &text, options(FRAMES), |_| {
            if Instant::now() < next || made >= faults || made >= begin + AT_ONCE {
                return;
            }
            made += 1;
            let weather = &relay.weather;
            match random(&mut state) % 5 {
                0 | 1 => _ = weather.resets.fetch_add(1, Ordering::Relaxed),
                2 => {
                    // Longer than the time after which a machine counts as lost, or shorter.
                    weather.is_parted.store(true, Ordering::Relaxed);
                    std::thread::sleep(Duration::from_millis(random(&mut state) % 600));
                    weather.is_parted.store(false, Ordering::Relaxed);
                }
                3 => weather.loses_one_of.store(50 + random(&mut state) % 100, Ordering::Relaxed),
                _ => {
                    weather.delay_us.store(random(&mut state) % 3_000, Ordering::Relaxed);
                    weather.jitter_us.store(random(&mut state) % 4_000, Ordering::Relaxed);
                }
            }
            next = Instant::now() + Duration::from_millis(random(&mut state) % 150);
        });
        for (port, packets) in &run.packets {
            // A source that fails loses no picture but a tick: it goes on with the picture after the last one that arrived.
            let is_source = port.starts_with("far.");
            // It says how old a picture is; where that is lost, it says so.
            let says_what_is_lost = |seq: &u64| port == "old.table" && !run.packets["here.image"].contains_key(seq);
            let right = |hash: &u64| home.packets[port].values().any(|known| known == hash);
            for (seq, hash) in packets {
                if is_source {
                    assert!(right(hash), "{case}: packet {seq} of {port}");
                    continue;
                }
                if !says_what_is_lost(seq) {
                    assert_eq!(home.packets[port].get(seq), Some(hash), "{case}: packet {seq} of {port}");
                }
            }
            delivered += packets.len();
            lost += home.packets[port].len() - packets.len();
        }
        for port in ["scope.left", "scope.right"] {
            assert_eq!(run.packets[port], home.packets[port], "{case}: nothing of the nodes here is lost");
        }
        let there = ["passes", "rectify", "marks", "old", "far"];
        assert!(run.faults.iter().all(|fault| there.contains(&fault.node.as_str())), "{case}: {:?}", run.faults);
    }
    println!("{made} faults of the network: {delivered} packets delivered, none wrong, {lost} lost with their ticks");
    assert!(delivered > 0);
    let _ = std::fs::remove_dir_all(&folder);
}
