//! Playing a recording: its own graph to the byte, or another graph on its pictures.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use panoscope_graph::{Catalog, Diagnostics, Graph, GraphText, Mode, check};

use crate::head::{head, model_hashes, plugin_hashes};
use crate::recorder::{RecordError, RecordOptions, Recorder};
use crate::recording::Recording;
use crate::script::{Script, Step};
use panoscope_engine::ApplyError;
use panoscope_engine::decide::Decider;
use panoscope_engine::{Engine, Options, StartError};
use panoscope_loader::{self as loader, Loader};

/// How a recording is played.
#[derive(Default)]
pub struct ReplayOptions {
    /// Another graph: where it lies, and its text.
    pub graph: Option<(PathBuf, String)>,
    /// `node.param=value`; wins over what was recorded.
    pub settings: Vec<String>,
    /// Nodes with side effects act: files are written, things are moved. Without it they are left out.
    pub act: bool,
    /// Recording of the replay itself, and fingerprints of its ports.
    pub record: Option<RecordOptions>,
    /// Where plugins come from; without it they are searched for.
    pub loader: Option<Arc<Loader>>,
    /// Threads, log and the like.
    pub engine: Options,
}

/// Why a recording was not played, or not to its end.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// The graph has mistakes, here and now.
    #[error("the graph does not fit this machine's plugins and files:\n{}", .0.render(false))]
    Check(Diagnostics),
    /// It did not start.
    #[error(transparent)]
    Start(#[from] StartError),
    /// The recording of the replay could not be written.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// A source of the graph has no ticks in the recording.
    #[error(
        "the graph reads source `{node}`, the recording has {recorded}; rename the node in the graph, or record with it"
    )]
    NoSource {
        /// The source.
        node: String,
        /// What there is.
        recorded: String,
    },
    /// An output of a source is not in the recording.
    #[error("`{reader}` reads `{port}`, which the recording does not hold; it holds {recorded}")]
    NoPort {
        /// The reader.
        reader: String,
        /// The output.
        port: String,
        /// What there is.
        recorded: String,
    },
    /// A recorded change does not fit the plugins of this machine.
    #[error("change {number} of the recording does not fit: {reason}; replay with the plugins of the recording")]
    Stale {
        /// From 1.
        number: usize,
        /// What is missing.
        reason: String,
    },
    /// A recorded change could not be made again.
    #[error("change {number} of the recording could not be made again: {cause}")]
    Edit {
        /// From 1.
        number: usize,
        /// Why.
        cause: ApplyError,
    },
    /// Something in the recording could not be played.
    #[error("{0}")]
    Broken(String),
}

/// A recording being played.
pub struct Replay {
    engine: Engine,
    script: Arc<Script>,
    loader: Arc<Loader>,
    recorder: Option<Arc<Recorder>>,
    /// Where the recording is damaged: what follows was not played.
    damage: Option<String>,
    /// What differs from the machine and files of the recording, in words.
    pub warnings: Vec<String>,
}

impl Replay {
    /// Starts to play. Changes of the graph are made by [`Self::follow`].
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
        let search = || Arc::new(Loader::search(&loader::search_path(&parsed.plugin_paths())));
        let loader = options.loader.clone().unwrap_or_else(search);
        let catalog = loader.catalog(&parsed.plugins());
        let (mut graph, _) = check(&parsed, &catalog).into_result().map_err(ReplayError::Check)?;
        if other {
            // What `latest` meets must not depend on how fast the pictures are read.
            graph.mode = Mode::Batch;
        }
        let names = sources(&graph, &catalog, recording, other)?;
        let overrides = overrides(&graph, &catalog, &options.settings);
        let mut script = Script::new(Arc::clone(recording), &names, other, !options.act, overrides);
        for (index, edit) in script.edits.iter_mut().enumerate() {
            let catalog = loader.catalog(&edit.graph.plugins);
            resolve(&mut edit.graph, &catalog).map_err(|reason| ReplayError::Stale { number: index + 1, reason })?;
        }
        let mut warnings = differences(recording, &graph, &catalog, &loader, other);
        if !options.act {
            let quiet = |n: &&panoscope_graph::Node| n.node_type(&catalog).side_effects;
            let quiet: Vec<&str> = graph.nodes.iter().filter(quiet).map(|n| n.id.as_str()).collect();
            if !quiet.is_empty() {
                warnings.push(format!("nodes that act on the world are left out: {}", quiet.join(", ")));
            }
        }
        let script = Arc::new(script);
        let recorder = match options.record {
            Some(record) => {
                let mut new = head(&graph, &catalog, &loader, &path, &text, &settings);
                new.all_ports = record.all_ports;
                Some(Recorder::start(record, new)?)
            }
            None => None,
        };
        let engine_options = Options {
            decider: Some(Arc::clone(&script) as _),
            observer: recorder.clone().map(|recorder| recorder as _),
            graph_dir: path.parent().unwrap_or(Path::new("")).to_owned(),
            ..options.engine
        };
        let engine = Engine::start(graph, &catalog, &loader, engine_options)?;
        let damage = recording.cut.as_ref().filter(|cut| cut.damaged).map(|cut| {
            let (file, at, reason) = (recording.path().display(), cut.at, &cut.reason);
            format!("{file} is damaged at byte {at}: {reason}; only what is before it was played")
        });
        Ok(Self { engine, script, loader, recorder, damage, warnings })
    }

    /// The engine.
    pub fn engine(&self) -> &Engine {
        &self.engine
    }

    /// The recording of the replay itself.
    pub fn recorder(&self) -> Option<&Arc<Recorder>> {
        self.recorder.as_ref()
    }

    /// Makes the recorded changes at their ticks; returns when all are made or the replay has ended.
    pub fn follow(&self) -> Result<(), ReplayError> {
        for step in &self.script.steps {
            match step {
                Step::Set(node, values) => self.engine.know(node, values),
                Step::Edit(number) => {
                    let graph = self.script.edits[*number].graph.clone();
                    let catalog = self.loader.catalog(&graph.plugins);
                    match self.engine.apply_as_decided(*number, graph, &catalog, &self.loader) {
                        Ok(_) => {}
                        // Stopped by its user, or the recording is over.
                        Err(ApplyError::Ended) => return self.verdict(),
                        Err(cause) => {
                            let error = ReplayError::Edit { number: number + 1, cause };
                            self.script.fail(error.to_string());
                            self.engine.stop();
                            return Err(error);
                        }
                    }
                }
            }
        }
        Ok(())
    }

    /// Whether all was played.
    pub fn verdict(&self) -> Result<(), ReplayError> {
        match self.script.failure() {
            Some(reason) => Err(ReplayError::Broken(reason.to_owned())),
            None => match &self.damage {
                Some(words) => Err(ReplayError::Broken(words.clone())),
                None => Ok(()),
            },
        }
    }
}

