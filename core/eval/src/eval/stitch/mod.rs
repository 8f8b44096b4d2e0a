//! Registration and panorama of a graph compared with ground truth, OpenCV's conventional pipeline and
//! as-projective-as-possible warps.

mod apap;
mod beside;
pub mod cases;
pub mod fov;
mod graphs;
mod incidents;
mod pictures;
mod reference;
mod sources;
mod speed_list;
pub mod speeds;
mod tally;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use panoscope_engine::text_table::table;
use panoscope_graph::GraphOptions;

use crate::error::{FileAction, OnFile, Result};
use crate::figures::Figure;
use crate::inputs::Folder;
use crate::inputs::wiring::JudgeInputs;
use crate::packets::Table;
use crate::plot::{self, Chart, Series, Style};
use crate::registration::{JudgedRun, Registration, judges, registration, run_judged};
use crate::session::{Session, note};
use crate::statistics::rms;
use sources::{Case, Missing, Places};

pub use sources::CASES;
pub use speed_list::{SpeedList, SpeedListError};

/// Ticks for the registration of a still scene to settle.
const SETTLE: usize = 5;
const PEER: &str = "OpenCV SIFT, full graph cut";
/// Suffix of the reference method's figures.
const REFERENCE: &str = "apap";

/// Options of [`judge`].
#[derive(Clone, Debug)]
pub struct Options {
    /// Graph with a composite of two or more views.
    pub graph: PathBuf,
    /// Names of [`CASES`]; default: the graph's own images (`own`).
    pub cases: Vec<String>,
    /// Folders of data sets, searched before the default ones.
    pub data: Vec<PathBuf>,
    /// Image file (PNG) for a plot of alignment and similarity over time.
    pub plot: Option<PathBuf>,
    /// Base of the names of CSV files with a row per tick, one file per evaluating node: `FILE` becomes
    /// `FILE-composite.csv`.
    pub rows: Option<PathBuf>,
    /// Ticks of each run.
    pub frames: u64,
    /// `NODE.PARAM=VALUE`.
    pub settings: Vec<String>,
    /// Overlays of the graphs, and values of their arguments.
    pub given: GraphOptions,
    /// Runs OpenCV's conventional pipeline and as-projective-as-possible warps on the same images.
    pub with_peer: bool,
    /// Skips the runs with still views and with incidents.
    pub is_brief: bool,
    /// Folder for the last panorama of each case: the graph's and each peer's, one above the other.
    pub pictures: Option<PathBuf>,
}

