//! `panoscope sweep`: effect of parameters and node types on measures.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result};
use panoscope_eval::EvalError;
use panoscope_eval::plot;
use panoscope_eval::report::is_larger_better;
use panoscope_eval::sweep::{
    self, AxisRequest, AxisValues, Plan, Point, Request, RunResult, Statistic, Study, StudyFolder, StudyRequest, Sweep,
    SweepError,
};
use panoscope_graph::{Diagnostics, GraphText, check};
use panoscope_host::loader::{self as loader, Loader};
use panoscope_record::{Recording, RecordingError};

use panoscope_cli::given::Given;
use panoscope_cli::terminal::{log, out, raw, stderr_color};
use panoscope_cli::{End, interrupt};

/// Arguments of `sweep`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Graph file. Nodes with side effects (files, motors) are removed.
    graph: PathBuf,
    /// A parameter, with its values: FROM..TO, FROM..TO/STEPS or VALUE,VALUE,...; default: from its minimum to its
    /// maximum, or all of a switch or a choice. NODE.type=TYPE,TYPE varies the type of a node. Repeatable: all
    /// combinations are run.
    #[arg(long, value_name = "NODE.PARAM[=VALUES]", required = true)]
    param: Vec<String>,
    /// First value of a single parameter; default: the parameter's minimum. Switches and choices use all values.
    #[arg(long, allow_negative_numbers = true)]
    from: Option<f64>,
    /// Last value of a single parameter; default: the parameter's maximum.
    #[arg(long, allow_negative_numbers = true)]
    to: Option<f64>,
    /// Number of values, both ends included.
    #[arg(long, default_value_t = 9)]
    steps: usize,
    /// A scalar port, a column of a table port (`COLUMN[2]` for the second of several rows, `COLUMN[*]` for all), or a
    /// number or counter that a node reports (p50_ms, ...). Repeatable.
    #[arg(long, value_name = "NODE.PORT[.COLUMN]", required = true)]
    measure: Vec<String>,
    /// Number of runs with random values, instead of all combinations.
    #[arg(long, value_name = "RUNS")]
    random: Option<usize>,
    /// Number of runs of a search, each with values that promise a better first measure by earlier runs
    /// (tree-structured Parzen estimator).
    #[arg(long, value_name = "RUNS", conflicts_with = "random")]
    search: Option<usize>,
    /// Seed of --random and --search: the same seed gives the same values; of a search, one run at a time.
    // Graphs have arguments called `seed`.
    #[arg(long, default_value_t = 1)]
    random_seed: u64,
    /// Statistic of the first measure that --search improves. Use `last` for measures that accumulate from the start
    /// (ap50_pct, ...).
    #[arg(long, default_value = "mean", value_parser = clap::builder::PossibleValuesParser::new(Statistic::ALL.map(Statistic::name)))]
    statistic: String,
    /// Maximizes the first measure in --search. Recognised by name: see `panoscope report --help`.
    #[arg(long)]
    maximize: bool,
    /// Number of parallel runs. They share the machine: measure times with 1.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=256))]
    jobs: u16,
    /// Writes a folder for each run (graph.toml, results.json with hashes and machine) and results.csv over all.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Maximum number of ticks of each source per value.
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u64).range(1..))]
    frames: u64,
    /// Uses the frames of a recording of `panoscope record` instead of the graph's sources.
    #[arg(long, value_name = "FILE.mcap")]
    recording: Option<PathBuf>,
    /// Sets another parameter in all runs; repeatable.
    #[arg(long, value_name = "NODE.PARAM=VALUE")]
    set: Vec<String>,
    #[command(flatten)]
    given: Given,
    /// Threads of the pool; default: one per core.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Writes a row per value as JSON; only for a single parameter.
    #[arg(long, value_name = "FILE.json")]
    json: Option<PathBuf>,
    /// Writes a row per value as CSV.
    #[arg(long, value_name = "FILE.csv")]
    csv: Option<PathBuf>,
    /// Draws mean, minimum and maximum over the values; only for a single parameter.
    #[arg(long, value_name = "FILE.png")]
    plot: Option<PathBuf>,
}

/// Sweeps.
pub fn run(arguments: &Arguments) -> Result<End> {
    match (&arguments.param[..], &arguments.measure[..]) {
        ([param], [measure]) if !param.contains('=') && !arguments.is_study() => single(arguments, param, measure),
        _ => study(arguments),
    }
}

impl Arguments {
    /// Options that only a study has.
    fn is_study(&self) -> bool {
        self.random.is_some() || self.search.is_some() || self.jobs > 1 || self.out.is_some()
    }
}

