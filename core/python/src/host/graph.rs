//! A graph file with its arguments: its arguments, check and start.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use panoscope_engine::Options;
use panoscope_engine::inbox::{Full, Inbox};
use panoscope_graph::{Catalog, Graph, GraphText, Mode, ParamKind, ParamValue, command_line};
use panoscope_host::loader::{self as loader, Loader, graph_file};
use panoscope_record::{FileHash, RecordOptions, Recorder, ReplayOptions, hash_file, head};
use pyo3::prelude::*;
use serde::Serialize;

use super::error::Problem;
use super::recording::RecordingFile;
use super::running::{Lines, Run, Running};
use super::values::value_of;
use super::watched::Watched;

/// Maximum number of waiting packets of all watched outputs.
const MAX_WAITING: usize = 32;

/// Names and types of nodes; edges: producer, output, consumer, input, whether the packet is of the tick before.
type Drawing = (Vec<(String, String)>, Vec<(usize, String, usize, String, bool)>);

/// A graph file as read, with its arguments.
#[pyclass(frozen, module = "panoscope._native")]
pub struct GraphFile {
    text: GraphText,
}

/// A checked graph, or the part of it that the watched outputs need.
pub struct Ready {
    checked: graph_file::Ready,
    watched: Vec<Watched>,
}

impl Ready {
    /// The text of the running graph: one file, with arguments and settings in place.
    fn settled(&self) -> Result<String, Problem> {
        self.checked.text.settled(&self.checked.catalog).map_err(|error| Problem::Use(error.to_string()))
    }
}

/// All outputs of these nodes, as `node.output`.
fn outputs(graph: &Graph, catalog: &Catalog) -> Vec<String> {
    let of = |node: &panoscope_graph::Node| {
        let ports = node.node_type(catalog).outputs.iter();
        ports.map(|port| format!("{}.{}", node.id, port.name)).collect::<Vec<_>>()
    };
    graph.nodes.iter().flat_map(of).collect()
}

impl GraphFile {
    /// Checks the graph. With `is_part` only the part that the outputs in `watch` need, so that other plugins may be
    /// missing.
    pub fn ready(&self, watch: &[String], is_part: bool) -> Result<Ready, Problem> {
        let mut text = self.text.clone();
        let loader = Loader::search(&loader::search_path(&text.plugin_paths()));
        let targets: Vec<String> = watch.iter().map(|output| text.resolve_output(output)).collect();
        let split =
            |target: &'_ String| target.rsplit_once('.').map(|(node, output)| (node.to_owned(), output.to_owned()));
        let targets: Vec<(String, String)> =
            targets.iter().map(|target| split(target).unwrap_or_else(|| (target.clone(), String::new()))).collect();
        if is_part {
            let nodes = text.outline();
            for ((node, _), output) in targets.iter().zip(watch) {
                if !nodes.iter().any(|known| known.id == *node) {
                    let parts = text.parts();
                    let ids = nodes.iter().map(|node| &node.id).chain(parts.iter().map(|part| &part.id));
                    let ids = ids.map(String::as_str).collect::<Vec<_>>().join(", ");
                    return Err(Problem::Use(format!("there is no output `{output}`; nodes and parts are {ids}")));
                }
            }
            let nodes: Vec<&str> = targets.iter().map(|(node, _)| node.as_str()).collect();
            text.reduce_to(&nodes, &loader.offers());
        }
        let checked = graph_file::ready_with(&text, loader)?;
        let (graph, catalog) = (&checked.graph, &checked.catalog);
        let mut watched = Vec::new();
        for ((node, output), name) in targets.into_iter().zip(watch) {
            let node_type = graph.node(&node).map(|index| graph.nodes[index].node_type(catalog));
            let port = node_type.and_then(|of| Some(&of.outputs[of.output(&output)?]));
            let Some(port) = port else {
                let all = outputs(graph, catalog).join(", ");
                return Err(Problem::Use(format!("there is no output `{name}`; the outputs are {all}")));
            };
            watched.push(Watched { node, output, packet: port.packet.name.clone() });
        }
        Ok(Ready { checked, watched })
    }

