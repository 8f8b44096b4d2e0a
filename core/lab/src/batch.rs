//! `panoscope batch` and `panoscope worst`: a graph over many recordings. The Python package does the work, where executors, tables and statistics
//! are libraries; here are the arguments.

use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use panoscope_cli::End;
use panoscope_host::loader::python_module;
use serde::Serialize;

/// Module of the Python package that reads a request.
const MODULE: &str = "panoscope.studies";
/// A file in the folder of each study.
const MARK: &str = "study.json";

/// Arguments of `batch`. Each name is that of an argument of `panoscope.batch`.
#[derive(clap::Args, Serialize)]
pub struct Arguments {
    /// Graph file.
    graph: PathBuf,
    /// What the graph runs over: a table (.csv, .parquet) with columns named after arguments of the graph, or a pattern such as
    /// '{operation}/{clip}_left.mkv', whose names become columns; ARGUMENT=PATTERN, given for each argument, joins on the common names.
    #[arg(long, required = true, value_name = "TABLE|PATTERN|ARGUMENT=PATTERN")]
    inputs: Vec<String>,
    /// Folder of the study. One that exists is continued: what is done and has the same hashes is kept.
    #[arg(long, short = 'o', value_name = "STUDY")]
    output: PathBuf,
    /// Runs each input with each of these values, FROM..TO/STEPS or a list; of several parameters all combinations. May be given again.
    #[arg(long, value_name = "NODE.PARAM=VALUES")]
    param: Vec<String>,
    /// Sets a parameter in all runs. May be given again.
    #[arg(long, value_name = "NODE.PARAM=VALUE")]
    set: Vec<String>,
    /// Sets an argument of the graph in all runs. May be given again.
    #[arg(long, value_name = "NAME=VALUE")]
    arg: Vec<String>,
    /// Overlay file. May be given again.
    #[arg(long, value_name = "OVERLAY")]
    with: Vec<PathBuf>,
    /// What is measured: an output with a scalar or a table, a column of a table, or a number that a node reports. May be given again; without it,
    /// all outputs with scalars and tables.
    #[arg(long, value_name = "NODE.OUTPUT[.COLUMN]|NODE.NUMBER")]
    measure: Vec<String>,
    /// Keeps the measures of each tick, too.
    #[arg(long)]
    ticks: bool,
    /// Maximum number of ticks of each source per run.
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..))]
    frames: Option<u64>,
    /// Threads of each run; without it, the cores of this machine shared by --jobs.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Runs at a time on this machine.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=1024))]
    jobs: u16,
    /// Ends a run that takes longer, in seconds.
    #[arg(long, default_value_t = 3600, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    max_s: u32,
    /// Ends a run whose processes take more memory, in MB.
    #[arg(long, value_parser = clap::value_parser!(u32).range(16..))]
    max_memory_mb: Option<u32>,
    /// Runs on the workers of a Dask scheduler.
    #[arg(long, value_name = "tcp://HOST:PORT", conflicts_with_all = ["jobs", "ray"])]
    dask: Option<String>,
    /// Runs on a Ray cluster.
    #[arg(long, value_name = "auto|ADDRESS", conflicts_with = "jobs")]
    ray: Option<String>,
    /// Runs failed runs again.
    #[arg(long)]
    retry: bool,
    /// Prints what would run, and runs nothing.
    #[arg(long)]
    dry_run: bool,
}

/// Arguments of `worst`.
#[derive(clap::Args, Serialize)]
pub struct WorstArguments {
    /// Folder of `panoscope batch`.
    study: PathBuf,
    /// Measure of which the mean over a run counts.
    #[arg(long)]
    measure: String,
    /// Number of runs.
    #[arg(short, long = "count", default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    n: u32,
    /// More of the measure is better. Known by names such as precision, coverage, inliers and fps.
    #[arg(long)]
    larger: bool,
    /// Runs them again as recordings for the editor, in the folder `worst` of the study.
    #[arg(long)]
    record: bool,
}

/// A request to the module.
#[derive(Serialize)]
#[serde(tag = "command", rename_all = "lowercase")]
pub enum Request<'a> {
    /// Runs a graph over many inputs.
    Batch(&'a Arguments),
    /// Lists the worst runs.
    Worst(&'a WorstArguments),
    /// Writes a page.
    Report {
        /// Folders of studies.
        studies: &'a [PathBuf],
        /// The page.
        html: &'a Path,
        /// Measures; all without any.
        measures: &'a [String],
        /// Columns that runs are grouped by.
        by: &'a [String],
        /// Measures of which more is better.
        larger: &'a [String],
        /// Measures of which less is better.
        smaller: &'a [String],
    },
}

/// Whether a folder is that of a study of `panoscope batch`.
pub fn is_study(folder: &Path) -> bool {
    folder.join(MARK).is_file()
}

/// Becomes the interpreter, which answers the request. Returns only if that fails.
pub fn run(request: &Request) -> Result<End> {
    let mut python = python_module(MODULE).context(
        "batches are run by the Python package; install Python 3 with NumPy and pyarrow, or name an interpreter in PANOSCOPE_PYTHON",
    )?;
    let this = panoscope_cli::beside::file(panoscope_cli::beside::PROGRAM)?;
    python.arg(serde_json::to_string(request)?).env("PANOSCOPE_PROGRAM", this);
    let interpreter = python.get_program().to_owned();
    Err(python.exec()).with_context(|| format!("{} does not start", interpreter.display()))
}

#[cfg(test)]
mod tests {
    use panoscope_eval::report::LARGER_IS_BETTER;

    #[test]
    fn more_of_the_same_measures_is_better_in_both_reports() {
        let package = include_str!("../../python/panoscope/studies/statistics.py");
        let names = LARGER_IS_BETTER.map(|name| format!("{name:?}")).join(", ");
        assert!(package.contains(&format!("LARGER = ({names})\n")), "write {names}");
    }
}
