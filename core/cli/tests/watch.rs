//! `panoscope run --watch` from outside: a graph file and a plugin that change on disk while it runs.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

const PROGRAM: &str = env!("CARGO_BIN_EXE_panoscope");
const PATIENCE: Duration = Duration::from_secs(60);

/// The built `flow` plugin: out of `PANOSCOPE_PLUGIN_PATH`, else beside the program.
fn flow() -> Option<PathBuf> {
    let given = std::env::var_os("PANOSCOPE_PLUGIN_PATH").unwrap_or_default();
    let beside = Path::new(PROGRAM).parent().map(Path::to_owned).unwrap_or_default();
    let folders = std::env::split_paths(&given).chain([beside.join("plugins"), beside]);
    let names = ["libflow.so", "libpanoscope_flow.so"];
    folders.flat_map(|folder| names.map(|name| folder.join(name))).find(|file| file.is_file())
}

struct Watched {
    child: Child,
    lines: Receiver<String>,
    seen: Vec<String>,
}

impl Watched {
    fn start(graph: &Path, plugins: &Path, report: &Path) -> Self {
        Self::start_with(graph, plugins, report, &[])
    }

    fn start_with(graph: &Path, plugins: &Path, report: &Path, more: &[&str]) -> Self {
        let mut child = Command::new(PROGRAM)
            .args(["run", "--watch", "--headless", "--threads", "2", "--report"])
            .arg(report)
            .arg(graph)
            .args(more)
            .env("PANOSCOPE_PLUGIN_PATH", plugins)
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the program starts");
        let (send, lines) = channel();
        let stderr = child.stderr.take().expect("piped");
        std::thread::spawn(move || {
            for line in BufReader::new(stderr).lines().map_while(Result::ok) {
                if send.send(line).is_err() {
                    return;
                }
            }
        });
        Self { child, lines, seen: Vec::new() }
    }

    /// Waits for a line that holds all these words.
    fn says(&mut self, words: &[&str]) {
        let end = Instant::now() + PATIENCE;
        loop {
            let line = self.lines.recv_timeout(Duration::from_millis(200));
            if let Ok(line) = line {
                let found = words.iter().all(|w| line.contains(w));
                self.seen.push(line);
                if found {
                    return;
                }
            }
            let running = self.child.try_wait().expect("a child").is_none();
            assert!(running && Instant::now() < end, "no line with {words:?}; so far:\n{}", self.seen.join("\n"));
        }
    }
}

