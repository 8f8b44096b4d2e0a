//! A whole graph (graphs/surgeon.toml) on views rendered beforehand, so that only the system runs: its frames per
//! second when unpaced, and their age at 30 per second.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use panoscope_engine::Report;
use panoscope_engine::text_table::table;
use panoscope_graph::{GraphOptions, GraphText};
use panoscope_host::loader::graph_file;
use panoscope_record::timeline::{self, Beside, Budget, Calls, Timeline, Waits, work_tables};
use toml::{Table, Value};

use crate::error::{Context, Result};
use crate::figures::Figure;
use crate::inputs::Folder;
use crate::inputs::pairs::Pairs;
use crate::run::{self, Pace, Plan, Watchers};
use crate::session::{Session, note};
use crate::system::usage;

/// Pairs that are rendered, and played forwards and backwards in a loop: as many as `capture` keeps as frames, so that
/// no image is read or copied twice.
const PAIRS: u64 = 25;
/// Bytes of one view that `capture` keeps.
const KEPT_BYTES: u64 = 256 << 20;
const NO_NODES: &str = "the graph has no [nodes]";
/// Type of the source that is rendered beforehand.
const SOURCE: &str = "phantom";

/// A run with its timeline.
pub(super) struct Run {
    pub report: Report,
    pub timeline: Arc<Timeline>,
    /// Processor time of the whole process.
    pub cpu_seconds: f64,
}

/// Runs a graph; 0 `threads`: one per core.
pub(super) fn run(
    session: &dyn Session,
    text: &str,
    path: &Path,
    frames: u64,
    pace: Pace,
    threads: usize,
) -> Result<Run> {
    let timeline = Arc::new(Timeline::default());
    let watchers = Watchers { tracer: Some(Arc::clone(&timeline) as _), ..Watchers::default() };
    let plan = Plan { text, path, frames: Some(frames), threads, ports: &[], pace };
    let before = usage().cpu_seconds;
    let report = run::run_watched(session, &plan, watchers)?.report;
    Ok(Run { report, timeline, cpu_seconds: usage().cpu_seconds - before })
}

/// A graph whose views are rendered beforehand.
pub(super) struct Rendered {
    folder: Folder,
    graph: Table,
    source: String,
    pairs: Pairs,
    /// Number of pairs.
    pub count: u64,
}

impl Rendered {
    /// Renders the views of the phantom in the graph at `path`, in the size `size`, if given.
    pub fn of(session: &dyn Session, path: &Path, given: &GraphOptions, size: Option<(u32, u32)>) -> Result<Self> {
        let text = run::flattened(path, given)?;
        let graph: Table = text.parse().with_context(|| format!("{} is not a graph", path.display()))?;
        let (source, mut phantom) = source(&graph)?;
        if let Some((width, height)) = size
            && let Some(params) =
                phantom.as_table_mut().map(|node| node.entry("params").or_insert(Value::Table(Table::new())))
            && let Some(params) = params.as_table_mut()
        {
            params.insert("width".to_owned(), Value::Integer(i64::from(width)));
            params.insert("height".to_owned(), Value::Integer(i64::from(height)));
        }
        let folder = Folder::new("panoscope-bench-system")?;
        let count = pairs_of(&phantom);
        note!(session, "rendering {count} pairs");
        let pairs = Pairs::render(session, &folder, "pairs", &phantom, count)?.and_back(count)?;
        Ok(Self { folder, graph, source, pairs, count })
    }

    /// The graph on those views, at the rate of a camera (`pace` on) or as fast as they are accepted (off).
    pub fn text(&self, pace: &str, rate_hz: u32) -> Result<String> {
        played(&self.graph, self.folder.path(), &self.source, &self.pairs.node(pace, rate_hz))
    }
}