    fn start_with(&self, how: &Start) -> Result<Running, Problem> {
        let ready = self.ready(&how.watch, how.is_part)?;
        // A later change of a parameter overrides its setting.
        let text = GraphText::parse(self.text.path(), &ready.settled()?);
        let Ready { checked, watched } = ready;
        let ready = graph_file::Ready { text, ..checked };
        let full = if ready.graph.mode == Mode::Batch || how.keeps_all { Full::Wait } else { Full::Drop };
        let inbox = Arc::new(Inbox::new(MAX_WAITING, full));
        let lines = Lines::default();
        let recorder = match &how.record {
            Some(file) => {
                let options =
                    RecordOptions { file: Some(file.clone()), all_ports: how.all_ports, ..RecordOptions::default() };
                Some(Recorder::start(options, head(&ready)).map_err(|error| Problem::Recording(error.to_string()))?)
            }
            None => None,
        };
        let options = Options {
            threads: how.threads,
            frames: how.frames,
            paced: how.paced,
            log: Some(lines.sink()),
            observer: recorder.clone().map(|recorder| recorder as _),
            listen: inbox.listeners(&Watched::outputs(&watched)),
            ..Options::default()
        };
        let live = ready.start(options).map_err(|error| Problem::Run(error.to_string()))?;
        let engine = Arc::clone(live.engine());
        let run = Run::Graph { engine, live: Box::new(Mutex::new(live)), parts: Box::new(self.text.clone()) };
        Ok(Running::new(run, inbox, lines, watched, recorder))
    }

    /// The checked graph for a replay with more settings, and its settings with parameters of parts replaced by those
    /// of nodes.
    fn for_replay(&self, watch: &[String], settings: &[String]) -> Result<(Ready, Vec<String>), Problem> {
        let mut text = self.text.clone();
        settings.iter().for_each(|setting| text.set(setting));
        let ready = Self { text }.ready(watch, !watch.is_empty())?;
        let settings = ready.checked.text.settings();
        Ok((ready, settings))
    }
}

/// What the results of a run depend on besides its inputs, and what the run writes.
#[derive(Serialize)]
struct Provenance {
    version: String,
    is_live: bool,
    /// The graph, its parts and its overlays.
    files: Vec<FileHash>,
    plugins: Vec<FileHash>,
    /// Files that must exist, by `node.param`.
    models: Vec<FileHash>,
    /// Files and folders that nodes write: `node.param` and the path.
    written: Vec<(String, PathBuf)>,
    /// Nodes with other side effects.
    acting: Vec<String>,
}

impl Provenance {
    fn of(ready: &graph_file::Ready) -> Self {
        let head = head(ready);
        let (mut written, mut acting) = (Vec::new(), Vec::new());
        for node in &ready.graph.nodes {
            let node_type = node.node_type(&ready.catalog);
            let before = written.len();
            for (param, value) in node_type.params.iter().zip(&node.params) {
                if let (ParamKind::Path { must_exist: false, .. }, ParamValue::Path(file)) = (&param.kind, value)
                    && node_type.side_effects
                {
                    written.push((format!("{}.{}", node.id, param.name), file.clone()));
                }
            }
            if node_type.side_effects && written.len() == before {
                acting.push(node.id.clone());
            }
        }
        Self {
            version: head.version,
            is_live: ready.graph.mode == Mode::Live,
            files: ready.text.files().into_iter().map(|file| hash_file(file.path, Path::new(file.path))).collect(),
            plugins: head.plugins,
            models: head.models,
            written,
            acting,
        }
    }
}

/// XXH3 of a file with 128 bits, as hexadecimal digits; empty when the file cannot be read.
#[pyfunction]
pub fn file_hash(py: Python<'_>, file: PathBuf) -> String {
    py.detach(|| hash_file("", &file).xxh3)
}

/// Options of the start of a graph.
struct Start {
    watch: Vec<String>,
    is_part: bool,
    keeps_all: bool,
    frames: Option<u64>,
    paced: bool,
    threads: usize,
    record: Option<PathBuf>,
    all_ports: bool,
}

