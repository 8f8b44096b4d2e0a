//! Runs a graph given as text, and reads packets of its outputs.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use panoscope_engine::memory::FrameRef;
use panoscope_engine::trace::Tracer;
use panoscope_engine::{Engine, Listener, NumberListener, Options, Outcome, Preview, Report};
use panoscope_graph::{GraphOptions, GraphText};
use panoscope_host::loader::graph_file::{self, Ready};

use crate::embedded;
use crate::error::{Context, EvalError, Result};
use crate::session::{Session, check_cancelled};

/// Maximum wait for nodes to close.
const CLOSE_LIMIT: Duration = Duration::from_secs(10);

/// Options of a run.
pub struct Plan<'a> {
    /// The graph as TOML text; its parts may be embedded files.
    pub text: &'a str,
    /// Path of the graph in messages; relative paths start from its folder.
    pub path: &'a Path,
    /// Ticks of each source; default: until each port has had a packet.
    pub frames: Option<u64>,
    /// Threads of the pool; 0: one per core.
    pub threads: usize,
    /// Nodes and outputs whose newest packets are returned.
    pub ports: &'a [(&'a str, &'a str)],
    /// When ticks begin.
    pub pace: Pace,
}

/// When a tick begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// At the capture time of its frame.
    Camera,
    /// As soon as the graph takes it; ticks overlap.
    Free,
    /// When the one before it has ended, so that nothing else runs while a node is timed.
    Alone,
}

impl Default for Plan<'_> {
    fn default() -> Self {
        Self { text: "", path: Path::new("eval.toml"), frames: None, threads: 0, ports: &[], pace: Pace::Free }
    }
}

/// Results of a run.
pub struct RunOutput {
    /// The newest packet of each requested port; `None` if there was none.
    pub packets: Vec<Option<FrameRef>>,
    /// Counters of the engine.
    pub report: Report,
    /// The newest log lines: node and text.
    pub log: Vec<(String, String)>,
}

/// Text of a checked graph with parts replaced by their nodes, and with overlays, settings and arguments applied.
///
/// # Errors
/// The graph has mistakes.
pub fn flattened(path: &Path, options: &GraphOptions) -> Result<String> {
    let ready = graph_file::open(path, options).map_err(|diagnostics| EvalError::Check { diagnostics })?;
    ready.text.settled(&ready.catalog).context("the settings")
}

/// Loads the plugins of a graph that an evaluation made and checks it.
///
/// # Errors
/// The graph has mistakes.
pub(crate) fn ready(text: &GraphText) -> Result<Ready> {
    graph_file::ready(text).map_err(|d| EvalError::Graph { diagnostics: d.render(false).trim_end().to_owned() })
}

/// Closes a graph and returns its counters.
///
/// # Errors
/// The run failed.
pub(crate) fn close(engine: &Engine) -> Result<Report> {
    match engine.close(CLOSE_LIMIT) {
        Outcome::Done => Ok(engine.report()),
        Outcome::Failed(reason) => Err(EvalError::Run { reason }),
    }
}

/// The first node all of whose calls failed, with its last message in the log.
pub(crate) fn failed_node(engine: &Engine, report: &Report) -> Option<(String, String)> {
    let (node, _) = report.nodes.iter().find(|(_, n)| n.faults > 0 && n.faults >= n.count)?;
    let last = engine.recent_log().into_iter().rev().find(|(_, id, _)| id == node);
    Some((node.clone(), last.map_or_else(String::new, |(_, _, text)| text)))
}

/// Runs the graph to its end; without a number of frames until each port has had a packet.
pub fn run(session: &dyn Session, plan: &Plan<'_>) -> Result<RunOutput> {
    run_watched(session, plan, Watchers::default())
}

/// Watchers of a run.
#[derive(Default)]
pub struct Watchers {
    /// Listeners for all packets of ports.
    pub listen: Vec<Listener>,
    /// Listeners for the metrics of nodes.
    pub numbers: Vec<NumberListener>,
    /// Receives all calls and their times.
    pub tracer: Option<Arc<dyn Tracer>>,
}

/// As [`run`], with watchers.
pub fn run_watched(session: &dyn Session, plan: &Plan<'_>, watchers: Watchers) -> Result<RunOutput> {
    check_cancelled(session)?;
    let ready = ready(&GraphText::parse_with(plan.path, plan.text, &embedded::options()))?;
    let counters = session.allocation_counters();
    let options = Options {
        threads: plan.threads,
        frames: plan.frames,
        paced: plan.pace == Pace::Camera,
        ticks_at_once: (plan.pace == Pace::Alone).then_some(1),
        listen: watchers.listen,
        numbers: watchers.numbers,
        tracer: watchers.tracer,
        process_allocations: counters.process,
        thread_allocations: counters.thread,
        ..Options::default()
    };
    let live = ready.start(options)?;
    let engine = live.engine();
    let previews: Vec<Preview> = plan
        .ports
        .iter()
        .map(|&(node, port)| {
            let missing = || EvalError::Output { node: node.to_owned(), port: port.to_owned() };
            engine.preview(node, port).ok_or_else(missing)
        })
        .collect::<Result<_>>()?;
    let mut packets: Vec<Option<FrameRef>> = plan.ports.iter().map(|_| None).collect();
    let mut take_newest = || {
        for (packet, preview) in packets.iter_mut().zip(&previews) {
            if let Some(newer) = preview.take() {
                *packet = Some(newer);
            }
        }
        packets.iter().all(Option::is_some)
    };
    let mut complete = false;
    engine.watch(Duration::from_millis(10), |engine| {
        if !complete && take_newest() && plan.frames.is_none() {
            complete = true;
            engine.stop();
        }
        check_cancelled(session)
    })?;
    if !complete {
        take_newest();
    }
    let report = close(engine)?;
    if let Some((node, reason)) = failed_node(engine, &report) {
        return Err(EvalError::Node { node, reason });
    }
    let log = engine.recent_log().into_iter().map(|(_, node, text)| (node, text)).collect();
    Ok(RunOutput { packets, report, log })
}
