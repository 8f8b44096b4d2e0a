//! Replays a recording: its own graph to the byte, or another graph on its source packets.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use panoscope_graph::{Catalog, Diagnostics, Graph, GraphText, Mode};

use crate::head::{head, model_hashes, plugin_hashes};
use crate::recorder::{RecordError, RecordOptions, Recorder};
use crate::recording::Recording;
use crate::script::{RecordedChange, Script};
use panoscope_engine::ApplyError;
use panoscope_engine::decide::Decider;
use panoscope_engine::{Engine, Options};
use panoscope_host::loader::graph_file::{self, RunError};
use panoscope_host::loader::{Live, Loader};

/// Options of a replay.
#[derive(Default)]
pub struct ReplayOptions {
    /// Path and text of another graph; `None` for the recorded one.
    pub graph: Option<(PathBuf, String)>,
    /// `node.param=value` settings; override the recorded values.
    pub settings: Vec<String>,
    /// Whether nodes with side effects, which write files or move an arm, run; otherwise they are skipped.
    pub act: bool,
    /// Options for recording the replay itself; `None`: not recorded.
    pub record: Option<RecordOptions>,
    /// The loader of plugins; `None` to search for them.
    pub loader: Option<Arc<Loader>>,
    /// Options of the engine, such as threads and log.
    pub engine: Options,
}

/// A replay that failed or ended early.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// The graph has mistakes with the plugins and files of this machine.
    #[error("the graph does not match this machine's plugins and files:\n{}", .0.render(false))]
    Check(Diagnostics),
    /// The engine did not start.
    #[error(transparent)]
    Start(#[from] RunError),
    /// The recording of the replay could not be written.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// A source of the graph has no ticks in the recording.
    #[error(
        "the graph has the source `{node}`, the recording has {recorded}; rename the node in the graph, or record with it"
    )]
    NoSource {
        /// The source.
        node: String,
        /// The sources that the recording has.
        recorded: String,
    },
    /// An output of a source is not in the recording.
    #[error("`{reader}` reads `{port}`, which the recording does not contain; it contains {recorded}")]
    NoPort {
        /// The reader.
        reader: String,
        /// The output.
        port: String,
        /// The ports of that source that the recording has.
        recorded: String,
    },
    /// A recorded change does not fit the plugins of this machine.
    #[error("change {number} of the recording does not match: {cause}; replay with the plugins of the recording")]
    Stale {
        /// Number of the change, from 1.
        number: usize,
        /// Description of the difference.
        cause: StaleError,
    },
    /// A recorded change could not be applied.
    #[error("change {number} of the recording could not be applied: {cause}")]
    Edit {
        /// Number of the change, from 1.
        number: usize,
        /// Reason for which it was not applied.
        cause: ApplyError,
    },
    /// A part of the recording could not be replayed.
    #[error("{reason}")]
    Incomplete {
        /// The part and the reason.
        reason: String,
    },
}

/// A recorded graph that does not fit the plugins of this machine.
#[derive(Debug, thiserror::Error)]
pub enum StaleError {
    /// No plugin has the node type.
    #[error("node `{node}` is of type `{node_type}`, which no plugin here has")]
    UnknownType {
        /// The node.
        node: String,
        /// `plugin/type`.
        node_type: String,
    },
    /// The node type has other parameters than recorded.
    #[error("type `{node_type}` of node `{node}` has other parameters here")]
    OtherParams {
        /// The node.
        node: String,
        /// `plugin/type`.
        node_type: String,
    },
    /// A node type at one end of a recorded edge has other ports than recorded.
    #[error("type `{from}` or `{to}` has other ports here")]
    OtherPorts {
        /// Type of the node that the edge comes from.
        from: String,
        /// Type of the node that the edge goes to.
        to: String,
    },
}

/// A running replay.
pub struct Replay {
    live: Live,
    script: Arc<Script>,
    recorder: Option<Arc<Recorder>>,
    /// Message about an early end of the recording, by damage or an interrupted run.
    cut: Option<String>,
    /// Differences from the machine and files of the recording.
    pub warnings: Vec<String>,
}

