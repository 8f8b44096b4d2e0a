//! `panoscope audit`: shows the audit log of the theatre, and checks that it is intact.

use std::path::PathBuf;

use anyhow::{Context, Result};

use crate::End;
use crate::terminal::{log, out, raw};

/// Arguments of `audit`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Folder of a log, or one file of it; default: the log of this user.
    #[arg(value_name = "FILE")]
    path: Option<PathBuf>,
    /// Only checks whether the log is intact.
    #[arg(long)]
    verify: bool,
}

/// Shows the log.
pub fn run(arguments: &Arguments) -> Result<End> {
    let path = match &arguments.path {
        Some(path) if !path.exists() => {
            log!("error: there is no audit log {}", path.display());
            return Ok(End::Wrong);
        }
        Some(path) => path.clone(),
        None => panoscope_host::audit::folder()
            .context("neither XDG_STATE_HOME nor HOME is set; give the folder of the log")?,
    };
    let report = panoscope_host::audit::read(&path).with_context(|| format!("{} cannot be read", path.display()))?;
    if !arguments.verify {
        raw(&report.entries.iter().map(|entry| format!("{entry}\n")).collect::<String>());
    }
    for problem in &report.problems {
        log!("error: {problem}");
    }
    if !report.problems.is_empty() {
        out!(
            "{}: DAMAGED: {} lines are whole, {} problems",
            path.display(),
            report.entries.len(),
            report.problems.len()
        );
        return Ok(End::Failed);
    }
    let Some((number, hash)) = &report.last else {
        out!("{}: no lines", path.display());
        return Ok(End::Done);
    };
    out!("{}: {} lines, unbroken; line {number} has the hash {hash}", path.display(), report.entries.len());
    Ok(End::Done)
}
