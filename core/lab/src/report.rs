//! `panoscope report`: runs of studies compared on one page.

use std::path::PathBuf;

use anyhow::{Context, Result};
use panoscope_eval::EvalError;
use panoscope_eval::report::{self, Options, Statistic};

use crate::batch;
use panoscope_cli::End;
use panoscope_cli::terminal::{log, out};

/// Arguments of `report`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Folders that `panoscope sweep --out` wrote, or single runs in them; or one or two studies of `panoscope batch`, of which two are compared
    /// run by run.
    #[arg(required = true, value_name = "DIR")]
    folders: Vec<PathBuf>,
    /// Writes the page: tables and plots, without scripts, self-contained.
    #[arg(long, value_name = "FILE.html")]
    html: PathBuf,
    /// Statistic of the measures that is compared. Use `last` for measures that accumulate from the start (ap50_pct,
    /// ...).
    #[arg(long, default_value = "mean", value_parser = clap::builder::PossibleValuesParser::new(Statistic::ALL.map(Statistic::name)))]
    statistic: String,
    /// A measure for which more is better. Recognised by name: ap50, precision, recall, coverage, inliers, density,
    /// confidence, fps, hz.
    #[arg(long, value_name = "MEASURE")]
    larger: Vec<String>,
    /// A measure for which less is better, as for all others.
    #[arg(long, value_name = "MEASURE")]
    smaller: Vec<String>,
    /// Only this measure of studies of `panoscope batch`. May be given again.
    #[arg(long, value_name = "MEASURE")]
    measure: Vec<String>,
    /// Groups the runs of a study of `panoscope batch` by a column. May be given again.
    #[arg(long, value_name = "COLUMN")]
    by: Vec<String>,
}

/// Compares.
pub fn run(arguments: &Arguments) -> Result<End> {
    let are_studies = arguments.folders.iter().filter(|folder| batch::is_study(folder)).count();
    if are_studies > 0 && are_studies < arguments.folders.len() {
        log!(
            "error: studies of `panoscope batch` and folders of `panoscope sweep` do not go on one page: report each kind by itself"
        );
        return Ok(End::Wrong);
    }
    if are_studies > 0 {
        return batch::run(&batch::Request::Report {
            studies: &arguments.folders,
            html: &arguments.html,
            measures: &arguments.measure,
            by: &arguments.by,
            larger: &arguments.larger,
            smaller: &arguments.smaller,
        });
    }
    let options = Options {
        folders: arguments.folders.clone(),
        statistic: Statistic::named(&arguments.statistic).unwrap_or(Statistic::Mean),
        larger: arguments.larger.clone(),
        smaller: arguments.smaller.clone(),
    };
    let comparison = match report::compare(&options) {
        Ok(comparison) => comparison,
        Err(EvalError::Options { reason }) => {
            log!("error: {reason}");
            return Ok(End::Wrong);
        }
        Err(error) => return Err(error.into()),
    };
    for measure in &comparison.measures {
        if let Some(best) = comparison.best(measure, &options) {
            let run = &comparison.runs[best];
            let values: Vec<String> = run.file.params.iter().map(|p| format!("{} = {}", p.name, p.value)).collect();
            out!("best {measure}: {} ({})", run.folder.display(), values.join(", "));
        }
    }
    let path = &arguments.html;
    std::fs::write(path, report::page(&comparison, &options))
        .with_context(|| format!("cannot write {}", path.display()))?;
    out!("{}: {} runs compared", path.display(), comparison.runs.len());
    Ok(End::Done)
}