impl Replay {
    /// Starts a replay. Call [`Self::follow`] to apply the recorded changes of the graph.
    pub fn start(recording: &Arc<Recording>, options: ReplayOptions) -> Result<Self, ReplayError> {
        let head_of = &recording.head;
        let other = options.graph.is_some();
        let (path, text) = match &options.graph {
            Some((path, text)) => (path.clone(), text.clone()),
            None => (PathBuf::from(&head_of.graph_path), head_of.text.clone()),
        };
        let mut parsed = GraphText::parse(&path, &text);
        let mut settings = if other { Vec::new() } else { head_of.settings.clone() };
        settings.extend(options.settings.iter().cloned());
        for setting in &settings {
            parsed.set(setting);
        }
        let ready = match &options.loader {
            Some(loader) => graph_file::ready_with(&parsed, Arc::clone(loader)),
            None => graph_file::ready(&parsed),
        };
        let mut ready = ready.map_err(ReplayError::Check)?;
        if other {
            // In live mode the packets at `latest` inputs would depend on how fast the recording is read.
            ready.graph.mode = Mode::Batch;
        }
        let (graph, catalog, loader) = (&ready.graph, &ready.catalog, &ready.loader);
        let names = sources(graph, catalog, recording, other)?;
        let overrides = overrides(graph, catalog, &options.settings);
        let mut script = Script::new(Arc::clone(recording), &names, other, !options.act, overrides);
        for (index, edit) in script.edits.iter_mut().enumerate() {
            let catalog = loader.catalog_of_graph(&edit.graph);
            resolve(&mut edit.graph, &catalog).map_err(|cause| ReplayError::Stale { number: index + 1, cause })?;
        }
        let mut warnings = differences(recording, graph, catalog, loader, other);
        if !options.act {
            let skipped = |n: &&panoscope_graph::Node| n.node_type(catalog).side_effects;
            let skipped: Vec<&str> = graph.nodes.iter().filter(skipped).map(|n| n.id.as_str()).collect();
            if !skipped.is_empty() {
                warnings.push(format!("nodes with side effects are skipped: {}", skipped.join(", ")));
            }
        }
        let script = Arc::new(script);
        let recorder = match options.record {
            Some(mut record) => {
                record.all_outputs = head_of.all_ports && !other;
                Some(Recorder::start(record, head(&ready))?)
            }
            None => None,
        };
        let engine_options = Options {
            decider: Some(Arc::clone(&script) as _),
            observer: recorder.clone().map(|recorder| recorder as _),
            ..options.engine
        };
        let live = ready.start(engine_options)?;
        let cut = recording.cut.as_ref().map(|cut| {
            let (file, at, reason) = (recording.path().display(), cut.at, &cut.reason);
            let what = if cut.damaged { "is damaged" } else { "is cut off" };
            format!("{file} {what} at byte {at}: {reason}; only the part before it was replayed")
        });
        Ok(Self { live, script, recorder, cut, warnings })
    }

    /// The engine.
    pub fn engine(&self) -> &Engine {
        self.live.engine()
    }

    /// The recorder of the replay itself.
    pub fn recorder(&self) -> Option<&Arc<Recorder>> {
        self.recorder.as_ref()
    }

    /// Applies the recorded changes at their ticks; returns when all are applied or the replay has ended.
    pub fn follow(&self) -> Result<(), ReplayError> {
        for change in &self.script.changes {
            match change {
                RecordedChange::Set(node, values) => self.engine().know(node, values),
                RecordedChange::Edit(number) => {
                    let graph = self.script.edits[*number].graph.clone();
                    let loader = self.live.loader();
                    let catalog = loader.catalog_of_graph(&graph);
                    match self.engine().apply_as_decided(*number, graph, &catalog, loader) {
                        Ok(_) => {}
                        // The user stopped the replay, or the recording has ended.
                        Err(ApplyError::Ended) => return self.verdict(),
                        Err(cause) => {
                            let error = ReplayError::Edit { number: number + 1, cause };
                            self.script.fail(error.to_string());
                            self.engine().stop();
                            return Err(error);
                        }
                    }
                }
            }
        }
        Ok(())
    }

    /// Whether the whole recording was replayed.
    pub fn verdict(&self) -> Result<(), ReplayError> {
        match self.script.failure() {
            Some(reason) => Err(ReplayError::Incomplete { reason: reason.to_owned() }),
            None => match &self.cut {
                Some(reason) => Err(ReplayError::Incomplete { reason: reason.clone() }),
                None => Ok(()),
            },
        }
    }
}

