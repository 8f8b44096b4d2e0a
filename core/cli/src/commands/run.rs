//! `panoscope run`.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use panoscope_base::files;
use panoscope_engine::ending::signals;
use panoscope_engine::fault::json_lines;
use panoscope_engine::{Engine, Options, Report};
use panoscope_graph::{Diagnostics, GraphOptions, GraphText, OnFault, ParamValue, installed};
use panoscope_host::attach::Attachable;
use panoscope_host::loader::Live;
use panoscope_host::loader::graph_file::{Ready, RunError};
use panoscope_host::loader::live::FileWatch;
use panoscope_host::loader::lock::{ALWAYS_LOCKED, Lock, LockError, lock_path};
use panoscope_host::loader::sealed::readable;
use panoscope_host::loader::verify::{self, VerifyError};
use panoscope_monitor::{Address, Monitor};
use panoscope_record::timeline::{self, Timeline};
use panoscope_record::{RecordOptions, Recorded, Recorder, head};
use serde::Serialize;

use crate::given::Given;
use crate::judge::{Facts, Verdict, Weight, judge};
use crate::log_lines::{self, LogFormat};
use crate::progress::Progress;
use crate::terminal::{self, log, out, raw, stderr_color};
use crate::tick_numbers::{TickNumbers, TickTable};
use crate::trust::{IsolatedPlugins, Keys};
use crate::{End, allocations, beside, interrupt, summary};

use super::windows;

/// Time limit for nodes to finish after the end of a run was requested.
pub const PATIENCE: Duration = Duration::from_secs(30);

/// Arguments of `run`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Graph file.
    graph: PathBuf,
    /// Sets a parameter; overrides the file; repeatable.
    #[arg(long, value_name = "NODE.PARAM=VALUE")]
    set: Vec<String>,
    #[command(flatten)]
    given: Given,
    /// Ticks that each source makes; default: until the sources end or Ctrl-C.
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..))]
    frames: Option<u64>,
    /// Maximum number of ticks that each source makes; unlike with --frames, one that ends before is no failure.
    #[arg(long, conflicts_with = "frames", value_parser = clap::value_parser!(u64).range(1..))]
    max_frames: Option<u64>,
    /// Threads of the pool; default: one per core.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Neither windows nor a progress bar: plain lines, for a machine without a screen.
    #[arg(long)]
    headless: bool,
    /// Sources of a live graph run as fast as the graph accepts frames instead of waiting for capture times.
    #[arg(long)]
    unpaced: bool,
    /// Applies changes on disk while the graph runs: of the graph file, or a rebuilt plugin. Mistakes are shown, and
    /// the old graph keeps running.
    #[arg(long)]
    watch: bool,
    /// Runs only files of the lock next to the graph file: they are compared before use, and nodes read immutable
    /// copies. --set accepts only parameters that the graph's `[preset]` offers.
    #[arg(long, conflicts_with = "watch")]
    lock: bool,
    #[command(flatten)]
    isolated: IsolatedPlugins,
    #[command(flatten)]
    keys: Keys,
    /// Writes counters and times as JSON at the end.
    #[arg(long, value_name = "FILE.json")]
    report: Option<PathBuf>,
    /// Adds a number of each tick to --report: an output with a scalar or a table, a column of a table, or a number that
    /// a node reports; `*` for all outputs with numbers. Repeatable.
    #[arg(long, value_name = "NODE.OUTPUT[.COLUMN]|NODE.NUMBER", requires = "report")]
    measure: Vec<String>,
    /// Writes at the end what each thread did and when, for the viewer at ui.perfetto.dev: the newest million calls,
    /// with their ticks and bytes.
    #[arg(long, value_name = "FILE.json")]
    trace: Option<PathBuf>,
    /// Appends faults as JSON lines: time, node, cause, response.
    #[arg(long, value_name = "FILE")]
    fault_log: Option<PathBuf>,
    /// Also shows debug lines of nodes.
    #[arg(long, short)]
    verbose: bool,
    /// Format of lines on standard error; `json` writes one object per line: time, level, node (empty for the command
    /// itself), message.
    #[arg(long, value_name = "FORMAT", default_value = "text")]
    log_format: LogFormat,
    /// Serves a page with images, ages and states, and metrics for Prometheus at /metrics, for reading only: a port of
    /// this machine such as 9464, or IP:PORT. Anyone who can reach the address sees the images; there is no password.
    #[arg(long, value_name = "PORT|IP:PORT")]
    web: Option<Address>,
    /// Serves outputs and parameters to Foxglove over a WebSocket: a port of this machine such as 8765, or IP:PORT.
    /// Anyone who can reach the address sees the images; there is no password.
    #[arg(long, value_name = "PORT|IP:PORT")]
    foxglove: Option<Address>,
    /// Lets clients of --foxglove set numbers, switches and choices: those that `[preset]` pins or, without pins, those
    /// of all nodes without side effects.
    #[arg(long, requires = "foxglove")]
    foxglove_set: bool,
    #[command(flatten)]
    windows: windows::Arguments,
}

