//! Tracks of tips, read and measured.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use panoscope_arm_core::tracking::skill::measures::FIGURES;
use panoscope_arm_core::tracking::skill::{self, Measures, Movement, Settings, Together};
use panoscope_engine::text_table::table;
use serde_json::{Map, Value, json};

use super::options::Options;
use super::trace::Trace;
use super::tracks::Track;
use crate::error::{Context, FileAction, OnFile, Result, ensure};
use crate::session::{Session, check_cancelled};

/// Data of a report.
pub struct SkillStudy {
    pub(super) session: skill::Session,
    pub(super) traces: Vec<Trace>,
    grasping: Vec<String>,
    pub(super) files: Vec<String>,
    /// First and last time, s.
    pub(super) span_s: (f64, f64),
    /// Start of each phase, s, and its number.
    pub(super) changes: Vec<(f64, usize)>,
    /// Tips without a tool, because there are too many tools.
    refused: u64,
    settings: Settings,
}

/// Reads phases: begin in s and name.
fn read_phases(path: &Path) -> Result<Vec<(f64, String)>> {
    let text = std::fs::read_to_string(path).on_file(FileAction::Read, path)?;
    let mut phases: Vec<(f64, String)> = Vec::new();
    for (index, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
        let place = || format!("{}, line {}", path.display(), index + 1);
        let (start, name) =
            line.split_once(',').with_context(|| format!("{}: expected a begin in s, a comma and a name", place()))?;
        let Ok(start) = start.trim().parse::<f64>() else {
            // A head is welcome.
            ensure!(index == 0, "{}: `{}` is not a number of seconds", place(), start.trim());
            continue;
        };
        ensure!(phases.last().is_none_or(|(last, _)| *last <= start), "{}: phases must be in order of time", place());
        phases.push((start, name.trim().to_owned()));
    }
    ensure!(!phases.is_empty(), "{} has no phase", path.display());
    Ok(phases)
}

impl SkillStudy {
    /// Reads the tracks and measures.
    ///
    /// # Errors
    /// A file cannot be read or has no tip, or the session is cancelled.
    pub fn read(session: &dyn Session, options: &Options) -> Result<Self> {
        read(session, options)
    }

    /// Measures of all tools and of both hands, as text.
    pub fn table(&self) -> String {
        let mut rows = vec![vec!["measure".to_owned()]];
        rows[0].extend(self.session.tools().map(|tool| tool.name.to_owned()));
        for figure in FIGURES {
            let mut row = vec![figure.title.to_owned()];
            row.extend(self.session.tools().map(|tool| shown((figure.of)(tool.total))));
            rows.push(row);
        }
        let mut text = table(&rows);
        let names: Vec<&str> = self.session.tools().map(|tool| tool.name).collect();
        for (a, b, both, _) in self.session.pairs() {
            let (overlap, correlation) = (shown(both.overlap()), shown(both.correlation()));
            let _ = writeln!(
                text,
                "  {} and {}: together {overlap} of the time in which either moves, speeds correlate by {correlation}",
                names[a], names[b]
            );
        }
        text
    }

    /// Tips that were not measured because there are too many tools.
    pub fn refused_tips(&self) -> u64 {
        self.refused
    }

    /// The report as JSON.
    ///
    /// # Errors
    /// A value cannot be written as JSON.
    pub fn json(&self) -> Result<String> {
        Ok(serde_json::to_string_pretty(&self.value())? + "\n")
    }

    fn collect(&mut self) {
        let count = self.session.tools().count();
        self.traces.resize_with(count, Trace::default);
        for (index, trace) in self.traces.iter_mut().enumerate() {
            self.session.take_cells(index).for_each(|cell| trace.cell(&cell));
            self.session.take_movements(index).for_each(|movement: Movement| trace.movement(&movement));
        }
    }

    /// Number of grasps of a tool that grasps, as text.
    pub(super) fn grasps(&self, name: &str, measures: &Measures) -> Option<u64> {
        let name = name.to_lowercase();
        measures.contacts().filter(|_| self.grasping.iter().any(|word| name.contains(word.as_str())))
    }

    pub(super) fn phase_name(&self, phase: usize) -> &str {
        self.session.phases().get(phase).map(String::as_str).filter(|name| !name.is_empty()).unwrap_or("(no phase)")
    }

    fn value(&self) -> Value {
        let settings = &self.settings;
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

/// A formatted number.
pub(super) fn shown(value: f64) -> String {
    match value.abs() {
        _ if !value.is_finite() => "-".to_owned(),
        size if size >= 1000.0 => format!("{value:.0}"),
        size if size >= 10.0 => format!("{value:.1}"),
        _ => format!("{value:.3}"),
    }
}

/// Reads all tracks in order of time.
fn read(session: &dyn Session, options: &Options) -> Result<SkillStudy> {
    let list = |text: &str| -> Vec<String> {
        text.split(',').map(|word| word.trim().to_lowercase()).filter(|word| !word.is_empty()).collect()
    };
    let labels: Vec<&str> = options.labels.split(',').map(str::trim).collect();
    let phases = options.phases.as_deref().map(read_phases).transpose()?;
    let mut phases = phases.as_ref().map(|list| list.iter().peekable());
    let mut tracks = options.files.iter().map(|path| Track::open(path)).collect::<Result<Vec<_>>>()?;
    let stem = |path: &PathBuf| path.file_stem().map_or_else(String::new, |s| s.to_string_lossy().into_owned());
    let stems: Vec<String> = options.files.iter().map(stem).collect();
    let mut study = SkillStudy {
        session: skill::Session::new(options.settings()).keep_cells(),
        traces: Vec::new(),
        grasping: list(&options.grasping),
        files: options.files.iter().map(|path| path.display().to_string()).collect(),
        span_s: (f64::NAN, f64::NAN),
        changes: Vec::new(),
        refused: 0,
        settings: options.settings(),
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
        check_cancelled(session)?;
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
            // Files are hands; numbers distinguish tools of one hand.
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
    ensure!(
        study.session.tools().next().is_some(),
        "{} has no positions of a tip: did the run detect an instrument?",
        study.files.join(", ")
    );
    study.session.finish();
    study.collect();
    Ok(study)
}
