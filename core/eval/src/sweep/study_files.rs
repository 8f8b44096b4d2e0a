//! A study on disk: a folder per run, and a table of all runs.

use std::fs;
use std::path::{Path, PathBuf};

use panoscope_engine::Machine;
use panoscope_engine::text_table;
use panoscope_graph::GraphText;
use panoscope_record::{FileHash, hash_file};
use serde::{Deserialize, Serialize};

use super::error::PointError;
use super::report::{failures, number};
use super::run_measure::RunMeasure;
use super::study::{RunResult, Study};
use crate::error::{Context, EvalError, FileAction, OnFile, Result};

/// Name of the file with the results of a run.
pub const RESULTS: &str = "results.json";
const GRAPH: &str = "graph.toml";
const TABLE: &str = "results.csv";

/// A parameter of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunParam {
    /// Axis, `node.param` or `node.type`.
    pub name: String,
    /// The value as in a graph file.
    pub value: String,
    /// The value as a number; for words its position.
    pub at: f64,
    /// Unit; empty for none.
    pub unit: String,
    /// Whether the value is a word.
    pub is_word: bool,
}

/// Content of [`RESULTS`].
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct RunFile {
    /// Version of Panoscope.
    pub version: String,
    /// Number of the run, from 1.
    pub run: usize,
    /// The studied graph file. Relative paths in graph.toml start from its folder.
    pub graph: String,
    /// Hash of graph.toml.
    pub graph_hash: FileHash,
    /// Hashes of the plugins that the graph lists.
    pub plugins: Vec<FileHash>,
    /// Hashes of required files in its parameters, such as models.
    pub models: Vec<FileHash>,
    /// The machine.
    pub machine: Machine,
    /// When the study was prepared, in ms since 1970.
    pub unix_ms: u64,
    /// Duration of the run, s.
    pub seconds: f64,
    /// Maximum number of ticks of each source.
    pub frames: u64,
    /// Recording that replaced the sources.
    pub recording: Option<String>,
    /// `node.param=value` of the command line, applied in all runs.
    pub settings: Vec<String>,
    /// Parameters omitted because the chosen node type lacks them.
    pub dropped: Vec<String>,
    /// Values of the axes.
    pub params: Vec<RunParam>,
    /// The measures.
    pub measures: Vec<RunMeasure>,
}

impl RunFile {
    /// Reads the results of a run.
    ///
    /// # Errors
    /// The file cannot be read, or has another format.
    pub fn read(file: &Path) -> Result<Self> {
        let text = fs::read_to_string(file).on_file(FileAction::Read, file)?;
        serde_json::from_str(&text).with_context(|| format!("{} has no results of a run", file.display()))
    }
}

/// The folder of a study.
#[derive(Debug)]
pub struct StudyFolder {
    folder: PathBuf,
    recording: Option<String>,
}

impl StudyFolder {
    /// Creates the folder. `recording` is the file that replaces the sources.
    ///
    /// # Errors
    /// It cannot be created, or already has a study.
    pub fn create(folder: &Path, recording: Option<&Path>) -> Result<Self> {
        if folder.join(TABLE).exists() {
            let reason = format!("{} holds a study already: name another folder with --out", folder.display());
            return Err(EvalError::Options { reason });
        }
        fs::create_dir_all(folder).on_file(FileAction::Create, folder)?;
        let recording = recording.map(|file| file.display().to_string());
        Ok(Self { folder: folder.to_owned(), recording })
    }

    /// Writes a run: its graph and its measures.
    ///
    /// # Errors
    /// A file cannot be written.
    pub fn write(&self, study: &Study, result: &RunResult) -> Result<()> {
        let folder = self.folder.join(format!("run_{:04}", result.number));
        fs::create_dir_all(&folder).on_file(FileAction::Create, &folder)?;
        let (variant, own) = study.of_run(&result.values);
        let head = &variant.head;
        let mut parsed = GraphText::parse(&study.request.path, &variant.text);
        variant.settings.iter().chain(&own).for_each(|setting| parsed.set(setting));
        let settled = parsed.settled(&study.loader.catalog_of(&parsed));
        let settled = settled.with_context(|| format!("the graph of run {} cannot be written", result.number))?;
        let note = format!(
            "# Run {} of a study. Relative paths start from the folder of {}\n",
            result.number, head.graph_path
        );
        let graph = folder.join(GRAPH);
        fs::write(&graph, note + &settled).on_file(FileAction::Write, &graph)?;
        let params = study.axes.iter().zip(&result.values).map(|(axis, (value, at))| RunParam {
            name: axis.param.clone(),
            value: value.clone(),
            at: *at,
            unit: axis.unit.clone(),
            is_word: axis.has_words,
        });
        let measures = study.measures().iter().zip(&result.results).map(|(name, result)| RunMeasure::of(name, result));
        let file = RunFile {
            version: head.version.clone(),
            run: result.number,
            graph: head.graph_path.clone(),
            graph_hash: hash_file(GRAPH, &graph),
            plugins: head.plugins.clone(),
            models: head.models.clone(),
            machine: head.machine.clone(),
            unix_ms: head.unix_ms,
            seconds: result.seconds,
            frames: study.request.frames,
            recording: self.recording.clone(),
            settings: study.request.settings.clone(),
            dropped: variant.dropped.clone(),
            params: params.collect(),
            measures: measures.collect(),
        };
        let path = folder.join(RESULTS);
        let text = serde_json::to_string_pretty(&file)? + "\n";
        fs::write(&path, text).on_file(FileAction::Write, &path)
    }

