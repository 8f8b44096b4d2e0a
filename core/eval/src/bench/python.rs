//! What a frame's way to a node in Python and back costs.

use std::path::PathBuf;
use std::process::Command;

use super::graph::{self, Pace};
use crate::error::{FileAction, OnFile, Result};
use crate::figures::Figure;
use crate::session::{Session, note};

const PLUGIN: &str = "\
import panoscope as ps

@ps.node(family=\"filter\")
class HandOn:
    def process(self, image: ps.AnyImage) -> ps.AnyImage:
        return image
";
const RATE_HZ: f64 = 200.0;
const SIZES: [(&str, u32, u32); 2] = [("640x480", 640, 480), ("1920x1080", 1920, 1080)];

/// A folder that is removed when the bench ends.
struct Folder(PathBuf);

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Measures at two sizes: no pixel is copied, so that the size makes no difference.
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
    let mut figures = Vec::new();
    for (size, width, height) in SIZES {
        let (mut p50_ns, mut p99_ns) = (f64::INFINITY, f64::INFINITY);
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
        }
        let input = format!("{size} bgr8 to a node in Python and back at 200 Hz");
        figures.push(Figure::new(&format!("hop_python/{size}"), p50_ns, "ns", &format!("{input}, p50")));
        figures.push(Figure::new(&format!("hop_python/{size}/p99"), p99_ns, "ns", &format!("{input}, p99")));
    }
    Ok(figures)
}