/// Shows the time budget of a frame, from the end of the source's call to the end of each sink that takes every tick.
fn show_budget(session: &dyn Session, run: &Run, text: &str, path: &Path) -> Result<()> {
    let text = GraphText::parse(path, text);
    let Ok(ready) = graph_file::ready(&text) else { return Ok(()) };
    let (waits, calls) = (Waits::of(&ready.graph), run.timeline.snapshot());
    let mut sinks: Vec<(&String, f64)> = run.report.paths.iter().map(|(sink, path)| (sink, path.age_p99_ms)).collect();
    sinks.sort_by(|a, b| b.1.total_cmp(&a.1));
    for budget in sinks.iter().filter_map(|(sink, _)| Budget::of(&calls, &waits, sink)) {
        note!(
            session,
            "the chain of calls that `{}` waits for, mean of {} pictures, {:.2} ms from the source:",
            budget.sink,
            budget.pictures,
            budget.total_ms
        );
        session.table(&budget.text());
    }
    if let Some((budget, beside)) = sinks.first().and_then(|(sink, _)| Budget::of_slowest(&calls, &waits, sink)) {
        note!(
            session,
            "its slowest hundredth at `{}`, {} pictures, {:.2} ms, and what ran while they waited (sources wait for light):",
            budget.sink,
            budget.pictures,
            budget.total_ms
        );
        session.table(&budget.text());
        session.table(&Beside::text(&beside));
    }
    let [moved, threads] = work_tables(&calls, run.report.frames);
    note!(session, "bytes per picture, and their rate while the node works:");
    session.table(&moved);
    note!(session, "threads, share of the run in which they are in calls (sources wait for light in theirs):");
    session.table(&threads);
    Ok(())
}

fn nodes(graph: &mut Table) -> Result<&mut Table> {
    graph.get_mut("nodes").and_then(Value::as_table_mut).context(NO_NODES)
}

fn kind(node: &Value) -> &str {
    node.get("type").and_then(Value::as_str).unwrap_or("")
}

fn source(graph: &Table) -> Result<(String, Value)> {
    let nodes = graph.get("nodes").and_then(Value::as_table).context(NO_NODES)?;
    let found = nodes.iter().find(|(_, node)| kind(node) == SOURCE);
    let (name, node) =
        found.context("the graph has no `phantom`: the bench replaces it by a recording of its views")?;
    Ok((name.clone(), node.clone()))
}

/// Number of pairs for the size of a phantom's images.
fn pairs_of(phantom: &Value) -> u64 {
    let of = |name: &str, default: u64| {
        let value = phantom.get("params").and_then(|params| params.get(name)).and_then(Value::as_integer);
        value.and_then(|value| u64::try_from(value).ok()).unwrap_or(default)
    };
    kept_pairs(of("width", 640), of("height", 480))
}

/// Number of pairs of a size that are played forwards and backwards from memory.
pub(super) fn kept_pairs(width: u64, height: u64) -> u64 {
    // There and back again, each picture is kept twice.
    PAIRS.min(KEPT_BYTES / (2 * 3 * width * height).max(1)).max(2)
}

/// The graph with its phantom played from files and its sinks writing into `folder`.
fn played(graph: &Table, folder: &Path, name: &str, capture: &str) -> Result<String> {
    let mut graph = graph.clone();
    if let Some(plugins) = graph.get_mut("plugins").and_then(Value::as_array_mut) {
        plugins.push(Value::String("capture".to_owned()));
    }
    let nodes = nodes(&mut graph)?;
    nodes.insert(name.to_owned(), Value::Table(capture.parse()?));
    // Cameras know no truth: lists lose what they take from the phantom besides its views.
    let truth = |entry: &Value| {
        let from = entry.as_str().or_else(|| entry.get("from").and_then(Value::as_str)).unwrap_or("");
        from.split_once('.')
            .is_some_and(|(node, port)| node == name && !matches!(port, "left" | "right" | "calibration"))
    };
    for inputs in nodes.iter_mut().filter_map(|(_, node)| node.get_mut("inputs").and_then(Value::as_table_mut)) {
        inputs.retain(|_, input| !truth(input));
        for list in inputs.iter_mut().filter_map(|(_, input)| input.as_array_mut()) {
            list.retain(|entry| !truth(entry));
        }
    }
    for (id, node) in nodes.iter_mut().filter(|(_, node)| kind(node).starts_with("write_")) {
        let path = node.get("params").and_then(|p| p.get("path")).and_then(Value::as_str).unwrap_or("out");
        let file = Path::new(path).file_name().map_or_else(|| id.clone(), |f| f.to_string_lossy().into_owned());
        let place = folder.join(format!("{id}_{file}")).to_string_lossy().into_owned();
        let node = node.as_table_mut().context("a node must be a table")?;
        let params = node.entry("params").or_insert_with(|| Value::Table(Table::new()));
        if let Some(params) = params.as_table_mut() {
            params.insert("path".to_owned(), Value::String(place));
        }
    }
    Ok(toml::to_string(&graph)?)
}

