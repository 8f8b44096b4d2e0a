//! `panoscope run --web`: the page, its pictures and the metrics of a running graph, over HTTP and in a browser.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use crate::chromium::{Browser, Page};
use crate::common::plugins;
use panoscope_testing::{Folder, own_settings, skipped};
use serde_json::Value;

const GRAPH: &str = r#"name = "watched"
mode = "live"
plugins = ["flow"]

[nodes.source]
type = "frames"
params = { width_px = 64, height_px = 48, rate_hz = 30.0 }

[nodes."a/pass"]
type = "pass"
inputs = { image = "source.image" }

[nodes.end]
type = "drain"
inputs = { image = "a/pass.image" }
"#;

/// A running graph with its page; killed when dropped.
struct Watched {
    child: Child,
    address: String,
    _folder: Folder,
}

impl Watched {
    fn start(name: &str) -> Self {
        let folder = Folder::new(name, &[("graph.toml", GRAPH)]);
        let file = folder.path().join("graph.toml");
        Self::start_file(folder, &file)
    }

    /// Runs a graph file in a folder.
    fn start_file(folder: Folder, file: &Path) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_panoscope"));
        own_settings(&mut command, folder.path());
        command.current_dir(folder.path()).arg("run").arg(file).args(["--headless", "--web", "0"]);
        let mut child = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("the program starts");
        let mut lines = BufReader::new(child.stderr.take().expect("standard error")).lines();
        let address =
            lines.by_ref().map_while(Result::ok).find_map(|line| Some(line.strip_prefix("serves http://")?.to_owned()));
        // Read on, so that the program never waits for a reader.
        thread::spawn(move || lines.for_each(drop));
        Self { child, address: address.expect("the address is printed"), _folder: folder }
    }

    /// Status, head and body of the answer to a request with this first line and `Host`.
    fn ask(&self, request: &str, host: &str) -> (u16, String, Vec<u8>) {
        let mut stream = TcpStream::connect(&self.address).expect("the page is served");
        stream.set_read_timeout(Some(Duration::from_secs(20))).expect("a limit");
        write!(stream, "{request} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\nContent-Length: 0\r\n\r\n")
            .expect("sent");
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).expect("an answer");
        let end = answer.windows(4).position(|bytes| bytes == b"\r\n\r\n").expect("a head");
        let head = String::from_utf8_lossy(&answer[..end]).to_lowercase();
        let status = head.split(' ').nth(1).and_then(|status| status.parse().ok()).expect("a status");
        (status, head, answer[end + 4..].to_vec())
    }

    fn get(&self, path: &str) -> (u16, String, Vec<u8>) {
        self.ask(&format!("GET {path}"), &self.address)
    }

    /// Asks until the answer is 200: the first picture comes after the first request.
    fn get_soon(&self, path: &str) -> (String, Vec<u8>) {
        let until = Instant::now() + Duration::from_secs(20);
        loop {
            match self.get(path) {
                (200, head, body) => return (head, body),
                (status, _, body) if Instant::now() > until => {
                    panic!("{path}: {status} {}", String::from_utf8_lossy(&body))
                }
                _ => thread::sleep(Duration::from_millis(50)),
            }
        }
    }
}