impl Arguments {
    /// Number of ticks after which each source ends.
    fn last_frame(&self) -> Option<u64> {
        self.frames.or(self.max_frames)
    }

    /// Address for clients of Foxglove, and whether they may set parameters.
    pub fn foxglove(&self) -> Option<(Address, bool)> {
        self.foxglove.map(|address| (address, self.foxglove_set))
    }
}

/// Serves a running graph to other programs.
pub trait Server {
    /// Starts to listen, before the graph of this name runs.
    ///
    /// # Errors
    /// The address cannot be used.
    fn start(&mut self, graph: &str) -> Result<()>;
    /// Passes on what is new; called ten times a second.
    fn update(&mut self, live: &mut Live);
}

/// Runs a graph to its end, with a server for `--foxglove`.
pub fn run(arguments: &Arguments, server: Option<Box<dyn Server>>) -> Result<End> {
    Ok(match run_with(arguments, None, server, |_| {})? {
        RunEnd::Not(end) => end,
        RunEnd::Over { verdict, .. } => conclude(&verdict),
    })
}

/// Result of a run.
pub enum RunEnd {
    /// It did not begin; the reason has been reported.
    Not(End),
    /// It has ended; [`conclude`] prints the verdict.
    Over {
        /// Verdict on the run.
        verdict: Verdict,
        /// Result of its recording.
        recorded: Option<Box<Recorded>>,
    },
}

/// A graph that does not run as requested.
#[derive(Debug, thiserror::Error)]
enum OpenError {
    /// Its mistakes, rendered for the terminal.
    #[error("{rendered}")]
    Graph { rendered: String },
    #[error(
        "error: --isolate-plugins cannot be used with --watch or --lock: a changed file may name other plugins, and a lock names its own"
    )]
    Isolated,
    #[error("error: {0}")]
    Lock(#[from] LockError),
    #[error(
        "error: --set {setting}: the graph runs under its lock, and its [preset] does not offer that value\n  help: leave --lock out, or \
         change the graph and lock it again with `panoscope lock`"
    )]
    NotOffered { setting: String },
    #[error("error: {0}\n  help: restore the files, or lock the graph again with `panoscope lock`")]
    Verify(VerifyError),
}

/// Reads and checks the graph, under its lock if requested.
fn open(arguments: &Arguments, given: &GraphOptions) -> Result<Result<Ready, OpenError>> {
    if arguments.isolated.is_on() && (arguments.watch || arguments.lock) {
        return Ok(Err(OpenError::Isolated));
    }
    let path = &arguments.graph;
    let rendered = |found: Diagnostics| OpenError::Graph { rendered: found.render(stderr_color()) };
    let text = match GraphText::load_with(path, given) {
        Ok(text) => text,
        Err(diagnostics) => return Ok(Err(rendered(diagnostics))),
    };
    if !arguments.lock {
        let loader = arguments.isolated.loader(&text.plugin_paths());
        return Ok(arguments.isolated.ready(&text, loader).map_err(rendered));
    }
    let never = || LockError::Never { graph: path.clone(), file: lock_path(path) };
    let lock = Lock::read(path).and_then(|lock| lock.ok_or_else(never));
    let trust = arguments.keys.trusted()?;
    let lock = match lock.and_then(|lock| lock.check_signature(path, &trust).map(|_| lock)) {
        Ok(lock) => lock,
        Err(error) => return Ok(Err(error.into())),
    };
    Ok(match verify::open(&text, &lock, &ALWAYS_LOCKED) {
        Ok(ready) => match text.settings().into_iter().find(|setting| !is_offered(&ready, setting)) {
            Some(setting) => Err(OpenError::NotOffered { setting }),
            None => Ok(ready),
        },
        Err(VerifyError::Check(diagnostics)) => Err(rendered(diagnostics)),
        Err(error) => Err(OpenError::Verify(error)),
    })
}

