//! `panoscope eval skill`: a report of surgical skill from tracks of tips; without files, the measures beside motions that are known.

mod page;
mod svg;
mod trace;
mod tracks;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use panoscope_tracking::skill::measures::FIGURES;
use panoscope_tracking::skill::motions::{self, Timing};
use panoscope_tracking::skill::{Measures, Movement, Session, Settings, Together};
use serde_json::{Map, Value, json};

use self::trace::Trace;
use self::tracks::Track;
use crate::End;
use crate::commands::bench::record::Figure;
use crate::terminal::{raw, say, table, tell};

/// Words in the name of a tool that can grasp.
const GRASPING: &str = "grasper,bipolar,clipper,forceps,needle";

/// Arguments of `eval skill`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Tracks of tips, best one per hand: tables of `tip_track` (or `proximity`, which tells of touches too), or tips, as `write_table` writes them
    /// (.csv, .jsonl). Without any, the measures are judged beside motions that are known in closed form.
    #[arg(value_name = "TRACK")]
    pub files: Vec<PathBuf>,
    /// Writes the report as a page with plots.
    #[arg(long, value_name = "FILE.html")]
    html: Option<PathBuf>,
    /// Phases of the operation, a line each: begin in s of capture time, comma, name. Else the column `phase` or `text` of the tracks tells.
    #[arg(long, value_name = "FILE.csv")]
    phases: Option<PathBuf>,
    /// Names of the classes by their numbers, separated by commas.
    #[arg(long, default_value = "")]
    labels: String,
    /// Words in the names of tools that grasp, separated by commas: only their touches are counted as grasps.
    #[arg(long, default_value = GRASPING)]
    grasping: String,
    /// Speed below which a tool rests, mm/s.
    #[arg(long, default_value_t = Settings::default().rest_mm_s)]
    rest_mm_s: f64,
    /// Longest time between two tips that is bridged, ms.
    #[arg(long, default_value_t = 1e3 * Settings::default().max_gap_s)]
    max_gap_ms: f64,
    /// Writes the report, or the figures, as JSON.
    #[arg(long, value_name = "FILE.json")]
    pub json: Option<PathBuf>,
}

/// Judges the measures beside motions that are known in closed form, sampled evenly, at uneven times, and with pictures lost.
pub fn judge(arguments: &Arguments) -> Result<Option<Vec<Figure>>> {
    if arguments.html.is_some() || arguments.phases.is_some() {
        tell!(
            "error: `--html` and `--phases` need a track: `panoscope eval skill out/skill_tip.csv --html skill.html`"
        );
        return Ok(None);
    }
    let settings = settings(arguments);
    let mut figures = Vec::new();
    let mut worst: f64 = 0.0;
    for motion in motions::all(&settings) {
        let runs = Timing::ALL.map(|timing| motions::check(&motion, timing, &settings));
        for (index, (measure, known)) in motion.known.iter().enumerate() {
            let of = runs.iter().map(|run| run[index]);
            let far = of.max_by(|a, b| a.error().total_cmp(&b.error())).context("no timing")?;
            worst = worst.max(100.0 * far.error());
            let input = "motion in closed form at 30 Hz: even times, uneven times, every seventh picture lost; the worst of the three";
            let mut figure = Figure::new(&format!("{measure}/{}", motion.name), far.measured, "", input);
            (figure.peer, figure.peer_value) = (Some("closed form".to_owned()), Some(*known));
            figures.push(figure);
        }
    }
    let input = "of all measures of all motions at all timings; of a known zero the value itself";
    figures.push(Figure::new("worst_error_pct", worst, "%", input));
    Ok(Some(figures))
}

fn settings(arguments: &Arguments) -> Settings {
    Settings { rest_mm_s: arguments.rest_mm_s, max_gap_s: arguments.max_gap_ms * 1e-3, ..Settings::default() }
}

/// What a report is made of.
pub struct Study {
    session: Session,
    traces: Vec<Trace>,
    grasping: Vec<String>,
    files: Vec<String>,
    /// First and last time, s.
    span_s: (f64, f64),
    /// When phases began, s, and their numbers.
    changes: Vec<(f64, usize)>,
    /// Tips that belong to no tool because there are too many.
    refused: u64,
}

