//! A study: several parameters and node types varied together, with several measures and parallel runs.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, mpsc};
use std::time::Instant;

use panoscope_base::random::SplitMix64;
use panoscope_engine::sync::lock;
use panoscope_graph::{GraphText, check};
use panoscope_host::loader::{Loader, graph_file};
use panoscope_record::{Head, Recording};
use toml::{Table, Value};

use super::axis::{Axis, AxisRequest, AxisValue, AxisValues, TYPE};
use super::error::{PointError, SweepError};
use super::measure::{Measure, NoSummary, Summary};
use super::part;
use super::run_measure::{RunMeasure, Statistic};
use super::search::Search;
use super::trial::Trial;

/// Maximum number of runs of a study.
pub const MAX_RUNS: usize = 10_000;

/// Combinations of values to run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Plan {
    /// All combinations.
    Grid,
    /// A number of runs with independently drawn values.
    Random {
        /// Number of runs.
        runs: usize,
        /// Seed of the drawn values.
        seed: u64,
    },
    /// A number of runs that optimise the first measure.
    Search {
        /// Number of runs.
        runs: usize,
        /// Seed; runs one at a time are reproducible.
        seed: u64,
        /// Statistic of the first measure.
        statistic: Statistic,
        /// Whether larger is better.
        is_larger_better: bool,
    },
}

/// Options of a study.
#[derive(Clone, Debug)]
pub struct StudyRequest {
    /// The graph file.
    pub path: PathBuf,
    /// Its text, without parts.
    pub text: String,
    /// `node.param=value`, applied in all runs.
    pub settings: Vec<String>,
    /// Axes; the last one changes fastest.
    pub axes: Vec<AxisRequest>,
    /// Combinations to run.
    pub plan: Plan,
    /// Number of values of a range without its own number.
    pub steps: usize,
    /// As [`super::Request::measure`], one or more.
    pub measures: Vec<String>,
    /// Maximum number of ticks of each source per run.
    pub frames: u64,
    /// Recording that replaces the graph's sources.
    pub recording: Option<Arc<Recording>>,
    /// Threads of each run; 0: the cores are divided among the runs.
    pub threads: usize,
    /// Number of parallel runs, at least 1.
    pub jobs: usize,
}

/// The graph with one combination of node types.
pub(super) struct Variant {
    /// Types of the axes that vary types, in their order.
    types: Vec<String>,
    /// Text of the part of the graph that is run.
    pub text: String,
    /// Settings that apply to this graph.
    pub settings: Vec<String>,
    measures: Vec<Measure>,
    /// Parameters of the file or settings that the chosen types lack.
    pub dropped: Vec<String>,
    /// Hashes of the files, and the machine.
    pub head: Head,
}

/// Result of one run.
#[derive(Clone, Debug)]
pub struct RunResult {
    /// Number of the run, from 1, in the order of the combinations.
    pub number: usize,
    /// A value for each axis.
    pub values: Vec<AxisValue>,
    /// Statistics, or the reason for their absence, in the order of the measures.
    pub results: Vec<Result<Summary, PointError>>,
    /// Duration of the run, s.
    pub seconds: f64,
}

/// A checked study.
pub struct Study {
    pub(super) request: StudyRequest,
    pub(super) loader: Arc<Loader>,
    pub(super) axes: Vec<Axis>,
    pub(super) variants: Vec<Variant>,
    runs: Runs,
}

/// The values of each run.
enum Runs {
    Known(Vec<Vec<AxisValue>>),
    Searched { count: usize, search: Box<Mutex<Search>> },
}

fn bad_param(param: &str, reason: impl Into<String>) -> SweepError {
    SweepError::Param { param: param.to_owned(), reason: reason.into() }
}

/// Node and parameter of `node.param`.
fn split(param: &str) -> Result<(&str, &str), SweepError> {
    param.rsplit_once('.').ok_or_else(|| bad_param(param, "write it as NODE.PARAMETER, such as match.block_px"))
}