/// Whether the preset of a checked graph pins the parameter of `node.param=value` with a range that has its value.
fn is_offered(Ready { graph, catalog, .. }: &Ready, setting: &str) -> bool {
    let target = setting.split_once('=').map_or(setting, |(target, _)| target).trim();
    graph.preset.pinned.iter().any(|pin| {
        let node = &graph.nodes[pin.node];
        let number = match node.params[pin.param] {
            ParamValue::Int(value) => Some(value as f64),
            ParamValue::Float(value) => Some(value),
            _ => None,
        };
        let is_inside = number.zip(pin.range).is_none_or(|(number, (low, high))| (low..=high).contains(&number));
        format!("{}.{}", node.id, node.node_type(catalog).params[pin.param].name) == target && is_inside
    })
}

/// A graph that runs.
pub struct Running {
    /// Its engine and its text.
    pub live: Live,
    /// Nodes whose faults do not fail the run, because the command causes them.
    pub expected_faults: BTreeSet<String>,
}

/// Reads and checks the graph, see [`open`]. Prints its mistakes and warnings; `None` if it cannot run.
fn open_and_report(arguments: &Arguments, given: &GraphOptions) -> Result<Option<Ready>> {
    let ready = match open(arguments, given)? {
        Ok(ready) => ready,
        Err(error) => {
            log!("{}", error.to_string().trim_end());
            return Ok(None);
        }
    };
    if !ready.warnings.is_empty() {
        log!("{}", ready.warnings.render(stderr_color()).trim_end());
    }
    if let Some(notice) = installed::notice(&arguments.graph) {
        log!("note: {notice}");
    }
    Ok(Some(ready))
}

/// What serves a running graph to other programs.
struct Outlets {
    monitor: Option<Monitor>,
    server: Option<Box<dyn Server>>,
    windows: Option<Attachable>,
}

impl Outlets {
    /// Listens at the requested addresses, before the graph of this name runs. `None` if one cannot be used; the reason has been reported.
    fn start(arguments: &Arguments, mut server: Option<Box<dyn Server>>, graph: &str) -> Option<Self> {
        fn reported<T>(result: Result<T, impl std::fmt::Display>) -> Option<T> {
            result.inspect_err(|error| log!("error: {error}")).ok()
        }
        let monitor = match arguments.web {
            Some(address) => Some(reported(Monitor::start(address))?),
            None => None,
        };
        if let Some((address, monitor)) = arguments.web.zip(monitor.as_ref()) {
            log!("serves http://{}", monitor.address());
            if address.is_public() {
                log!("warning: other machines can reach this address; whoever does sees the pictures");
            }
        }
        if let Some(server) = &mut server {
            reported(server.start(graph))?;
        }
        let windows = reported(arguments.windows.start())?;
        Some(Self { monitor, server, windows })
    }
}

/// Options of the engine, without those that observe or trace the run.
fn engine_options(arguments: &Arguments, progress: &Progress, numbers: &TickNumbers) -> Result<Options> {
    let faults = match &arguments.fault_log {
        Some(path) => Some(json_lines(path).with_context(|| format!("cannot write {}", path.display()))?),
        None => None,
    };
    Ok(Options {
        threads: arguments.threads.map_or(0, usize::from),
        frames: arguments.last_frame(),
        paced: !arguments.unpaced,
        log: Some(log_lines::sink(arguments.verbose, arguments.log_format, stderr_color(), progress.line_writer())),
        process_allocations: allocations::process(),
        thread_allocations: allocations::thread(),
        faults,
        listen: numbers.listeners(),
        numbers: numbers.number_listeners(),
        ..Options::default()
    })
}

