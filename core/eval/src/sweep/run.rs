//! Checks a sweep and runs it.

use std::path::PathBuf;
use std::sync::Arc;

use panoscope_graph::{GraphText, ParamKind, ParamValue, check};
use panoscope_host::loader::Loader;
use panoscope_record::Recording;

use super::error::{PointError, SweepError};
use super::measure::{Measure, NoSummary, Summary};
use super::trial::Trial;
use super::values::shown;
use super::{part, values};

/// Options of a sweep.
#[derive(Clone, Debug)]
pub struct Request {
    /// The graph file.
    pub path: PathBuf,
    /// Its text.
    pub text: String,
    /// `node.param=value`, applied in all runs.
    pub settings: Vec<String>,
    /// `node.param`.
    pub param: String,
    /// First value; default: the parameter's minimum. Ignored for switches and choices, which take all their values.
    pub from: Option<f64>,
    /// Last value; default: the parameter's maximum.
    pub to: Option<f64>,
    /// Number of values, both ends included.
    pub steps: usize,
    /// `node.port` of a scalar, `node.port.column` of a table (`column[2]` if it has several rows, `column[*]` for
    /// all), `node.metric`, or `node.` and one of [`COUNTERS`].
    pub measure: String,
    /// Maximum number of ticks of each source per value.
    pub frames: u64,
    /// Recording that replaces the graph's sources.
    pub recording: Option<Arc<Recording>>,
    /// Threads of each run; 0: one per core.
    pub threads: usize,
}

/// Result of one value.
#[derive(Clone, Debug, PartialEq)]
pub struct Point {
    /// The value as in a graph file.
    pub value: String,
    /// The value as a number; for switches and choices its position.
    pub at: f64,
    /// The statistics, or the reason for their absence.
    pub result: Result<Summary, PointError>,
}

/// A checked sweep.
pub struct Sweep {
    request: Request,
    loader: Arc<Loader>,
    /// Text of the part of the graph that is run.
    text: String,
    values: Vec<(ParamValue, f64)>,
    measure: Measure,
    /// Unit of the parameter.
    unit: String,
    /// Whether the values are words: switches or choices.
    words: bool,
}

impl Sweep {
    /// Checks graph, parameter and measure.
    ///
    /// # Errors
    /// See [`SweepError`]; nothing has been run.
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
            return Err(bad_param(format!("the recording replaces source `{id}`: sweep another node")));
        }
        let values = values::of(&declared.kind, request.from, request.to, request.steps)
            .map_err(|error| bad_param(error.to_string()))?;
        let (measure, at) = Measure::of(&request.measure, &graph, &catalog)?;
        let kept = part::needed(&graph, &[at]);
        if !kept[node] {
            return Err(bad_param(format!(
                "`{id}` is not upstream of `{}`, so it has no effect on it: sweep another parameter",
                measure
            )));
        }
        part::refuse_acting(&graph, &catalog, &kept, &request.measure)?;
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

    /// Always false: a sweep has at least one value.
    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    /// The parameter, `node.param`.
    pub fn param(&self) -> &str {
        &self.request.param
    }

    /// The measure as requested.
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

    /// Whether the values are words, as of switches and choices; their numbers are only positions.
    pub fn has_words(&self) -> bool {
        self.words
    }

    /// Runs all values; `each` receives each point. Ends early if `cancelled` returns true; it is called often.
    ///
    /// # Errors
    /// The column, row or metric does not exist, which only the first run can show.
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

    /// Runs one value to its end.
    fn one(&self, value: &str, cancelled: &dyn Fn() -> bool) -> Result<Summary, NoSummary> {
        let mut settings = self.request.settings.clone();
        settings.push(format!("{}={value}", self.request.param));
        let trial = Trial {
            path: &self.request.path,
            text: &self.text,
            settings,
            measures: std::slice::from_ref(&self.measure),
            frames: self.request.frames,
            threads: self.request.threads,
            recording: self.request.recording.as_ref(),
            loader: &self.loader,
        };
        let mut summaries = trial.run(cancelled)?;
        summaries.pop().unwrap_or_else(|| Err(NoSummary::Run("nothing was measured".to_owned())))
    }
}

/// Whether parameters of this kind can be swept.
pub fn can_sweep(kind: &ParamKind) -> bool {
    matches!(kind, ParamKind::Bool { .. } | ParamKind::Int { .. } | ParamKind::Float { .. } | ParamKind::Choice { .. })
}
