//! Checking a sweep and running it.

use std::convert::Infallible;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use panoscope_engine::sync::lock;
use panoscope_engine::{Engine, Listener, NumberListener, Options, Outcome};
use panoscope_graph::{GraphText, ParamKind, ParamValue, check};
use panoscope_loader::Loader;
use panoscope_record::{Recording, Replay, ReplayOptions};

use super::error::{PointError, SweepError};
use super::measure::{Measure, NoSummary, Received, Summary};
use super::values::shown;
use super::{part, values};

/// How long nodes may take to end.
const PATIENCE: Duration = Duration::from_secs(30);

/// What is swept.
#[derive(Clone, Debug)]
pub struct Request {
    /// The graph file.
    pub path: PathBuf,
    /// Its text.
    pub text: String,
    /// `node.param=value`, in force in all runs.
    pub settings: Vec<String>,
    /// `node.param`.
    pub param: String,
    /// First value; the parameter's smallest without it. Ignored for switches and choices, of which all values are taken.
    pub from: Option<f64>,
    /// Last value; the parameter's largest without it.
    pub to: Option<f64>,
    /// Number of values, both ends included.
    pub steps: usize,
    /// `node.port` of a scalar, `node.port.column` of a table (`column[2]` where it has several rows, `column[*]` for all), `node.metric`, or
    /// `node.` and one of [`COUNTERS`].
    pub measure: String,
    /// Most ticks of each source per value.
    pub frames: u64,
    /// Replaces the graph's sources.
    pub recording: Option<Arc<Recording>>,
    /// Threads of each run; 0 takes as many as the machine has.
    pub threads: usize,
}

/// Result of one value.
#[derive(Clone, Debug, PartialEq)]
pub struct Point {
    /// The value as a graph file writes it.
    pub value: String,
    /// The same as a number; the position for switches and choices.
    pub at: f64,
    /// What was measured, or why there is nothing.
    pub result: Result<Summary, PointError>,
}

/// A sweep that was checked and can be run.
pub struct Sweep {
    request: Request,
    loader: Arc<Loader>,
    /// The part of the graph that is run.
    text: String,
    values: Vec<(ParamValue, f64)>,
    measure: Measure,
    /// Unit of the parameter.
    unit: String,
    /// The values are words: switches or choices.
    words: bool,
}

impl Sweep {
    /// Checks graph, parameter and measure.
    ///
    /// # Errors
    /// See [`SweepError`]; nothing has run then.
    pub fn new(request: Request, loader: Arc<Loader>) -> Result<Self, SweepError> {
        let mut parsed = GraphText::parse(&request.path, &request.text);
        request.settings.iter().for_each(|setting| parsed.set(setting));
        let catalog = loader.catalog_of(&parsed);
        let (graph, _) = check(&parsed, &catalog).into_result().map_err(SweepError::Check)?;
        let bad_param = |reason: String| SweepError::Param { param: request.param.clone(), reason };
        let (id, name) = request
            .param
            .split_once('.')
            .ok_or_else(|| bad_param("write it as NODE.PARAMETER, such as match.block_px".to_owned()))?;
        let node = graph.node(id).ok_or_else(|| bad_param(part::no_node(&graph, id)))?;
        let node_type = graph.nodes[node].node_type(&catalog);
        let declared = node_type.param(name).map(|at| &node_type.params[at]).ok_or_else(|| {
            let names: Vec<&str> = node_type.params.iter().map(|p| p.name.as_str()).collect();
            bad_param(format!("`{id}` has no such parameter; it has {}", part::list(&names)))
        })?;
        if request.recording.is_some() && node_type.source {
            return Err(bad_param(format!("the recording stands in for source `{id}`: sweep another node")));
        }
        let values = values::of(&declared.kind, request.from, request.to, request.steps)
            .map_err(|error| bad_param(error.to_string()))?;
        let (measure, at) = Measure::of(&request.measure, &graph, &catalog)?;
        let kept = part::needed(&graph, at);
        if !kept[node] {
            return Err(bad_param(format!("nothing of `{id}` reaches `{}`: its value changes nothing there", measure)));
        }
        let acts = |n: &usize| kept[*n] && graph.nodes[*n].node_type(&catalog).side_effects;
        if let Some(acting) = (0..graph.nodes.len()).find(acts) {
            let (measure, node) = (request.measure.clone(), graph.nodes[acting].id.clone());
            return Err(SweepError::Acts { measure, node });
        }
        let text = part::text(&request.text, &graph, &kept).map_err(|error| bad_param(error.to_string()))?;
        let of_kept = |setting: &String| {
            let node = setting.split_once('.').and_then(|(node, _)| graph.node(node.trim()));
            node.is_some_and(|n| kept[n])
        };
        let unit = declared.unit.clone();
        let words = matches!(declared.kind, ParamKind::Bool { .. } | ParamKind::Choice { .. });
        let mut request = request;
        request.settings.retain(of_kept);
        Ok(Self { request, loader, text, values, measure, unit, words })
    }

    /// Number of values.
    pub fn len(&self) -> usize {
        self.values.len()
    }