/// Runs a graph to its end, optionally recorded, and updates observers ten times a second. Without a server,
/// `--foxglove` is left to the program that has one.
pub fn run_with(
    arguments: &Arguments,
    record: Option<RecordOptions>,
    server: Option<Box<dyn Server>>,
    look: impl FnMut(&mut Running),
) -> Result<RunEnd> {
    if arguments.foxglove.is_some() && server.is_none() {
        return beside::lab().map(RunEnd::Not);
    }
    let on_duty = signals::opening();
    let is_json = arguments.log_format == LogFormat::Json;
    if is_json {
        terminal::write_json_lines();
    }
    let given = arguments.given.options(&arguments.set);
    let Some(ready) = open_and_report(arguments, &given)? else { return Ok(RunEnd::Not(End::Wrong)) };
    let Some(mut outlets) = Outlets::start(arguments, server, &ready.graph.name) else {
        return Ok(RunEnd::Not(End::Failed));
    };
    let mut progress = Progress::new(&ready.graph.name, arguments.last_frame(), !arguments.headless && !is_json);
    let numbers = match TickNumbers::new(&arguments.measure, &ready.text, &ready.graph, &ready.catalog) {
        Ok(numbers) => numbers,
        Err(error) => {
            log!("error: {error}");
            return Ok(RunEnd::Not(End::Wrong));
        }
    };
    let options = engine_options(arguments, &progress, &numbers)?;
    let recorder = record.map(|options| Recorder::start(options, head(&ready))).transpose()?;
    let timeline = arguments.trace.is_some().then(|| Arc::new(Timeline::default()));
    let options = Options {
        observer: recorder.clone().map(|recorder| recorder as _),
        tracer: timeline.clone().map(|timeline| timeline as _),
        ..options
    };
    let files = arguments.watch.then(|| {
        let files = ready.text.files().into_iter().skip(1).map(|f| PathBuf::from(f.path));
        FileWatch::new(&arguments.graph, &ready.loader).with_files(files)
    });
    let live = match ready.start(options) {
        Ok(live) => live,
        Err(RunError::NotLocked(error)) => return Err(error.into()),
        Err(error) => {
            progress.finish();
            log!("error: {}", readable(&error.to_string()));
            out!("failed: the graph did not start");
            return Ok(RunEnd::Not(End::Failed));
        }
    };
    let on_duty = on_duty.watching();
    allocations::exclude_this_thread();
    let engine = Arc::clone(live.engine());
    let running = Running { live, expected_faults: BTreeSet::new() };
    let expected_faults =
        attend(&engine, running, &mut outlets, files.map(|files| (files, &given)), &mut progress, look);
    let mut verdict = close(&engine, on_duty, arguments.frames, &progress, &expected_faults);
    if let Some(path) = &arguments.report {
        let ticks = (!arguments.measure.is_empty()).then(|| numbers.table());
        report_into(path, &Reported { report: &engine.report(), ticks }, &mut verdict);
    }
    if let Some((path, timeline)) = arguments.trace.as_ref().zip(timeline)
        && let Err(error) = timeline::write(&timeline, path)
    {
        verdict.add(Weight::Error, format!("cannot write {}: {error}", path.display()));
    }
    Ok(RunEnd::Over { verdict, recorded: recorder.map(|r| Box::new(r.finish())) })
}

/// Updates everything that observes the run, and applies changed files, until the run ends; then only the monitor goes on. Returns the nodes
/// whose faults do not fail the run.
fn attend(
    engine: &Engine,
    mut running: Running,
    outlets: &mut Outlets,
    mut files: Option<(FileWatch, &GraphOptions)>,
    progress: &mut Progress,
    mut look: impl FnMut(&mut Running),
) -> BTreeSet<String> {
    let Outlets { monitor, server, windows } = &mut *outlets;
    let during = || {
        look(&mut running);
        if let Some(monitor) = monitor {
            monitor.update(engine, |graph| running.live.loader().catalog_of_graph(graph));
        }
        if let Some(server) = server.as_mut() {
            server.update(&mut running.live);
        }
        if let Some(windows) = windows.as_ref() {
            windows.update(&mut running.live).iter().for_each(|line| log!("{line}"));
        }
        if let Some((files, given)) = &mut files {
            apply_changes(files, &mut running.live, given);
        }
    };
    windows::beside(windows.as_ref(), engine, || watch(engine, progress, during));
    (outlets.server, outlets.windows) = (None, None);
    running.expected_faults
}

