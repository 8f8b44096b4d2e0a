//! `panoscope eval stitch`: registration and panorama of a graph beside the truth and beside OpenCV's conventional pipeline.

mod beside;
mod cases;
mod fov;
mod incidents;
mod sources;
mod speed_list;
mod speeds;
mod tally;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

use super::look::{self, Pace, Plan, Seen, Table};
use super::plot::{self, Chart, Series, Style};
use super::rewire::{Judged, Wiring};
use crate::commands::bench::record::Figure;
use crate::terminal::{raw, table, tell};
use sources::{CASES, Case, Missing, Places};
use speed_list::SpeedList;

/// Ticks that a still scene's registration has to settle.
const SETTLE: usize = 5;
const PEER: &str = "OpenCV SIFT, full graph cut";
const FRESH: f64 = 0.0;

/// Arguments of `eval stitch`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Graph with a composite of two or more views.
    #[arg(required_unless_present_any = ["speeds", "cases"])]
    graph: Option<PathBuf>,
    /// Which pictures: `own` are the graph's; `cut` real frames cut into two views; `hamlyn` real stereo pairs; `leuven` two
    /// photographs. May be given again; `own` without it.
    #[arg(long, value_parser = CASES)]
    case: Vec<String>,
    /// Folder of data sets, searched before the usual ones. May be given again.
    #[arg(long, value_name = "DIR")]
    data: Vec<PathBuf>,
    /// Writes the figures as JSON.
    #[arg(long, value_name = "FILE.json")]
    pub json: Option<PathBuf>,
    /// Draws alignment and likeness over time.
    #[arg(long, value_name = "FILE.png")]
    plot: Option<PathBuf>,
    /// Writes a row for every tick as CSV, one file per judge: FILE becomes FILE-composite.csv.
    #[arg(long, value_name = "FILE")]
    rows: Option<PathBuf>,
    /// Ticks of each run.
    #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u64).range(12..))]
    frames: u64,
    /// Sets a parameter; wins over the file. May be given again.
    #[arg(long, value_name = "NODE.PARAM=VALUE")]
    set: Vec<String>,
    /// Leaves OpenCV's conventional pipeline out.
    #[arg(long)]
    no_peer: bool,
    #[command(flatten)]
    fov: fov::FovArguments,
    #[command(flatten)]
    sweeps: Sweeps,
}

/// Graphs side by side on the same pictures of the phantom; `--set scope.PARAM=VALUE` sets a parameter of the phantom.
#[derive(clap::Args)]
struct Sweeps {
    /// Sweeps the speed of the cameras, cm/s, as `1,2.5,10` or `0.5..10` or `0.5..10:0.5`: share of stitched frames and alignment of each
    /// graph; of our conventional, ROI and grid and the thesis's chapters 2 and 4 when no graph is given.
    #[arg(long, value_name = "LIST", conflicts_with_all = ["case", "rows"])]
    speeds: Option<SpeedList>,
    /// Judges each graph on hard pictures (few features, smoke, blur, low light, real pairs): share of stitched frames, alignment, time,
    /// jitter; the thesis's chapters 2 and 4 and our ROI and grid when no graph is given.
    #[arg(long, conflicts_with_all = ["case", "rows", "speeds"])]
    cases: bool,
    /// With `--cases`: only this one. May be given again.
    #[arg(long, value_name = "CASE", requires = "cases", value_parser = clap::builder::PossibleValuesParser::new(cases::known()))]
    only: Vec<String>,
    /// With `--fov`, `--speeds` or `--cases`: further graphs.
    #[arg(value_name = "GRAPHS")]
    more: Vec<PathBuf>,
}

