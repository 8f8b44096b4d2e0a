//! The thesis's chain step by step, compared with OpenCV's four steps (thesis, table 3.2), and lengths and depths on
//! the phantom compared with ground truth (figs 3.14 and 3.15).
//!
//! Both chains are graphs of real nodes on the same images of the phantom, rendered beforehand and run alternately,
//! one pair after the other. Times are the nodes' own, measured by the engine.

use std::path::{Path, PathBuf};

use panoscope_engine::text_table::table;

use crate::bench::CAMERA_HZ;
use crate::error::{Context, Result, chain};
use crate::figures::Figure;
use crate::inputs::Folder;
use crate::inputs::pairs::Pairs;
use crate::inputs::scene::rectified;
use crate::ruler::Ruler;
use crate::run::{self, Pace, Plan};
use crate::session::{Session, note};

/// Options of [`measure`].
#[derive(Clone, Debug)]
pub struct Options {
    /// Fewer frames and rounds: a quick check instead of a measurement.
    pub quick: bool,
    /// PNG file for measured lengths and depths against the true ones.
    pub plot: Option<PathBuf>,
}

/// Scenes of the table.
const SCENES: [&str; 4] = ["bowel", "liver", "cavity", "box"];
/// Pairs that are rendered and played in a loop.
const PAIRS: u64 = 8;
/// Distance whose lengths and depths are printed.
const PRINTED_MM: f64 = 50.0;

/// Name of the end of both chains.
const LAST: [(&str, &str); 1] = [("fbs", "disparity")];

/// First disparity and number of disparities that are searched.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Search {
    name: &'static str,
    first_px: u32,
    width_px: u32,
}

/// Size of the views, and its searches: the remaining range when the offset is known, and the full range from the
/// horizon to the nearest tissue.
struct Size {
    width: u32,
    height: u32,
    searches: [Search; 2],
}

/// At 50 mm the tissue holds 206 to 262 px of 640, and twice as many of 1280.
const SIZES: [Size; 2] = [
    Size {
        width: 640,
        height: 480,
        searches: [
            Search { name: "64 residual", first_px: 204, width_px: 64 },
            Search { name: "full range", first_px: 0, width_px: 288 },
        ],
    },
    Size {
        width: 1280,
        height: 720,
        searches: [
            Search { name: "64 residual", first_px: 430, width_px: 64 },
            Search { name: "full range", first_px: 64, width_px: 480 },
        ],
    },
];

/// One line of the table.
struct Case<'a> {
    scene: &'a str,
    size: &'a Size,
    search: Search,
    threads: usize,
}

