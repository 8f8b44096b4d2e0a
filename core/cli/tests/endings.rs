//! How a run ends: exit code and last line, signals at any moment, plugins that take the program down.

use crate::common;
use std::ffi::{OsStr, OsString};
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

const PROGRAM: &str = env!("CARGO_BIN_EXE_panoscope");
const PATIENCE: Duration = Duration::from_secs(90);

/// Search path with the plugins of the graphs here.
fn plugin_path() -> &'static OsStr {
    static PATH: OnceLock<OsString> = OnceLock::new();
    PATH.get_or_init(|| common::built_plugins(&["flow", "fixtures"]))
}

#[test]
fn help_of_a_command_is_found_in_both_orders() {
    let help = |words: &[&str]| {
        let output = Command::new(PROGRAM).args(words).output().expect("it starts");
        assert!(output.status.success(), "{words:?}: {}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).expect("text")
    };
    assert_eq!(help(&["help", "record"]), help(&["record", "--help"]));
    assert!(help(&["help"]).contains("Usage: panoscope <COMMAND>"));
}

/// What the command prints belongs to a file as often as to a terminal.
#[test]
fn output_that_cannot_be_written_is_an_error_and_a_closed_pipe_is_none() {
    let shown = |stdout: Stdio| {
        let mut list = Command::new(PROGRAM);
        let output = list.arg("list").env("PANOSCOPE_PLUGIN_PATH", plugin_path()).stdout(stdout).output();
        let output = output.expect("it starts");
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let full = || Stdio::from(std::fs::File::options().write(true).open("/dev/full").expect("Linux has it"));
    let (code, said) = shown(full());
    assert!(code == Some(1) && said.contains("standard output cannot be written: No space left"), "{code:?}: {said}");
    let (reader, writer) = std::io::pipe().expect("a pipe");
    drop(reader);
    assert_eq!(shown(writer.into()), (Some(0), String::new()));
}

/// A folder of this test process.
fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("panoscope_endings_{}", std::process::id())).join(name);
    std::fs::create_dir_all(&folder).expect("temporary files can be written");
    folder
}

/// `source` -> `file` (a ledger), and `source` -> `bad` (chaos) -> `end`.
fn graph(folder: &Path, bad: &str) -> PathBuf {
    graph_in("live", folder, bad)
}

/// The same in a mode; in batch no tick is dropped, however busy the machine is.
fn graph_in(mode: &str, folder: &Path, bad: &str) -> PathBuf {
    let ledger = folder.join("ledger.jsonl");
    let _ = std::fs::remove_file(&ledger);
    let text = format!(
        r#"mode = "{mode}"
plugins = ["flow", "fixtures"]
[nodes.source]
type = "frames"
params = {{ width_px = 64, height_px = 48, rate_hz = 200.0 }}
[nodes.file]
type = "ledger"
inputs = {{ images = ["source.image"] }}
params = {{ path = "{}" }}
[nodes.bad]
type = "chaos"
inputs = {{ image = "source.image" }}
params = {{ first = 20, {bad} }}
[nodes.end]
type = "drain"
inputs = {{ image = "bad.image" }}
"#,
        ledger.display()
    );
    let file = folder.join("graph.toml");
    std::fs::write(&file, text).expect("written");
    file
}

/// Lines of the ledger; the last one is whole.
fn lines(folder: &Path) -> usize {
    let text = std::fs::read_to_string(folder.join("ledger.jsonl")).expect("the ledger");
    assert!(text.is_empty() || text.ends_with("}\n"), "the last line is torn: {text:?}");
    for line in text.lines() {
        serde_json::from_str::<serde_json::Value>(line).expect("a whole line");
    }
    text.lines().count()
}

struct Ended {
    status: ExitStatus,
    out: String,
    err: String,
}

impl Ended {
    fn all(&self) -> String {
        format!("{:?}\n{}{}", self.status, self.out, self.err)
    }

    fn last_line(&self) -> &str {
        self.out.lines().last().unwrap_or_default()
    }
}

/// The program with its signals as a shell gives them, also where who runs the tests ignores some, as `nohup` does.
fn command(arguments: &[&str]) -> Command {
    let mut command = Command::new("env");
    command.args(["--default-signal=HUP,INT,TERM,USR1,USR2,XCPU,XFSZ", PROGRAM]);
    command.env("PANOSCOPE_PLUGIN_PATH", plugin_path()).args(arguments);
    command
}

/// A child whose words go into files, so that they can be looked at while it runs.
struct Running {
    child: Child,
    out: PathBuf,
    err: PathBuf,
}

