//! Windows on other machines attached to a running graph: what they see and may do, and what happens to both when the network fails.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use panoscope_graph::ParamValue;
use panoscope_host::attach::message::Wanted;
use panoscope_host::attach::{Attachment, Contact, Target};
use panoscope_tests::machines::{Namespace, free_port, program};
use panoscope_tests::scratch;

/// A graph with 30 frames per second, and a node with a parameter.
const GRAPH: &str = r#"
mode = "live"
plugins = ["flow"]
[nodes.camera]
type = "frames"
params = { width_px = 320, height_px = 240 }
[nodes.level]
type = "level"
inputs = { image = { from = "camera.image", queue = 64 } }
params = { gain = 1.0 }
[nodes.end]
type = "drain"
inputs = { image = { from = "camera.image", queue = 64 } }
"#;

/// A `panoscope run` with its log; killed when dropped.
struct Run {
    child: Child,
    log: Arc<Mutex<Vec<String>>>,
}

impl Run {
    /// Starts it with `before` in front of the program, and waits until it listens; `None` if there is no program.
    fn start(before: &[&str], graph: &Path, arguments: &[&str]) -> Option<Self> {
        let program = program()?;
        let words = before.iter().map(|word| (*word).to_owned()).chain([program.display().to_string()]);
        let words: Vec<String> = words.collect();
        let mut command = Command::new(&words[0]);
        command.args(&words[1..]).args(["run", "--headless"]).args(arguments).arg(graph);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
        let mut child = command.spawn().unwrap_or_else(|error| panic!("{command:?}: {error}"));
        let stderr = child.stderr.take().expect("it is piped");
        let log = Arc::new(Mutex::new(Vec::new()));
        let lines = Arc::clone(&log);
        std::thread::spawn(move || {
            for line in BufReader::new(stderr).lines().map_while(Result::ok) {
                lines.lock().unwrap_or_else(PoisonError::into_inner).push(line);
            }
        });
        let this = Self { child, log };
        assert!(until(60, || this.says("windows attach to")), "it does not listen: {:?}", this.log());
        Some(this)
    }

