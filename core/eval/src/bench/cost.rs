//! Cost of a graph by image width and number of cameras, nodes and threads, as tables and curves, and a simulation of
//! more cores from recorded calls.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use panoscope_engine::text_table::{number, table};
use panoscope_graph::{GraphOptions, GraphText};
use panoscope_host::loader::graph_file;
use panoscope_record::timeline::{Recorded, Waits};

use super::scale;
use super::system::{Rendered, Run, kept_pairs, run, screen_fps};
use crate::bench::CAMERA_HZ;
use crate::error::{FileAction, OnFile, Result};
use crate::figures::Figure;
use crate::inputs::pairs::Pairs;
use crate::inputs::{Folder, quoted};
use crate::plot::{self, Chart, Series, Style};
use crate::run::{self, Pace};
use crate::session::{Session, note};

/// Images of 16:9, as used by endoscopes and screens.
const SIZES: [(u32, u32); 6] = [(640, 360), (960, 540), (1280, 720), (1920, 1080), (2560, 1440), (3840, 2160)];
const CORES: [usize; 5] = [1, 2, 4, 8, 16];
/// Ticks between source and sinks in a live graph, as admitted by the engine.
const IN_FLIGHT: usize = panoscope_engine::TICKS_LIVE as usize;
/// Maximum number of pairs of a size that are rendered for panoramas.
const PAIRS: u64 = 12;

/// Options of [`measure`].
#[derive(Clone, Debug)]
pub struct Options {
    /// Fewer sizes, cameras and frames: a quick check instead of a measurement.
    pub quick: bool,
    /// Graph with a `phantom`, whose views are rendered beforehand.
    pub graph: PathBuf,
    /// Its overlays, arguments and settings.
    pub given: GraphOptions,
    /// Image file for the curves.
    pub plot: Option<PathBuf>,
}

/// One point of a curve.
#[derive(Clone, Copy, Debug)]
struct Cost {
    /// Width in px, cameras, or threads.
    at: f64,
    /// Unpaced frames per second of each camera, after all have been read from their files.
    fps: f64,
    /// Processor time per frame, all threads, ms; includes reading the first ones.
    cpu_ms: f64,
}

/// Frames that take about as long at each size.
fn frames_of(size: (u32, u32), quick: bool) -> u64 {
    let pixels = f64::from(size.0) * f64::from(size.1);
    let frames = if quick { 4e7 } else { 3e8 } / pixels;
    (frames as u64).clamp(if quick { 24 } else { 120 }, 900)
}

impl Cost {
    /// The cost of a run whose first `read` frames came from files.
    fn of(done: &Run, at: f64, read: u64) -> Self {
        let cpu_ms = 1e3 * done.cpu_seconds / done.report.frames.max(1) as f64;
        Self { at, fps: screen_fps(done, read), cpu_ms }
    }
}

/// The graph at each width.
fn widths(session: &dyn Session, options: &Options) -> Result<Vec<Cost>> {
    let sizes = SIZES.iter().filter(|(width, _)| !options.quick || [640, 1280].contains(width));
    let of_size = |size: &(u32, u32)| {
        let rendered = Rendered::of(session, &options.graph, &options.given, Some(*size))?;
        let text = rendered.text("off", CAMERA_HZ)?;
        // The first time round each picture is read from its file, later ones are kept.
        let read = 2 * rendered.count;
        let frames = frames_of(*size, options.quick) + read;
        Ok(Cost::of(&run(session, &text, &options.graph, frames, Pace::Free, 0)?, f64::from(size.0), read))
    };
    sizes.map(of_size).collect()
}

/// A graph that makes a panorama of each of `count` pairs of cameras, like `graphs/panorama_large.toml` does.
fn panoramas(pairs: &Pairs, count: usize, parts: &Path, out: &Path) -> String {
    let mut text = "mode = \"live\"\nplugins = [\"capture\", \"stereo\", \"sinks\"]\n".to_owned();
    let part = |name: &str| quoted(&parts.join(name));
    let (matching, panorama) = (part("block_matching.toml"), part("panorama_disparity_mesh.toml"));
    for at in 0..count {
        let views =
            format!("left = \"pair{at}.left\", right = \"pair{at}.right\", calibration = \"pair{at}.calibration\"");
        let file = quoted(&out.join(format!("panorama{at}.png")));
        let _ = write!(
            text,
            "[nodes.pair{at}]\n{}[nodes.views{at}]\ngraph = {matching}\ninputs = {{ {views} }}\nparams = {{ picture_scale = 0, scale = 0 }}\n\
             [nodes.wide{at}]\ngraph = {panorama}\ninputs = {{ {views}, disparity = \"views{at}.disparity\" }}\n\
             [nodes.still{at}]\ntype = \"write_images\"\ninputs = {{ image = \"wide{at}.panorama\" }}\nparams = {{ path = {file}, at_end = true }}\n",
            pairs.node("off", CAMERA_HZ),
        );
    }
    text
}

