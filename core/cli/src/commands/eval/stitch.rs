//! `panoscope eval stitch`: registration and panorama of a graph beside the truth and beside OpenCV's conventional pipeline.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

use super::look::{self, Plan, Seen, Table};
use super::rewire::Wiring;
use crate::commands::bench::record::Figure;
use crate::terminal::{raw, table, tell};

/// First black picture of the recovery run, and how many.
const BLACK: (i64, i64) = (20, 10);
/// Ticks that a still scene's registration has to settle.
const SETTLE: usize = 5;
const PEER: &str = "OpenCV SIFT, full graph cut";
const FRESH: f64 = 0.0;

/// Arguments of `eval stitch`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Graph with a composite of two views.
    graph: PathBuf,
    /// Writes the figures as JSON.
    #[arg(long, value_name = "FILE.json")]
    pub json: Option<PathBuf>,
    /// Writes a row for every tick as CSV, one file per composite: FILE becomes FILE-composite.csv.
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
}

/// Measures of one composite; NaN where there is no truth.
#[derive(Clone, Debug)]
struct Marks {
    stitched_pct: f64,
    align_px: f64,
    floor_px: f64,
    psnr_overlap_db: f64,
    ssim_overlap: f64,
    psnr_seam_db: f64,
    ssim_seam: f64,
    fov_pct: f64,
    cropped_pct: f64,
    jitter_px: f64,
    recovery: Recovery,
}

/// What a black camera does.
#[derive(Clone, Copy, Debug)]
struct Recovery {
    /// Good frames until stitching is back; 1: the first one is stitched. NaN when it does not come back.
    frames: f64,
    /// Black frames that were called fresh.
    false_fresh: f64,
}

impl Default for Recovery {
    fn default() -> Self {
        Self { frames: f64::NAN, false_fresh: f64::NAN }
    }
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
        recovery: Recovery::default(),
    })
}

fn recovery(rows: &Table) -> Option<Recovery> {
    let state = rows.column("state")?;
    let (first, end) = (BLACK.0 as usize, (BLACK.0 + BLACK.1) as usize);
    let black = state.get(first..end)?;
    let back = state.get(end..)?.iter().position(|s| *s == FRESH);
    Some(Recovery {
        frames: back.map_or(f64::NAN, |index| index as f64 + 1.0),
        false_fresh: black.iter().filter(|s| **s == FRESH).count() as f64,
    })
}

/// One graph with its judges, run.
struct Judged {
    tables: Vec<Table>,
    seen: Seen,
}

fn run(wiring: &Wiring, path: &Path, frames: u64) -> Result<Judged> {
    let text = wiring.judged().text();
    let names: Vec<String> = wiring.composites.iter().map(|c| format!("judge_{}", c.id)).collect();
    let ports: Vec<(&str, &str)> = names.iter().map(|name| (name.as_str(), "table")).collect();
    let plan = Plan { text: &text, path, frames: Some(frames), threads: 0, ports: &ports, paced: false };
    let seen = look::run(&plan)?;
    let mut tables = Vec::new();
    for packet in &seen.packets {
        let bytes = packet.as_ref().context("the judge saw nothing")?.bytes();
        tables.push(Table::read(bytes).context("the judge's table could not be read")?);
    }
    Ok(Judged { tables, seen })
}