/// Measures of one pair of views; NaN where there is no truth.
#[derive(Clone, Debug)]
pub struct Marks {
    /// Share of frames with a fresh registration.
    pub stitched_pct: f64,
    /// Root mean square distance of mapped from true places in the overlap.
    pub align_px: f64,
    /// The same of the best plane: what parallax leaves.
    pub floor_px: f64,
    psnr_overlap_db: f64,
    ssim_overlap: f64,
    psnr_seam_db: f64,
    ssim_seam: f64,
    fov_pct: f64,
    cropped_pct: f64,
    jitter_px: f64,
    /// Incident, good frames until it is over, wrong ones called fresh.
    recovery: Vec<(&'static str, incidents::Recovery)>,
}

fn finite(values: &[f64]) -> impl Iterator<Item = f64> + '_ {
    values.iter().copied().filter(|v| v.is_finite())
}

fn mean(values: &[f64]) -> f64 {
    let count = finite(values).count();
    if count == 0 { f64::NAN } else { finite(values).sum::<f64>() / count as f64 }
}

fn rms(values: &[f64]) -> f64 {
    mean(&values.iter().map(|v| v * v).collect::<Vec<_>>()).sqrt()
}

fn marks(rows: &Table) -> Result<Marks> {
    let column = |name: &str| rows.column(name).with_context(|| format!("the table has no column {name}"));
    let state = column("state")?;
    let fresh = state.iter().filter(|s| **s == FRESH).count();
    Ok(Marks {
        stitched_pct: 100.0 * fresh as f64 / state.len().max(1) as f64,
        align_px: rms(&column("align_px")?),
        floor_px: rms(&column("floor_px")?),
        psnr_overlap_db: mean(&column("psnr_overlap_db")?),
        ssim_overlap: mean(&column("ssim_overlap")?),
        psnr_seam_db: mean(&column("psnr_seam_db")?),
        ssim_seam: mean(&column("ssim_seam")?),
        fov_pct: mean(&column("fov_pct")?),
        cropped_pct: finite(&column("cropped_pct")?).fold(f64::NAN, f64::max),
        jitter_px: f64::NAN,
        recovery: Vec::new(),
    })
}

/// One graph with its judges, run.
struct Run {
    tables: Vec<Table>,
    seen: Seen,
}

/// Names of the judges and what figures call them.
fn judges(wiring: &Wiring) -> Vec<(String, String)> {
    let mut all = Vec::new();
    for composite in &wiring.composites {
        for pair in 0..composite.pairs() {
            let view = if composite.pairs() > 1 { format!("view{}", pair + 1) } else { String::new() };
            let id = if wiring.composites.len() > 1 { composite.id.clone() } else { String::new() };
            all.push((
                composite.judge(pair),
                [id, view].into_iter().filter(|p| !p.is_empty()).collect::<Vec<_>>().join("_"),
            ));
        }
    }
    all
}

fn run(wiring: &Wiring, judged: Judged, path: &Path, frames: u64) -> Result<Run> {
    let text = wiring.judged(judged).text();
    let names = judges(wiring);
    let ports: Vec<(&str, &str)> = names.iter().map(|(name, _)| (name.as_str(), "table")).collect();
    let plan = Plan { text: &text, path, frames: Some(frames), threads: 0, ports: &ports, pace: Pace::Free };
    let seen = look::run(&plan)?;
    let mut tables = Vec::new();
    for packet in &seen.packets {
        let bytes = packet.as_ref().context("the judge saw nothing")?.bytes();
        tables.push(Table::read(bytes).context("the judge's table could not be read")?);
    }
    Ok(Run { tables, seen })
}