/// Closes a finished or cancelled run, shows its summary and evaluates it. Faults of the nodes in `expected_faults` do
/// not fail it.
pub fn close(
    engine: &Engine,
    on_duty: signals::OnDuty,
    frames: Option<u64>,
    progress: &Progress,
    expected_faults: &BTreeSet<String>,
) -> Verdict {
    let stopped_by = signals::asked();
    // Held until the process leaves: a signal that comes now finds the end being made.
    std::mem::forget(on_duty.finishing());
    let outcome = engine.close(PATIENCE);
    let (graph, report, faults) = (engine.graph(), engine.report(), engine.recent_faults());
    progress.finish();
    raw(&summary::text(&graph, &report));
    let bypassed = graph.nodes.iter().filter(|n| n.on_fault == OnFault::Bypass).map(|n| n.id.as_str());
    let bypassed = bypassed.chain(expected_faults.iter().map(String::as_str)).collect();
    let stopped_by = stopped_by.map(|signal| signal.to_string());
    judge(&Facts { report: &report, faults: &faults, outcome: &outcome, bypassed, frames, stopped_by })
}

/// Prints the verdict: the findings and the last line.
pub fn conclude(verdict: &Verdict) -> End {
    for finding in &verdict.findings {
        match finding.weight {
            Weight::Error => log!("error: {}", finding.words),
            Weight::Warning => log!("warning: {}", finding.words),
        }
    }
    out!("{}", verdict.last_line());
    verdict.end()
}

/// A stopped run did not end within [`PATIENCE`].
struct OutOfPatience;

/// Shows progress until the end of the run, or until [`PATIENCE`] with a stopped one is over.
pub fn watch(engine: &Engine, progress: &mut Progress, mut look: impl FnMut()) {
    let mut stopped: Option<Instant> = None;
    // Closing the engine names the nodes that do not return.
    let _ = engine.watch(Duration::from_millis(100), |engine| {
        progress.update(&engine.report());
        match stopped {
            Some(since) if since.elapsed() > PATIENCE => return Err(OutOfPatience),
            Some(_) => {}
            None => {
                look();
                if interrupt::asked() {
                    engine.stop();
                    stopped = Some(Instant::now());
                }
            }
        }
        Ok(())
    });
}

/// Applies the changed files to the running graph, or reports why not.
fn apply_changes(files: &mut FileWatch, live: &mut Live, given: &GraphOptions) {
    let changed = files.poll();
    let mut results = Vec::new();
    if changed.plugins {
        results.push(live.reload_plugins());
    }
    if changed.graph {
        match GraphText::load_with(files.path(), given) {
            Ok(text) => {
                let applied = live.apply(&text);
                // A part that cannot be read now may come back.
                let parts = text.files().into_iter().skip(1).map(|f| PathBuf::from(f.path)).collect::<Vec<_>>();
                files.set_files(parts.into_iter(), applied.is_err());
                results.push(applied);
            }
            Err(diagnostics) => log!("{}\nthe old graph keeps running", diagnostics.render(stderr_color()).trim_end()),
        }
    }
    for result in results {
        match result {
            Ok(applied) if applied.is_nothing() => {}
            Ok(applied) => log!("changed: {applied}"),
            Err(error) => log!("error: {error}"),
        }
    }
}

/// The contents of a report.
#[derive(Serialize)]
pub struct Reported<'r> {
    /// Counters and times.
    #[serde(flatten)]
    pub report: &'r Report,
    /// Numbers of `--measure`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ticks: Option<TickTable>,
}

/// Writes the report; a failure to write is reported without hiding the result of the run.
pub fn report_into(path: &Path, report: &Reported, verdict: &mut Verdict) {
    if let Err(error) = write_report(path, report) {
        verdict.add(Weight::Error, format!("{error:#}"));
    }
}

/// Writes the report atomically, so that no reader sees a partial file.
fn write_report(path: &Path, report: &Reported) -> Result<()> {
    // A line for each number of each tick would triple the file.
    let text =
        if report.ticks.is_some() { serde_json::to_string(report)? } else { serde_json::to_string_pretty(report)? };
    let text = text + "\n";
    if let Some(folder) = path.parent().filter(|p| !p.as_os_str().is_empty()) {
        fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    }
    files::replace(path, text.as_bytes()).with_context(|| format!("cannot write {}", path.display()))
}
