//! Foreign models are first opened in a separate process, so that a file that exhausts memory, hangs or crashes its
//! reader does so there.
//!
//! The process is that of a group of isolated nodes with one node in it. A run, a window and a live change open a model
//! on trial first, also for an isolated node, because its group has other nodes; `panoscope check` does only the trial.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use panoscope_abi as abi;
use panoscope_engine::isolation::Isolator;
use panoscope_engine::{Engine, Options, Plugins, StartError};
use panoscope_graph::{Catalog, Graph, ParamValue, Preset};

pub use crate::loader::foreign_models::is_model;
use crate::loader::foreign_models::limits;
use crate::loader::search::Loader;

/// A node that did not open on trial.
#[derive(Debug, thiserror::Error)]
pub enum TrialError {
    /// The node refused to open, or its process ended.
    #[error("{reason}")]
    Refused {
        /// The node's message, or the end of its process.
        reason: String,
    },
    /// The trial could not run.
    #[error("{0}")]
    Start(#[from] StartError),
}

/// Plugins whose nodes open without a trial, because they are part of one.
struct OnTrial<'a>(&'a Loader);

impl Plugins for OnTrial<'_> {
    fn entry(&self, plugin: &str, node_type: &str) -> Option<&'static abi::NodeType> {
        self.0.entry(plugin, node_type)
    }

    fn isolator(&self) -> Option<Arc<dyn Isolator>> {
        self.0.isolator()
    }

    fn files(&self, plugins: &[String]) -> Vec<(String, PathBuf)> {
        self.0.files(plugins)
    }
}

/// Opens one node of a checked graph in a separate process and closes it there. `graph_dir` is the folder of the graph.
///
/// # Errors
/// See [`TrialError`].
pub fn try_node(
    graph: &Graph,
    node: usize,
    catalog: &Catalog,
    loader: &Loader,
    graph_dir: &Path,
) -> Result<(), TrialError> {
    let mut alone = graph.nodes[node].clone();
    let models = alone.node_type(catalog).params.iter().zip(&alone.params);
    let models: Vec<PathBuf> = models
        .filter_map(|(param, value)| match value {
            ParamValue::Path(file) if is_model(&param.name, value) => Some(file.clone()),
            _ => None,
        })
        .collect();
    let models: Vec<&Path> = models.iter().map(PathBuf::as_path).collect();
    let limits = limits(&models);
    // Always on this machine: it says whether the file can be read, not whether another machine answers.
    (alone.isolate, alone.machine, alone.cpu) = (Some(format!("trial of {}", alone.id)), None, None);
    let graph =
        Graph { nodes: vec![alone], edges: Vec::new(), order: vec![0], preset: Preset::default(), ..graph.clone() };
    let options = Options {
        frames: Some(1),
        graph_dir: graph_dir.to_owned(),
        open_limit: limits.time,
        group_memory_bytes: limits.memory_bytes,
        keep_group_stderr: true,
        ..Options::default()
    };
    match Engine::start(graph, catalog, &OnTrial(loader), options) {
        Ok(_) => Ok(()),
        Err(StartError::Open { reason, .. }) => Err(TrialError::Refused { reason }),
        Err(other) => Err(other.into()),
    }
}