/// A checked graph, and what became of its settings.
struct Ready {
    checked: graph_file::Ready,
    settings: Vec<String>,
    dropped: Vec<String>,
}

impl StudyRequest {
    /// The graph with these types of nodes, without the parameters that they lack.
    fn ready(&self, types: &[(&str, &str)], loader: &Arc<Loader>) -> Result<Ready, SweepError> {
        let mut text = self.text.clone();
        let mut settings = self.settings.clone();
        let mut dropped = Vec::new();
        if !types.is_empty() {
            let parsed = GraphText::parse(&self.path, &self.text);
            let catalog = loader.catalog_of(&parsed);
            let mut table: Table = text.parse().map_err(|e: toml::de::Error| bad_param(TYPE, e.message()))?;
            for (id, name) in types {
                let of = format!("{id}.{TYPE}");
                let found = catalog.find(name);
                let [at] = found[..] else {
                    let plugins = catalog.offering(name);
                    let where_from =
                        if plugins.is_empty() { String::new() } else { format!(" ({})", plugins.join(", ")) };
                    let reason = format!(
                        "there is no node type `{name}`{where_from} among those of the graph's `plugins`: add its plugin there"
                    );
                    return Err(bad_param(&of, reason));
                };
                let has = |param: &str| catalog.node_types[at].param(param).is_some();
                let node = table.get_mut("nodes").and_then(|nodes| nodes.get_mut(*id)).and_then(Value::as_table_mut);
                let node = node.ok_or_else(|| bad_param(&of, format!("there is no node `{id}`")))?;
                node.insert(TYPE.to_owned(), Value::String((*name).to_owned()));
                if let Some(params) = node.get_mut("params").and_then(Value::as_table_mut) {
                    dropped.extend(params.keys().filter(|p| !has(p)).map(|p| format!("{id}.{p}")));
                    params.retain(|param, _| has(param));
                }
                settings.retain(|setting| {
                    let param = setting.split_once('=').and_then(|(param, _)| param.trim().rsplit_once('.'));
                    let is_kept = param.is_none_or(|(node, param)| node != *id || has(param));
                    if let (false, Some((node, param))) = (is_kept, param) {
                        dropped.push(format!("{node}.{param}"));
                    }
                    is_kept
                });
            }
            text = toml::to_string(&table).map_err(|error| bad_param(TYPE, error.to_string()))?;
        }
        let mut parsed = GraphText::parse(&self.path, &text);
        settings.iter().for_each(|setting| parsed.set(setting));
        let checked = graph_file::ready_with(&parsed, Arc::clone(loader)).map_err(SweepError::Check)?;
        Ok(Ready { checked, settings, dropped })
    }

    /// Reduces a checked graph to the part that is run. `varied` are the nodes of the axes.
    fn variant(&self, types: &[(&str, &str)], ready: Ready) -> Result<Variant, SweepError> {
        let Ready { checked, mut settings, dropped } = ready;
        let (graph, catalog) = (&checked.graph, &checked.catalog);
        let found: Result<Vec<(Measure, usize)>, SweepError> =
            self.measures.iter().map(|measure| Measure::of(measure, graph, catalog)).collect();
        let (measures, nodes): (Vec<Measure>, Vec<usize>) = found?.into_iter().unzip();
        let kept = part::needed(graph, &nodes);
        let names = self.measures.join("`, `");
        for axis in &self.axes {
            let (id, _) = split(&axis.param)?;
            let node = graph.node(id).ok_or_else(|| bad_param(&axis.param, part::no_node(graph, id)))?;
            if !kept[node] {
                let reason =
                    format!("`{id}` is not upstream of `{names}`, so it has no effect: vary another parameter");
                return Err(bad_param(&axis.param, reason));
            }
            if self.recording.is_some() && graph.nodes[node].node_type(catalog).source {
                let reason = format!("the recording replaces source `{id}`: sweep another node");
                return Err(bad_param(&axis.param, reason));
            }
        }
        part::refuse_acting(graph, catalog, &kept, &names)?;
        let head = panoscope_record::head(&checked);
        let text =
            part::text(checked.text.text(), graph, &kept).map_err(|error| bad_param("graph", error.to_string()))?;
        settings.retain(|setting| {
            let node = setting.split_once('.').and_then(|(node, _)| graph.node(node.trim()));
            node.is_some_and(|n| kept[n])
        });
        let types = types.iter().map(|(_, name)| (*name).to_owned()).collect();
        Ok(Variant { types, text, settings, measures, dropped, head })
    }
}