impl Case<'_> {
    /// Whether this is the case whose figures have unprefixed names.
    fn is_first(&self) -> bool {
        self.scene == SCENES[0] && self.size.width == 640 && self.search.width_px == 64
    }

    fn name(&self) -> String {
        let range = if self.search.width_px == 64 { "64" } else { "full" };
        match self.is_first() {
            true => self.threads.to_string(),
            false => format!("{}_{}x{}_{range}_{}", self.scene, self.size.width, self.size.height, self.threads),
        }
    }

    fn input(&self) -> String {
        let Size { width, height, .. } = self.size;
        let Search { name, first_px, width_px } = self.search;
        let threads = self.threads;
        format!(
            "phantom {} {width}x{height}, {name}: {width_px} disparities from {first_px}, {threads} threads",
            self.scene
        )
    }

    fn scope(&self) -> String {
        format!("scene = \"{}\", width = {}, height = {}", self.scene, self.size.width, self.size.height)
    }

    fn ours(&self, source: &str) -> String {
        let Search { first_px, width_px, .. } = self.search;
        rectified("batch", &["opencv"], source)
            + &format!(
                r#"
[nodes.bm]
type = "stereo_bm"
inputs = {{ left = "rectify.left", right = "rectify.right" }}
params = {{ auto_offset = false, min_disparity_px = {first_px}, search_px = {width_px} }}
[nodes.wls]
type = "disparity_wls"
inputs = {{ image = "rectify.left", disparity = "bm.disparity", disparity_right = "bm.disparity_right" }}
[nodes.fbs]
type = "disparity_fbs"
inputs = {{ image = "rectify.left", disparity = "wls.disparity", confidence = "wls.confidence" }}
"#
            )
    }

    fn opencv(&self, source: &str) -> String {
        let (Search { first_px, width_px, .. }, threads) = (self.search, self.threads);
        let matcher =
            format!("method = \"bm\", min_disparity_px = {first_px}, search_px = {width_px}, threads = {threads}");
        // The matches are judged by the filter behind, as in OpenCV's sample `disparity_filtering`: tests of its own cost the matcher time.
        rectified("batch", &["opencv"], source)
            + &format!(
                r#"
[nodes.bm]
type = "stereo_opencv"
inputs = {{ left = "rectify.left", right = "rectify.right" }}
params = {{ auto_offset = false, {matcher}, own_checks = false }}
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

    /// Best medians of the rounds, ours and OpenCV's: other load only adds time.
    fn measure(&self, session: &dyn Session, source: &str, frames: u64, rounds: usize) -> Result<([f64; 3], [f64; 3])> {
        let (mut own, mut peer) = ([f64::INFINITY; 3], [f64::INFINITY; 3]);
        let mut no_peer = None;
        for _ in 0..rounds {
            let times = steps(session, &self.ours(source), self.threads, 4 * frames)?;
            own = std::array::from_fn(|i| own[i].min(times[i]));
            match steps(session, &self.opencv(source), 1, frames) {
                Ok(times) => peer = std::array::from_fn(|i| peer[i].min(times[i])),
                Err(error) => no_peer = Some(error),
            }
        }
        if let Some(error) = no_peer {
            note!(session, "no peer: {}", chain(&error));
        }
        Ok((own, peer))
    }
}

/// Runs a chain on a number of threads (OpenCV uses its own) and returns the median time of each step in ms.
fn steps(session: &dyn Session, text: &str, threads: usize, frames: u64) -> Result<[f64; 3]> {
    let plan =
        Plan { text, path: Path::new("bench.toml"), frames: Some(frames), threads, ports: &LAST, pace: Pace::Alone };
    let report = run::run(session, &plan)?.report;
    let step = |node: &str| {
        let node = report.nodes.get(node).filter(|n| n.faults == 0 && n.count > 0);
        node.map(|n| n.p50_ms).context("a step of the chain failed")
    };
    Ok([step("bm")?, step("wls")?, step("fbs")?])
}

/// Heap allocations of the whole process per frame in steady state.
fn allocations(session: &dyn Session, case: &Case<'_>, frames: u64) -> Result<Option<f64>> {
    let source = format!("type = \"phantom\"\nparams = {{ {} }}\n", case.scope());
    let text = case.ours(&source);
    let plan = Plan {
        text: &text,
        path: Path::new("bench.toml"),
        frames: Some(frames),
        threads: case.threads,
        ports: &LAST,
        pace: Pace::Free,
    };
    Ok(run::run(session, &plan)?.report.allocations_per_frame)
}

/// Measures the chain of both, and the phantom.
pub fn measure(session: &dyn Session, options: &Options) -> Result<Vec<Figure>> {
    let quick = options.quick;
    let (frames, rounds) = if quick { (6, 1) } else { (12, 2) };
    let (sizes, scenes) = if quick { (&SIZES[..1], &SCENES[..1]) } else { (&SIZES[..], &SCENES[..]) };
    let head = [
        "scene, size, disparities, threads",
        "left + right",
        "WLS",
        "FBS",
        "whole ms",
        "OpenCV",
        "WLS",
        "FBS",
        "whole ms",
        "ratio",
    ];
    let (mut figures, mut rows) = (Vec::new(), vec![head.map(str::to_owned).to_vec()]);
    let folder = Folder::new("panoscope-bench-stereo")?;
    for size in sizes {
        for scene in scenes {
            let case = Case { scene, size, search: size.searches[0], threads: 1 };
            let pairs = Pairs::of(session, &folder, &format!("{scene}{}", size.width), &case.scope(), PAIRS)?;
            let source = pairs.node("off", CAMERA_HZ);
            for search in size.searches.into_iter().take(if quick { 1 } else { 2 }) {
                for threads in [1, 2] {
                    let case = Case { search, threads, ..case };
                    let (own, peer) = case.measure(session, &source, frames, rounds)?;
                    let (whole, other) = (own.iter().sum::<f64>(), peer.iter().sum::<f64>());
                    let (name, input) = (case.name(), case.input());
                    let known = |value: f64| value.is_finite().then_some(value);
                    for (step, (own, peer)) in ["stereo_bm", "wls", "fbs"].iter().zip(own.iter().zip(peer)) {
                        let figure = Figure::new(&format!("{step}/{name}"), *own, "ms", &input);
                        figures.push(figure.beside("OpenCV", known(peer)));
                    }
                    let figure = Figure::new(&format!("stereo_chain/{name}"), whole, "ms", &input);
                    figures.push(figure.beside("OpenCV", known(other)));
                    let ms = |v: f64| if v.is_finite() { format!("{v:.2}") } else { "-".to_owned() };
                    let mut row = vec![format!("{scene} {}x{} {} {threads}", size.width, size.height, search.name)];
                    row.extend(own.map(ms));
                    row.push(ms(whole));
                    row.extend(peer.map(ms));
                    row.extend([ms(other), format!("{:.1}", other / whole)]);
                    rows.push(row);
                }
            }
        }
    }
    session.table(&format!("Table 3.2: median time of each step, ms\n{}\n", table(&rows)));
    let first = Case { scene: SCENES[0], size: &SIZES[0], search: SIZES[0].searches[0], threads: 2 };
    if let Some(count) = allocations(session, &first, if quick { 60 } else { 200 })? {
        figures.push(Figure::new("allocations_per_frame/stereo_chain", count, "1/frame", &first.input()));
    }
    let ruler = Ruler::measure(session)?;
    session.table(&format!("Figures 3.14 and 3.15: lengths and depths on the phantom\n{}\n", ruler.tables(PRINTED_MM)));
    figures.extend(ruler.figures());
    if let Some(path) = &options.plot {
        ruler.plot(path)?;
    }
    Ok(figures)
}