impl Drop for Watched {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Whether a program is there.
fn is_there(program: &str) -> bool {
    Command::new(program).arg("--version").output().is_ok_and(|output| output.status.success())
}

#[test]
fn state_pictures_and_metrics_are_those_of_the_run() {
    if plugins(&["flow"]).is_none() {
        return;
    }
    let watched = Watched::start("web");
    let (_, body) = watched.get_soon("/state");
    let state: serde_json::Value = serde_json::from_slice(&body).expect("JSON");
    assert_eq!(
        (state["graph"].as_str(), state["pictures"][0]["name"].as_str()),
        (Some("watched"), Some("a/pass.image"))
    );
    let (head, first) = watched.get_soon("/pictures/a/pass.image");
    assert!(head.contains("content-type: image/jpeg") && head.contains("x-age-ms: "), "{head}");
    assert_eq!(image::load_from_memory(&first).expect("a JPEG").into_rgb8().dimensions(), (64, 48));
    let tick =
        |head: &str| head.lines().find_map(|line| line.strip_prefix("x-tick: ")?.parse::<u64>().ok()).expect("a tick");
    let until = Instant::now() + Duration::from_secs(20);
    while tick(&watched.get_soon("/pictures/a/pass.image").0) == tick(&head) {
        assert!(Instant::now() < until, "the picture stays the same");
        thread::sleep(Duration::from_millis(50));
    }
    let (head, metrics) = watched.get_soon("/metrics");
    assert!(head.contains("content-type: text/plain; version=0.0.4"), "{head}");
    let metrics = String::from_utf8(metrics).expect("UTF-8");
    let calls = metrics.lines().find_map(|line| line.strip_prefix("panoscope_node_calls_total{node=\"a/pass\"} "));
    assert!(calls.expect("a count").parse::<f64>().expect("a number") > 0.0, "{metrics}");
    if !is_there("promtool") {
        return skipped!("no promtool: the metrics were not checked by Prometheus's own tool");
    }
    let mut promtool = Command::new("promtool");
    let promtool =
        promtool.args(["check", "metrics"]).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut promtool = promtool.spawn().expect("promtool");
    promtool.stdin.take().expect("a pipe").write_all(metrics.as_bytes()).expect("written");
    let output = promtool.wait_with_output().expect("promtool");
    let words = String::from_utf8_lossy(&output.stdout) + String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && words.is_empty(), "{words}");
}

#[test]
fn nothing_can_be_changed_and_other_origins_are_refused() {
    if plugins(&["flow"]).is_none() {
        return;
    }
    let watched = Watched::start("web-refused");
    let own = watched.address.clone();
    watched.get_soon("/state");
    for (request, host, status) in [
        ("POST /state", own.as_str(), 405),
        ("DELETE /", &own, 405),
        ("PUT /pictures/a/pass.image", &own, 405),
        ("GET /", "panoscope.example", 403),
        ("GET /state", "127.0.0.1.example:80", 403),
        ("GET /pictures/source.image", &own, 404),
        ("GET /pictures/../state", &own, 404),
        ("GET /etc/passwd", &own, 404),
    ] {
        let (given, _, body) = watched.ask(request, host);
        assert_eq!(given, status, "{request} for {host}: {}", String::from_utf8_lossy(&body));
    }
    let (status, head, page) = watched.get("/");
    assert!(status == 200 && head.contains("content-security-policy: default-src 'none'"), "{head}");
    assert!(!String::from_utf8_lossy(&page).contains("http"), "the page loads nothing from elsewhere");
}

/// The page as a browser has it after a few seconds of its own time.
fn dumped(address: &str) -> String {
    let profile = Folder::new("web-profile", &[]);
    let mut browser = Command::new("chromium");
    browser.args(["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"]);
    browser.args(["--disable-background-networking", "--disable-component-update", "--disable-sync"]);
    browser.args(["--virtual-time-budget=6000", "--dump-dom"]);
    browser.arg(format!("--user-data-dir={}", profile.path().display())).arg(format!("http://{address}/"));
    let output = browser.output().expect("Chromium");
    String::from_utf8_lossy(&output.stdout).into_owned()
}

#[test]
fn a_browser_shows_pictures_with_an_age() {
    if plugins(&["flow"]).is_none() {
        return;
    }
    if !is_there("chromium") {
        return skipped!("no Chromium: `cargo xtask setup` installs it");
    }
    let watched = Watched::start("web-browser");
    watched.get_soon("/state");
    // The browser's time runs ahead of the graph's while it waits for nothing, so that a look may end before the first picture has come, and the
    // age of the picture says nothing.
    let shown = "<img alt=\"a/pass\" src=\"blob:";
    let mut page = String::new();
    for _ in 0..10 {
        page = dumped(&watched.address);
        if page.contains(shown) {
            break;
        }
    }
    assert!(page.contains("<h1 id=\"graph\">watched</h1>"), "{page}");
    assert!(page.contains(shown), "a picture is shown: {page}");
    assert!(page.contains(" ms</span>") || page.contains("no new picture for "), "its age is shown: {page}");
    assert!(page.contains("<span id=\"state\" class=\"\">running</span>"), "{page}");
}

/// What a page shows of its pictures: words beside it, whether it is dimmed, its opacity, its width in px, its age in
/// words.
const FIGURES: &str = "[...document.querySelectorAll('figure')].map(f => ({
    label: f.querySelector('img').alt, old: f.classList.contains('old'), opacity: getComputedStyle(f.querySelector('img')).opacity,
    width: f.querySelector('img').naturalWidth, age: f.querySelector('.age').textContent }))";