/// All combinations of values; the last list changes fastest.
fn combinations<T: Clone>(lists: &[Vec<T>]) -> Vec<Vec<T>> {
    lists.iter().fold(vec![Vec::new()], |all, list| {
        all.iter()
            .flat_map(|head| list.iter().map(move |item| [&head[..], std::slice::from_ref(item)].concat()))
            .collect()
    })
}

impl Study {
    /// Checks graph, axes and measures, for every choice of node types.
    ///
    /// # Errors
    /// See [`SweepError`]; nothing has been run.
    pub fn new(request: StudyRequest, loader: Arc<Loader>) -> Result<Self, SweepError> {
        if request.axes.is_empty() {
            return Err(bad_param("--param", "name at least one parameter"));
        }
        if request.measures.is_empty() {
            let reason = "name at least one measure".to_owned();
            return Err(SweepError::Measure { measure: "--measure".to_owned(), reason });
        }
        for (index, axis) in request.axes.iter().enumerate() {
            if request.axes[..index].iter().any(|other| other.param == axis.param) {
                return Err(bad_param(&axis.param, "it is given twice"));
            }
        }
        let whole = request.ready(&[], &loader)?;
        let mut type_axes: Vec<(&str, &Vec<String>)> = Vec::new();
        for axis in &request.axes {
            let (id, name) = split(&axis.param)?;
            let node = whole
                .checked
                .graph
                .node(id)
                .ok_or_else(|| bad_param(&axis.param, part::no_node(&whole.checked.graph, id)))?;
            if name == TYPE && whole.checked.graph.nodes[node].node_type(&whole.checked.catalog).param(TYPE).is_none() {
                let AxisValues::List(types) = &axis.values else {
                    return Err(bad_param(&axis.param, "name the types: NODE.type=TYPE,TYPE"));
                };
                type_axes.push((id, types));
            }
        }
        let lists: Vec<Vec<(&str, &str)>> =
            type_axes.iter().map(|(id, types)| types.iter().map(|name| (*id, name.as_str())).collect()).collect();
        let is_random = request.plan != Plan::Grid;
        let mut variants = Vec::new();
        let mut axes: Vec<Axis> = Vec::new();
        for types in combinations(&lists) {
            let ready = request.ready(&types, &loader)?;
            let found: Result<Vec<Axis>, SweepError> =
                request.axes.iter().map(|axis| resolve(axis, &ready, &type_axes, request.steps, is_random)).collect();
            let found = found?;
            if axes.is_empty() {
                axes = found;
            }
            check_lists(&request, &ready, &type_axes, &loader)?;
            variants.push(request.variant(&types, ready)?);
        }
        let runs = match request.plan {
            Plan::Grid => {
                let count = axes.iter().try_fold(1usize, |product, axis| product.checked_mul(axis.values.len()));
                if count.is_none_or(|count| count > MAX_RUNS) {
                    let reason = format!("more than {MAX_RUNS} combinations: take fewer values, or --random");
                    return Err(bad_param("--param", reason));
                }
                let lists: Vec<Vec<AxisValue>> = axes.iter().map(|axis| axis.values.clone()).collect();
                Runs::Known(combinations(&lists))
            }
            Plan::Random { runs, .. } | Plan::Search { runs, .. } if !(1..=MAX_RUNS).contains(&runs) => {
                return Err(bad_param("--random, --search", format!("from 1 to {MAX_RUNS} runs can be made")));
            }
            Plan::Random { runs, seed } => {
                let mut random = SplitMix64(seed);
                Runs::Known((0..runs).map(|_| axes.iter().map(|axis| axis.draw(&mut random)).collect()).collect())
            }
            Plan::Search { runs, seed, .. } => {
                let search =
                    Search::new(&axes, seed).ok_or_else(|| bad_param("--search", "a parameter has one value only"))?;
                Runs::Searched { count: runs, search: Box::new(Mutex::new(search)) }
            }
        };
        drop(type_axes);
        Ok(Self { request, loader, axes, variants, runs })
    }