/// Measures of one pair of views in all runs of a case; NaN without ground truth.
#[derive(Clone, Debug)]
struct Marks {
    registration: Registration,
    /// Motion of the map between still views, RMS px.
    jitter_px: f64,
    /// Name of the incident and the recovery from it.
    recovery: Vec<(&'static str, incidents::Recovery)>,
}

/// Evaluates all runs of a case: unchanged, with still views, and with each incident; with OpenCV's pipeline instead if
/// `is_peer`.
fn judge_all(
    session: &dyn Session,
    case: &Case,
    options: &Options,
    is_peer: bool,
) -> Result<Option<(Vec<Marks>, JudgedRun)>> {
    let (path, frames) = (options.graph.as_path(), options.frames);
    let of = |judged: JudgeInputs| if is_peer { case.wiring.peer(judged, 0.0, 2) } else { Some(case.wiring.clone()) };
    let (Some(whole), Some(plain)) = (of(JudgeInputs::Pictures), of(JudgeInputs::Registration)) else {
        return Ok(None);
    };
    let main = run_judged(session, &whole, JudgeInputs::Pictures, path, frames)?;
    let mut all = Vec::new();
    for rows in &main.tables {
        all.push(Marks { registration: registration(rows)?, jitter_px: f64::NAN, recovery: Vec::new() });
    }
    if options.is_brief {
        return Ok(Some((all, main)));
    }
    if !case.still.is_empty() {
        let mut still = plain.clone();
        for (node, param, value) in &case.still {
            still.set(node, param, value.clone());
        }
        for (marks, rows) in
            all.iter_mut().zip(&run_judged(session, &still, JudgeInputs::Registration, path, frames.min(40))?.tables)
        {
            let motion_px = rows.column("move_px").unwrap_or_default();
            marks.jitter_px = rms(motion_px.get(SETTLE..).unwrap_or_default());
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
        for (marks, rows) in
            all.iter_mut().zip(&run_judged(session, &bad, JudgeInputs::Registration, path, incidents::TICKS)?.tables)
        {
            marks.recovery.extend(incidents::recovery(incident, rows).map(|found| (incident.name, found)));
        }
    }
    Ok(Some((all, main)))
}

/// Evaluates as-projective-as-possible warps on the images of a case.
fn reference_of(session: &dyn Session, case: &Case, options: &Options) -> Result<Option<reference::Reference>> {
    let Options { graph: path, frames, is_brief, .. } = options;
    let still = (!is_brief && !case.still.is_empty()).then(|| {
        let mut still = case.wiring.clone();
        case.still.iter().for_each(|(node, param, value)| still.set(node, param, value.clone()));
        still
    });
    reference::judge(session, &case.wiring, still.as_ref(), path, *frames)
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

/// Name, unit and value of each measure, and whether larger is better.
fn listed(marks: &Marks) -> Vec<(String, &'static str, f64, bool)> {
    let m = &marks.registration;
    let named = [
        ("stitched_share", "%", m.stitched_pct, true),
        ("align_px", "px", m.align_px, false),
        ("align_floor_px", "px", m.floor_px, false),
        ("psnr_overlap", "dB", m.psnr_overlap_db, true),
        ("ssim_overlap", "1", m.ssim_overlap, true),
        ("seam_psnr", "dB", m.psnr_seam_db, true),
        ("seam_ssim", "1", m.ssim_seam, true),
        ("seam_break_px", "px", m.seam_break_px.0, false),
        ("seam_break_p95_px", "px", m.seam_break_px.1, false),
        ("ghost_share", "%", m.ghost_pct, false),
        ("stretch_pct", "%", m.stretch_pct, false),
        ("fov_total_pct", "%", m.fov_pct, true),
        ("fov_gain_pct", "%", m.fov_pct - 100.0, true),
        ("cropped_pct", "%", m.cropped_pct, false),
        ("jitter_px", "px", marks.jitter_px, false),
    ];
    let mut all: Vec<_> = named.map(|(name, unit, value, more)| (name.to_owned(), unit, value, more)).into();
    for (incident, found) in &marks.recovery {
        all.push((format!("recovery_frames/{incident}"), "frames", found.frames, false));
        all.push((format!("recovery_false_fresh/{incident}"), "frames", found.false_fresh, false));
    }
    all
}

fn figures(session: &dyn Session, case: &str, marks: &Marks, peer: Option<&Marks>, input: &str) -> Vec<Figure> {
    let mut out = Vec::new();
    let theirs = peer.map(listed);
    for (name, unit, value, more) in listed(marks) {
        let lasts = name.starts_with("recovery_frames");
        if !value.is_finite() {
            if lasts {
                note!(session, "{name}: {case}: stitching does not come back within {} frames", incidents::TICKS);
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

/// Alignment and similarity along the seam over time, ours and the peer's.
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
                Series::new(name, Style::Line, color, points)
            })
            .filter(|series| !series.points.is_empty())
            .collect();
        if series.is_empty() {
            continue;
        }
        if column == "align_px" {
            let points = of(rows, "floor_px").into_iter().filter(|p| p.1.is_finite()).collect();
            series.push(Series::new("best plane", Style::Line, 2, points));
        }
        let title = [case, name].into_iter().filter(|t| !t.is_empty()).collect::<Vec<_>>().join(" ");
        all.push(Chart {
            title,
            x_label: "frame".to_owned(),
            y_label: label.to_owned(),
            series,
            from_zero: column == "align_px",
            ..Chart::default()
        });
    }
    all
}

fn stages(session: &dyn Session, run: &JudgedRun) {
    let mut rows = vec![["stage", "p50 ms", "p99 ms", "max ms"].map(str::to_owned).to_vec()];
    for (id, node) in run.output.report.nodes.iter().filter(|(id, _)| !id.starts_with("judge_")) {
        let ms = |v: f64| format!("{v:.2}");
        rows.push(vec![id.clone(), ms(node.p50_ms), ms(node.p99_ms), ms(node.max_ms)]);
    }
    session.table(&table(&rows));
}

/// Evaluates registration and panorama of a graph on each requested case.
///
/// Returns no figures if every case was skipped; the session receives the reasons.
///
/// # Errors
/// The graph has mistakes or nothing to evaluate, a run fails, or a file cannot be written.
pub fn judge(session: &dyn Session, options: &Options) -> Result<Vec<Figure>> {
    let folders = sources::data_folders(&options.data);
    let work = Folder::new("panoscope-eval")?;
    let path = options.graph.as_path();
    let graph = graphs::wiring(path, &GraphOptions { set: options.settings.clone(), ..options.given.clone() })?;
    let places = Places { folders: &folders, work: work.path() };
    let wanted = |name: &str| {
        if options.cases.is_empty() { name == CASES[0] } else { options.cases.iter().any(|c| c == name) }
    };
    let (mut out, mut pictures) = (Vec::new(), Vec::new());
    for name in CASES.into_iter().filter(|name| wanted(name)) {
        let case = match sources::case(name, &graph, &places)? {
            Ok(case) => case,
            Err(Missing::Pictures(what)) => {
                note!(session, "skipped: {name}: there is no {what} in the data folders (give --data)");
                continue;
            }
            Err(Missing::Port(why)) => {
                note!(session, "skipped: {name}: {why}");
                continue;
            }
        };
        let Some((ours, main)) = judge_all(session, &case, options, false)? else { continue };
        let peer = if options.with_peer { judge_all(session, &case, options, true)? } else { None };
        let peer_marks = peer.as_ref().and_then(|(marks, _)| marks.first());
        let peer_rows = peer.as_ref().and_then(|(_, run)| run.tables.first());
        let reference = if options.with_peer { reference_of(session, &case, options)? } else { None };
        let input = format!("{}, {} frames", case.input, options.frames);
        let title =
            [graph.name.as_str(), case.name].into_iter().filter(|n| !n.is_empty()).collect::<Vec<_>>().join("_");
        for (((judge, name), marks), rows) in judges(&case.wiring).iter().zip(&ours).zip(&main.tables) {
            let named =
                [title.as_str(), name.as_str()].into_iter().filter(|n| !n.is_empty()).collect::<Vec<_>>().join("_");
            out.extend(figures(session, &named, marks, peer_marks, &input));
            pictures.extend(charts(&title, name, rows, peer_rows));
            if let Some(path) = &options.rows {
                let mut file = path.as_os_str().to_owned();
                let case = if case.name.is_empty() { String::new() } else { format!("-{}", case.name) };
                file.push(format!("{case}-{}.csv", judge.trim_start_matches("judge_")));
                std::fs::write(&file, csv(rows)).on_file(FileAction::Write, Path::new(&file))?;
            }
        }
        if let Some(reference) = &reference {
            let named = [title.as_str(), REFERENCE].into_iter().filter(|n| !n.is_empty()).collect::<Vec<_>>().join("_");
            out.extend(figures(session, &named, &reference.marks, None, &input));
        }
        if let Some(folder) = &options.pictures {
            let mut panels = pictures::panels(&main, "ours");
            panels.extend(peer.iter().flat_map(|(_, run)| pictures::panels(run, "OpenCV")));
            panels.extend(reference.into_iter().filter_map(|r| r.picture).map(|picture| ("APAP".to_owned(), picture)));
            pictures::write(folder, &title, &panels)?;
        }
        stages(session, &main);
        if let Some((_, run)) = &peer {
            stages(session, run);
        }
    }
    if let Some(path) = options.plot.as_ref().filter(|_| !pictures.is_empty()) {
        plot::save(path, &pictures)?;
    }
    Ok(out)
}