fn show(session: &dyn Session, report: &Report) {
    let mut rows = vec![
        ["node", "calls", "per picture", "p50 ms", "p99 ms", "ms of work per picture"].map(str::to_owned).to_vec(),
    ];
    let pictures = report.frames.max(1) as f64;
    let mut nodes: Vec<_> = report.nodes.iter().collect();
    let work = |n: &panoscope_engine::NodeReport| n.p50_ms * n.count as f64 / pictures;
    nodes.sort_by(|a, b| work(b.1).total_cmp(&work(a.1)));
    for (id, node) in nodes {
        rows.push(vec![
            id.clone(),
            node.count.to_string(),
            format!("{:.2}", node.count as f64 / pictures),
            format!("{:.2}", node.p50_ms),
            format!("{:.2}", node.p99_ms),
            format!("{:.2}", work(node)),
        ]);
    }
    session.table(&table(&rows));
}

/// Options of [`measure`].
#[derive(Clone, Debug)]
pub struct Options {
    /// Fewer frames and rounds: a quick check instead of a measurement.
    pub quick: bool,
    /// Graph with a `phantom`, whose views are rendered beforehand.
    pub graph: PathBuf,
    /// Its overlays, arguments and settings.
    pub given: GraphOptions,
    /// Width and height of the views, px; default: those of the graph's `phantom`.
    pub size: Option<(u32, u32)>,
    /// Frames per second of the cameras. Nodes with a maximum rate process the corresponding share of the frames.
    pub rate_hz: u32,
    /// File for the timeline of all threads at the cameras' rate.
    pub trace: Option<PathBuf>,
}