    /// Writes the table of all runs.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn finish(&self, study: &Study, results: &[RunResult]) -> Result<PathBuf> {
        let path = self.folder.join(TABLE);
        fs::write(&path, study_csv(study, results)).on_file(FileAction::Write, &path)?;
        Ok(path)
    }
}

/// Runs as CSV, one line each: number, values, statistics of each measure, failure.
pub fn study_csv(study: &Study, results: &[RunResult]) -> String {
    let quoted = |text: &str| format!("\"{}\"", text.replace('"', "\"\""));
    let mut head = vec!["run".to_owned()];
    head.extend(study.axes.iter().map(|axis| quoted(&axis.param)));
    let none = PointError { reason: String::new() };
    for measure in study.measures() {
        let columns = RunMeasure::of(measure, &Err(none.clone())).columns();
        head.extend(columns.iter().map(|(name, _)| quoted(&format!("{measure} {name}"))));
        head.extend(["count", "missing"].map(|name| quoted(&format!("{measure} {name}"))));
    }
    head.extend(["seconds", "failed_calls", "failed"].map(str::to_owned));
    let mut lines = vec![head.join(",")];
    for run in sorted(results) {
        let mut cells = vec![run.number.to_string()];
        cells.extend(run.values.iter().map(|(value, _)| quoted(value)));
        let (mut failed, mut failed_calls) = (String::new(), 0);
        for (name, result) in study.measures().iter().zip(&run.results) {
            let measure = RunMeasure::of(name, result);
            cells.extend(measure.columns().map(|(_, value)| value.map_or_else(String::new, |v| v.to_string())));
            cells.extend([measure.count, measure.missing].map(|count| count.to_string()));
            failed_calls = failed_calls.max(measure.failed_calls);
            if let (Some(reason), true) = (&measure.failed, failed.is_empty()) {
                reason.lines().next().unwrap_or_default().clone_into(&mut failed);
            }
        }
        cells.extend([format!("{:.3}", run.seconds), failed_calls.to_string(), quoted(&failed)]);
        lines.push(cells.join(","));
    }
    lines.join("\n") + "\n"
}

fn sorted(results: &[RunResult]) -> Vec<&RunResult> {
    let mut sorted: Vec<&RunResult> = results.iter().collect();
    sorted.sort_by_key(|run| run.number);
    sorted
}

/// A run as one line of text.
pub fn study_line(study: &Study, run: &RunResult) -> String {
    let values = study.axes.iter().zip(&run.values).map(|(axis, (value, _))| format!("{} = {value}", axis.param));
    let results = study.measures().iter().zip(&run.results).map(|(name, result)| match result {
        Ok(summary) => format!("{name} {}{}", number(summary.mean), failures(summary)),
        Err(why) => format!("{name}: {}", why.reason.lines().next().unwrap_or_default()),
    });
    format!("{}: {}", values.collect::<Vec<_>>().join(", "), results.collect::<Vec<_>>().join(", "))
}

/// Runs as text, one row each, with the mean of each measure.
pub fn study_table(study: &Study, results: &[RunResult]) -> String {
    let mut head = vec!["run".to_owned()];
    head.extend(study.axes.iter().map(|axis| axis.param.clone()));
    head.extend(study.measures().iter().cloned());
    let mut rows = vec![head];
    for run in sorted(results) {
        let mut cells = vec![run.number.to_string()];
        cells.extend(run.values.iter().map(|(value, _)| value.clone()));
        cells.extend(run.results.iter().map(|result| match result {
            Ok(summary) => number(summary.mean),
            Err(_) => "failed".to_owned(),
        }));
        rows.push(cells);
    }
    text_table::table(&rows)
}