impl Running {
    fn start(mut command: Command) -> Self {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        let [out, err] = ["out", "err"].map(|kind| folder("words").join(format!("{number}.{kind}")));
        let open = |path: &Path| std::fs::File::create(path).expect("a file");
        let command = command.stdin(Stdio::null()).stdout(open(&out)).stderr(open(&err));
        Self { child: command.spawn().expect("the program starts"), out, err }
    }

    /// Its standard error so far.
    fn said(&self) -> String {
        std::fs::read_to_string(&self.err).expect("its words")
    }

    fn send(&self, signal: libc::c_int) {
        // SAFETY: a plain system call; the child is not waited for yet, so its number is its own.
        unsafe { libc::kill(self.child.id() as i32, signal) };
    }

    fn until(&mut self, what: &str, condition: impl Fn(&Self) -> bool) {
        let end = Instant::now() + PATIENCE;
        while !condition(self) {
            let runs = self.child.try_wait().expect("a child").is_none();
            assert!(Instant::now() < end && runs, "it never came to {what}: {}", self.said());
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    fn end(mut self) -> Ended {
        let end = Instant::now() + PATIENCE;
        let status = loop {
            if let Some(status) = self.child.try_wait().expect("a child") {
                break status;
            }
            assert!(Instant::now() < end, "it did not end");
            std::thread::sleep(Duration::from_millis(5));
        };
        let out = std::fs::read_to_string(&self.out).expect("its words");
        Ended { status, out, err: self.said() }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn run(arguments: &[&str]) -> Ended {
    Running::start(command(arguments)).end()
}

#[test]
fn exit_code_and_last_line_tell_what_a_run_came_to() {
    let folder = folder("truth");
    let graph = graph_in("batch", &folder, "harm = \"never\"");
    let graph = graph.to_str().expect("UTF-8");
    let with = |more: &[&str]| run(&[&["run", graph, "--headless"], more].concat());

    let fine = with(&["--frames", "40"]);
    assert_eq!(fine.status.code(), Some(0), "{}", fine.all());
    assert!(fine.last_line().starts_with("done: 40 frames in "), "{}", fine.all());
    assert!(fine.last_line().ends_with(" dropped, 0 faults"), "{}", fine.all());

    // A fault that lost a tick is no success, also where the node was opened again.
    let failed = with(&["--frames", "60", "--set", "bad.harm=error", "--set", "bad.ticks=7"]);
    assert_eq!(failed.status.code(), Some(1), "{}", failed.all());
    assert!(failed.last_line().starts_with("failed: 60 frames in "), "{}", failed.all());
    assert!(failed.last_line().contains("node `bad` failed "), "{}", failed.all());

    // Fewer frames than asked for.
    let short = with(&["--frames", "60", "--set", "source.count=25"]);
    assert_eq!(short.status.code(), Some(1), "{}", short.all());
    assert!(short.last_line().starts_with("failed: 25 of 60 frames in "), "{}", short.all());
    assert!(short.last_line().contains("source `source` made 25 of the 60 frames"), "{}", short.all());
    let whole = with(&["--set", "source.count=25"]);
    assert_eq!(whole.status.code(), Some(0), "{}", whole.all());

    // A source that never gives what a node needs.
    let silent = std::fs::read_to_string(graph).expect("the graph").replace("\"bad.image\"", "\"second.image\"")
        + "[nodes.second]\ntype = \"chaos_source\"\nparams = { harm = \"nothing\", first = 0, ticks = 1000000 }\n";
    let silent_graph = folder.join("silent.toml");
    std::fs::write(&silent_graph, silent).expect("written");
    let silent = run(&["run", silent_graph.to_str().expect("UTF-8"), "--frames", "40", "--headless"]);
    assert_eq!(silent.status.code(), Some(1), "{}", silent.all());
    assert!(silent.err.contains("node `end` never ran: `second.image` returned no packet"), "{}", silent.all());

    // A report that cannot be written.
    let report = with(&["--frames", "5", "--report", "/proc/nowhere/report.json"]);
    assert_eq!(report.status.code(), Some(1), "{}", report.all());
    assert!(report.last_line().contains("/proc/nowhere"), "{}", report.all());
}

#[test]
fn runs_with_the_same_report_do_not_disturb_each_other() {
    let folder = folder("same_report");
    let graph = graph_in("batch", &folder, "harm = \"nothing\"");
    let (graph, report) = (graph.to_str().expect("UTF-8"), folder.join("report.json"));
    // What another run is just writing, under the name that all runs once used.
    std::fs::create_dir_all(folder.join("report.json.part")).expect("made");
    let ran = run(&["run", graph, "--frames", "5", "--headless", "--report", report.to_str().expect("UTF-8")]);
    assert_eq!(ran.status.code(), Some(0), "{}", ran.all());
    let text = std::fs::read_to_string(&report).expect("the report");
    serde_json::from_str::<serde_json::Value>(&text).expect("a complete report");
}

#[test]
fn a_node_that_may_be_bypassed_is_a_warning() {
    let folder = folder("bypass");
    let graph = graph_in("batch", &folder, "harm = \"error\"");
    let text = std::fs::read_to_string(&graph).expect("the graph");
    std::fs::write(&graph, text.replace("[nodes.bad]", "[nodes.bad]\non_fault = \"bypass\"")).expect("written");
    let graph = graph.to_str().expect("UTF-8");
    let bypassed = run(&["run", graph, "--frames", "60", "--headless"]);
    assert_eq!(bypassed.status.code(), Some(0), "{}", bypassed.all());
    assert!(bypassed.err.contains("warning: node `bad` was bypassed"), "{}", bypassed.all());
    assert!(
        bypassed.last_line().starts_with("done: ") && bypassed.last_line().ends_with("1 fault"),
        "{}",
        bypassed.all()
    );
}

#[test]
fn a_signal_at_any_moment_leaves_whole_files_and_says_what_the_run_came_to() {
    let folder = folder("signals");
    let graph = graph(&folder, "harm = \"never\"");
    let graph = graph.to_str().expect("UTF-8");
    // How long it takes until frames flow decides which moments are worth a try.
    let begun = Instant::now();
    let mut first = Running::start(command(&["run", graph, "--headless"]));
    first.until("the first file", |_| folder.join("ledger.jsonl").exists());
    let opened = begun.elapsed();
    drop(first);
    let signals = [libc::SIGTERM, libc::SIGINT, libc::SIGHUP, libc::SIGUSR1];
    let (mut before, mut summaries, mut untouched) = (0, 0, 0);
    const TRIES: u32 = 30;
    for attempt in 0..TRIES {
        let _ = std::fs::remove_file(folder.join("ledger.jsonl"));
        let signal = signals[attempt as usize % 4];
        let child = Running::start(command(&["run", graph, "--headless"]));
        // Evenly from the start of the process to well into the run.
        std::thread::sleep((opened * 2 + Duration::from_millis(100)) * attempt / TRIES);
        child.send(signal);
        if attempt % 2 == 1 {
            // As `timeout` and shells do.
            child.send(signal);
        }
        let ended = child.end();
        match ended.status.code() {
            Some(0) => {
                summaries += 1;
                assert!(ended.out.contains("sink  age p50 ms"), "no summary: {}", ended.all());
                assert!(ended.last_line().starts_with("stopped by "), "{}", ended.all());
                let mut counts = ended.last_line().split(' ').filter_map(|w| w.parse::<f64>().ok());
                // Frames, seconds, dropped.
                let (frames, dropped) = (counts.next().expect("frames"), counts.nth(1).expect("drops"));
                let written = lines(&folder) as f64;
                assert!(written <= frames && written + dropped >= frames, "{written} lines: {}", ended.all());
            }
            Some(code) => {
                before += 1;
                assert_eq!(code, 128 + signal, "{}", ended.all());
                assert!(ended.err.contains("stopped by ") && ended.out.is_empty(), "{}", ended.all());
            }
            None => {
                // Before the program came to its first line.
                untouched += 1;
                assert_eq!(ended.status.signal(), Some(signal), "{}", ended.all());
                assert!(ended.out.is_empty() && ended.err.is_empty(), "{}", ended.all());
                assert!(!folder.join("ledger.jsonl").exists(), "it had begun to write: {}", ended.all());
            }
        }
    }
    println!("{summaries} with a summary, {before} before the first frame, {untouched} before the program listened");
    assert!(summaries > 0);
}

#[test]
fn the_first_signal_works_while_a_node_opens() {
    let folder = folder("opening");
    let graph = graph(&folder, "harm = \"never\", open_ms = 600000.0");
    let graph = graph.to_str().expect("UTF-8");
    for signal in [libc::SIGINT, libc::SIGTERM, libc::SIGHUP, libc::SIGUSR2, libc::SIGXCPU] {
        let mut child = Running::start(command(&["run", graph, "--headless"]));
        child.until("the open", |c| c.said().contains("told to open"));
        child.send(signal);
        child.send(signal);
        let ended = child.end();
        assert_eq!(ended.status.code(), Some(128 + signal), "{}", ended.all());
        assert!(ended.err.contains("before the first frame: `bad` (chaos) was still opening"), "{}", ended.all());
        let _ = std::fs::remove_file(folder.join("ledger.jsonl"));
    }
    // A change of the running graph that does not return holds nobody up either.
    let file = Path::new(graph);
    let text = std::fs::read_to_string(file).expect("the graph");
    std::fs::write(file, text.replace("open_ms = 600000.0", "open_ms = 0.0")).expect("written");
    let mut child = Running::start(command(&["run", graph, "--headless", "--watch"]));
    child.until("frames", |c| c.said().contains(" frames, "));
    std::fs::write(folder.join("part"), text).expect("written");
    std::fs::rename(folder.join("part"), file).expect("renamed");
    child.until("the change", |c| c.said().contains("told to open"));
    child.send(libc::SIGTERM);
    let ended = child.end();
    assert_eq!(ended.status.code(), Some(143), "{}", ended.all());
    assert!(ended.err.contains("`bad` (chaos) is still opening"), "{}", ended.all());
    assert!(ended.err.contains("files: finished are those of `file`"), "{}", ended.all());
    assert!(lines(&folder) > 0, "{}", ended.all());
}

#[test]
fn a_limit_of_file_size_is_an_error_of_the_node_that_writes() {
    let folder = folder("limit");
    let graph = graph(&folder, "harm = \"never\"");
    let mut child = Running::start(command(&["run", graph.to_str().expect("UTF-8"), "--headless"]));
    child.until("the first file", |_| folder.join("ledger.jsonl").exists());
    // Not from the start: plugins are copied into memory, for which the limit holds as well.
    let limited = Command::new("prlimit")
        .args(["--fsize=30000", "--pid", &child.child.id().to_string()])
        .status()
        .expect("it runs");
    assert!(limited.success());
    child.until("the limit", |c| c.said().contains("File too large"));
    child.send(libc::SIGTERM);
    let ended = child.end();
    assert_eq!(ended.status.code(), Some(1), "{}", ended.all());
    assert!(ended.err.contains("node `file` lost data"), "{}", ended.all());
}

#[test]
fn a_second_signal_a_while_later_ends_at_once() {
    let folder = folder("twice");
    // The source does not return, and the first signal waits for it.
    let text = "mode = \"batch\"\nplugins = [\"flow\", \"fixtures\"]\n[nodes.camera]\ntype = \"chaos_source\"\n\
                params = { harm = \"hang\", first = 5, hang_ms = 600000.0 }\n[nodes.end]\ntype = \"drain\"\ninputs = { image = \"camera.image\" }\n";
    let graph = folder.join("hang.toml");
    std::fs::write(&graph, text).expect("written");
    let mut child = Running::start(command(&["run", graph.to_str().expect("UTF-8"), "--headless"]));
    child.until("frames", |c| c.said().contains("5 frames"));
    child.send(libc::SIGINT);
    child.send(libc::SIGINT);
    // Longer than what counts as one signal.
    std::thread::sleep(Duration::from_millis(1500));
    assert!(child.child.try_wait().expect("a child").is_none(), "a doubled signal is one");
    child.send(libc::SIGINT);
    let ended = child.end();
    assert_eq!(ended.status.code(), Some(130), "{}", ended.all());
    assert!(ended.err.contains("stopped at once by a second signal"), "{}", ended.all());
}

/// What is said when the node `bad` takes the program down at tick 20.
fn assert_named(ended: &Ended, words: &str, folder: &Path) {
    assert!(ended.err.contains(words), "{}", ended.all());
    assert!(ended.err.contains("fixtures.so"), "the plugin's file: {}", ended.all());
    assert!(ended.err.contains("files: finished are those of `file`"), "{}", ended.all());
    assert!(ended.err.lines().last().is_some_and(|l| l.starts_with("failed: ")), "{}", ended.all());
    // Some ticks are under way at once; without a rescue there is none, because the ledger keeps them in its buffer.
    assert!(lines(folder) >= 10, "the frames before it are in the file: {}", ended.all());
}

#[test]
fn a_plugin_that_crashes_is_named_and_the_files_of_others_are_finished() {
    let folder = folder("crash");
    let graph = graph_in("batch", &folder, "harm = \"never\"");
    let graph = graph.to_str().expect("UTF-8");
    let at_tick = "error: node `bad` (chaos) crashed while it processed tick 20 of source 0: ";
    for (harm, signal, words) in [
        ("segv", libc::SIGSEGV, "SIGSEGV, memory that is not there, at address 0xbad"),
        ("segv_in_loop", libc::SIGSEGV, "SIGSEGV, memory that is not there"),
        ("abort", libc::SIGABRT, "SIGABRT, abort"),
        ("stack_overflow", libc::SIGSEGV, "SIGSEGV, its stack overflowed"),
    ] {
        let set = format!("bad.harm={harm}");
        let log = folder.join(format!("{harm}.jsonl"));
        let log = log.to_str().expect("UTF-8");
        let ended = run(&["run", graph, "--headless", "--threads", "2", "--set", &set, "--fault-log", log]);
        assert_eq!(ended.status.signal(), Some(signal), "the signal is the status: {}", ended.all());
        assert_named(&ended, &format!("{at_tick}{words}"), &folder);
        let faults = std::fs::read_to_string(log).expect("the fault log");
        assert!(faults.contains("\"cause\":\"crash\""), "{faults}");
    }
    let ended = run(&["run", graph, "--headless", "--set", "bad.harm=segv_in_open"]);
    assert_eq!(ended.status.signal(), Some(libc::SIGSEGV), "{}", ended.all());
    assert!(ended.err.contains("node `bad` (chaos) crashed while it was opened: SIGSEGV"), "{}", ended.all());
}

#[test]
fn a_plugin_that_calls_exit_fails_the_run() {
    let folder = folder("exit");
    let graph = graph_in("batch", &folder, "harm = \"never\"");
    let graph = graph.to_str().expect("UTF-8");
    for (harm, code) in [("exit", 3), ("exit_at_once", 0)] {
        let ended = run(&["run", graph, "--headless", "--set", &format!("bad.harm={harm}")]);
        assert_eq!(ended.status.code(), Some(1), "{}", ended.all());
        let words =
            format!("error: node `bad` (chaos) ended the program at tick 20 of source 0: it called exit({code})");
        assert_named(&ended, &words, &folder);
    }
}

#[test]
fn a_recording_survives_a_crash_and_a_replay_names_one_too() {
    let folder = folder("recorded");
    let graph = graph_in("batch", &folder, "harm = \"segv\"");
    let recording = folder.join("run.mcap");
    let recording = recording.to_str().expect("UTF-8");
    let ended = run(&["record", graph.to_str().expect("UTF-8"), "-o", recording, "--headless"]);
    assert_eq!(ended.status.signal(), Some(libc::SIGSEGV), "{}", ended.all());
    assert!(ended.err.contains("the recording"), "{}", ended.all());
    let again = run(&["replay", recording, "--headless"]);
    assert_eq!(
        again.status.signal(),
        Some(libc::SIGSEGV),
        "the crash is in the recorded pictures' path: {}",
        again.all()
    );
    assert!(again.err.contains("node `bad` (chaos) crashed while it processed tick 20"), "{}", again.all());
    let mended = run(&["replay", recording, "--headless", "--set", "bad.harm=never"]);
    assert_eq!(mended.status.code(), Some(0), "{}", mended.all());
    let frames: u64 = mended.last_line().split(' ').find_map(|w| w.parse().ok()).expect("a count");
    assert!(frames >= 10, "{}", mended.all());
}

#[test]
fn each_line_of_a_json_log_is_an_object() {
    let folder = folder("json");
    let words = ["run", "--headless", "--log-format", "json", "--web", "0", "--foxglove", "0"];
    let path = graph_in("live", &folder, "");
    let mut running = Running::start(command(&[&words[..], &[path.to_str().expect("a path")]].concat()));
    running.until("the first lines", |running| {
        running.said().contains("for Foxglove") && folder.join("ledger.jsonl").exists()
    });
    running.send(libc::SIGINT);
    let ended = running.end();
    let messages: Vec<String> = ended
        .err
        .lines()
        .map(|line| {
            let value: serde_json::Value = serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}"));
            value["message"].as_str().unwrap_or_else(|| panic!("{line}")).to_owned()
        })
        .collect();
    for part in ["serves http://", "serves ws://"] {
        assert!(messages.iter().any(|message| message.contains(part)), "{part}: {messages:?}");
    }
    // Mistakes of the graph too.
    let ended = run(&["run", "--headless", "--log-format", "json", "no_such_graph.toml"]);
    assert!(ended.err.lines().all(|line| line.starts_with("{\"unix_ms\":")), "{}", ended.err);
}
