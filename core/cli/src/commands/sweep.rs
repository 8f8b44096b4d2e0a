//! `panoscope sweep`: what a parameter does to a measure.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result};
use panoscope_eval::plot;
use panoscope_eval::sweep::{self, Point, Request, Sweep, SweepError};
use panoscope_graph::{Diagnostics, GraphText, check};
use panoscope_loader::{self as loader, Loader};
use panoscope_record::{Recording, RecordingError};

use crate::given::Given;
use crate::terminal::{log, out, raw, stderr_color};
use crate::{End, interrupt};

/// Arguments of `sweep`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Graph file. Nodes that act on the world (files, motors) are left out.
    graph: PathBuf,
    /// The parameter.
    #[arg(long, value_name = "NODE.PARAM")]
    param: String,
    /// First value; without it the parameter's smallest. Of switches and choices all values are taken.
    #[arg(long, allow_negative_numbers = true)]
    from: Option<f64>,
    /// Last value; without it the parameter's largest.
    #[arg(long, allow_negative_numbers = true)]
    to: Option<f64>,
    /// Number of values, both ends included.
    #[arg(long, default_value_t = 9)]
    steps: usize,
    /// A scalar port, a column of a table port (`COLUMN[2]` for the second of several rows, `COLUMN[*]` for all), or a number or counter that a
    /// node reports (p50_ms, ...).
    #[arg(long, value_name = "NODE.PORT[.COLUMN]")]
    measure: String,
    /// Most ticks of each source per value.
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u64).range(1..))]
    frames: u64,
    /// Takes the pictures of a recording of `panoscope record` instead of the graph's sources.
    #[arg(long, value_name = "FILE.mcap")]
    recording: Option<PathBuf>,
    /// Sets another parameter in all runs. May be given again.
    #[arg(long, value_name = "NODE.PARAM=VALUE")]
    set: Vec<String>,
    #[command(flatten)]
    given: Given,
    /// Threads of the pool; without it, one per core.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Writes a row per value as JSON.
    #[arg(long, value_name = "FILE.json")]
    json: Option<PathBuf>,
    /// Writes a row per value as CSV.
    #[arg(long, value_name = "FILE.csv")]
    csv: Option<PathBuf>,
    /// Draws mean, smallest and largest over the values.
    #[arg(long, value_name = "FILE.png")]
    plot: Option<PathBuf>,
}

/// Sweeps.
pub fn run(arguments: &Arguments) -> Result<End> {
    let sweep = match prepare(arguments) {
        Ok(sweep) => sweep,
        Err(refusal) => {
            log!("{refusal}");
            return Ok(End::Wrong);
        }
    };
    interrupt::listen();
    let mut points: Vec<Point> = Vec::new();
    let ran = sweep.run(&interrupt::asked, |point| {
        log!("{} of {}: {}", points.len() + 1, sweep.len(), sweep::line(&sweep, &point));
        points.push(point);
    });
    if let Err(error) = ran {
        log!("error: {error}");
        return Ok(End::Wrong);
    }
    raw(&sweep::table(&sweep, &points));
    let write = |path: &Path, text: String| {
        std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
    };
    if let Some(path) = &arguments.json {
        write(path, sweep::json(&sweep, &points)?)?;
    }
    if let Some(path) = &arguments.csv {
        write(path, sweep::csv(&arguments.param, &arguments.measure, &points))?;
    }
    if let Some(path) = &arguments.plot {
        plot::save(path, &[sweep::chart(&sweep, &points)])?;
    }
    Ok(conclude(&points, sweep.len()))
}

/// The last line: how many values were measured.
fn conclude(points: &[Point], wanted: usize) -> End {
    let measured = points.iter().filter(|point| point.result.is_ok()).count();
    let (how, end) = match (measured, points.len()) {
        (m, _) if m == wanted => ("done", End::Done),
        (m, p) if m == p => ("stopped", End::Done),
        _ => ("failed", End::Failed),
    };
    out!("{how}: {measured} of {wanted} values measured");
    end
}

/// Why nothing can be swept.
#[derive(Debug, thiserror::Error)]
enum Refusal {
    /// The graph has mistakes.
    #[error("{}", diagnostics.render(stderr_color()).trim_end())]
    Graph { diagnostics: Diagnostics },
    /// The recording cannot be read.
    #[error("error: {0}")]
    Recording(#[from] RecordingError),
    /// Parameter or measure cannot be used.
    #[error("error: {0}")]
    Sweep(SweepError),
}

impl From<SweepError> for Refusal {
    fn from(error: SweepError) -> Self {
        match error {
            SweepError::Check(diagnostics) => Self::Graph { diagnostics },
            other => Self::Sweep(other),
        }
    }
}

/// Checks what the arguments ask for.
fn prepare(arguments: &Arguments) -> Result<Sweep, Refusal> {
    let refused = |diagnostics| Refusal::Graph { diagnostics };
    let given = arguments.given.options(&arguments.set);
    let text = GraphText::load_with(&arguments.graph, &given).map_err(refused)?;
    let recording = match &arguments.recording {
        Some(file) => Some(Arc::new(Recording::open(file)?)),
        None => None,
    };
    let loader = Arc::new(Loader::search(&loader::search_path(&text.plugin_paths())));
    let catalog = loader.catalog_of(&text);
    if !text.is_plain() {
        // What is wrong is shown in the files it stands in.
        check(&text, &catalog).into_result().map_err(refused)?;
    }
    let request = Request {
        path: arguments.graph.clone(),
        text: text.flattened(&catalog).into_owned(),
        settings: text.settings(),
        param: text.resolve_param(&arguments.param),
        from: arguments.from,
        to: arguments.to,
        steps: arguments.steps,
        measure: text.resolve_output(&arguments.measure),
        frames: arguments.frames,
        recording,
        threads: arguments.threads.map_or(0, usize::from),
    };
    Ok(Sweep::new(request, loader)?)
}