/// Maps each source of the graph to a recorded source; for the recording's own graph also sources that were added
/// later.
fn sources(
    graph: &Graph,
    catalog: &Catalog,
    recording: &Recording,
    other: bool,
) -> Result<BTreeMap<String, String>, ReplayError> {
    let recorded: Vec<&String> = recording.sources.keys().collect();
    let mut names = BTreeMap::new();
    if !other {
        return Ok(recorded.into_iter().map(|name| (name.clone(), name.clone())).collect());
    }
    let own: Vec<usize> = (0..graph.nodes.len()).filter(|&n| graph.nodes[n].node_type(catalog).source).collect();
    for &node in &own {
        let id = &graph.nodes[node].id;
        let found = match (recording.sources.contains_key(id), own.as_slice(), recorded.as_slice()) {
            (true, _, _) => id.clone(),
            // With one source each, the name does not matter.
            (false, [_], [only]) => (*only).clone(),
            _ => {
                let recorded = list(&recorded);
                return Err(ReplayError::NoSource { node: id.clone(), recorded });
            }
        };
        let has = |port: &str| recording.ports.contains_key(&format!("{found}.{port}"));
        for edge in graph.outputs_of(node) {
            let port = &graph.nodes[node].node_type(catalog).outputs[edge.from_port].name;
            if !has(port) {
                let prefix = format!("{found}.");
                let recorded: Vec<&String> = recording.ports.keys().filter(|p| p.starts_with(&prefix)).collect();
                return Err(ReplayError::NoPort {
                    reader: graph.nodes[edge.to_node].id.clone(),
                    port: format!("{id}.{port}"),
                    recorded: list(&recorded),
                });
            }
        }
        names.insert(id.clone(), found);
    }
    Ok(names)
}

fn list(names: &[&String]) -> String {
    if names.is_empty() {
        return "nothing".to_owned();
    }
    names.iter().map(|n| format!("`{n}`")).collect::<Vec<_>>().join(", ")
}

/// The checked values of `node.param=value` settings: node, position of the parameter, value.
fn overrides(
    graph: &Graph,
    catalog: &Catalog,
    settings: &[String],
) -> Vec<(String, usize, panoscope_graph::ParamValue)> {
    let known = |setting: &String| {
        let (node, param) = setting.split_once('=')?.0.split_once('.')?;
        let node = &graph.nodes[graph.node(node.trim())?];
        let at = node.node_type(catalog).param(param.trim())?;
        Some((node.id.clone(), at, node.params.get(at)?.clone()))
    };
    settings.iter().filter_map(known).collect()
}

/// Finds the types of a recorded graph in this machine's catalogue.
fn resolve(graph: &mut Graph, catalog: &Catalog) -> Result<(), StaleError> {
    for node in &mut graph.nodes {
        let node_type = format!("{}/{}", node.plugin, node.type_name);
        let [index] = catalog.find(&node_type)[..] else {
            return Err(StaleError::UnknownType { node: node.id.clone(), node_type });
        };
        node.type_index = index;
        let declared = &catalog.node_types[index].params;
        let fits = declared.len() == node.params.len()
            && declared.iter().zip(&node.params).all(|(p, v)| p.kind.accepts(v).is_ok());
        if !fits {
            return Err(StaleError::OtherParams { node: node.id.clone(), node_type });
        }
    }
    for edge in &graph.edges {
        let (from, to) = (graph.nodes[edge.from_node].node_type(catalog), graph.nodes[edge.to_node].node_type(catalog));
        if edge.from_port >= from.outputs.len() || edge.to_port >= to.inputs.len() {
            return Err(StaleError::OtherPorts { from: from.name.clone(), to: to.name.clone() });
        }
    }
    Ok(())
}

/// Warnings of differences that may change the bytes of a replay.
fn differences(recording: &Recording, graph: &Graph, catalog: &Catalog, loader: &Loader, other: bool) -> Vec<String> {
    let mut warnings = Vec::new();
    if !recording.checked {
        let version = &recording.head.version;
        warnings.push(format!(
            "the recording has format {}, by panoscope {version}: its events carry no checksums, so damage to them is not noticed",
            recording.head.format
        ));
    }
    if let Some(cut) = recording.cut.as_ref().filter(|cut| !cut.damaged) {
        warnings.push(format!("the recording ends at byte {}: {}; the part before it is replayed", cut.at, cut.reason));
    }
    for (source, ticks) in &recording.sources {
        let gaps = ticks.iter().filter(|t| t.gap).count();
        if gaps > 0 {
            let first = ticks.iter().find(|t| t.gap).map_or(0, |t| t.seq);
            warnings
                .push(format!("{gaps} ticks of `{source}` are missing, the first is {first}: the disk was too slow"));
        }
    }
    if other {
        return warnings;
    }
    let mut now = plugin_hashes(graph, loader);
    now.extend(model_hashes(graph, catalog));
    for recorded in recording.head.plugins.iter().chain(&recording.head.models) {
        match now.iter().find(|n| n.name == recorded.name) {
            Some(file) if file.xxh3 == recorded.xxh3 => {}
            _ => warnings.push(format!("`{}` is not the recorded build or file: bytes may differ", recorded.name)),
        }
    }
    warnings
}
