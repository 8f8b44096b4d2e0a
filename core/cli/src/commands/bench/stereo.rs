//! `panoscope bench stereo`: the thesis's chain step by step, beside OpenCV's four steps (thesis, table 3.2).
//!
//! Both chains are graphs of real nodes on the same pictures of the phantom, run turn about. Times are the nodes' own, as
//! the engine counts them; pictures come slowly enough that only one is under way.

use std::path::Path;
use std::time::Duration;

use anyhow::{Result, bail};
use panoscope_graph::GraphText;
use panoscope_runtime::{Engine, Options, Outcome, Report};

use super::record::Figure;
use crate::terminal::tell;
use crate::{allocations, graph_file};

/// Disparity at which the search begins: the bowel scene at 50 mm holds 206 to 262 px.
const OFFSET_PX: u32 = 204;
const SEARCH_PX: u32 = 64;
const INPUT: &str = "phantom bowel 640x480, 64 residual disparities";

/// Picture source: few pictures a second, so that rendering and matching do not meet.
const HEAD: &str = r#"
mode = "live"
plugins = ["phantom", "stereo", "opencv", "sinks"]
[nodes.scope]
type = "phantom"
params = { scene = "bowel", rate_hz = 5.0 }
[nodes.rectify]
type = "rectify"
inputs = { left = "scope.left", right = "scope.right", calibration = "scope.calibration" }
[nodes.sink]
type = "write_raw"
params = { path = "out/bench.pfm", limit = 1 }
"#;

fn ours() -> String {
    format!(
        r#"{HEAD}inputs = {{ disparity = "fbs.disparity" }}
[nodes.bm]
type = "stereo_bm"
inputs = {{ left = "rectify.left", right = "rectify.right" }}
params = {{ auto_offset = false, min_disparity_px = {OFFSET_PX}, search_px = {SEARCH_PX} }}
[nodes.wls]
type = "disparity_wls"
inputs = {{ image = "rectify.left", disparity = "bm.disparity", disparity_right = "bm.disparity_right" }}
[nodes.fbs]
type = "disparity_fbs"
inputs = {{ image = "rectify.left", disparity = "wls.disparity", confidence = "wls.confidence" }}
"#
    )
}

fn opencv(threads: usize) -> String {
    let matcher =
        format!("method = \"bm\", min_disparity_px = {OFFSET_PX}, search_px = {SEARCH_PX}, threads = {threads}");
    format!(
        r#"{HEAD}inputs = {{ disparity = "fbs.disparity" }}
[nodes.bm]
type = "stereo_opencv"
inputs = {{ left = "rectify.left", right = "rectify.right" }}
params = {{ {matcher} }}
[nodes.wls]
type = "disparity_wls_opencv"
inputs = {{ image = "rectify.left", disparity = "bm.disparity", disparity_right = "bm.disparity_right" }}
params = {{ {matcher} }}
[nodes.fbs]
type = "disparity_fbs_opencv"
inputs = {{ image = "rectify.left", disparity = "wls.disparity", confidence = "wls.confidence" }}
params = {{ threads = {threads} }}
"#
    )
}

/// Runs a chain and gives the median time of each step in ms.
fn run(chain: &str, folder: &Path, threads: usize, frames: u64) -> Result<[f64; 3]> {
    let text = chain.replace("out/bench.pfm", &folder.join("bench.pfm").to_string_lossy());
    let text = GraphText::parse(Path::new("bench.toml"), &text);
    let ready = match graph_file::ready(&text) {
        Ok(ready) => ready,
        Err(diagnostics) => bail!("{}", diagnostics.render(false).trim_end()),
    };
    let options = Options {
        threads,
        frames: Some(frames),
        paced: true,
        process_allocations: allocations::process(),
        thread_allocations: allocations::thread(),
        ..Options::default()
    };
    let engine = Engine::start(ready.graph, &ready.catalog, &ready.loader, options)?;
    while !engine.wait(Some(Duration::from_millis(100))) {
        if crate::interrupt::asked() {
            bail!("interrupted");
        }
    }
    if let Outcome::Failed(reason) = engine.close(Duration::from_secs(10)) {
        bail!("{reason}");
    }
    let report: Report = engine.report();
    let step = |node: &str| report.nodes.get(node).filter(|n| n.faults == 0 && n.count > 0).map(|n| n.p50_ms);
    match (step("bm"), step("wls"), step("fbs")) {
        (Some(bm), Some(wls), Some(fbs)) => Ok([bm, wls, fbs]),
        _ => bail!("a step of the chain failed"),
    }
}

/// Measures the chain of both on one and on two threads.
pub fn measure(quick: bool) -> Result<Vec<Figure>> {
    let (frames, rounds) = if quick { (6, 1) } else { (20, 3) };
    let folder = std::env::temp_dir().join(format!("panoscope-bench-{}", std::process::id()));
    let mut figures = Vec::new();
    for threads in [1, 2] {
        // The best median of the rounds: whatever else the machine does only adds.
        let (mut own, mut peer) = ([f64::INFINITY; 3], [f64::INFINITY; 3]);
        let mut no_peer = None;
        for _ in 0..rounds {
            let times = run(&ours(), &folder, threads, frames)?;
            own = std::array::from_fn(|i| own[i].min(times[i]));
            match run(&opencv(threads), &folder, threads, frames) {
                Ok(times) => peer = std::array::from_fn(|i| peer[i].min(times[i])),
                Err(error) => no_peer = Some(error),
            }
        }
        if let Some(error) = no_peer {
            tell!("no peer: {error:#}");
        }
        let input = format!("{INPUT}, {threads} threads");
        let peer_of = |value: f64| value.is_finite().then_some(value);
        let steps = ["stereo_bm", "wls", "fbs"].iter().zip(own.iter().zip(peer));
        for (name, (own, peer)) in steps {
            figures.push(Figure::new(&format!("{name}/{threads}"), *own, "ms", &input).beside("OpenCV", peer_of(peer)));
        }
        let (own, peer) = (own.iter().sum(), peer.iter().sum());
        figures
            .push(Figure::new(&format!("stereo_chain/{threads}"), own, "ms", &input).beside("OpenCV", peer_of(peer)));
    }
    // What the sink wrote; nothing is lost when it cannot be removed.
    let _ = std::fs::remove_dir_all(&folder);
    Ok(figures)
}