/// Panoramas of 2 cameras and more, at one size.
fn cameras(session: &dyn Session, options: &Options, size: (u32, u32), counts: &[usize]) -> Result<Vec<Cost>> {
    let folder = Folder::new("panoscope-bench-cost")?;
    let params = format!("scene = \"bowel\", seed = 7, width = {}, height = {}", size.0, size.1);
    let pair_count = PAIRS.min(kept_pairs(size.0.into(), size.1.into()));
    note!(session, "rendering {pair_count} pairs of {}x{}", size.0, size.1);
    let pairs = Pairs::of(session, &folder, "pairs", &params, pair_count)?.and_back(pair_count)?;
    let parts = options.graph.parent().unwrap_or(Path::new("")).join("parts");
    let of_count = |count: &usize| {
        let file = folder.path().join(format!("panoramas{count}.toml"));
        std::fs::write(&file, panoramas(&pairs, *count, &parts, folder.path())).on_file(FileAction::Write, &file)?;
        let text = run::flattened(&file, &GraphOptions::default())?;
        let read = 2 * pair_count;
        let frames = frames_of(size, options.quick) + read;
        Ok(Cost::of(&run(session, &text, &file, frames, Pace::Free, 0)?, 2.0 * *count as f64, read))
    };
    counts.iter().map(of_count).collect()
}

/// The graph with different numbers of threads, and the calls of its run with one.
fn threads(session: &dyn Session, options: &Options) -> Result<(Vec<Cost>, Option<Recorded>)> {
    let rendered = Rendered::of(session, &options.graph, &options.given, None)?;
    let text = rendered.text("off", CAMERA_HZ)?;
    let read = 2 * rendered.count;
    let frames = if options.quick { 120 } else { 600 } + read;
    let waits = graph_file::ready(&GraphText::parse(&options.graph, &text)).ok().map(|ready| Waits::of(&ready.graph));
    let (mut measured, mut recorded) = (Vec::new(), None);
    for count in CORES.into_iter().filter(|count| !options.quick || *count <= 2) {
        let done = run(session, &text, &options.graph, frames, Pace::Free, count)?;
        if count == 1 {
            recorded = waits.as_ref().and_then(|waits| Recorded::of(&done.timeline.snapshot(), waits));
        }
        measured.push(Cost::of(&done, count as f64, read));
    }
    Ok((measured, recorded))
}

fn show(session: &dyn Session, first: &str, costs: &[Cost]) {
    let mut rows = vec![[first, "pictures a second", "CPU ms per picture"].map(str::to_owned).to_vec()];
    rows.extend(costs.iter().map(|c| vec![number(c.at, 0), number(c.fps, 1), number(c.cpu_ms, 2)]));
    session.table(&table(&rows));
}

fn line(name: &str, color: usize, points: Vec<(f64, f64)>) -> Series {
    Series { name: name.to_owned(), style: Style::Line, color, points }
}

fn chart(title: &str, x_label: &str, y_label: &str, series: Vec<Series>) -> Chart {
    let [title, x_label, y_label] = [title, x_label, y_label].map(str::to_owned);
    Chart { title, x_label, y_label, series, from_zero: true, ..Chart::default() }
}

fn points(costs: &[Cost], of: fn(&Cost) -> f64) -> Vec<(f64, f64)> {
    costs.iter().map(|c| (c.at, of(c))).collect()
}

/// Charts of the curves; `by_nodes` are ns per tick, `simulated` images per second by cores.
fn charts(
    name: &str,
    size: (u32, u32),
    by_width: &[Cost],
    by_cameras: &[Cost],
    by_nodes: &[(f64, f64)],
    by_threads: &[Cost],
    simulated: Vec<(f64, f64)>,
) -> [Chart; 4] {
    [
        chart(
            &format!("{name}: width"),
            "width, px",
            "ms of CPU per picture",
            vec![line("CPU", 0, points(by_width, |c| c.cpu_ms))],
        ),
        chart(
            "Panoramas: cameras",
            "cameras",
            "pictures a second of each",
            vec![line(&format!("{}x{}", size.0, size.1), 1, points(by_cameras, |c| c.fps))],
        ),
        chart(
            "Engine: nodes",
            "nodes in a chain",
            "us per tick",
            vec![line("tick", 2, by_nodes.iter().map(|(n, ns)| (*n, ns / 1e3)).collect())],
        ),
        chart(
            &format!("{name}: cores"),
            "cores",
            "pictures a second",
            vec![
                line(&format!("measured, {} cores", cores_here()), 0, points(by_threads, |c| c.fps)),
                line("simulated", 1, simulated),
            ],
        ),
    ]
}

