//! Cost of the window. The graph runs alternately without and with it, its source at 10 fps.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use serde_json::Value;

use crate::error::{Context, EvalError, Result};
use crate::figures::Figure;

/// The demo graph without files.
const GRAPH: &str = r#"name = "bench_editor"
plugins = ["phantom", "stitch", "flow"]
[nodes.scope]
type = "phantom"
params = { scene = "bowel", seed = 7, rate_hz = 10.0 }
[nodes.register]
type = "register_surf"
inputs = { left = "scope.left", right = "scope.right" }
params = { roi = true, scale = 2 }
[nodes.wide]
type = "composite"
inputs = { left = "scope.left", right = "scope.right", homography = "register.homography" }
[nodes.sink]
type = "drain"
inputs = { image = "wide.panorama" }
"#;

const INPUT: &str = "panorama, 640x480, source at 10 fps, window of 1440x900, software GL";

/// A graph of `chains` chains of 23 `pass` nodes and a source.
fn large(chains: usize) -> String {
    let mut text = "name = \"large\"\nplugins = [\"flow\"]\n".to_owned();
    text += "[nodes.source]\ntype = \"frames\"\nparams = { width_px = 64, height_px = 48, rate_hz = 10.0 }\n";
    for chain in 0..chains {
        let mut from = "source".to_owned();
        for link in 0..23 {
            let (id, node_type) = (format!("n{chain}_{link}"), if link == 22 { "drain" } else { "pass" });
            text += &format!("[nodes.{id}]\ntype = \"{node_type}\"\ninputs = {{ image = \"{from}.image\" }}\n");
            from = id;
        }
    }
    text
}

/// A screen: the existing one, or a virtual one.
struct Screen {
    server: Option<Child>,
    display: String,
}

impl Screen {
    fn find() -> Result<Self> {
        if let Ok(display) = std::env::var("DISPLAY") {
            return Ok(Self { server: None, display });
        }
        for number in 90..99 {
            let display = format!(":{number}");
            let mut command = Command::new("Xvfb");
            command.args([display.as_str(), "-screen", "0", "1440x900x24", "-nolisten", "tcp"]);
            let server = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn();
            let mut server = server.context("there is no screen: set DISPLAY, or install Xvfb")?;
            std::thread::sleep(Duration::from_millis(1500));
            if server.try_wait()?.is_none() {
                return Ok(Self { server: Some(server), display });
            }
        }
        Err(EvalError::Peer { reason: "Xvfb finds no free display".to_owned() })
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        if let Some(server) = &mut self.server {
            let _ = server.kill();
            let _ = server.wait();
        }
    }
}

/// Options of [`measure`].
#[derive(Clone, Debug)]
pub struct Options {
    /// The `panoscope` program, which runs the graph without a window.
    pub program: PathBuf,
    /// The editor's program.
    pub editor: PathBuf,
    /// Fewer frames and rounds: a quick check instead of a measurement.
    pub quick: bool,
}

struct Bench<'a> {
    options: &'a Options,
    screen: Screen,
    folder: PathBuf,
    seconds: u64,
}

impl Bench<'_> {
    fn json(file: &Path) -> Result<Value> {
        let text = std::fs::read_to_string(file).with_context(|| format!("{} was not written", file.display()))?;
        Ok(serde_json::from_str(&text)?)
    }

    /// The report of a run without a window.
    fn without(&self, graph: &Path) -> Result<Value> {
        let file = self.folder.join("without.json");
        let frames = (self.seconds * 10).to_string();
        let mut command = Command::new(&self.options.program);
        command.arg("run").arg(graph).args(["--headless", "--frames", &frames, "--report"]).arg(&file);
        let status = command.stdout(Stdio::null()).stderr(Stdio::null()).status()?;
        if !status.success() {
            return Err(EvalError::Peer { reason: "the graph did not run".to_owned() });
        }
        Self::json(&file)
    }

    /// The window's layout of a graph: `arrangement/<name>` in a window of 1440x900.
    fn arrangement(&self, name: &str, graph: &Path) -> Result<[Figure; 2]> {
        let file = self.folder.join("arrangement.json");
        let status = Command::new(&self.options.editor).arg(graph).arg("--arrangement").arg(&file).status()?;
        if !status.success() {
            return Err(EvalError::Peer { reason: "the editor did not arrange the graph".to_owned() });
        }
        let seen = Self::json(&file)?;
        let value = |key: &str| seen[key].as_f64().unwrap_or(f64::NAN);
        let input = format!("{} nodes, window of 1440x900", value("nodes"));
        Ok([
            Figure::new(&format!("arrangement/{name}/used"), value("used_pct"), "%", &input),
            Figure::new(&format!("arrangement/{name}/least_text"), value("text_px"), "px", &input),
        ])
    }

    /// The window's report of a run.
    fn with(&self, graph: &Path, arguments: &[&str]) -> Result<Value> {
        let editor = &self.options.editor;
        if !editor.is_file() {
            let reason = format!("{} is missing; `cargo xtask build` builds it", editor.display());
            return Err(EvalError::Peer { reason });
        }
        let file = self.folder.join("with.json");
        let mut command = Command::new(editor);
        command.arg(graph).arg("--measure").arg(&file).args(["--after", &self.seconds.to_string()]);
        command.args(arguments).env("DISPLAY", &self.screen.display).env("LIBGL_ALWAYS_SOFTWARE", "1");
        if !command.env_remove("WAYLAND_DISPLAY").status()?.success() {
            return Err(EvalError::Peer { reason: "the editor did not run".to_owned() });
        }
        Self::json(&file)
    }
}