/// All runs of a wiring: as it is, on a still scene, with a camera that goes black.
fn judge_all(wiring: &Wiring, path: &Path, frames: u64, is_peer: bool) -> Result<(Vec<Marks>, Judged)> {
    let main = run(wiring, path, frames)?;
    let mut all: Vec<Marks> = main.tables.iter().map(marks).collect::<Result<_>>()?;
    if let Some(phantom) = wiring.phantom() {
        // Registration alone decides here: the peer's seam need not be found at full resolution.
        let mut still = if is_peer { wiring.peer(0.1, 2) } else { wiring.clone() };
        let mut dark = still.clone();
        still.set(&phantom, "speed_mm_s", 0.0);
        still.set(&phantom, "breathing_mm", 0.0);
        for (marks, rows) in all.iter_mut().zip(&run(&still, path, frames.min(40))?.tables) {
            let ways = rows.column("move_px").unwrap_or_default();
            marks.jitter_px = rms(ways.get(SETTLE..).unwrap_or_default());
        }
        dark.set(&phantom, "black_camera", "right");
        dark.set(&phantom, "black_first", BLACK.0);
        dark.set(&phantom, "black_count", BLACK.1);
        let ticks = (BLACK.0 + BLACK.1) as u64 + 10;
        for (marks, rows) in all.iter_mut().zip(&run(&dark, path, ticks)?.tables) {
            marks.recovery = recovery(rows).unwrap_or_default();
        }
    }
    Ok((all, main))
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
fn listed(m: &Marks) -> [(&'static str, &'static str, f64, bool); 12] {
    [
        ("stitched_share", "%", m.stitched_pct, true),
        ("align_px", "px", m.align_px, false),
        ("align_floor_px", "px", m.floor_px, false),
        ("psnr_overlap", "dB", m.psnr_overlap_db, true),
        ("ssim_overlap", "1", m.ssim_overlap, true),
        ("seam_psnr", "dB", m.psnr_seam_db, true),
        ("seam_ssim", "1", m.ssim_seam, true),
        ("fov_gain_pct", "%", m.fov_pct, true),
        ("cropped_pct", "%", m.cropped_pct, false),
        ("jitter_px", "px", m.jitter_px, false),
        ("recovery_frames", "frames", m.recovery.frames, false),
        ("recovery_false_fresh", "frames", m.recovery.false_fresh, false),
    ]
}

fn figures(case: &str, marks: &Marks, peer: Option<&Marks>, input: &str) -> Vec<Figure> {
    let mut out = Vec::new();
    let theirs = peer.map(listed);
    for (index, (name, unit, value, more)) in listed(marks).into_iter().enumerate() {
        if !value.is_finite() {
            continue;
        }
        let mut figure = Figure::new(&format!("{name}/{case}"), value, unit, input);
        if let Some(peer_value) = theirs.map(|t| t[index].2).filter(|v| v.is_finite()) {
            figure.peer = Some(PEER.to_owned());
            figure.peer_value = Some(peer_value);
            let (best, other) = if more { (value, peer_value) } else { (peer_value, value) };
            figure.ratio = (other > 0.0).then(|| best / other);
        }
        out.push(figure);
    }
    out
}

/// Judges a graph; none when it cannot be judged.
pub fn judge(arguments: &Arguments) -> Result<Option<Vec<Figure>>> {
    let path = &arguments.graph;
    // All mistakes of the file as it stands, with their lines.
    if let Err(diagnostics) = crate::graph_file::load(path, &arguments.set) {
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
    for setting in &arguments.set {
        if let Some(((node, param), value)) = setting.split_once('=').and_then(|(k, v)| Some((k.split_once('.')?, v))) {
            let parsed = format!("v = {value}").parse::<toml::Table>().ok().and_then(|mut t| t.remove("v"));
            wiring.set(node.trim(), param.trim(), parsed.unwrap_or_else(|| value.trim().into()));
        }
    }
    let (ours, main) = judge_all(&wiring, path, arguments.frames, false)?;
    let peer =
        if arguments.no_peer { None } else { Some(judge_all(&wiring.peer(0.0, 2), path, arguments.frames, true)?.0) };
    let peer = peer.as_ref().and_then(|marks| marks.first());
    let input = format!("{}, {} frames", wiring.name, arguments.frames);
    let mut out = Vec::new();
    for ((composite, marks), rows) in wiring.composites.iter().zip(&ours).zip(&main.tables) {
        let case =
            if wiring.composites.len() > 1 { format!("{}_{}", wiring.name, composite.id) } else { wiring.name.clone() };
        out.extend(figures(&case, marks, peer, &input));
        if let Some(path) = &arguments.rows {
            let mut name = path.as_os_str().to_owned();
            name.push(format!("-{}.csv", composite.id));
            std::fs::write(&name, csv(rows)).with_context(|| format!("cannot write {}", Path::new(&name).display()))?;
        }
    }
    let mut stages = vec![["stage", "p50 ms", "p99 ms", "max ms"].map(str::to_owned).to_vec()];
    for (id, node) in main.seen.report.nodes.iter().filter(|(id, _)| !id.starts_with("judge_")) {
        let ms = |v: f64| format!("{v:.2}");
        stages.push(vec![id.clone(), ms(node.p50_ms), ms(node.p99_ms), ms(node.max_ms)]);
    }
    raw(&table(&stages));
    Ok(Some(out))
}

#[cfg(test)]
mod tests {
    use super::{BLACK, Table, recovery};

    #[test]
    fn recovery_counts_good_frames_and_false_ones() {
        let mut states = vec![0.0; 40];
        let (first, end) = (BLACK.0 as usize, (BLACK.0 + BLACK.1) as usize);
        states[first + 1..end + 1].fill(2.0);
        let rows = Table { names: vec!["state".to_owned()], rows: states.iter().map(|s| vec![*s]).collect() };
        let found = recovery(&rows).unwrap();
        assert_eq!((found.frames, found.false_fresh), (2.0, 1.0));
    }
}