/// All runs of a case: as it is, with views that hold still, with everything that can go wrong. The same of OpenCV's when `is_peer`.
fn judge_all(case: &Case, path: &Path, frames: u64, is_peer: bool) -> Result<Option<(Vec<Marks>, Run)>> {
    let of = |judged: Judged| if is_peer { case.wiring.peer(judged, 0.0, 2) } else { Some(case.wiring.clone()) };
    let (Some(whole), Some(plain)) = (of(Judged::Pictures), of(Judged::Registration)) else { return Ok(None) };
    let main = run(&whole, Judged::Pictures, path, frames)?;
    let mut all: Vec<Marks> = main.tables.iter().map(marks).collect::<Result<_>>()?;
    if !case.still.is_empty() {
        let mut still = plain.clone();
        for (node, param, value) in &case.still {
            still.set(node, param, value.clone());
        }
        for (marks, rows) in all.iter_mut().zip(&run(&still, Judged::Registration, path, frames.min(40))?.tables) {
            let ways = rows.column("move_px").unwrap_or_default();
            marks.jitter_px = rms(ways.get(SETTLE..).unwrap_or_default());
        }
    }
    let Some(phantom) = case.wiring.phantom() else { return Ok(Some((all, main))) };
    for incident in &incidents::ALL {
        let mut bad = plain.clone();
        for (param, value) in incident.params {
            bad.set(&phantom, param, *value);
        }
        bad.set(&phantom, incident.window[0], incidents::WINDOW.0);
        bad.set(&phantom, incident.window[1], incidents::WINDOW.1);
        for (marks, rows) in all.iter_mut().zip(&run(&bad, Judged::Registration, path, incidents::TICKS)?.tables) {
            marks.recovery.extend(incidents::recovery(incident, rows).map(|found| (incident.name, found)));
        }
    }
    Ok(Some((all, main)))
}

fn csv(rows: &Table) -> String {
    let mut text = rows.names.join(",") + "\n";
    for row in &rows.rows {
        let cells: Vec<String> =
            row.iter().map(|v| if v.is_finite() { v.to_string() } else { String::new() }).collect();
        let _ = writeln!(text, "{}", cells.join(","));
    }
    text
}

/// Name, unit, value and whether more is better.
fn listed(m: &Marks) -> Vec<(String, &'static str, f64, bool)> {
    let named = [
        ("stitched_share", "%", m.stitched_pct, true),
        ("align_px", "px", m.align_px, false),
        ("align_floor_px", "px", m.floor_px, false),
        ("psnr_overlap", "dB", m.psnr_overlap_db, true),
        ("ssim_overlap", "1", m.ssim_overlap, true),
        ("seam_psnr", "dB", m.psnr_seam_db, true),
        ("seam_ssim", "1", m.ssim_seam, true),
        ("fov_total_pct", "%", m.fov_pct, true),
        ("fov_gain_pct", "%", m.fov_pct - 100.0, true),
        ("cropped_pct", "%", m.cropped_pct, false),
        ("jitter_px", "px", m.jitter_px, false),
    ];
    let mut all: Vec<_> = named.map(|(name, unit, value, more)| (name.to_owned(), unit, value, more)).into();
    for (incident, found) in &m.recovery {
        all.push((format!("recovery_frames/{incident}"), "frames", found.frames, false));
        all.push((format!("recovery_false_fresh/{incident}"), "frames", found.false_fresh, false));
    }
    all
}

fn figures(case: &str, marks: &Marks, peer: Option<&Marks>, input: &str) -> Vec<Figure> {
    let mut out = Vec::new();
    let theirs = peer.map(listed);
    for (name, unit, value, more) in listed(marks) {
        let lasts = name.starts_with("recovery_frames");
        if !value.is_finite() {
            if lasts {
                tell!("{name}: {case}: stitching does not come back within {} frames", incidents::TICKS);
            }
            continue;
        }
        let (measure, rest) =
            name.split_once('/').map_or((name.as_str(), String::new()), |(m, r)| (m, format!("_{r}")));
        let mut figure = Figure::new(&format!("{measure}/{case}{rest}"), value, unit, input);
        let same = theirs.as_ref().and_then(|t| t.iter().find(|(n, ..)| *n == name));
        if let Some(peer_value) = same.map(|(_, _, value, _)| *value).filter(|v| v.is_finite()) {
            figure.peer = Some(PEER.to_owned());
            figure.peer_value = Some(peer_value);
            let (best, other) = if more { (value, peer_value) } else { (peer_value, value) };
            figure.ratio = (other > 0.0).then(|| best / other);
        }
        out.push(figure);
    }
    out
}