    /// Number of runs.
    pub fn len(&self) -> usize {
        match &self.runs {
            Runs::Known(runs) => runs.len(),
            Runs::Searched { count, .. } => *count,
        }
    }

    /// Always false: a study has at least one run.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Axes of the study.
    pub fn axes(&self) -> &[Axis] {
        &self.axes
    }

    /// The measures as requested.
    pub fn measures(&self) -> &[String] {
        &self.request.measures
    }

    /// Parameters omitted because a chosen node type lacks them.
    pub fn dropped(&self) -> Vec<&str> {
        let mut all: Vec<&str> = self.variants.iter().flat_map(|v| v.dropped.iter().map(String::as_str)).collect();
        all.sort_unstable();
        all.dedup();
        all
    }

    /// The variant of a run, and the settings of its axes.
    pub(super) fn of_run(&self, values: &[AxisValue]) -> (&Variant, Vec<String>) {
        let (mut types, mut settings) = (Vec::new(), Vec::new());
        for (axis, (value, _)) in self.axes.iter().zip(values) {
            if axis.is_type { types.push(value) } else { settings.push(format!("{}={value}", axis.param)) }
        }
        let variant = self.variants.iter().find(|v| v.types.iter().eq(types.iter().copied()));
        (variant.unwrap_or(&self.variants[0]), settings)
    }

    fn one(&self, number: usize, cancelled: &dyn Fn() -> bool) -> Result<RunResult, SweepError> {
        let values = match &self.runs {
            Runs::Known(runs) => runs[number].clone(),
            Runs::Searched { search, .. } => lock(search).ask(&self.axes, number),
        };
        let (variant, own) = self.of_run(&values);
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let jobs = self.request.jobs.max(1);
        let shared = if jobs > 1 { (cores / jobs).max(1) } else { 0 };
        let trial = Trial {
            path: &self.request.path,
            text: &variant.text,
            settings: variant.settings.iter().cloned().chain(own).collect(),
            measures: &variant.measures,
            frames: self.request.frames,
            threads: if self.request.threads > 0 { self.request.threads } else { shared },
            recording: self.request.recording.as_ref(),
            loader: &self.loader,
        };
        let start = Instant::now();
        let results = match trial.run(cancelled) {
            Ok(summaries) => {
                let mut results = Vec::new();
                for (summary, measure) in summaries.into_iter().zip(&self.request.measures) {
                    results.push(match summary {
                        Ok(summary) => Ok(summary),
                        // Another type may have it.
                        Err(NoSummary::Measure(reason)) if self.variants.len() == 1 && !cancelled() => {
                            return Err(SweepError::Measure { measure: measure.clone(), reason });
                        }
                        Err(NoSummary::Measure(reason) | NoSummary::Run(reason)) => Err(PointError { reason }),
                    });
                }
                results
            }
            Err(NoSummary::Measure(reason) | NoSummary::Run(reason)) => {
                vec![Err(PointError { reason }); self.request.measures.len()]
            }
        };
        if let (Runs::Searched { search, .. }, Plan::Search { statistic, is_larger_better, .. }) =
            (&self.runs, self.request.plan)
        {
            let first = statistic.of(&RunMeasure::of("", &results[0]));
            lock(search).tell(number, first.map(|value| if is_larger_better { -value } else { value }));
        }
        Ok(RunResult { number: number + 1, values, results, seconds: start.elapsed().as_secs_f64() })
    }