/// The recorded source of each source of the graph, and for the recording's own graph of all that came later.
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
            // One source here and one there: the name does not matter.
            (false, [_], [only]) => (*only).clone(),
            _ => {
                let recorded = list(&recorded);
                return Err(ReplayError::NoSource { node: id.clone(), recorded });
            }
        };
        let held = |port: &str| recording.ports.contains_key(&format!("{found}.{port}"));
        for edge in graph.outputs_of(node) {
            let port = &graph.nodes[node].node_type(catalog).outputs[edge.from_port].name;
            if !held(port) {
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

/// The checked values of `node.param=value` settings.
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
fn resolve(graph: &mut Graph, catalog: &Catalog) -> Result<(), String> {
    for node in &mut graph.nodes {
        let name = format!("{}/{}", node.plugin, node.type_name);
        let [index] = catalog.find(&name)[..] else {
            return Err(format!("node `{}` is of type `{name}`, which no plugin here offers", node.id));
        };
        node.type_index = index;
        let declared = &catalog.node_types[index].params;
        let fits = declared.len() == node.params.len()
            && declared.iter().zip(&node.params).all(|(p, v)| p.kind.accepts(v).is_ok());
        if !fits {
            return Err(format!("type `{name}` of node `{}` has other parameters here", node.id));
        }
    }
    for edge in &graph.edges {
        let (from, to) = (graph.nodes[edge.from_node].node_type(catalog), graph.nodes[edge.to_node].node_type(catalog));
        if edge.from_port >= from.outputs.len() || edge.to_port >= to.inputs.len() {
            return Err(format!("type `{}` or `{}` has other ports here", from.name, to.name));
        }
    }
    Ok(())
}

/// Why the bytes of a replay may be others than the recorded run's.
fn differences(recording: &Recording, graph: &Graph, catalog: &Catalog, loader: &Loader, other: bool) -> Vec<String> {
    let mut words = Vec::new();
    if !recording.checked {
        let version = &recording.head.version;
        words.push(format!(
            "the recording is of format {}, by panoscope {version}: its events carry no checksums, damage to them cannot be seen",
            recording.head.format
        ));
    }
    if let Some(cut) = recording.cut.as_ref().filter(|cut| !cut.damaged) {
        words.push(format!("the recording ends at byte {}: {}; what is before it is played", cut.at, cut.reason));
    }
    for (source, ticks) in &recording.sources {
        let gaps = ticks.iter().filter(|t| t.gap).count();
        if gaps > 0 {
            let first = ticks.iter().find(|t| t.gap).map_or(0, |t| t.seq);
            words.push(format!("{gaps} ticks of `{source}` are missing, the first is {first}: the disk was too slow"));
        }
    }
    if other {
        return words;
    }
    let mut now = plugin_hashes(graph, loader);
    now.extend(model_hashes(graph, catalog));
    for then in recording.head.plugins.iter().chain(&recording.head.models) {
        match now.iter().find(|n| n.name == then.name) {
            Some(file) if file.xxh3 == then.xxh3 => {}
            _ => {
                words.push(format!("`{}` is another build or file than the recorded one: bytes may differ", then.name))
            }
        }
    }
    words
}