    /// Whether there is nothing to run, which never happens.
    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    /// The parameter, `node.param`.
    pub fn param(&self) -> &str {
        &self.request.param
    }

    /// The measure as it was asked for.
    pub fn measure_text(&self) -> &str {
        &self.request.measure
    }

    /// What is measured.
    pub fn measure(&self) -> &Measure {
        &self.measure
    }

    /// Unit of the parameter; empty for none.
    pub fn unit(&self) -> &str {
        &self.unit
    }

    /// Whether the values are words, of switches and choices: their numbers are positions only.
    pub fn has_words(&self) -> bool {
        self.words
    }

    /// Runs all values; `each` gets the points one by one. Ends early once `cancelled` says so; it is asked often.
    ///
    /// # Errors
    /// There is no such column, row or number. That shows only while the first value runs, which ends then.
    pub fn run(&self, cancelled: &dyn Fn() -> bool, mut each: impl FnMut(Point)) -> Result<(), SweepError> {
        for (value, at) in &self.values {
            let value = shown(value);
            let result = match self.one(&value, cancelled) {
                _ if cancelled() => return Ok(()),
                Ok(summary) => Ok(summary),
                Err(NoSummary::Run(reason)) => Err(PointError { reason }),
                Err(NoSummary::Measure(reason)) => {
                    return Err(SweepError::Measure { measure: self.request.measure.clone(), reason });
                }
            };
            each(Point { value, at: *at, result });
        }
        Ok(())
    }

    /// One run to its end.
    fn one(&self, value: &str, cancelled: &dyn Fn() -> bool) -> Result<Summary, NoSummary> {
        let received = Arc::new(Mutex::new(Received::default()));
        let mut settings = self.request.settings.clone();
        settings.push(format!("{}={value}", self.request.param));
        let options = Options {
            threads: self.request.threads,
            frames: Some(self.request.frames),
            paced: false,
            graph_dir: self.request.path.parent().unwrap_or(Path::new("")).to_owned(),
            listen: self.listener(&received).into_iter().collect(),
            numbers: self.number_listener(&received),
            ..Options::default()
        };
        let wait = |engine: &Engine| {
            let Ok(()) = engine.watch(Duration::from_millis(50), |engine| {
                if cancelled() || self.measure.wrong(&lock(&received)).is_some() {
                    engine.stop();
                }
                Ok::<(), Infallible>(())
            });
            let outcome = engine.close(PATIENCE);
            (outcome, engine.report())
        };
        let (outcome, report) = match &self.request.recording {
            Some(recording) => {
                let replay_options = ReplayOptions {
                    graph: Some((self.request.path.clone(), self.text.clone())),
                    settings,
                    loader: Some(Arc::clone(&self.loader)),
                    engine: options,
                    ..ReplayOptions::default()
                };
                let replay = Replay::start(recording, replay_options).map_err(|e| NoSummary::Run(e.to_string()))?;
                let done = wait(replay.engine());
                replay.verdict().map_err(|e| NoSummary::Run(e.to_string()))?;
                done
            }
            None => {
                let mut parsed = GraphText::parse(&self.request.path, &self.text);
                settings.iter().for_each(|setting| parsed.set(setting));
                let catalog = self.loader.catalog_of(&parsed);
                let checked = check(&parsed, &catalog).into_result();
                let (graph, _) = checked.map_err(|d| NoSummary::Run(d.render(false)))?;
                let started = Engine::start(graph, &catalog, &self.loader, options);
                let engine = started.map_err(|error| NoSummary::Run(error.to_string()))?;
                wait(&engine)
            }
        };
        if let Outcome::Failed(reason) = outcome {
            return Err(NoSummary::Run(reason));
        }
        let received = lock(&received);
        self.measure.summary(&received, &report)
    }

    fn listener(&self, received: &Arc<Mutex<Received>>) -> Option<Listener> {
        let Measure::Port { node, port, packet, column, rows } = &self.measure else { return None };
        let (received, packet, column, rows) = (Arc::clone(received), packet.clone(), column.clone(), *rows);
        Some(Listener {
            node: node.clone(),
            output: port.clone(),
            hear: Arc::new(move |frame| lock(&received).take(frame.bytes(), &packet, column.as_deref(), rows)),
        })
    }
}

impl Sweep {
    fn number_listener(&self, received: &Arc<Mutex<Received>>) -> Option<NumberListener> {
        let Measure::Number { node, name } = &self.measure else { return None };
        let (received, name) = (Arc::clone(received), name.clone());
        let hear = move |tick: &panoscope_abi::Tick, reported: &str, value: f64| {
            if reported == name {
                lock(&received).take_number((tick.source, tick.seq), value);
            }
        };
        Some(NumberListener { node: node.clone(), hear: Arc::new(hear) })
    }
}

/// Whether values of that kind can be swept.
pub fn can_sweep(kind: &ParamKind) -> bool {
    matches!(kind, ParamKind::Bool { .. } | ParamKind::Int { .. } | ParamKind::Float { .. } | ParamKind::Choice { .. })
}