/// Measures the graph: unpaced for `system_fps`, at the cameras' rate for the ages.
pub fn measure(session: &dyn Session, options: &Options) -> Result<Vec<Figure>> {
    let (path, quick) = (options.graph.as_path(), options.quick);
    let rate_hz = options.rate_hz;
    let mut rendered = Rendered::of(session, path, &options.given, options.size)?;
    let (unheld, held) = (rendered.text("off", rate_hz), rendered.text("on", rate_hz));
    let (unheld, held) = (unheld?, held?);
    let (frames, rounds) = if quick { (480, 1) } else { (1800, 2) };
    let count = rendered.count;
    let of_size = options.size.map_or(String::new(), |(width, height)| format!(" of {width}x{height}"));
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let input = format!("{name} on {count} rendered pairs{of_size}, {rate_hz} a second");
    let fps = |run: &Run| screen_fps(run, 2 * count);
    let mut fastest: Option<Run> = None;
    let mut paced: Option<Run> = None;
    for _ in 0..rounds {
        let free = run(session, &unheld, path, frames, Pace::Free, 0)?;
        if fastest.as_ref().is_none_or(|best| fps(&free) > fps(best)) {
            fastest = Some(free);
        }
        let run = run(session, &held, path, frames, Pace::Camera, 0)?;
        let age = |run: &Run| slowest(&run.report).1;
        if paced.as_ref().is_none_or(|best| age(&run) < age(best)) {
            paced = Some(run);
        }
    }
    let (fastest, paced) = fastest.zip(paced).context("nothing was measured")?;
    note!(session, "unpaced, {} pictures in {:.1} s:", fastest.report.frames, fastest.report.seconds);
    show(session, &fastest.report);
    note!(session, "at {rate_hz} pictures a second:");
    show(session, &paced.report);
    show_budget(session, &paced, &held, path)?;
    if let Some(file) = &options.trace {
        timeline::write(&paced.timeline, file).with_context(|| format!("cannot write {}", file.display()))?;
    }
    let paced = paced.report;
    let mut figures = vec![Figure::new("system_fps", fps(&fastest), "1/s", &input)];
    // Figures of older versions counted the inputs of a sink's own tick only: they compare with those of the newest light.
    let (sink, age) = slowest(&paced);
    let (oldest, newest) = (format!("{input}, oldest light"), format!("{input}, newest light"));
    figures.push(Figure::new("system_age_p99", age, "ms", &format!("{oldest}, slowest sink {sink}")));
    for (sink, path) in &paced.paths {
        figures.push(Figure::new(&format!("system_age_p99/{sink}"), path.age_p99_ms, "ms", &oldest));
        figures.push(Figure::new(&format!("system_newest_age_p99/{sink}"), path.newest_age_p99_ms, "ms", &newest));
    }
    if let Some(path) = behind_the_arm(&mut rendered.graph)?.and_then(|sink| paced.paths.get(&sink)) {
        figures.push(Figure::new("setpoint_age_p50", path.age_p50_ms, "ms", &oldest));
        figures.push(Figure::new("setpoint_age_p99", path.age_p99_ms, "ms", &oldest));
        figures.push(Figure::new("setpoint_newest_age_p99", path.newest_age_p99_ms, "ms", &newest));
    }
    Ok(figures)
}

/// Frames per second at the sink with most of them, from frame `first` on; earlier frames are read from files, unlike
/// those of a camera.
pub(super) fn screen_fps(run: &Run, first: u64) -> f64 {
    let Calls { nodes, calls, .. } = run.timeline.snapshot();
    let rate = |sink: &String| {
        let node = nodes.iter().position(|node| **node == **sink)?;
        let ends = calls.iter().filter(|call| call.node as usize == node && call.made && call.seq >= first);
        let ends: Vec<u64> = ends.map(|call| call.end_ns).collect();
        let (start, end) = (ends.iter().min()?, ends.iter().max()?);
        (end > start).then(|| (ends.len() - 1) as f64 * 1e9 / (end - start) as f64)
    };
    run.report.paths.keys().filter_map(rate).fold(f64::NAN, f64::max)
}

/// The sink that writes only the output of an arm's driver.
fn behind_the_arm(graph: &mut Table) -> Result<Option<String>> {
    let nodes = nodes(graph)?;
    let is_arm = |input: &Value| {
        let from = input.as_str().and_then(|from| from.split_once('.'));
        from.and_then(|(node, _)| nodes.get(node))
            .is_some_and(|node| kind(node).starts_with("arm_") && kind(node) != "arm_pid")
    };
    let only_arm = |node: &&Value| {
        let inputs = node.get("inputs").and_then(Value::as_table);
        kind(node) == "write_table" && inputs.is_some_and(|inputs| inputs.values().all(is_arm))
    };
    Ok(nodes.iter().find(|(_, node)| only_arm(node)).map(|(id, _)| id.clone()))
}

fn slowest(report: &Report) -> (String, f64) {
    let oldest = report.paths.iter().max_by(|a, b| a.1.age_p99_ms.total_cmp(&b.1.age_p99_ms));
    oldest.map_or((String::new(), f64::NAN), |(id, path)| (id.clone(), path.age_p99_ms))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn large_pictures_are_fewer() {
        let phantom =
            |params: &str| Value::Table(format!("type = \"phantom\"\nparams = {{ {params} }}").parse().expect("TOML"));
        assert_eq!(pairs_of(&phantom("")), 25);
        assert_eq!(pairs_of(&phantom("width = 1920, height = 1080")), 21);
        assert_eq!(pairs_of(&phantom("width = 100000, height = 100000")), 2);
    }
}