/// Looks at a page until its pictures are as wanted.
fn figures_until(browser: &mut Browser, page: &Page, is_right: impl Fn(&[Value]) -> bool) -> Vec<Value> {
    let until = Instant::now() + Duration::from_secs(60);
    loop {
        let figures = browser.evaluate(page, FIGURES).as_array().cloned().unwrap_or_default();
        if !figures.is_empty() && is_right(&figures) {
            return figures;
        }
        assert!(Instant::now() < until, "{figures:?}");
        thread::sleep(Duration::from_millis(50));
    }
}

#[test]
fn a_browser_dims_an_old_picture_and_no_fresh_one() {
    if plugins(&["flow"]).is_none() {
        return;
    }
    if !is_there("chromium") {
        return skipped!("no Chromium: `cargo xtask setup` installs it");
    }
    let watched = Watched::start("web-dimmed");
    watched.get_soon("/state");
    let mut browser = Browser::start("web-dimmed");
    let page = browser.open(&format!("http://{}/", watched.address));
    let is_fresh = |figure: &Value| figure["old"] == false && figure["opacity"] == "1" && figure["width"] == 64;
    let fresh = figures_until(&mut browser, &page, |figures| figures.iter().all(is_fresh));
    assert!(fresh[0]["age"].as_str().is_some_and(|age| age.ends_with(" ms")), "{fresh:?}");
    let signal = |name: &str| {
        let sent = Command::new("kill").args([name, &watched.child.id().to_string()]).status();
        assert!(sent.is_ok_and(|status| status.success()));
    };
    // The program stands still: its last picture grows old in the browser, which hears nothing any more.
    signal("-STOP");
    let old = figures_until(&mut browser, &page, |figures| figures[0]["old"] == true);
    assert!(old[0]["age"].as_str().is_some_and(|age| age.starts_with("no new picture for ")), "{old:?}");
    assert_ne!(old[0]["opacity"], "1", "{old:?}");
    signal("-CONT");
    figures_until(&mut browser, &page, |figures| figures.iter().all(is_fresh));
}

#[test]
fn the_page_of_surgeon_shows_its_surface_too() {
    let names = ["stereo", "tools", "sinks", "phantom", "arm", "overlay", "flow", "stitch"];
    if plugins(&names).is_none() {
        return;
    }
    let folder = Folder::new("web-surgeon", &[]);
    let graphs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../graphs");
    // Its sinks write beside the folder of the graph.
    let copied = Command::new("cp").arg("-r").arg(&graphs).arg(folder.path()).status();
    assert!(copied.is_ok_and(|status| status.success()));
    let watched = Watched::start_file(folder, Path::new("graphs/surgeon.toml"));
    let (_, body) = watched.get_soon("/state");
    let state: Value = serde_json::from_slice(&body).expect("JSON");
    let shown: Vec<&str> =
        state["pictures"].as_array().expect("a list").iter().filter_map(|p| p["name"].as_str()).collect();
    for name in &shown {
        let (head, jpeg) = watched.get_soon(&format!("/pictures/{name}"));
        let picture = image::load_from_memory(&jpeg).expect("a JPEG").into_rgb8();
        let levels: std::collections::BTreeSet<[u8; 3]> = picture.pixels().map(|pixel| pixel.0).collect();
        assert!(picture.width() > 100 && levels.len() > 50, "{name}: {head}");
    }
    assert!(shown.contains(&"points.cloud"), "{shown:?}");
}

#[test]
fn an_address_that_is_taken_or_none_is_an_error_before_the_graph_starts() {
    if plugins(&["flow"]).is_none() {
        return;
    }
    let watched = Watched::start("web-taken");
    let folder = Folder::new("web-second", &[("graph.toml", GRAPH)]);
    for (address, code, words) in [
        (watched.address.as_str(), 1, "another program may use the port"),
        ("nowhere", 2, "is not an address to listen on"),
    ] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_panoscope"));
        let output =
            command.current_dir(folder.path()).args(["run", "graph.toml", "--web", address]).output().expect("a run");
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(code) && stderr.contains(words), "{address}: {stderr}");
    }
}
