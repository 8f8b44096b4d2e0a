//! Comparison of runs of studies: varied parameters, measures, best runs.

mod page;

use std::path::{Path, PathBuf};

use crate::error::{EvalError, FileAction, OnFile, Result};
use crate::sweep::{RESULTS, RunFile};

pub use crate::sweep::Statistic;

pub use page::page;

/// Parts of the names of measures for which larger is better.
pub const LARGER_IS_BETTER: [&str; 9] =
    ["ap50", "precision", "recall", "coverage", "inliers", "density", "confidence", "fps", "_hz"];

/// Whether larger values of a measure are better, by its name.
pub fn is_larger_better(measure: &str) -> bool {
    LARGER_IS_BETTER.iter().any(|part| measure.contains(part))
}

/// Options of [`compare`].
#[derive(Clone, Debug)]
pub struct Options {
    /// Folders of studies or of single runs.
    pub folders: Vec<PathBuf>,
    /// Statistic that is compared.
    pub statistic: Statistic,
    /// Measures for which larger is better, besides those whose names contain one of [`LARGER_IS_BETTER`].
    pub larger: Vec<String>,
    /// Measures for which smaller is better, whatever their names.
    pub smaller: Vec<String>,
}

impl Options {
    /// Whether larger values of a measure are better.
    pub fn is_larger_better(&self, measure: &str) -> bool {
        let is_named = |list: &[String]| list.iter().any(|name| name == measure);
        is_named(&self.larger) || (is_larger_better(measure) && !is_named(&self.smaller))
    }
}

/// A run and its folder.
#[derive(Clone, Debug)]
pub struct Run {
    /// Path of the run's folder, relative as given.
    pub folder: PathBuf,
    /// Results of the run.
    pub file: RunFile,
}

/// Runs to compare.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// Runs in the order of their folders and numbers.
    pub runs: Vec<Run>,
    /// Names of all varied parameters.
    pub params: Vec<String>,
    /// Names of all measures.
    pub measures: Vec<String>,
}

impl Comparison {
    /// The run with the best value of a measure; `None` if no run has a value.
    pub fn best(&self, measure: &str, options: &Options) -> Option<usize> {
        let sign = if options.is_larger_better(measure) { -1.0 } else { 1.0 };
        let values = self.runs.iter().enumerate().filter_map(|(index, run)| {
            let found = run.file.measures.iter().find(|m| m.name == measure)?;
            Some((index, sign * options.statistic.of(found)?))
        });
        values.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(index, _)| index)
    }
}

fn runs_in(folder: &Path) -> Result<Vec<PathBuf>> {
    if folder.join(RESULTS).is_file() {
        return Ok(vec![folder.to_owned()]);
    }
    let entries = std::fs::read_dir(folder).on_file(FileAction::Read, folder)?;
    let mut found: Vec<PathBuf> =
        entries.flatten().map(|entry| entry.path()).filter(|path| path.join(RESULTS).is_file()).collect();
    found.sort();
    if found.is_empty() {
        let reason = format!("{} holds no run: `panoscope sweep --out DIR` writes runs", folder.display());
        return Err(EvalError::Options { reason });
    }
    Ok(found)
}

/// Reads the runs of all folders.
///
/// # Errors
/// A folder has no run, or a file cannot be read.
pub fn compare(options: &Options) -> Result<Comparison> {
    let mut runs = Vec::new();
    for folder in &options.folders {
        for folder in runs_in(folder)? {
            let file = RunFile::read(&folder.join(RESULTS))?;
            runs.push(Run { folder, file });
        }
    }
    let (mut params, mut measures): (Vec<String>, Vec<String>) = (Vec::new(), Vec::new());
    let add = |list: &mut Vec<String>, name: &String| {
        if !list.contains(name) {
            list.push(name.clone());
        }
    };
    for run in &runs {
        run.file.params.iter().for_each(|param| add(&mut params, &param.name));
        run.file.measures.iter().for_each(|measure| add(&mut measures, &measure.name));
    }
    for name in options.larger.iter().chain(&options.smaller) {
        if !measures.contains(name) {
            let reason = format!("no run measured `{name}`; measures are {}", measures.join(", "));
            return Err(EvalError::Options { reason });
        }
    }
    Ok(Comparison { runs, params, measures })
}

#[cfg(test)]
mod tests;
