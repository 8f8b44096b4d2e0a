//! Round-trip cost of a frame to a Python node, and the recovery time of such a node.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use panoscope_engine::Listener;

use super::dora;
use super::graph::{self, Pace};
use crate::error::{FileAction, OnFile, Result};
use crate::figures::Figure;
use crate::run::{self, Plan, Watchers};
use crate::session::{Session, note};
use crate::statistics::percentile;

const PLUGIN: &str = "\
import panoscope as ps

@ps.node(family=\"filter\")
class HandOn:
    def process(self, image: ps.AnyImage) -> ps.AnyImage:
        return image
";
/// A node whose instances each fail at their 40th frame.
const HARMFUL: &str = "\
import ctypes, os
import numpy as np
import panoscope as ps

@ps.node(family=\"filter\")
class DoesHarm:
    how: str = ps.param(\"segv\", choices=(\"segv\", \"exit\", \"loop\", \"memory\"))

    def __init__(self):
        self.count = 0

    def process(self, image: ps.AnyImage) -> ps.AnyImage:
        self.count += 1
        if self.count == 40:
            if self.how == \"segv\":
                ctypes.string_at(8)
            elif self.how == \"exit\":
                os._exit(3)
            elif self.how == \"memory\":
                np.ones(10 << 30, np.uint8)
            while self.how == \"loop\":
                pass
        return image
";
/// Failures of the node, with their descriptions.
const HARMS: [(&str, &str); 4] = [
    ("segv", "a segmentation fault"),
    ("exit", "os._exit"),
    ("loop", "an endless loop, with a budget of 50 ms"),
    ("memory", "10 GB asked for"),
];
const RATE_HZ: f64 = 200.0;
const SIZES: [(&str, u32, u32); 2] = [("640x480", 640, 480), ("1920x1080", 1920, 1080)];

/// A folder that is removed when the bench ends.
struct Folder(PathBuf);

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Measures at two sizes: no pixel is copied, so the size should make no difference.
pub fn measure(session: &dyn Session, quick: bool) -> Result<Vec<Figure>> {
    if !Command::new("python3").args(["-c", "import numpy"]).output().is_ok_and(|output| output.status.success()) {
        note!(session, "skipped: nodes in Python: no python3 with NumPy");
        return Ok(Vec::new());
    }
    let folder = Folder(std::env::temp_dir().join(format!("panoscope-bench-{}", std::process::id())));
    let file = folder.0.join("hand_on.py");
    std::fs::create_dir_all(&folder.0).on_file(FileAction::Create, &folder.0)?;
    std::fs::write(&file, PLUGIN).on_file(FileAction::Write, &file)?;
    let (frames, rounds) = if quick { (200, 1) } else { (600, 3) };
    let has_peer = dora::is_there();
    if !has_peer {
        note!(session, "skipped: dora beside nodes in Python: no `dora` (pip install dora-rs dora-rs-cli pyarrow)");
    }
    let mut figures = Vec::new();
    for (size, width, height) in SIZES {
        let (mut p50_ns, mut p99_ns) = (f64::INFINITY, f64::INFINITY);
        let mut peer_ns: Option<f64> = None;
        for _ in 0..rounds {
            let text = graph::chain("hand_on", 1, None, Pace::Hz(RATE_HZ))
                .replace(
                    "plugins = [\"flow\"]",
                    &format!("plugin_paths = [{:?}]\nplugins = [\"flow\", \"hand_on\"]", folder.0),
                )
                .replace("rate_hz", &format!("width_px = {width}, height_px = {height}, rate_hz"));
            let run = graph::run(session, &text, frames)?;
            if let Some(node) = run.report.nodes.get("n0") {
                p50_ns = p50_ns.min(node.p50_ms * 1e6);
                p99_ns = p99_ns.min(node.p99_ms * 1e6);
            }
            if has_peer && let Some(ns) = dora::round_trip_ns(&folder.0, width, height, frames)? {
                peer_ns = Some(peer_ns.map_or(ns, |least| least.min(ns)));
            }
        }
        let input = format!("{size} bgr8 to a node in Python and back at 200 Hz");
        let p50 = Figure::new(&format!("hop_python/{size}"), p50_ns, "ns", &format!("{input}, p50"));
        figures.push(p50.beside("dora, from Python to Python and back", peer_ns));
        figures.push(Figure::new(&format!("hop_python/{size}/p99"), p99_ns, "ns", &format!("{input}, p99")));
    }
    let file = folder.0.join("does_harm.py");
    std::fs::write(&file, HARMFUL).on_file(FileAction::Write, &file)?;
    for (how, harm) in HARMS {
        figures.extend(back(session, &folder.0, how, harm, frames)?);
    }
    Ok(figures)
}

/// Time from the last packet before a death to the first one after it, the median of all deaths of a run.
fn back(session: &dyn Session, folder: &Path, how: &str, harm: &str, frames: u64) -> Result<Option<Figure>> {
    let plugins = format!("plugin_paths = [{folder:?}]\nplugins = [\"flow\", \"does_harm\"]");
    let node = format!("[nodes.n0]\nbudget_ms = 50.0\nparams = {{ how = \"{how}\" }}\n");
    let text = graph::chain("does_harm", 1, None, Pace::Hz(RATE_HZ))
        .replace("plugins = [\"flow\"]", &plugins)
        .replace("[nodes.n0]\n", &node);
    let times = Arc::new(Mutex::new(Vec::new()));
    let heard = Arc::clone(&times);
    let hear = move |_: &_| heard.lock().unwrap_or_else(PoisonError::into_inner).push(Instant::now());
    let listen = vec![Listener { node: "n0".to_owned(), output: "image".to_owned(), hear: Arc::new(hear) }];
    let path = Path::new("bench.toml");
    let plan = Plan { text: &text, path, frames: Some(frames), threads: 0, ports: &[], pace: run::Pace::Camera };
    let report = run::run_watched(session, &plan, Watchers { listen, ..Watchers::default() })?.report;
    let times = times.lock().unwrap_or_else(PoisonError::into_inner);
    let mut gaps_ms: Vec<f64> =
        times.windows(2).map(|pair| pair[1].duration_since(pair[0]).as_secs_f64() * 1e3).collect();
    gaps_ms.sort_by(|a, b| b.total_cmp(a));
    gaps_ms.truncate(report.nodes.get("n0").map_or(0, |node| node.faults) as usize);
    if gaps_ms.is_empty() {
        note!(session, "skipped: no death by {harm} within {frames} frames");
        return Ok(None);
    }
    let input = format!("a node in Python at 200 Hz, {harm}: the gap between two frames, median of {}", gaps_ms.len());
    Ok(Some(Figure::new(&format!("python_back/{how}"), percentile(&gaps_ms, 0.5), "ms", &input)))
}