/// Alignment and likeness along the seam over time, ours beside the peer's.
fn charts(case: &str, name: &str, rows: &Table, peer: Option<&Table>) -> Vec<Chart> {
    let of = |rows: &Table, column: &str| -> Vec<(f64, f64)> {
        rows.column(column).unwrap_or_default().into_iter().enumerate().map(|(tick, v)| (tick as f64, v)).collect()
    };
    let mut all = Vec::new();
    for (column, label) in [("align_px", "alignment, px"), ("ssim_seam", "structural similarity along the seam")] {
        let sets = [(Some(rows), "Panoscope", 0), (peer, "OpenCV", 1)];
        let mut series: Vec<Series> = sets
            .into_iter()
            .filter_map(|(rows, name, color)| Some((of(rows?, column), name, color)))
            .map(|(points, name, color)| {
                // Some measures are taken on every few ticks only.
                let points: Vec<_> = points.into_iter().filter(|p| p.1.is_finite()).collect();
                Series { name: name.to_owned(), style: Style::Line, color, points }
            })
            .filter(|series| !series.points.is_empty())
            .collect();
        if series.is_empty() {
            continue;
        }
        if column == "align_px" {
            let points = of(rows, "floor_px").into_iter().filter(|p| p.1.is_finite()).collect();
            series.push(Series { name: "best plane".to_owned(), style: Style::Line, color: 2, points });
        }
        let title = [case, name].into_iter().filter(|t| !t.is_empty()).collect::<Vec<_>>().join(" ");
        all.push(Chart {
            title,
            x_label: "frame".to_owned(),
            y_label: label.to_owned(),
            series,
            from_zero: column == "align_px",
            log: false,
            words: Vec::new(),
        });
    }
    all
}

fn stages(run: &Run) {
    let mut rows = vec![["stage", "p50 ms", "p99 ms", "max ms"].map(str::to_owned).to_vec()];
    for (id, node) in run.seen.report.nodes.iter().filter(|(id, _)| !id.starts_with("judge_")) {
        let ms = |v: f64| format!("{v:.2}");
        rows.push(vec![id.clone(), ms(node.p50_ms), ms(node.p99_ms), ms(node.max_ms)]);
    }
    raw(&table(&rows));
}

/// A folder that is removed at the end.
struct Work(PathBuf);

impl Work {
    fn new() -> Result<Self> {
        let path = std::env::temp_dir().join(format!("panoscope-eval-{}", std::process::id()));
        std::fs::create_dir_all(&path).with_context(|| format!("cannot make {}", path.display()))?;
        Ok(Self(path))
    }
}

