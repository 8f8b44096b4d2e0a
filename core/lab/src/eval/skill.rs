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
    /// Writes the report as a page with plots.
    #[arg(long, value_name = "FILE.html")]
    html: Option<PathBuf>,
    #[command(flatten)]
    pub options: Options,
    /// Writes the report, or the figures, as JSON.
    #[arg(long, value_name = "FILE.json")]
    pub json: Option<PathBuf>,
}

/// Compares the measures with known motions; `None` if the arguments need a track.
pub fn judge(arguments: &Arguments) -> Result<Option<Vec<Figure>>> {
    if arguments.html.is_some() || arguments.options.phases.is_some() {
        log!("error: `--html` and `--phases` need a track: `panoscope eval skill out/skill_tip.csv --html skill.html`");
        return Ok(None);
    }
    Ok(Some(skill::judge(&arguments.options)?))
}

/// Reads tracks and reports: a table on the terminal, JSON and a page if requested.
pub fn report(session: &dyn Session, arguments: &Arguments) -> Result<End> {
    let study = SkillStudy::read(session, &arguments.options)?;
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