/// Sum of the median times of all nodes, ms.
fn work_ms(report: &Value) -> f64 {
    let nodes = report["nodes"].as_object().into_iter().flatten();
    nodes.filter_map(|(_, node)| node["p50_ms"].as_f64()).sum()
}

/// Measures the window.
pub fn measure(options: &Options) -> Result<Vec<Figure>> {
    let folder = std::env::temp_dir().join(format!("panoscope_bench_editor_{}", std::process::id()));
    std::fs::create_dir_all(&folder)?;
    let quick = options.quick;
    let bench = Bench { options, screen: Screen::find()?, folder: folder.clone(), seconds: if quick { 8 } else { 20 } };
    let [graph, many, most] = ["graph.toml", "large.toml", "largest.toml"].map(|name| folder.join(name));
    std::fs::write(&graph, GRAPH)?;
    std::fs::write(&many, large(13))?;
    std::fs::write(&most, large(44))?;
    let figures = all(&bench, [&graph, &many, &most], if quick { 1 } else { 3 });
    let _ = std::fs::remove_dir_all(&folder);
    figures
}

fn all(bench: &Bench<'_>, [graph, many, most]: [&Path; 3], rounds: usize) -> Result<Vec<Figure>> {
    let number = |value: &Value, name: &str| value[name].as_f64().unwrap_or(f64::NAN);
    let (mut without, mut with, mut ui_ms, mut cpu_pct) = (f64::INFINITY, f64::INFINITY, f64::INFINITY, f64::INFINITY);
    for _ in 0..rounds {
        without = without.min(work_ms(&bench.without(graph)?));
        let window = bench.with(graph, &[])?;
        with = with.min(work_ms(&window["report"]));
        ui_ms = ui_ms.min(number(&window, "ui_ms"));
        cpu_pct = cpu_pct.min(number(&window, "ui_cpu_pct"));
    }
    let pan = bench.with(many, &["--do", "pan"])?;
    let whole = "300 nodes, all in view, moved with every frame";
    let pan_most = bench.with(most, &["--do", "pan"])?;
    let whole_most = "1,013 nodes, all in view, moved with every frame";
    // The run ends after a second; the second half of the time is measured.
    let idle = bench.with(graph, &["--frames", "10"])?;
    let at_rest = "panorama, all threads of the editor, after the end of the run";
    let mut figures = vec![
        Figure::new("editor_cost_pct", (with / without - 1.0) * 100.0, "%", INPUT),
        Figure::new("ui_ms", ui_ms, "ms", INPUT),
        Figure::new("ui_ms/share_of_a_core", cpu_pct, "%", INPUT),
        Figure::new("ui_ms/idle_share_of_a_core", number(&idle, "process_cpu_pct"), "%", at_rest),
        Figure::new("ui_ms/pan_300", number(&pan, "ui_ms"), "ms", whole),
        Figure::new("ui_ms/pan_300_fps", number(&pan, "ui_fps"), "fps", whole),
        Figure::new("ui_ms/pan_1000", number(&pan_most, "ui_ms"), "ms", whole_most),
        Figure::new("ui_ms/pan_1000_fps", number(&pan_most, "ui_fps"), "fps", whole_most),
    ];
    for (name, graph) in [("panorama", graph), ("300", many), ("1000", most)] {
        figures.extend(bench.arrangement(name, graph)?);
    }
    Ok(figures)
}