/// Reads phases: begin in s and name.
fn read_phases(path: &Path) -> Result<Vec<(f64, String)>> {
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let mut phases: Vec<(f64, String)> = Vec::new();
    for (index, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
        let place = || format!("{}, line {}", path.display(), index + 1);
        let (start, name) =
            line.split_once(',').with_context(|| format!("{}: a begin in s, a comma, a name", place()))?;
        let Ok(start) = start.trim().parse::<f64>() else {
            // A head is welcome.
            ensure!(index == 0, "{}: `{}` is no number of seconds", place(), start.trim());
            continue;
        };
        ensure!(phases.last().is_none_or(|(last, _)| *last <= start), "{}: phases come in order of time", place());
        phases.push((start, name.trim().to_owned()));
    }
    ensure!(!phases.is_empty(), "{} holds no phase", path.display());
    Ok(phases)
}

/// Reads all tracks in order of time.
fn study(arguments: &Arguments) -> Result<Study> {
    let list = |text: &str| -> Vec<String> {
        text.split(',').map(|word| word.trim().to_lowercase()).filter(|word| !word.is_empty()).collect()
    };
    let labels: Vec<&str> = arguments.labels.split(',').map(str::trim).collect();
    let phases = arguments.phases.as_deref().map(read_phases).transpose()?;
    let mut phases = phases.as_ref().map(|list| list.iter().peekable());
    let mut tracks = arguments.files.iter().map(|path| Track::open(path)).collect::<Result<Vec<_>>>()?;
    let stem = |path: &PathBuf| path.file_stem().map_or_else(String::new, |s| s.to_string_lossy().into_owned());
    let stems: Vec<String> = arguments.files.iter().map(stem).collect();
    let mut study = Study {
        session: Session::new(settings(arguments)).keep_cells(),
        traces: Vec::new(),
        grasping: list(&arguments.grasping),
        files: arguments.files.iter().map(|path| path.display().to_string()).collect(),
        span_s: (f64::NAN, f64::NAN),
        changes: Vec::new(),
        refused: 0,
    };
    loop {
        let mut next: Option<(f64, usize)> = None;
        for (index, track) in tracks.iter_mut().enumerate() {
            if let Some(at_s) = track.next_s()?
                && next.is_none_or(|(earliest, _)| at_s < earliest)
            {
                next = Some((at_s, index));
            }
        }
        let Some((at_s, file)) = next else { break };
        let Some(row) = tracks[file].take() else { break };
        ensure!(!crate::interrupt::asked(), "interrupted");
        if study.span_s.0.is_nan() {
            study.span_s.0 = at_s;
        }
        study.span_s.1 = at_s;
        while let Some((_, name)) = phases.as_mut().and_then(|list| list.next_if(|(start, _)| *start <= at_s)) {
            study.session.set_phase(name);
        }
        if let Some(name) = row.phase.as_deref().filter(|_| phases.is_none()) {
            study.session.set_phase(name.lines().next().unwrap_or("").trim());
        }
        if let Some(tip) = row.tip {
            // Files are hands; numbers tell tools of one hand apart.
            let key = (file as u64) << 32 | u64::from(tip.track_id as u32);
            let name = || {
                let class =
                    tip.class_index.and_then(|class| labels.get(class as usize)).filter(|name| !name.is_empty());
                let name = class.map_or_else(|| stems[file].clone(), |class| format!("{} {class}", stems[file]));
                if tip.track_id >= 0 { format!("{name} #{}", tip.track_id) } else { name }
            };
            match study.session.tool(key, name) {
                Some(tool) => study.session.observe(tool, tip.sample),
                None => study.refused += 1,
            }
        }
        study.session.advance(at_s);
        if study.changes.last().is_none_or(|(_, phase)| *phase != study.session.phase()) {
            study.changes.push((at_s, study.session.phase()));
        }
        study.collect();
    }
    ensure!(study.session.tools().next().is_some(), "no tip in {}: was anything seen?", study.files.join(", "));
    study.session.finish();
    study.collect();
    Ok(study)
}

impl Study {
    fn collect(&mut self) {
        let count = self.session.tools().count();
        self.traces.resize_with(count, Trace::default);
        for (index, trace) in self.traces.iter_mut().enumerate() {
            self.session.take_cells(index).for_each(|cell| trace.cell(&cell));
            self.session.take_movements(index).for_each(|movement: Movement| trace.movement(&movement));
        }
    }