#[pymethods]
impl GraphFile {
    /// Reads a graph from the file or from `text`. `words` are arguments as on a command line, `args` arguments by
    /// name.
    #[new]
    #[pyo3(signature = (path, words, args, settings, with, text = None))]
    fn open(
        py: Python<'_>,
        path: PathBuf,
        words: Vec<OsString>,
        args: Vec<(String, String)>,
        settings: Vec<String>,
        with: Vec<PathBuf>,
        text: Option<String>,
    ) -> PyResult<Self> {
        let open = || {
            let (mut with, mut settings) = (with, settings);
            let args_of_words = given(&path, words, &mut with, &mut settings)?;
            let mut options = command_line::options(&with, &args_of_words, &settings);
            options.args.extend(args);
            let text = match text {
                Some(text) => GraphText::parse_with(&path, &text, &options),
                None => GraphText::load_with(&path, &options)?,
            };
            Ok(Self { text })
        };
        py.detach(open).map_err(|problem: Problem| problem.raise(py))
    }

    /// Checks the graph; returns its warnings as JSON.
    fn check(&self, py: Python<'_>, watch: Vec<String>, is_part: bool) -> PyResult<String> {
        let ready = py.detach(|| self.ready(&watch, is_part)).map_err(|problem| problem.raise(py))?;
        Ok(serde_json::to_string(&ready.checked.warnings).unwrap_or_default())
    }

    /// Starts the graph.
    fn start(
        &self,
        py: Python<'_>,
        watch: Vec<String>,
        is_part: bool,
        keeps_all: bool,
        frames: Option<u64>,
        paced: bool,
        threads: usize,
        record: Option<PathBuf>,
        all_ports: bool,
    ) -> PyResult<Running> {
        let how = Start { watch, is_part, keeps_all, frames, paced, threads, record, all_ports };
        py.detach(|| self.start_with(&how)).map_err(|problem| problem.raise(py))
    }

    /// Value of a parameter as JSON, while the graph does not run.
    fn get(&self, py: Python<'_>, param: &str) -> PyResult<String> {
        let get = || {
            let ready = self.ready(&[], false)?.checked;
            let resolved = self.text.resolve_param(param);
            value_of(&ready.graph, &ready.catalog, &resolved).map_err(|error| Problem::Use(error.to_string()))
        };
        py.detach(get).map_err(|problem| problem.raise(py))
    }

    /// All outputs, as `node.output`, with the names of their packet types.
    fn outputs(&self, py: Python<'_>) -> PyResult<Vec<(String, String)>> {
        let ready = py.detach(|| self.ready(&[], false)).map_err(|problem| problem.raise(py))?.checked;
        let of = |node: &panoscope_graph::Node| {
            let ports = node.node_type(&ready.catalog).outputs.iter();
            ports.map(|port| (format!("{}.{}", node.id, port.name), port.packet.name.clone())).collect::<Vec<_>>()
        };
        Ok(ready.graph.nodes.iter().flat_map(of).collect())
    }

    /// Nodes and edges for a drawing of the graph.
    fn drawing(&self, py: Python<'_>) -> PyResult<Drawing> {
        let ready = py.detach(|| self.ready(&[], false)).map_err(|problem| problem.raise(py))?.checked;
        let (nodes, catalog) = (&ready.graph.nodes, &ready.catalog);
        let edge = |edge: &panoscope_graph::Edge| {
            let (from, to) = (&nodes[edge.from_node], &nodes[edge.to_node]);
            let output = from.node_type(catalog).outputs[edge.from_port].name.clone();
            let input = to.node_type(catalog).inputs[edge.to_port].name.clone();
            (edge.from_node, output, edge.to_node, input, edge.delay > 0)
        };
        let names = nodes.iter().map(|node| (node.id.clone(), node.node_type(catalog).name.clone()));
        Ok((names.collect(), ready.graph.edges.iter().map(edge).collect()))
    }

