//! The password of an address is shown nowhere and stored nowhere.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use crate::common::built_plugins;
use panoscope_testing::{Folder, own_settings};

const PASSWORD: &str = "geheim4711";
/// Nobody listens there, so the stream is sent again and again, and each failure is a fault.
const GRAPH: &str = r#"mode = "live"
plugins = ["flow", "sinks"]
[nodes.source]
type = "frames"
params = { width_px = 64, height_px = 48, rate_hz = 30.0, format = "bgr8" }
[nodes.out]
type = "stream"
inputs = { image = "source.image" }
params = { serve = false, push = "rtsp://surgeon:geheim4711@127.0.0.1:1/wide" }
"#;

#[test]
fn a_password_is_in_no_message_page_log_or_recording() {
    let folder = Folder::new("secrets", &[("graph.toml", GRAPH)]);
    let mut command = Command::new(env!("CARGO_BIN_EXE_panoscope"));
    own_settings(&mut command, folder.path());
    command.env("PANOSCOPE_PLUGIN_PATH", built_plugins(&["flow", "sinks"])).current_dir(folder.path());
    command.args([
        "record",
        "graph.toml",
        "-o",
        "run.mcap",
        "--headless",
        "--verbose",
        "--web",
        "0",
        "--foxglove",
        "0",
    ]);
    command.args(["--fault-log", "faults.jsonl", "--report", "report.json"]);
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the program starts");
    let mut lines = BufReader::new(child.stderr.take().expect("standard error")).lines().map_while(Result::ok);
    let mut messages = String::new();
    let mut until = |text: &str| loop {
        let line = lines.next().unwrap_or_else(|| panic!("the program ended before `{text}`: {messages}"));
        messages += &format!("{line}\n");
        if let Some((_, rest)) = line.split_once(text) {
            return rest.to_owned();
        }
    };
    let address = until("serves http://");
    until("cannot send the stream to rtsp://***@127.0.0.1:1/wide");
    let end = Instant::now() + Duration::from_secs(20);
    let state = loop {
        let mut page = TcpStream::connect(&address).expect("the page is served");
        write!(page, "GET /state HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n").expect("sent");
        let mut state = String::new();
        page.read_to_string(&mut state).expect("an answer");
        // The page follows once a second.
        if state.contains("cannot send") {
            break state;
        }
        assert!(Instant::now() < end, "{state}");
    };
    // SAFETY: a signal to a child that was not waited for.
    assert_eq!(unsafe { libc::kill(child.id().cast_signed(), libc::SIGINT) }, 0);
    lines.for_each(|line| messages += &format!("{line}\n"));
    let mut printed = String::new();
    child.stdout.take().expect("standard output").read_to_string(&mut printed).expect("text");
    child.wait().expect("it ends");
    let read = |file: &str| std::fs::read(folder.path().join(file)).expect("it was written");
    let all = [
        ("messages", messages.into_bytes()),
        ("output", printed.into_bytes()),
        ("/state", state.into_bytes()),
        ("faults", read("faults.jsonl")),
        ("report", read("report.json")),
        ("recording", read("run.mcap")),
    ];
    for (what, bytes) in &all {
        let is_in = |text: &str| bytes.windows(text.len()).any(|part| part == text.as_bytes());
        assert!(!is_in(PASSWORD), "{what}: {}", String::from_utf8_lossy(bytes));
    }
    let is_named = |bytes: &[u8]| String::from_utf8_lossy(bytes).contains("rtsp://***@127.0.0.1:1/wide");
    assert!(is_named(&all[3].1) && is_named(&all[5].1), "the rest of the address stays");
}

#[test]
fn a_variable_that_is_not_set_is_named() {
    let variable = "PANOSCOPE_SECRET_OF_NO_TEST";
    let graph = GRAPH.replace(PASSWORD, &format!("${{{variable}}}"));
    let folder = Folder::new("secret_variable", &[("graph.toml", &graph)]);
    let mut command = Command::new(env!("CARGO_BIN_EXE_panoscope"));
    own_settings(&mut command, folder.path());
    command.env("PANOSCOPE_PLUGIN_PATH", built_plugins(&["flow", "sinks"])).current_dir(folder.path());
    let output = command.args(["run", "graph.toml", "--headless", "--frames", "60"]).output().expect("it runs");
    let messages = String::from_utf8_lossy(&output.stderr);
    assert!(messages.contains(&format!("the environment variable `{variable}`")), "{messages}");
}