impl Drop for Watched {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Writes a file in one step, as editors and linkers do.
fn put(file: &Path, bytes: &[u8]) {
    let part = file.with_extension("part");
    std::fs::write(&part, bytes).expect("written");
    std::fs::rename(&part, file).expect("renamed");
}

#[test]
fn a_changed_graph_and_a_rebuilt_plugin_are_taken_and_broken_ones_are_not() {
    let Some(flow) = flow() else {
        panoscope_testing::skipped!("the flow plugin is not built");
        return;
    };
    let folder = std::env::temp_dir().join(format!("panoscope_watch_{}", std::process::id()));
    let plugins = folder.join("plugins");
    std::fs::create_dir_all(&plugins).expect("a folder");
    let (plugin, graph, report) = (plugins.join("libflow.so"), folder.join("graph.toml"), folder.join("report.json"));
    let whole = std::fs::read(&flow).expect("the plugin");
    put(&plugin, &whole);
    let text = r#"name = "watched"
mode = "live"
plugins = ["flow"]
[nodes.a]
type = "frames"
params = { width_px = 16, height_px = 8, format = "gray8", rate_hz = 100.0 }
[nodes.end]
type = "drain"
inputs = { image = "a.image" }
"#;
    put(&graph, text.as_bytes());
    let mut run = Watched::start(&graph, &plugins, &report);
    run.says(&["frames,"]);

    let more = format!(
        "{text}[nodes.extra]\ntype = \"pass\"\ninputs = {{ image = \"a.image\" }}\n[nodes.extra_end]\ntype = \"drain\"\ninputs = {{ image = \"extra.image\" }}\n"
    );
    put(&graph, more.as_bytes());
    run.says(&["changed:", "added", "extra"]);

    put(&graph, more.replace("\"pass\"", "\"pas\"").as_bytes());
    run.says(&["the old one keeps running"]);
    run.says(&["unknown-type"]);
    put(&graph, more.as_bytes());

    // Rebuilt: other bytes, the same nodes.
    put(&plugin, &[whole.as_slice(), b"rebuilt"].concat());
    run.says(&["changed:", "replaced", "extra"]);
    // Cut off, then no library at all: the rebuilt one runs on.
    put(&plugin, &whole[..whole.len() / 2]);
    run.says(&["error"]);
    put(&plugin, b"no library");
    run.says(&["error"]);
    put(&plugin, &whole);
    run.says(&["changed:", "replaced"]);

    let sent = Command::new("kill").args(["-INT", &run.child.id().to_string()]).status().expect("kill runs");
    assert!(sent.success());
    let end = Instant::now() + PATIENCE;
    let status = loop {
        if let Some(status) = run.child.try_wait().expect("a child") {
            break status;
        }
        assert!(Instant::now() < end, "it does not end");
        std::thread::sleep(Duration::from_millis(20));
    };
    assert_eq!(status.code(), Some(0), "{}", run.seen.join("\n"));
    let report: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(&report).expect("the report")).expect("JSON");
    assert!(report["nodes"]["extra_end"]["count"].as_u64().is_some_and(|n| n > 0), "{report}");
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn changed_parts_and_overlays_are_taken_and_broken_ones_are_not() {
    let Some(flow) = flow() else {
        panoscope_testing::skipped!("the flow plugin is not built");
        return;
    };
    let graph = r#"name = "watched"
mode = "live"
plugins = ["flow"]
[args.width]
type = "whole"
[nodes.a]
type = "frames"
[nodes.chain]
graph = "parts/chain.toml"
inputs = { image = "a.image" }
[nodes.end]
type = "drain"
inputs = { image = "chain.image" }
"#;
    let part = "plugins = [\"flow\"]\n[part]\ninputs = { image = \"first.image\" }\noutputs = { image = \"first.image\" }\n[nodes.first]\ntype = \"pass\"\n";
    let longer = "plugins = [\"flow\"]\n[part]\ninputs = { image = \"first.image\" }\noutputs = { image = \"second.image\" }\n[nodes.first]\ntype = \"pass\"\n\
                  [nodes.second]\ntype = \"pass\"\ninputs = { image = \"first.image\" }\n";
    let over = |height: u32| {
        format!(
            "plugins = [\"flow\"]\n[nodes.a]\ntype = \"frames\"\nparams = {{ width_px = {{ arg = \"width\" }}, height_px = {height}, rate_hz = 100.0 }}\n"
        )
    };
    let files = [("g.toml", graph), ("parts/chain.toml", part), ("parts/other.toml", part), ("over.toml", &over(8))];
    let folder = panoscope_testing::Folder::new("watch-parts", &files);
    let with = folder.at("over.toml").display().to_string();
    let plugins = flow.parent().expect("a folder");
    let mut run =
        Watched::start_with(&folder.at("g.toml"), plugins, &folder.at("r.json"), &["--with", &with, "--width", "16"]);
    run.says(&["frames,"]);

    folder.write("parts/chain.toml", longer);
    run.says(&["changed:", "added", "chain/second"]);
    folder.write("over.toml", &over(16));
    run.says(&["changed:", "a"]);
    // Wrong: named with its file, and the old graph runs on until it is right again.
    folder.write("parts/chain.toml", &longer.replace("\"pass\"\ninputs", "\"pas\"\ninputs"));
    run.says(&["the old one keeps running"]);
    run.says(&["parts/chain.toml:"]);
    folder.write("parts/chain.toml", part);
    run.says(&["changed:", "removed", "chain/second"]);
    // A part that the graph names only now is watched from now on.
    folder.write(
        "g.toml",
        &graph
            .replace("parts/chain.toml", "parts/other.toml")
            .replace("[nodes.end]", "[nodes.more]\ntype = \"drain\"\ninputs = { image = \"a.image\" }\n[nodes.end]"),
    );
    run.says(&["changed:", "added", "more"]);
    folder.write("parts/other.toml", longer);
    run.says(&["changed:", "added", "chain/second"]);
}