    /// The declared arguments: name, type, description, and whether it is required.
    fn arguments(&self) -> Vec<(String, String, String, bool)> {
        let missing = self.text.missing_args();
        let of = |arg: &panoscope_graph::Arg| {
            (arg.name.clone(), arg.kind.word().to_owned(), arg.doc.clone(), missing.contains(&arg.name.as_str()))
        };
        self.text.args().iter().map(of).collect()
    }

    /// What the results of a run depend on besides its inputs, and what the run writes, as JSON; see [`Provenance`].
    fn provenance(&self, py: Python<'_>) -> PyResult<String> {
        let find = || Ok(serde_json::to_string(&Provenance::of(&self.ready(&[], false)?.checked)).unwrap_or_default());
        py.detach(find).map_err(|problem: Problem| problem.raise(py))
    }

    /// The text of the file as read.
    #[getter]
    fn text(&self) -> &str {
        self.text.text()
    }

    /// Name of the graph.
    #[getter]
    fn name(&self) -> &str {
        self.text.name()
    }
}

/// The arguments of a graph in a command line; overlays and settings are separated.
fn given(
    path: &Path,
    words: Vec<OsString>,
    with: &mut Vec<PathBuf>,
    settings: &mut Vec<String>,
) -> Result<Vec<String>, Problem> {
    if words.is_empty() {
        return Ok(Vec::new());
    }
    let line = [OsString::from("panoscope"), path.into()].into_iter().chain(words).collect();
    let line = command_line::rewrite(line);
    if let Some(problem) = line.problem {
        return Err(Problem::Use(problem));
    }
    let mut args = Vec::new();
    let mut words = line.words.into_iter().skip(2).map(|word| word.to_string_lossy().into_owned());
    while let Some(word) = words.next() {
        let (name, value) = word.split_once('=').map_or((word.as_str(), None), |(name, value)| (name, Some(value)));
        let value = value.map(str::to_owned);
        let missing = || Problem::Use(format!("`{name}` needs a value"));
        match name {
            "--graph-arg" => args.push(value.ok_or_else(missing)?),
            "--with" => with.push(value.or_else(|| words.next()).ok_or_else(missing)?.into()),
            "--set" => settings.push(value.or_else(|| words.next()).ok_or_else(missing)?),
            _ => {
                let known = if line.help.is_empty() { "the graph has no arguments".to_owned() } else { line.help };
                return Err(Problem::Use(format!("the graph has no argument `{word}`; {}", known.trim_end())));
            }
        }
    }
    Ok(args)
}

/// Plays a recording.
#[pyfunction]
pub fn replay(
    py: Python<'_>,
    recording: &RecordingFile,
    graph: Option<&GraphFile>,
    watch: Vec<String>,
    settings: Vec<String>,
    frames: Option<u64>,
    threads: usize,
    act: bool,
    record: Option<PathBuf>,
) -> PyResult<Running> {
    let start = || {
        let (graph, watched, settings) = match graph {
            Some(graph) => {
                let (ready, settings) = graph.for_replay(&watch, &settings)?;
                let text = ready.settled()?;
                (Some((graph.text.path().to_owned(), text)), ready.watched, settings)
            }
            None => (None, recording.watched(&watch)?, settings),
        };
        let (inbox, lines) = (Arc::new(Inbox::new(MAX_WAITING, Full::Wait)), Lines::default());
        let options = ReplayOptions {
            graph,
            settings,
            act,
            record: record.map(|file| RecordOptions {
                file: Some(file),
                all_source_ports: false,
                // The replay waits for nobody: no packet may be missing.
                max_queued_bytes: usize::MAX,
                ..RecordOptions::default()
            }),
            loader: None,
            engine: Options {
                threads,
                frames,
                log: Some(lines.sink()),
                listen: inbox.listeners(&Watched::outputs(&watched)),
                ..Options::default()
            },
        };
        let run = Run::replay(recording, options)?;
        let recorder = run.recorder();
        Ok(Running::new(run, inbox, lines, watched, recorder))
    };
    py.detach(start).map_err(|problem: Problem| problem.raise(py))
}
