//! A graph or a recording that runs.

use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use panoscope_engine::fault::Fault;
use panoscope_engine::inbox::{Heard, Inbox};
use panoscope_engine::log::{Level, LogFn};
use panoscope_engine::sync::lock;
use panoscope_engine::{Engine, Outcome};
use panoscope_graph::GraphText;
use panoscope_host::loader::Live;
use panoscope_record::{Recorded, Recorder, Replay, ReplayError, ReplayOptions};
use pyo3::prelude::*;
use serde_json::json;

use super::error::Problem;
use super::recording::RecordingFile;
use super::values::{to_toml, value_of};
use super::watched::{TickParts, Watched};
use crate::view::View;

/// Time between two checks for the end of a run.
const STEP: Duration = Duration::from_millis(5);
/// Maximum number of log lines that wait for Python; later ones are dropped.
const MAX_LINES: usize = 1000;

/// A line of the log: level, node, message.
type Line = (Level, String, String);

/// Log lines on their way to Python.
#[derive(Clone, Default)]
pub struct Lines(Arc<Mutex<Vec<Line>>>);

impl Lines {
    /// Function that the engine calls with each line.
    pub fn sink(&self) -> Box<LogFn> {
        let lines = Arc::clone(&self.0);
        Box::new(move |level, node, words| {
            let mut lines = lock(&lines);
            if lines.len() < MAX_LINES {
                lines.push((level, node.to_owned(), words.to_owned()));
            }
        })
    }

    fn take(&self) -> Vec<Line> {
        std::mem::take(&mut lock(&self.0))
    }
}

/// A running graph and its text.
type LiveGraph = Mutex<Live>;

/// A run.
pub enum Run {
    /// A graph.
    Graph {
        engine: Arc<Engine>,
        live: Box<LiveGraph>,
        /// Resolves parameters of parts.
        parts: Box<GraphText>,
    },
    /// A recording.
    Replay {
        replay: Arc<Replay>,
        /// Applies the recorded changes.
        follows: Mutex<Option<JoinHandle<Result<(), ReplayError>>>>,
    },
}

impl Run {
    /// Starts to play a recording.
    pub fn replay(recording: &RecordingFile, options: ReplayOptions) -> Result<Self, Problem> {
        let replay = Arc::new(Replay::start(recording.recording(), options)?);
        let following = Arc::clone(&replay);
        let follows = std::thread::Builder::new().name("replay".to_owned()).spawn(move || following.follow());
        let follows = follows.map_err(|error| Problem::Run(format!("no thread could be started: {error}")))?;
        Ok(Self::Replay { replay, follows: Mutex::new(Some(follows)) })
    }

    /// Recorder of the run.
    pub fn recorder(&self) -> Option<Arc<Recorder>> {
        match self {
            Self::Graph { .. } => None,
            Self::Replay { replay, .. } => replay.recorder().cloned(),
        }
    }

    fn engine(&self) -> &Engine {
        match self {
            Self::Graph { engine, .. } => engine,
            Self::Replay { replay, .. } => replay.engine(),
        }
    }

    fn live(&self) -> Result<(&LiveGraph, &GraphText), Problem> {
        match self {
            Self::Graph { live, parts, .. } => Ok((live, parts)),
            Self::Replay { .. } => Err(Problem::Edit("a replay applies only the changes of the recording".to_owned())),
        }
    }

    /// Reason for which a replay was incomplete.
    fn incomplete(&self) -> Option<String> {
        let Self::Replay { replay, follows } = self else { return None };
        let followed = lock(follows).take().map(JoinHandle::join);
        match followed {
            Some(Ok(Err(error))) => Some(error.to_string()),
            _ => replay.verdict().err().map(|error| error.to_string()),
        }
    }
}

/// A running graph, ended by [`Running::close`].
#[pyclass(frozen, module = "panoscope._native")]
pub struct Running {
    run: Run,
    inbox: Arc<Inbox>,
    lines: Lines,
    watched: Vec<Watched>,
    recorder: Option<Arc<Recorder>>,
    /// Result of closing, as JSON.
    closed: Mutex<Option<String>>,
}

/// Output, view, tick, age in ms.
type Packet = (u32, View, TickParts, f64);

impl Running {
    /// A run whose packets arrive in `inbox`.
    pub fn new(
        run: Run,
        inbox: Arc<Inbox>,
        lines: Lines,
        watched: Vec<Watched>,
        recorder: Option<Arc<Recorder>>,
    ) -> Self {
        Self { run, inbox, lines, watched, recorder, closed: Mutex::default() }
    }

    /// A copy of a packet, so that the graph's memory is released at once.
    fn packet(&self, heard: Heard) -> Packet {
        let Heard { port, frame, made_ns } = heard;
        let tick = frame.tick();
        let arrived_ns = self.run.engine().arrived_ns(&tick);
        let age_ms = arrived_ns.map_or(f64::NAN, |arrived| (made_ns as i64).saturating_sub(arrived) as f64 / 1e6);
        let view = View::own(frame.frame(), frame.bytes().to_vec());
        (port, view, (tick.source, tick.seq, tick.capture_ns), age_ms)
    }

