//! A sweep: one parameter and one measure.

use std::path::PathBuf;
use std::sync::Arc;

use panoscope_graph::ParamKind;
use panoscope_host::loader::Loader;
use panoscope_record::Recording;

use super::axis::{Axis, AxisRequest, AxisValues};
use super::error::{PointError, SweepError};
use super::measure::Summary;
use super::study::{Plan, RunResult, Study, StudyRequest};

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

/// A checked sweep: a [`Study`] of one parameter and one measure, one run at a time.
pub struct Sweep(Study);

impl Sweep {
    /// Checks graph, parameter and measure.
    ///
    /// # Errors
    /// See [`SweepError`]; nothing has been run.
    pub fn new(request: Request, loader: Arc<Loader>) -> Result<Self, SweepError> {
        let Request { path, text, settings, param, from, to, steps, measure, frames, recording, threads } = request;
        let axes = vec![AxisRequest { param, values: AxisValues::Range { from, to, steps: None } }];
        let (plan, measures, jobs) = (Plan::Grid, vec![measure], 1);
        let request =
            StudyRequest { path, text, settings, axes, plan, steps, measures, frames, recording, threads, jobs };
        Study::new(request, loader).map(Self)
    }

    /// Number of values.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Always false: a sweep has at least one value.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    fn axis(&self) -> &Axis {
        &self.0.axes[0]
    }

    /// The parameter, `node.param`.
    pub fn param(&self) -> &str {
        &self.axis().param
    }

    /// The measure as requested.
    pub fn measure_text(&self) -> &str {
        &self.0.request.measures[0]
    }

    /// Unit of the parameter; empty for none.
    pub fn unit(&self) -> &str {
        &self.axis().unit
    }

    /// Whether the values are words, as of switches and choices; their numbers are only positions.
    pub fn has_words(&self) -> bool {
        self.axis().has_words
    }

    /// Runs all values; `each` receives each point. Ends early if `cancelled` returns true; it is called often.
    ///
    /// # Errors
    /// The column, row or metric does not exist, which only the first run can show.
    pub fn run(&self, cancelled: &(dyn Fn() -> bool + Sync), mut each: impl FnMut(Point)) -> Result<(), SweepError> {
        self.0.run(cancelled, |RunResult { values, results, .. }| {
            for ((value, at), result) in values.into_iter().zip(results) {
                each(Point { value, at, result });
            }
        })
    }
}

/// Whether parameters of this kind can be swept.
pub fn can_sweep(kind: &ParamKind) -> bool {
    matches!(kind, ParamKind::Bool { .. } | ParamKind::Int { .. } | ParamKind::Float { .. } | ParamKind::Choice { .. })
}