/// Sweeps several parameters, or writes folders.
fn study(arguments: &Arguments) -> Result<End> {
    let study = match prepare_study(arguments) {
        Ok(study) => study,
        Err(refusal) => {
            log!("{refusal}");
            return Ok(End::Wrong);
        }
    };
    let folder = match &arguments.out {
        None => None,
        Some(folder) => match StudyFolder::create(folder, arguments.recording.as_deref()) {
            Ok(folder) => Some(folder),
            Err(EvalError::Options { reason }) => {
                log!("error: {reason}");
                return Ok(End::Wrong);
            }
            Err(error) => return Err(error.into()),
        },
    };
    interrupt::listen();
    for param in study.dropped() {
        log!("note: {param} is left out where the chosen node type has no such parameter");
    }
    let mut results: Vec<RunResult> = Vec::new();
    let mut unwritten = None;
    let ran = study.run(&interrupt::asked, |result| {
        log!("{} of {}: {}", results.len() + 1, study.len(), sweep::study_line(&study, &result));
        if let Some(folder) = &folder {
            unwritten = unwritten.take().or(folder.write(&study, &result).err());
        }
        results.push(result);
    });
    if let Err(error) = ran {
        log!("error: {error}");
        return Ok(End::Wrong);
    }
    if let Some(error) = unwritten {
        return Err(error.into());
    }
    raw(&sweep::study_table(&study, &results));
    if let Some(path) = &arguments.csv {
        write(path, sweep::study_csv(&study, &results))?;
    }
    if let Some(folder) = &folder {
        out!("{}", folder.finish(&study, &results)?.display());
    }
    let measured = results.iter().filter(|run| run.results.iter().all(Result::is_ok)).count();
    Ok(conclude(measured, results.len(), study.len()))
}

fn write(path: &Path, text: String) -> Result<()> {
    std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
}

/// Sweeps one parameter.
fn single(arguments: &Arguments, param: &str, measure: &str) -> Result<End> {
    let sweep = match prepare(arguments, param, measure) {
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
    if let Some(path) = &arguments.json {
        write(path, sweep::json(&sweep, &points)?)?;
    }
    if let Some(path) = &arguments.csv {
        write(path, sweep::csv(param, measure, &points))?;
    }
    if let Some(path) = &arguments.plot {
        plot::save(path, &[sweep::chart(&sweep, &points)])?;
    }
    let measured = points.iter().filter(|point| point.result.is_ok()).count();
    Ok(conclude(measured, points.len(), sweep.len()))
}

/// The last line: number of measured values, of runs and of requested values.
fn conclude(measured: usize, ran: usize, wanted: usize) -> End {
    let (how, end) = match (measured, ran) {
        (m, _) if m == wanted => ("done", End::Done),
        (m, p) if m == p => ("stopped", End::Done),
        _ => ("failed", End::Failed),
    };
    out!("{how}: {measured} of {wanted} values measured");
    end
}

/// A sweep that cannot run.
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

/// Settings of all runs.
struct Common {
    text: GraphText,
    flat: String,
    recording: Option<Arc<Recording>>,
    loader: Arc<Loader>,
}

fn common(arguments: &Arguments) -> Result<Common, Refusal> {
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
    let flat = text.flattened(&catalog).into_owned();
    Ok(Common { text, flat, recording, loader })
}

/// Checks the arguments.
fn prepare(arguments: &Arguments, param: &str, measure: &str) -> Result<Sweep, Refusal> {
    let Common { text, flat, recording, loader } = common(arguments)?;
    let request = Request {
        path: arguments.graph.clone(),
        text: flat,
        settings: text.settings(),
        param: text.resolve_param(param),
        from: arguments.from,
        to: arguments.to,
        steps: arguments.steps,
        measure: text.resolve_output(measure),
        frames: arguments.frames,
        recording,
        threads: arguments.threads.map_or(0, usize::from),
    };
    Ok(Sweep::new(request, loader)?)
}

/// Checks the arguments for several parameters.
fn prepare_study(arguments: &Arguments) -> Result<Study, Refusal> {
    let single = arguments.param.len() == 1;
    let conflict = |option: &str, reason: &str| {
        Err(Refusal::Sweep(SweepError::Param { param: option.to_owned(), reason: reason.to_owned() }))
    };
    if (arguments.from.is_some() || arguments.to.is_some()) && !single {
        return conflict("--from, --to", "with several parameters each has its own range: --param NODE.PARAM=FROM..TO");
    }
    if arguments.json.is_some() || arguments.plot.is_some() {
        return conflict(
            "--json, --plot",
            "they show one parameter and one measure: take --out DIR and `panoscope report DIR --html FILE`",
        );
    }
    let Common { text, flat, recording, loader } = common(arguments)?;
    let mut axes = Vec::new();
    for param in &arguments.param {
        let mut axis = AxisRequest::parse(param)?;
        if let AxisValues::Range { from, to, .. } = &mut axis.values {
            (*from, *to) = (from.or(arguments.from), to.or(arguments.to));
        }
        axis.param = text.resolve_param(&axis.param);
        axes.push(axis);
    }
    let seed = arguments.random_seed;
    let plan = match (arguments.random, arguments.search) {
        (Some(runs), _) => Plan::Random { runs, seed },
        (None, Some(runs)) => Plan::Search {
            runs,
            seed,
            statistic: Statistic::named(&arguments.statistic).unwrap_or(Statistic::Mean),
            is_larger_better: arguments.maximize || arguments.measure.first().is_some_and(|m| is_larger_better(m)),
        },
        (None, None) => Plan::Grid,
    };
    let request = StudyRequest {
        path: arguments.graph.clone(),
        text: flat,
        settings: text.settings(),
        axes,
        plan,
        steps: arguments.steps,
        measures: arguments.measure.iter().map(|measure| text.resolve_output(measure)).collect(),
        frames: arguments.frames,
        recording,
        threads: arguments.threads.map_or(0, usize::from),
        jobs: arguments.jobs.into(),
    };
    Ok(Study::new(request, loader)?)
}