    /// Touches of a tool that grasps.
    fn grasps(&self, name: &str, measures: &Measures) -> Option<u64> {
        let name = name.to_lowercase();
        measures.contacts().filter(|_| self.grasping.iter().any(|word| name.contains(word.as_str())))
    }

    fn phase_name(&self, phase: usize) -> &str {
        self.session.phases().get(phase).map(String::as_str).filter(|name| !name.is_empty()).unwrap_or("(no phase)")
    }

    fn json(&self, settings: &Settings) -> Value {
        let of = |name: &str, measures: &Measures| -> Value {
            let number = |value: f64| if value.is_finite() { json!(value) } else { Value::Null };
            let mut all: Map<String, Value> =
                FIGURES.iter().map(|figure| (figure.name.to_owned(), number((figure.of)(measures)))).collect();
            all.insert("grasps".to_owned(), json!(self.grasps(name, measures)));
            Value::Object(all)
        };
        let tools = self.session.tools().map(|tool| {
            let phases = tool.phases.iter().enumerate().filter(|(_, measures)| !measures.is_empty());
            let phases: Map<String, Value> =
                phases.map(|(phase, measures)| (self.phase_name(phase).to_owned(), of(tool.name, measures))).collect();
            json!({ "name": tool.name, "all": of(tool.name, tool.total), "phases": phases })
        });
        let names: Vec<&str> = self.session.tools().map(|tool| tool.name).collect();
        let both = |both: &Together| {
            let number = |value: f64| if value.is_finite() { json!(value) } else { Value::Null };
            json!({ "seen_s": both.seen_s(), "both_s": both.both_s(), "overlap": number(both.overlap()), "correlation": number(both.correlation()) })
        };
        let pairs = self.session.pairs().map(|(a, b, total, phases)| {
            let phases = phases.iter().enumerate().filter(|(_, pair)| pair.seen_s() > 0.0);
            let phases: Map<String, Value> =
                phases.map(|(phase, pair)| (self.phase_name(phase).to_owned(), both(pair))).collect();
            json!({ "a": names[a], "b": names[b], "all": both(total), "phases": phases })
        });
        json!({
            "files": self.files,
            "duration_s": self.span_s.1 - self.span_s.0,
            "settings": {
                "max_gap_s": settings.max_gap_s, "window_s": settings.window_s, "rest_mm_s": settings.rest_mm_s,
                "rest_s": settings.rest_s, "knot_s": settings.knot_s, "touch_mm": settings.touch_mm, "touch_s": settings.touch_s,
            },
            "tools": tools.collect::<Vec<_>>(),
            "pairs": pairs.collect::<Vec<_>>(),
            "tips_refused": self.refused,
        })
    }
}

/// A number for people.
fn shown(value: f64) -> String {
    match value.abs() {
        _ if !value.is_finite() => "-".to_owned(),
        size if size >= 1000.0 => format!("{value:.0}"),
        size if size >= 10.0 => format!("{value:.1}"),
        _ => format!("{value:.3}"),
    }
}

/// Reads tracks and reports: a table on the terminal, JSON and a page where they are asked for.
pub fn report(arguments: &Arguments) -> Result<End> {
    let study = study(arguments)?;
    let mut rows = vec![vec!["measure".to_owned()]];
    rows[0].extend(study.session.tools().map(|tool| tool.name.to_owned()));
    for figure in FIGURES {
        let mut row = vec![figure.title.to_owned()];
        row.extend(study.session.tools().map(|tool| shown((figure.of)(tool.total))));
        rows.push(row);
    }
    raw(&table(&rows));
    let names: Vec<&str> = study.session.tools().map(|tool| tool.name).collect();
    for (a, b, both, _) in study.session.pairs() {
        let (overlap, correlation) = (shown(both.overlap()), shown(both.correlation()));
        say!(
            "  {} and {}: together {overlap} of the time in which either moves, speeds correlate by {correlation}",
            names[a],
            names[b]
        );
    }
    if study.refused > 0 {
        tell!("warning: {} tips belong to more than 16 tools and are not measured", study.refused);
    }
    let write = |path: &Path, text: String| {
        std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
    };
    if let Some(path) = &arguments.json {
        write(path, serde_json::to_string_pretty(&study.json(&settings(arguments)))? + "\n")?;
    }
    if let Some(path) = &arguments.html {
        write(path, page::page(&study))?;
    }
    Ok(End::Done)
}