    fn wait(&self, most: Duration) -> Option<Vec<Packet>> {
        let until = Instant::now() + most;
        loop {
            // Before the queue is read: what was made until then is in it.
            let is_finished = self.run.engine().is_finished();
            let step = if is_finished { Duration::ZERO } else { STEP };
            let heard = self.inbox.take(step);
            if !heard.is_empty() {
                return Some(heard.into_iter().map(|heard| self.packet(heard)).collect());
            }
            if is_finished {
                return None;
            }
            if Instant::now() >= until {
                return Some(Vec::new());
            }
        }
    }

    fn end(&self, patience: Duration) -> String {
        let mut closed = lock(&self.closed);
        if let Some(done) = &*closed {
            return done.clone();
        }
        self.inbox.close();
        let engine = self.run.engine();
        let outcome = engine.close(patience);
        let failed = match outcome {
            Outcome::Done => self.run.incomplete(),
            Outcome::Failed(reason) => Some(reason),
        };
        let recorded: Option<Recorded> = self.recorder.as_ref().map(|recorder| recorder.finish());
        let faults: Vec<Fault> = engine.recent_faults();
        let done = json!({
            "failed": failed,
            "faults": faults,
            "report": engine.report(),
            "dropped": self.inbox.dropped(),
            "recorded": recorded.map(|recorded| json!({
                "bytes": recorded.bytes, "ticks": recorded.ticks, "gaps": recorded.gaps, "failed": recorded.failed,
            })),
        });
        closed.insert(done.to_string()).clone()
    }

    fn get_value(&self, param: &str) -> Result<String, Problem> {
        let (live, parts) = self.run.live()?;
        let live = lock(live);
        let graph = live.engine().graph();
        // As the graph was checked: plugins that are loaded already are not loaded again.
        let catalog = live.loader().catalog_of_graph(&graph);
        value_of(&graph, &catalog, &parts.resolve_param(param)).map_err(|error| Problem::Edit(error.to_string()))
    }

    fn set_value(&self, param: &str, json: &str) -> Result<String, Problem> {
        let (live, parts) = self.run.live()?;
        let resolved = parts.resolve_param(param);
        let (node, name) =
            resolved.rsplit_once('.').ok_or_else(|| Problem::Edit(format!("`{param}` is not NODE.PARAM")))?;
        let value = to_toml(json).map_err(|why| Problem::Edit(format!("`{param}` cannot be {json}: {why}")))?;
        let applied = self.inbox.without_limit(|| lock(live).set_param(node, name, &value))?;
        Ok(applied.to_string())
    }
}

#[pymethods]
impl Running {
    /// The packets that were made since the last call; waits up to `most_s` for the first one. None when the run has
    /// ended and all were taken.
    fn poll(&self, py: Python<'_>, most_s: f64) -> Option<Vec<Packet>> {
        let most = Duration::try_from_secs_f64(most_s).unwrap_or(Duration::ZERO);
        py.detach(|| self.wait(most))
    }

    /// Log lines since the last call: level from 0 (error) to 3 (debug), node, message.
    fn log_lines(&self) -> Vec<(u8, String, String)> {
        self.lines.take().into_iter().map(|(level, node, words)| (level as u8, node, words)).collect()
    }

    /// Node, output and packet type of each watched output.
    fn watched(&self) -> Vec<(String, String, String)> {
        let of = |w: &Watched| (w.node.clone(), w.output.clone(), w.packet.clone());
        self.watched.iter().map(of).collect()
    }

    /// Asks the sources to end.
    fn stop(&self) {
        self.run.engine().stop();
    }

    /// Ends the run and completes its files; returns the result as JSON.
    fn close(&self, py: Python<'_>, patience_s: f64) -> String {
        let patience = Duration::try_from_secs_f64(patience_s).unwrap_or(Duration::ZERO);
        py.detach(|| self.end(patience))
    }

    /// Value of a parameter as JSON.
    fn get(&self, py: Python<'_>, param: &str) -> PyResult<String> {
        py.detach(|| self.get_value(param)).map_err(|problem| problem.raise(py))
    }

    /// Sets a parameter to a value in JSON, between two ticks; returns the changes.
    fn set(&self, py: Python<'_>, param: &str, json: &str) -> PyResult<String> {
        py.detach(|| self.set_value(param, json)).map_err(|problem| problem.raise(py))
    }

    /// Replaces the running graph by the one in this text; returns the changes.
    fn apply(&self, py: Python<'_>, text: &str) -> PyResult<String> {
        let apply = || {
            let (live, _) = self.run.live()?;
            let applied = self.inbox.without_limit(|| lock(live).apply_text(text))?;
            Ok(applied.to_string())
        };
        py.detach(apply).map_err(|problem: Problem| problem.raise(py))
    }

    /// Text of the running graph.
    fn text(&self, py: Python<'_>) -> PyResult<String> {
        let text = || Ok(lock(self.run.live()?.0).text().to_owned());
        py.detach(text).map_err(|problem: Problem| problem.raise(py))
    }

    /// Counters and times so far as JSON.
    fn report(&self, py: Python<'_>) -> String {
        py.detach(|| serde_json::to_string(&self.run.engine().report()).unwrap_or_default())
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // A node that waits for room would make the engine wait for it.
        self.inbox.close();
        self.run.engine().stop();
    }
}