    /// Makes all runs, `jobs` in parallel; `each` receives each result. Ends early if `cancelled` returns true; it is
    /// called often.
    ///
    /// # Errors
    /// The column, row or metric does not exist, which only the first run can show.
    pub fn run(
        &self,
        cancelled: &(dyn Fn() -> bool + Sync),
        mut each: impl FnMut(RunResult),
    ) -> Result<(), SweepError> {
        let (next, is_over) = (AtomicUsize::new(0), AtomicBool::new(false));
        let stopped = || is_over.load(Ordering::Relaxed) || cancelled();
        let (sender, receiver) = mpsc::channel();
        std::thread::scope(|scope| {
            for _ in 0..self.request.jobs.clamp(1, self.len().max(1)) {
                let (sender, next, stopped) = (sender.clone(), &next, &stopped);
                scope.spawn(move || {
                    loop {
                        let number = next.fetch_add(1, Ordering::Relaxed);
                        if number >= self.len() || stopped() {
                            return;
                        }
                        let result = self.one(number, stopped);
                        if stopped() || sender.send(result).is_err() {
                            return;
                        }
                    }
                });
            }
            drop(sender);
            for result in receiver {
                match result {
                    Ok(result) => each(result),
                    Err(error) => {
                        is_over.store(true, Ordering::Relaxed);
                        return Err(error);
                    }
                }
            }
            Ok(())
        })
    }
}

/// Resolves an axis in a graph with these node types.
fn resolve(
    axis: &AxisRequest,
    ready: &Ready,
    type_axes: &[(&str, &Vec<String>)],
    steps: usize,
    is_random: bool,
) -> Result<Axis, SweepError> {
    let (id, name) = split(&axis.param)?;
    if let Some((_, types)) = type_axes.iter().find(|(node, _)| *node == id && name == TYPE) {
        return Ok(Axis { has_words: true, is_type: true, ..Axis::of_list(&axis.param, "", types) });
    }
    let node =
        ready.checked.graph.node(id).ok_or_else(|| bad_param(&axis.param, part::no_node(&ready.checked.graph, id)))?;
    let node_type = ready.checked.graph.nodes[node].node_type(&ready.checked.catalog);
    let declared = node_type.param(name).map(|at| &node_type.params[at]).ok_or_else(|| {
        let names: Vec<&str> = node_type.params.iter().map(|p| p.name.as_str()).collect();
        let reason = format!("`{id}` ({}) has no such parameter; it has {}", node_type.name, part::list(&names));
        bad_param(&axis.param, reason)
    })?;
    match &axis.values {
        AxisValues::List(list) => Ok(Axis::of_list(&axis.param, &declared.unit, list)),
        AxisValues::Range { .. } => Axis::of_range(axis, &declared.kind, &declared.unit, steps, is_random),
    }
}

/// Checks the graph with each value of each list.
fn check_lists(
    request: &StudyRequest,
    ready: &Ready,
    type_axes: &[(&str, &Vec<String>)],
    loader: &Loader,
) -> Result<(), SweepError> {
    for axis in &request.axes {
        let (id, name) = split(&axis.param)?;
        let AxisValues::List(list) = &axis.values else { continue };
        if name == TYPE && type_axes.iter().any(|(node, _)| *node == id) {
            continue;
        }
        for value in list {
            let mut parsed = ready.checked.text.clone();
            parsed.set(&format!("{}={value}", axis.param));
            check(&parsed, &loader.catalog_of(&parsed)).into_result().map_err(SweepError::Check)?;
        }
    }
    Ok(())
}