impl Drop for Work {
    fn drop(&mut self) {
        // Nothing is lost when it cannot be removed.
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// How well a graph's first composite is registered.
pub fn registration_of(text: &str, frames: u64) -> Result<Marks> {
    let wiring = Wiring::of(text, "bench")?;
    let run = run(&wiring, Judged::Registration, Path::new("bench.toml"), frames)?;
    marks(run.tables.first().context("there is no judge")?)
}

fn wiring(path: &Path, set: &[String]) -> Result<Option<Wiring>> {
    // All mistakes of the file as it stands, with their lines.
    if let Err(diagnostics) = crate::graph_file::load(path, set) {
        raw(&diagnostics.render(false));
        return Ok(None);
    }
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let stem = path.file_stem().map_or_else(|| "graph".into(), |s| s.to_string_lossy());
    let mut wiring = match Wiring::of(&text, &stem) {
        Ok(wiring) => wiring,
        Err(error) => {
            tell!("error: {}: {error}", path.display());
            return Ok(None);
        }
    };
    for (node, param, value) in set.iter().filter_map(|setting| beside::setting(setting)) {
        wiring.set(node, param, value);
    }
    Ok(Some(wiring))
}

/// Several graphs side by side, when that is asked for.
fn swept(arguments: &Arguments, folders: &[PathBuf], work: &Work) -> Option<Result<Option<Vec<Figure>>>> {
    let Sweeps { speeds, cases, only, more } = &arguments.sweeps;
    let graphs: Vec<&PathBuf> = arguments.graph.iter().chain(more).collect();
    let (settings, frames, plot) = (&arguments.set[..], arguments.frames, arguments.plot.as_deref());
    if let Some(speeds) = speeds {
        let methods = beside::methods(&graphs, speeds::built_in(), settings);
        return Some(methods.and_then(|methods| speeds::judge(speeds, methods, frames, settings, plot)));
    }
    if *cases {
        let judge = |methods| {
            let work = &work.0;
            cases::judge(&cases::Plan { methods, only, frames, settings, folders, work, plot })
        };
        return Some(beside::methods(&graphs, cases::built_in(), settings).and_then(judge));
    }
    (!more.is_empty()).then(|| {
        Err(anyhow::anyhow!("several graphs are judged with --fov, --speeds or --cases; give one graph without them"))
    })
}

/// Judges a graph; none when it cannot be judged.
pub fn judge(arguments: &Arguments) -> Result<Option<Vec<Figure>>> {
    if arguments.fov.fov {
        let graphs: Vec<&Path> = arguments.graph.iter().chain(&arguments.sweeps.more).map(PathBuf::as_path).collect();
        return fov::judge(&graphs, &arguments.set, arguments.frames, &arguments.fov);
    }
    let usual = ["../shared/data", "../shared/data/stereo", "/usr/share/doc/opencv-doc/examples/data"];
    let folders: Vec<PathBuf> = arguments.data.iter().cloned().chain(usual.map(PathBuf::from)).collect();
    let work = Work::new()?;
    if let Some(found) = swept(arguments, &folders, &work) {
        return found;
    }
    let path = arguments.graph.as_deref().context("no graph is given")?;
    let Some(graph) = wiring(path, &arguments.set)? else { return Ok(None) };
    let places = Places { folders: &folders, work: &work.0 };
    let wanted = |name: &str| {
        if arguments.case.is_empty() { name == CASES[0] } else { arguments.case.iter().any(|c| c == name) }
    };
    let (mut out, mut pictures) = (Vec::new(), Vec::new());
    for name in CASES.into_iter().filter(|name| wanted(name)) {
        let case = match sources::case(name, &graph, &places)? {
            Ok(case) => case,
            Err(Missing::Pictures(what)) => {
                tell!("skipped: {name}: there is no {what} in the data folders (give --data)");
                continue;
            }
            Err(Missing::Port(why)) => {
                tell!("skipped: {name}: {why}");
                continue;
            }
        };
        let Some((ours, main)) = judge_all(&case, path, arguments.frames, false)? else { continue };
        let peer = if arguments.no_peer { None } else { judge_all(&case, path, arguments.frames, true)? };
        let peer_marks = peer.as_ref().and_then(|(marks, _)| marks.first());
        let peer_rows = peer.as_ref().and_then(|(_, run)| run.tables.first());
        let input = format!("{}, {} frames", case.input, arguments.frames);
        let title =
            [graph.name.as_str(), case.name].into_iter().filter(|n| !n.is_empty()).collect::<Vec<_>>().join("_");
        for (((judge, name), marks), rows) in judges(&case.wiring).iter().zip(&ours).zip(&main.tables) {
            let named =
                [title.as_str(), name.as_str()].into_iter().filter(|n| !n.is_empty()).collect::<Vec<_>>().join("_");
            out.extend(figures(&named, marks, peer_marks, &input));
            pictures.extend(charts(&title, name, rows, peer_rows));
            if let Some(path) = &arguments.rows {
                let mut file = path.as_os_str().to_owned();
                let case = if case.name.is_empty() { String::new() } else { format!("-{}", case.name) };
                file.push(format!("{case}-{}.csv", judge.trim_start_matches("judge_")));
                std::fs::write(&file, csv(rows))
                    .with_context(|| format!("cannot write {}", Path::new(&file).display()))?;
            }
        }
        stages(&main);
        if let Some((_, run)) = &peer {
            stages(run);
        }
    }
    if let Some(path) = arguments.plot.as_ref().filter(|_| !pictures.is_empty()) {
        plot::save(path, &pictures)?;
    }
    Ok((!out.is_empty()).then_some(out))
}
