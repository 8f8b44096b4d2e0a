//! `panoscope replay`: replays a recording to the byte, or runs another graph on its frames.

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::Arc;

use anyhow::Result;
use panoscope_engine::Options;
use panoscope_engine::ending::signals;
use panoscope_graph::GraphText;
use panoscope_record::{RecordOptions, Recording, Replay, ReplayError, ReplayOptions};

use super::record::{Ports, told, write_digests};
use super::run;
use crate::End;
use crate::given::Given;
use crate::judge::Weight;
use crate::log_lines::{self, LogFormat};
use crate::progress::Progress;
use crate::terminal::{log, out, stderr_color};
use crate::trust::OwnPlugins;

/// Arguments of `replay`.
#[derive(clap::Args)]
pub struct Arguments {
    /// A recording of `panoscope record`.
    recording: PathBuf,
    /// Runs this graph on the recorded frames instead of the recorded graph. Then no tick is dropped.
    #[arg(long, value_name = "GRAPH")]
    graph: Option<PathBuf>,
    #[command(flatten)]
    given: Given,
    #[command(flatten)]
    own_plugins: OwnPlugins,
    /// Sets a parameter; overrides the graph and recorded changes; repeatable.
    #[arg(long, value_name = "NODE.PARAM=VALUE")]
    set: Vec<String>,
    /// Ticks of each source to play; default: all.
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..))]
    frames: Option<u64>,
    /// Threads of the pool; default: one per core.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Runs nodes that write files or move things; by default they are skipped.
    #[arg(long)]
    act: bool,
    /// Records the replay.
    #[arg(long, short, value_name = "FILE.mcap")]
    output: Option<PathBuf>,
    #[command(flatten)]
    ports: Ports,
    /// Neither windows nor a progress bar.
    #[arg(long)]
    headless: bool,
    /// Writes counters and times as JSON at the end.
    #[arg(long, value_name = "FILE.json")]
    report: Option<PathBuf>,
    /// Also shows debug lines of nodes.
    #[arg(long, short)]
    verbose: bool,
}

/// The mistake in the arguments, if there is one.
fn mistake(arguments: &Arguments) -> Option<String> {
    if arguments.ports.all_ports && arguments.output.is_none() {
        return Some("--all-ports says what the recording of the replay holds: name one with -o FILE.mcap".to_owned());
    }
    let same = |a: &PathBuf, b: &PathBuf| a.canonicalize().is_ok_and(|a| b.canonicalize().is_ok_and(|b| a == b));
    let is_played = arguments.output.as_ref().is_some_and(|out| same(out, &arguments.recording));
    let recording = arguments.recording.display();
    is_played.then(|| format!("-o {recording} is the recording that is played; name another file"))
}

/// Options of the replay; `graph` replaces the recorded one.
fn options(
    arguments: &Arguments,
    graph: Option<(PathBuf, String)>,
    settings: Vec<String>,
    recording: &Recording,
    progress: &Progress,
) -> ReplayOptions {
    let own_folders = match &graph {
        Some((path, text)) => GraphText::parse(path, text).plugin_paths(),
        None => panoscope_record::own_folders(&recording.head),
    };
    let loader = arguments.own_plugins.loader(&own_folders);
    ReplayOptions {
        graph,
        settings,
        act: arguments.act,
        loader: Some(Arc::new(loader)),
        record: (arguments.output.is_some() || arguments.ports.digests.is_some()).then(|| RecordOptions {
            file: arguments.output.clone(),
            digests: arguments.ports.digests.is_some(),
            all_ports: arguments.ports.all_ports,
            all_source_ports: false,
            // The replay waits for nobody: no packet may be missing.
            max_queued_bytes: usize::MAX,
            ..RecordOptions::default()
        }),
        engine: Options {
            threads: arguments.threads.map_or(0, usize::from),
            frames: arguments.frames,
            log: Some(log_lines::sink(arguments.verbose, LogFormat::Text, stderr_color(), progress.line_writer())),
            ..Options::default()
        },
    }
}

/// Reports why a replay did not start.
fn not_started(error: &ReplayError) -> End {
    match error {
        ReplayError::Check(diagnostics) => {
            log!("{}", diagnostics.render(stderr_color()).trim_end());
            End::Wrong
        }
        ReplayError::Start(_) => {
            log!("error: {error}");
            out!("failed: the graph did not start");
            End::Failed
        }
        _ => {
            log!("error: {error}");
            End::Wrong
        }
    }
}

/// Plays a recording.
pub fn run(arguments: &Arguments) -> Result<End> {
    if let Some(mistake) = mistake(arguments) {
        log!("error: {mistake}");
        return Ok(End::Wrong);
    }
    let on_duty = signals::opening();
    let recording = match Recording::open(&arguments.recording) {
        Ok(recording) => Arc::new(recording),
        Err(error) => {
            log!("error: {error}");
            return Ok(End::Wrong);
        }
    };
    let mut settings = arguments.set.clone();
    let graph = match &arguments.graph {
        Some(path) => match arguments.own_plugins.open(path, &arguments.given.options(&arguments.set)) {
            Ok(ready) => {
                settings = ready.text.settings();
                Some((path.clone(), ready.text.flattened(&ready.catalog).into_owned()))
            }
            Err(diagnostics) => {
                log!("{}", diagnostics.render(stderr_color()).trim_end());
                return Ok(End::Wrong);
            }
        },
        None if arguments.given.is_empty() => None,
        None => {
            log!(
                "error: --with and arguments belong to a graph: name one with --graph, or change the recorded one with --set"
            );
            return Ok(End::Wrong);
        }
    };
    let longest = recording.sources.values().map(Vec::len).max().unwrap_or(0) as u64;
    let wanted = arguments.frames.map_or(longest, |n| n.min(longest));
    let name = arguments.recording.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let mut progress = Progress::new(&name, Some(wanted), !arguments.headless);
    let options = options(arguments, graph, settings, &recording, &progress);
    let replay = match Replay::start(&recording, options) {
        Ok(replay) => replay,
        Err(error) => {
            progress.finish();
            return Ok(not_started(&error));
        }
    };
    let on_duty = on_duty.watching();
    for warning in &replay.warnings {
        log!("note: {warning}");
    }
    let engine = replay.engine();
    let followed = std::thread::scope(|scope| {
        let follows = scope.spawn(|| replay.follow());
        run::watch(engine, &mut progress, || {});
        engine.stop();
        follows.join()
    });
    let mut verdict = run::close(engine, on_duty, None, &progress, &BTreeSet::new());
    let followed = if let Ok(Err(error)) = followed { Some(error) } else { None };
    for error in followed.into_iter().chain(replay.verdict().err()) {
        let words = error.to_string();
        if !verdict.findings.iter().any(|finding| finding.words == words) {
            verdict.add(Weight::Error, words);
        }
    }
    if let Some(path) = &arguments.report {
        run::report_into(path, &run::Reported { report: &engine.report(), ticks: None }, &mut verdict);
    }
    if let Some(recorder) = replay.recorder() {
        let recorded = recorder.finish();
        match &arguments.output {
            Some(file) => told(&recorded, file, &arguments.ports, &mut verdict),
            None => write_digests(&recorded, &arguments.ports, &mut verdict),
        }
    }
    Ok(run::conclude(&verdict))
}
