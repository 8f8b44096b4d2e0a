//! `panoscope sweep`: what a parameter does to a measure.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result};
use panoscope_eval::sweep::{Point, Request, Summary, Sweep, SweepError, csv};
use panoscope_graph::{Diagnostics, GraphText, check};
use panoscope_loader::{self as loader, Loader};
use panoscope_record::Recording;
use serde_json::{Value, json};

use super::eval::plot::{self, Chart, Series, Style};
use crate::graph_file::Given;
use crate::terminal::{raw, say, stderr_color, table, tell};
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
    /// node tells (p50_ms, ...).
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
        Err(words) => {
            tell!("{words}");
            return Ok(End::Wrong);
        }
    };
    interrupt::listen();
    let mut points: Vec<Point> = Vec::new();
    let ran = sweep.run(&interrupt::asked, |point| {
        tell!("{} of {}: {}", points.len() + 1, sweep.len(), told(&arguments.param, sweep.unit(), &point));
        points.push(point);
    });
    if let Err(error) = ran {
        tell!("error: {error}");
        return Ok(End::Wrong);
    }
    show(arguments, &points);
    let write = |path: &Path, text: String| {
        std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
    };
    if let Some(path) = &arguments.json {
        let rows: Vec<Value> = points.iter().map(|point| row(arguments, sweep.unit(), point)).collect();
        write(path, serde_json::to_string_pretty(&rows)? + "\n")?;
    }
    if let Some(path) = &arguments.csv {
        write(path, csv(&arguments.param, &arguments.measure, &points))?;
    }
    if let Some(path) = &arguments.plot {
        plot::save(path, &[chart(arguments, &sweep, &points)])?;
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
    say!("{how}: {measured} of {wanted} values measured");
    end
}

/// The sweep, or what is wrong, in words.
fn prepare(arguments: &Arguments) -> Result<Sweep, String> {
    let colored = |error: SweepError| match error {
        SweepError::Check(diagnostics) => diagnostics.render(stderr_color()).trim_end().to_owned(),
        other => format!("error: {other}"),
    };
    let shown = |d: Diagnostics| d.render(stderr_color()).trim_end().to_owned();
    let text = GraphText::load_with(&arguments.graph, &arguments.given.options(&arguments.set)).map_err(shown)?;
    let recording = match &arguments.recording {
        Some(file) => Some(Arc::new(Recording::open(file).map_err(|error| format!("error: {error}"))?)),
        None => None,
    };
    let loader = Arc::new(Loader::search(&loader::search_path(&text.plugin_paths())));
    let catalog = loader.catalog(&text.plugins());
    if !text.is_plain() {
        // What is wrong is shown in the files it stands in.
        check(&text, &catalog).into_result().map_err(shown)?;
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
    Sweep::new(request, loader).map_err(colored)
}

fn number(value: f64) -> String {
    if value.abs() >= 1000.0 { format!("{value:.0}") } else { format!("{value:.4}") }
}

fn told(param: &str, unit: &str, point: &Point) -> String {
    let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
    match &point.result {
        Ok(s) => format!("{param} = {}{unit}: {}", point.value, number(s.mean)),
        Err(why) => format!("{param} = {}{unit}: {why}", point.value),
    }
}

fn show(arguments: &Arguments, points: &[Point]) {
    let head = [arguments.param.as_str(), "mean", "median", "min", "max", "deviation", "count", "missing"];
    let mut rows = vec![head.map(str::to_owned).to_vec()];
    for point in points {
        let mut cells = vec![point.value.clone()];
        match &point.result {
            Ok(Summary { count, missing, mean, median, min, max, deviation }) => {
                cells.extend([mean, median, min, max, deviation].map(|v| number(*v)));
                cells.extend([count.to_string(), missing.to_string()]);
            }
            Err(_) => cells.push("failed".to_owned()),
        }
        rows.push(cells);
    }
    raw(&table(&rows));
}

fn row(arguments: &Arguments, unit: &str, point: &Point) -> Value {
    let (summary, failed) = match &point.result {
        Ok(summary) => (Some(summary), None),
        Err(why) => (None, Some(why)),
    };
    // JSON has no NaN: what is unknown is null.
    let of = |value: fn(&Summary) -> f64| summary.map(value).filter(|v| v.is_finite());
    json!({
        "param": arguments.param,
        "value": point.value,
        "at": point.at,
        "unit": unit,
        "measure": arguments.measure,
        "mean": of(|s| s.mean),
        "median": of(|s| s.median),
        "min": of(|s| s.min),
        "max": of(|s| s.max),
        "deviation": of(|s| s.deviation),
        "count": summary.map(|s| s.count),
        "missing": summary.map(|s| s.missing),
        "failed": failed,
    })
}

fn chart(arguments: &Arguments, sweep: &Sweep, points: &[Point]) -> Chart {
    let (unit, has_words) = (sweep.unit(), sweep.has_words());
    let known = || points.iter().filter_map(|p| Some((p.at, p.result.as_ref().ok()?)));
    let bars = known().flat_map(|(at, s)| [(at, s.min), (at, s.max)]).collect();
    let means = known().map(|(at, s)| (at, s.mean)).collect();
    let series = |name: &str, style, color, points| Series { name: name.to_owned(), style, color, points };
    Chart {
        title: format!("{} over {}", arguments.measure, arguments.param),
        x_label: if unit.is_empty() { arguments.param.clone() } else { format!("{} [{unit}]", arguments.param) },
        y_label: arguments.measure.clone(),
        // Between words there is nothing.
        series: vec![
            series("smallest to largest", Style::Bars, 1, bars),
            series("mean", if has_words { Style::Dots } else { Style::Line }, 0, means),
        ],
        from_zero: false,
        log: false,
        words: if has_words { points.iter().map(|p| (p.at, p.value.clone())).collect() } else { Vec::new() },
    }
}