/// Measures the curves, shows them, and draws them if `plot` names a file.
pub fn measure(session: &dyn Session, options: &Options) -> Result<Vec<Figure>> {
    let quick = options.quick;
    let name = options.graph.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let by_width = widths(session, options)?;
    note!(session, "{name} against the width of its pictures (16:9):");
    show(session, "width px", &by_width);
    let size = if quick { (640, 360) } else { (1920, 1080) };
    let by_cameras = cameras(session, options, size, if quick { &[1, 2] } else { &[1, 2, 3, 4] })?;
    note!(session, "panoramas of {}x{} against the number of cameras, two for each panorama:", size.0, size.1);
    show(session, "cameras", &by_cameras);
    let large = if quick { Vec::new() } else { cameras(session, options, (3840, 2160), &[1])? };
    let by_nodes = scale::ticks(session, quick)?;
    note!(session, "the engine against the number of nodes in a chain:");
    let mut rows = vec![["nodes", "us per tick"].map(str::to_owned).to_vec()];
    rows.extend(by_nodes.iter().map(|(nodes, ns)| vec![number(*nodes, 0), number(ns / 1e3, 2)]));
    session.table(&table(&rows));
    let (by_threads, recorded) = threads(session, options)?;
    note!(session, "{name} against the number of threads on {} cores:", cores_here());
    show(session, "threads", &by_threads);
    let mut figures = Vec::new();
    let mut figure = |name: String, value: f64, unit: &'static str, input: &str| {
        figures.push(Figure::new(&name, value, unit, input));
    };
    for c in &by_width {
        figure(format!("cost_fps/{}px", c.at), c.fps, "1/s", &name);
        figure(format!("cost_cpu/{}px", c.at), c.cpu_ms, "ms", &name);
    }
    for c in &by_cameras {
        figure(format!("cost_fps/{}_cameras", c.at), c.fps, "1/s", &format!("panoramas of {}x{}", size.0, size.1));
    }
    for c in &large {
        figure("panorama_fps/3840x2160".to_owned(), c.fps, "1/s", "one panorama of two cameras");
    }
    for c in &by_threads {
        figure(format!("cost_fps/{}_threads", c.at), c.fps, "1/s", &format!("{name}, {} cores", cores_here()));
    }
    let mut simulated = Vec::new();
    if let Some(recorded) = &recorded {
        simulated = CORES.iter().map(|cores| (*cores as f64, recorded.pictures_per_s(*cores, IN_FLIGHT))).collect();
        note!(session, "simulated from {:.1} ms of calls per picture, recorded with one thread:", recorded.work_ms());
        let mut rows =
            vec![["cores", "pictures a second", "if calls were divided without loss"].map(str::to_owned).to_vec()];
        let divided = |cores: f64| 1e3 * cores / recorded.work_ms();
        rows.extend(
            simulated.iter().map(|(cores, fps)| vec![number(*cores, 0), number(*fps, 1), number(divided(*cores), 1)]),
        );
        session.table(&table(&rows));
        if let Some((node, ms)) = recorded.busiest() {
            note!(
                session,
                "`{node}` works {ms:.1} ms per picture: undivided it ends at {:.0} pictures a second",
                1e3 / ms
            );
        }
        let input = format!("{name}, calls of a run with one thread, undivided");
        simulated.iter().for_each(|(cores, fps)| figure(format!("simulated_fps/{cores}_cores"), *fps, "1/s", &input));
    }
    if let Some(file) = &options.plot {
        let charts = charts(&name, size, &by_width, &by_cameras, &by_nodes, &by_threads, simulated);
        plot::save(file, &charts)?;
    }
    Ok(figures)
}

fn cores_here() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn large_pictures_take_fewer_frames() {
        assert_eq!([frames_of((640, 360), false), frames_of((3840, 2160), false)], [900, 120]);
        assert_eq!([frames_of((640, 360), true), frames_of((3840, 2160), true)], [173, 24]);
    }
}
