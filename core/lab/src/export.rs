//! `panoscope export`: a recording as files of other programs.

use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::Arc;

use anyhow::{Context, Result};
use panoscope_engine::text_table::table;
use panoscope_export::{Export, ExportError, PortReport, Selection, folder, foxglove, ros2};
use panoscope_host::loader::python_module;
use panoscope_record::{PortTypes, Recording, own_folders};
use serde::Deserialize;

use panoscope_cli::End;
use panoscope_cli::terminal::{log, raw};
use panoscope_cli::trust::OwnPlugins;

/// Module of the Python package that writes files of rerun.
const RERUN_MODULE: &str = "panoscope.rerun_file";

/// Arguments of `export`.
#[derive(clap::Args)]
pub struct Arguments {
    /// A recording of `panoscope record`.
    recording: PathBuf,
    #[command(flatten)]
    targets: Targets,
    /// Ports, or nodes for all of their ports, separated by commas; default: all.
    #[arg(long, value_name = "NODE[.PORT]", value_delimiter = ',')]
    ports: Vec<String>,
    /// First tick.
    #[arg(long, default_value_t = 0, value_name = "TICK")]
    from: u64,
    /// Last tick; default: the last one of the recording.
    #[arg(long, value_name = "TICK")]
    to: Option<u64>,
    /// Replaces files that exist.
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    own_plugins: OwnPlugins,
}

/// Outputs of the export.
#[derive(clap::Args)]
#[group(required = true, multiple = true)]
struct Targets {
    /// Writes a folder: images as PNG, disparity and depth as NPY, clouds as PLY, calibrations as YAML, all others as
    /// CSV.
    #[arg(long, value_name = "DIR")]
    folder: Option<PathBuf>,
    /// Writes an MCAP file with the schemas of Foxglove.
    #[arg(long, value_name = "FILE.mcap")]
    foxglove: Option<PathBuf>,
    /// Writes a bag of ROS 2: a folder with an MCAP file and metadata.yaml, which every distribution since Humble
    /// reads.
    #[arg(long, value_name = "DIR")]
    ros2: Option<PathBuf>,
    /// Writes a file of rerun, through Python with the package rerun-sdk.
    #[arg(long, value_name = "FILE.rrd")]
    rerun: Option<PathBuf>,
}

/// Exports a recording.
pub fn run(arguments: &Arguments) -> Result<End> {
    if arguments.to.is_some_and(|to| to < arguments.from) {
        log!("error: --to is before --from: no tick is between them");
        return Ok(End::Wrong);
    }
    let recording = match Recording::open(&arguments.recording) {
        Ok(recording) => Arc::new(recording),
        Err(error) => {
            log!("error: {error}");
            return Ok(End::Wrong);
        }
    };
    if let Some(cut) = &recording.cut {
        log!(
            "warning: {} ends at byte {}: {}; exporting what is before",
            recording.path().display(),
            cut.at,
            cut.reason
        );
    }
    let is_damaged = recording.cut.as_ref().is_some_and(|cut| cut.damaged);
    let loader = arguments.own_plugins.loader(&own_folders(&recording.head));
    let types = PortTypes::new(Arc::clone(&recording), loader);
    let selection =
        Selection { ports: arguments.ports.clone(), ticks: arguments.from..=arguments.to.unwrap_or(u64::MAX) };
    let export = match Export::new(&types, &selection) {
        Ok(export) => export,
        Err(error) => return Ok(failed(&error)),
    };
    let Targets { folder, foxglove, ros2, rerun } = &arguments.targets;
    if let Some(path) = folder {
        match folder::write(&export, path, arguments.force) {
            Ok(reports) => show(path, &reports.iter().map(Line::from).collect::<Vec<_>>()),
            Err(error) => return Ok(failed(&error)),
        }
    }
    if let Some(path) = foxglove {
        match foxglove::write(&export, path, arguments.force) {
            Ok(reports) => show(path, &reports.iter().map(Line::from).collect::<Vec<_>>()),
            Err(error) => return Ok(failed(&error)),
        }
    }
    if let Some(path) = ros2 {
        match ros2::write(&export, path, arguments.force) {
            Ok(reports) => show(path, &reports.iter().map(Line::from).collect::<Vec<_>>()),
            Err(error) => return Ok(failed(&error)),
        }
    }
    if let Some(path) = rerun {
        match write_rerun(arguments, &export, path)? {
            Some(lines) => show(path, &lines),
            None => return Ok(End::Failed),
        }
    }
    Ok(if is_damaged { End::Failed } else { End::Done })
}

fn failed(error: &ExportError) -> End {
    log!("error: {error}");
    match error {
        ExportError::NoPort { .. }
        | ExportError::NoTicks { .. }
        | ExportError::Empty { .. }
        | ExportError::Exists { .. }
        | ExportError::IsRecording { .. } => End::Wrong,
        ExportError::Write { .. } | ExportError::Recording(_) | ExportError::Value { .. } => End::Failed,
    }
}

/// Writes a file of rerun. `None` if it failed and the interpreter reported why.
fn write_rerun(arguments: &Arguments, export: &Export<'_>, path: &Path) -> Result<Option<Vec<Line>>> {
    let mut python = python_module(RERUN_MODULE)
        .context("rerun files are written by Python; set PANOSCOPE_PYTHON to an interpreter")?;
    python.arg(&arguments.recording).arg(path);
    python.args(["--from", &arguments.from.to_string()]);
    if let Some(to) = arguments.to {
        python.args(["--to", &to.to_string()]);
    }
    for port in &export.ports {
        python.args(["--port", port.name]);
    }
    if arguments.force {
        python.arg("--force");
    }
    if arguments.own_plugins.is_trusted() {
        python.arg("--trust-plugins");
    }
    let output = python.stderr(Stdio::inherit()).output().context("Python was not started")?;
    if !output.status.success() {
        // The module itself ends with 2, after an error in one line.
        if output.status.code() != Some(2) {
            let interpreter = python.get_program().display();
            log!(
                "error: {interpreter} did not write {}; it needs NumPy and rerun-sdk: `{interpreter} -m pip install numpy rerun-sdk`",
                path.display()
            );
        }
        return Ok(None);
    }
    Ok(Some(serde_json::from_slice(&output.stdout).context("Python did not report its files")?))
}

/// A port in the list of written ports.
#[derive(Deserialize)]
struct Line {
    port: String,
    packets: usize,
    /// Form in the target.
    form: Option<String>,
    /// Location in the target.
    at: Option<String>,
    /// Reason for which it was left out.
    left_out: Option<String>,
}

impl From<&PortReport> for Line {
    fn from(report: &PortReport) -> Self {
        let (form, at, left_out) = match &report.outcome {
            Ok((form, at)) => (Some((*form).to_owned()), Some(at.clone()), None),
            Err(why) => (None, None, Some(why.clone())),
        };
        Self { port: report.port.clone(), packets: report.packets, form, at, left_out }
    }
}

fn show(path: &Path, lines: &[Line]) {
    let mut rows = vec![["port", "packets", "as", "in"].map(str::to_owned).to_vec()];
    for line in lines.iter().filter(|line| line.left_out.is_none()) {
        let text = |text: &Option<String>| text.clone().unwrap_or_default();
        rows.push(vec![line.port.clone(), line.packets.to_string(), text(&line.form), text(&line.at)]);
    }
    raw(&format!("{}:\n", path.display()));
    raw(&table(&rows));
    for line in lines {
        if let Some(why) = &line.left_out {
            log!("warning: `{}` was left out: {why}", line.port);
        }
    }
}