    fn log(&self) -> Vec<String> {
        self.log.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn says(&self, words: &str) -> bool {
        self.log().iter().any(|line| line.contains(words))
    }
}

impl Drop for Run {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Waits for a condition; returns whether it became true.
fn until(seconds: u64, is_there: impl Fn() -> bool) -> bool {
    let end = Instant::now() + Duration::from_secs(seconds);
    while !is_there() {
        if Instant::now() > end {
            return false;
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    true
}

fn graph_file(folder: &Path) -> PathBuf {
    let file = folder.join("graph.toml");
    std::fs::write(&file, GRAPH).expect("a file");
    file
}

fn attach(name: &str, address: &str, keys: Option<PathBuf>) -> Attachment {
    let target = Target { keys, ..Target::find(&format!("{name}@{address}"), None).expect("a target") };
    Attachment::open(target).expect("a thread")
}

fn want(attachment: &Attachment) {
    let wanted = Wanted { node: "camera".to_owned(), port: "image".to_owned(), max_width: 160, group: 0 };
    attachment.request_packets(vec![wanted], Duration::from_millis(50));
}

/// Tick number of the next frame, and its age.
fn picture(attachment: &Attachment, seconds: u64) -> Option<(u64, Duration)> {
    let end = Instant::now() + Duration::from_secs(seconds);
    while Instant::now() < end {
        if let Some((packet, arrived_ns)) = attachment.take_packet("camera", "image") {
            assert_eq!(
                (packet.frame.frame().width, packet.frame.frame().height, packet.size_px),
                (160, 120, (320, 240))
            );
            let now_ns = i64::try_from(panoscope_engine::clock::now_ns()).expect("a time");
            let age_ns = now_ns - arrived_ns.expect("an age");
            return Some((packet.frame.tick().seq, Duration::from_nanos(age_ns.max(0).unsigned_abs())));
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    None
}

fn gain(attachment: &Attachment) -> Option<f64> {
    match attachment.values("level")?.first()? {
        ParamValue::Float(value) => Some(*value),
        _ => None,
    }
}

fn keys(folder: &Path, names: &[&str]) -> Option<PathBuf> {
    let keys = folder.join("keys");
    let made = Command::new(program()?).arg("keys").arg(&keys).args(names).output().expect("it runs");
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    Some(keys)
}

#[test]
fn a_window_on_another_machine_survives_a_cut_cable_and_the_graph_loses_nothing() {
    let folder = scratch("attach-namespaces");
    let Some(space) = Namespace::new(1) else {
        return panoscope_testing::skipped!("this user makes no network namespaces");
    };
    let Some(keys) = keys(&folder, &["desk", &format!("rack={}", space.address)]) else {
        return panoscope_testing::skipped!("there is no program `panoscope`");
    };
    let (address, report) = (format!("tls/{}:7448", space.address), folder.join("report.json"));
    let (own, report_file) = (keys.join("rack").display().to_string(), report.display().to_string());
    let arguments =
        ["--frames", "600", "--report", &report_file, "--attachable", &address, "--allow-edit", "desk", "--keys", &own];
    let mut run = Run::start(&space.words(), &graph_file(&folder), &arguments).expect("a program");
    let window = attach("rack", &address, Some(keys.join("desk")));
    assert!(window.wait_opened(Duration::from_secs(60)), "{:?} {:?}", window.state(), run.log());
    let opened = window.state().opened.expect("a graph");
    assert!(opened.may_edit && opened.text.trim() == GRAPH.trim(), "{}", opened.text);
    want(&window);
    let is_fresh = || picture(&window, 60).is_some_and(|(_, age)| age < Duration::from_secs(2));
    assert!(until(60, is_fresh), "no picture is younger than 2 s");
    let clock = window.state().clock.expect("it was measured");
    assert!(clock.offset_ns.unsigned_abs() <= clock.error_ns, "both clocks are one here: {clock:?}");
    // A parameter that is set here changes the running graph there.
    assert!(until(60, || gain(&window) == Some(1.0)), "{:?}", window.values("level"));
    let edited = opened.text.replace("gain = 1.0", "gain = 2.0");
    window.run(&opened.text, &edited, || true).unwrap_or_else(|refused| panic!("{refused:?}"));
    assert!(until(60, || gain(&window) == Some(2.0)), "{:?}", window.values("level"));
    // What was edited from another text is a conflict.
    let refused = window.run(&opened.text, &edited.replace("2.0", "3.0"), || true).expect_err("another text runs");
    assert!(refused.words.contains("changed elsewhere"), "{refused:?}");
    let mistake = edited.replace("type = \"level\"", "type = \"lever\"");
    let refused = window.run(&edited, &mistake, || true).expect_err("there is no such node");
    assert!(refused.words.contains("lever"), "{refused:?}");
    space.set_joined(false);
    let cut = Instant::now();
    // At least 5 s, so that a picture of before the cut can be recognized by its age.
    let is_lost = || cut.elapsed() > Duration::from_secs(5) && matches!(window.state().contact, Contact::Lost(_));
    assert!(until(60, is_lost), "{:?}", window.state());
    match window.state().contact {
        Contact::Lost(why) => assert!(why.contains("sent nothing for"), "{why}"),
        other => panic!("{other:?}"),
    }
    let problem = window.state().problem;
    assert!(problem.contains("is `panoscope run --attachable` running there?"), "{problem}");
    let joined = Instant::now();
    space.set_joined(true);
    assert!(until(60, || window.state().contact == Contact::Attached), "{:?}", window.state());
    let mut seen = Vec::new();
    // The first may be one that came before the cut: its age says so.
    while seen.last().is_none_or(|(_, age)| *age > Duration::from_secs(1)) {
        seen.push(picture(&window, 60).expect("a picture"));
    }
    println!("a new picture {} ms after the cable was joined: {seen:?}", joined.elapsed().as_millis());
    assert!(seen.iter().all(|(seq, age)| *seq >= 150 || *age >= Duration::from_secs(4)), "{seen:?}");
    assert_eq!(window.state().opened.map(|opened| opened.text.clone()), Some(edited), "the graph is as it was left");
    assert!(run.says("a window on `desk` is attached; it reads and edits") && run.says("is gone"), "{:?}", run.log());
    assert!(run.child.wait().expect("it ends").success(), "{:?}", run.log());
    assert!(until(60, || matches!(window.state().contact, Contact::Ended(_))), "{:?}", window.state());
    let report: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(&report).expect("a report")).expect("JSON");
    let number = |node: &str, what: &str| report["nodes"][node][what].as_u64().expect("a number");
    assert_eq!(
        (number("end", "count"), number("camera", "dropped"), number("level", "count")),
        (600, 0, 600),
        "{report}"
    );
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn unknown_machines_are_refused_and_readers_change_nothing() {
    let folder = scratch("attach-keys");
    let Some(keys) = keys(&folder, &["desk", "ward", "rack=127.0.0.1"]) else {
        return panoscope_testing::skipped!("there is no program `panoscope`");
    };
    let strangers = folder.join("strangers");
    std::fs::create_dir_all(&strangers).expect("a folder");
    let strangers = self::keys(&strangers, &["desk"]).expect("a program");
    let address = format!("tls/127.0.0.1:{}", free_port());
    let own = keys.join("rack").display().to_string();
    let arguments = ["--attachable", &address, "--allow-read", "desk", "--keys", &own];
    let run = Run::start(&[], &graph_file(&folder), &arguments).expect("a program");
    let reader = attach("rack", &address, Some(keys.join("desk")));
    assert!(reader.wait_opened(Duration::from_secs(60)), "{:?}", reader.state());
    want(&reader);
    assert!(picture(&reader, 60).is_some());
    let opened = reader.state().opened.expect("a graph");
    assert!(!opened.may_edit);
    let edited = opened.text.replace("gain = 1.0", "gain = 2.0");
    let refused = reader.run(&opened.text, &edited, || true).expect_err("it only reads");
    assert!(refused.words.contains("only read"), "{refused:?}");
    assert!(until(60, || gain(&reader) == Some(1.0)));
    for (name, keys, words) in [
        ("rack", keys.join("ward"), "lets no window of this machine attach"),
        ("rack", strangers.join("desk"), "certificates of one authority"),
        ("attic", keys.join("desk"), "its name is not `attic`"),
    ] {
        let window = attach(name, &address, Some(keys));
        assert!(until(60, || window.state().problem.contains(words)), "{words}: {:?}", window.state());
        assert!(window.state().opened.is_none());
    }
    assert!(run.says("a window on `desk` is attached; it reads"), "{:?}", run.log());
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn what_has_no_encryption_stays_on_this_machine() {
    let folder = scratch("attach-plain");
    let Some(program) = program() else { return panoscope_testing::skipped!("there is no program `panoscope`") };
    let refused = |address: &str| {
        let mut command = Command::new(&program);
        command.args(["run", "--headless", "--frames", "1", "--attachable", address]).arg(graph_file(&folder));
        let done = command.output().expect("it runs");
        assert!(!done.status.success());
        String::from_utf8_lossy(&done.stderr).into_owned()
    };
    let words = refused("tcp/0.0.0.0:7448");
    assert!(words.contains("without encryption"), "{words}");
    let words = refused("tls/127.0.0.1:7448");
    assert!(words.contains("panoscope keys") || words.contains("--allow-read"), "{words}");
    let address = format!("tcp/127.0.0.1:{}", free_port());
    let _run = Run::start(&[], &graph_file(&folder), &["--attachable", &address]).expect("a program");
    let window = attach("engine", &address, None);
    assert!(window.wait_opened(Duration::from_secs(60)), "{:?}", window.state());
    let _ = std::fs::remove_dir_all(&folder);
}
