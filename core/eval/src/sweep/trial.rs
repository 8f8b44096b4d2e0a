//! One run of a graph with its measures.

use std::convert::Infallible;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use panoscope_engine::sync::lock;
use panoscope_engine::{Engine, Listener, NumberListener, Options, Outcome};
use panoscope_graph::GraphText;
use panoscope_host::loader::{Loader, graph_file};
use panoscope_record::{Recording, Replay, ReplayOptions};

use super::measure::{Measure, NoSummary, Received, Summary};
use crate::run::failed_node;

/// Maximum time for nodes to end.
const PATIENCE: Duration = Duration::from_secs(30);

/// A run to make.
pub(super) struct Trial<'a> {
    /// The graph file: relative paths start from its folder.
    pub path: &'a Path,
    /// The part of the graph that is run.
    pub text: &'a str,
    /// `node.param=value`.
    pub settings: Vec<String>,
    pub measures: &'a [Measure],
    /// Maximum number of ticks of each source.
    pub frames: u64,
    /// Threads of the pool; 0: one per core.
    pub threads: usize,
    /// Recording that replaces the graph's sources.
    pub recording: Option<&'a Arc<Recording>>,
    pub loader: &'a Arc<Loader>,
}

/// Received values, in the order of the measures.
type AllReceived = Arc<Vec<Mutex<Received>>>;

impl Trial<'_> {
    /// Runs to the end; returns statistics in the order of the measures. Ends early if `cancelled` returns true or a
    /// measure cannot exist.
    ///
    /// # Errors
    /// The run failed: nothing was measured.
    pub fn run(mut self, cancelled: &dyn Fn() -> bool) -> Result<Vec<Result<Summary, NoSummary>>, NoSummary> {
        let received: AllReceived = Arc::new(self.measures.iter().map(|_| Mutex::default()).collect());
        let options = Options {
            threads: self.threads,
            frames: Some(self.frames),
            paced: false,
            listen: self.listeners(&received),
            numbers: self.number_listeners(&received),
            ..Options::default()
        };
        let is_wrong = || self.measures.iter().zip(&*received).any(|(m, r)| m.wrong(&lock(r)).is_some());
        let wait = |engine: &Engine| {
            let Ok(()) = engine.watch(Duration::from_millis(50), |engine| {
                if cancelled() || is_wrong() {
                    engine.stop();
                }
                Ok::<(), Infallible>(())
            });
            let outcome = engine.close(PATIENCE);
            let report = engine.report();
            let failed = failed_node(engine, &report);
            (outcome, report, failed)
        };
        let settings = std::mem::take(&mut self.settings);
        let (outcome, report, failed) = match self.recording {
            Some(recording) => {
                let replay_options = ReplayOptions {
                    graph: Some((self.path.to_owned(), self.text.to_owned())),
                    settings,
                    loader: Some(Arc::clone(self.loader)),
                    engine: options,
                    ..ReplayOptions::default()
                };
                let replay = Replay::start(recording, replay_options).map_err(|e| NoSummary::Run(e.to_string()))?;
                let done = wait(replay.engine());
                replay.verdict().map_err(|e| NoSummary::Run(e.to_string()))?;
                done
            }
            None => {
                let mut parsed = GraphText::parse(self.path, self.text);
                settings.iter().for_each(|setting| parsed.set(setting));
                let ready = graph_file::ready_with(&parsed, Arc::clone(self.loader));
                let ready = ready.map_err(|d| NoSummary::Run(d.render(false)))?;
                wait(ready.start(options).map_err(|error| NoSummary::Run(error.to_string()))?.engine())
            }
        };
        if let Outcome::Failed(reason) = outcome {
            return Err(NoSummary::Run(reason));
        }
        if let Some((node, reason)) = failed {
            return Err(NoSummary::Run(format!("every call of node `{node}` failed: {reason}")));
        }
        let failed_calls = report.nodes.values().map(|node| node.faults).sum();
        let summary = |(measure, received): (&Measure, &Mutex<Received>)| {
            measure.summary(&lock(received), &report).map(|summary| Summary { failed_calls, ..summary })
        };
        Ok(self.measures.iter().zip(&*received).map(summary).collect())
    }

    /// One listener for each port.
    fn listeners(&self, received: &AllReceived) -> Vec<Listener> {
        let mut listeners: Vec<Listener> = Vec::new();
        for measure in self.measures {
            let Measure::Port { node, port, packet, .. } = measure else { continue };
            if listeners.iter().any(|l| l.node == *node && l.output == *port) {
                continue;
            }
            let of_port: Vec<_> = self
                .measures
                .iter()
                .enumerate()
                .filter_map(|(index, other)| match other {
                    Measure::Port { node: n, port: p, column, rows, .. } if n == node && p == port => {
                        Some((index, column.clone(), *rows))
                    }
                    _ => None,
                })
                .collect();
            let (received, packet) = (Arc::clone(received), packet.clone());
            listeners.push(Listener {
                node: node.clone(),
                output: port.clone(),
                hear: Arc::new(move |frame| {
                    for (index, column, rows) in &of_port {
                        lock(&received[*index]).take(frame.bytes(), &packet, column.as_deref(), *rows);
                    }
                }),
            });
        }
        listeners
    }

    /// One listener for each node with measured metrics.
    fn number_listeners(&self, received: &AllReceived) -> Vec<NumberListener> {
        let mut listeners: Vec<NumberListener> = Vec::new();
        for measure in self.measures {
            let Measure::Number { node, .. } = measure else { continue };
            if listeners.iter().any(|l| l.node == *node) {
                continue;
            }
            let of_node: Vec<(usize, String)> = self
                .measures
                .iter()
                .enumerate()
                .filter_map(|(index, m)| match m {
                    Measure::Number { node: n, name } if n == node => Some((index, name.clone())),
                    _ => None,
                })
                .collect();
            let received = Arc::clone(received);
            let hear = move |tick: &panoscope_abi::Tick, reported: &str, value: f64| {
                for (index, _) in of_node.iter().filter(|(_, name)| name == reported) {
                    lock(&received[*index]).take_number((tick.source, tick.seq), value);
                }
            };
            listeners.push(NumberListener { node: node.clone(), hear: Arc::new(hear) });
        }
        listeners
    }
}
