//! `panoscope eval skill`.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use panoscope_eval::Session;
use panoscope_eval::eval::skill::{self, Options, SkillStudy};
use panoscope_eval::figures::Figure;

use panoscope_cli::End;
use panoscope_cli::terminal::{log, raw};

/// Arguments of `eval skill`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Tracks of tips, best one per hand: tables of `tip_track` (or `proximity`, which reports touches too), or tips,
    /// written by `write_table` (.csv, .jsonl). Without files, the measures are compared with motions known in closed
    /// form.
    #[arg(value_name = "TRACK")]
    pub files: Vec<PathBuf>,
    /// Writes the report as a page with plots.
    #[arg(long, value_name = "FILE.html")]
    html: Option<PathBuf>,
    /// Phases of the operation, one per line: start in s of capture time, comma, name. By default the column `phase` or
    /// `text` of the tracks.
    #[arg(long, value_name = "FILE.csv")]
    phases: Option<PathBuf>,
    /// Names of the classes by their numbers, separated by commas.
    #[arg(long, default_value = "")]
    labels: String,
    /// Words in the names of tools that grasp, separated by commas: only their touches are counted as grasps.
    #[arg(long, default_value = skill::GRASPING)]
    grasping: String,
    /// Speed below which a tool rests, mm/s.
    #[arg(long, default_value_t = skill::Options::default().rest_mm_s)]
    rest_mm_s: f64,
    /// Maximum time between two tips that is bridged, ms.
    #[arg(long, default_value_t = skill::Options::default().max_gap_ms)]
    max_gap_ms: f64,
    /// Writes the report, or the figures, as JSON.
    #[arg(long, value_name = "FILE.json")]
    pub json: Option<PathBuf>,
}

impl Arguments {
    fn options(&self) -> Options {
        let Self { files, phases, labels, grasping, rest_mm_s, max_gap_ms, .. } = self;
        Options {
            files: files.clone(),
            phases: phases.clone(),
            labels: labels.clone(),
            grasping: grasping.clone(),
            rest_mm_s: *rest_mm_s,
            max_gap_ms: *max_gap_ms,
        }
    }
}

/// Compares the measures with known motions; `None` if the arguments need a track.
pub fn judge(arguments: &Arguments) -> Result<Option<Vec<Figure>>> {
    if arguments.html.is_some() || arguments.phases.is_some() {
        log!("error: `--html` and `--phases` need a track: `panoscope eval skill out/skill_tip.csv --html skill.html`");
        return Ok(None);
    }
    Ok(Some(skill::judge(&arguments.options())?))
}

/// Reads tracks and reports: a table on the terminal, JSON and a page if requested.
pub fn report(session: &dyn Session, arguments: &Arguments) -> Result<End> {
    let study = SkillStudy::read(session, &arguments.options())?;
    raw(&study.table());
    if study.refused_tips() > 0 {
        log!("warning: {} tips belong to more than 16 tools and are not measured", study.refused_tips());
    }
    let write = |path: &Path, text: String| {
        std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
    };
    if let Some(path) = &arguments.json {
        write(path, study.json()?)?;
    }
    if let Some(path) = &arguments.html {
        write(path, skill::page(&study))?;
    }
    Ok(End::Done)
}
