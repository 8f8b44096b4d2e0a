//! Makes the head of a recording: the graph, its files and the machine.

use panoscope_graph::{Catalog, Graph, ParamKind, ParamValue};

use crate::file_hash::{FileHash, hash, hashes};
use crate::format::{FORMAT, Head};
use panoscope_engine::Machine;
use panoscope_engine::Plugins;
use panoscope_engine::fault::unix_ms;
use panoscope_host::loader::Loader;
use panoscope_host::loader::graph_file::Ready;

/// Hashes of the files of a graph's plugins.
pub(crate) fn plugin_hashes(graph: &Graph, loader: &Loader) -> Vec<FileHash> {
    hashes(&loader.files(&graph.plugins))
}

/// Hashes of the files that parameters name and that must exist.
pub(crate) fn model_hashes(graph: &Graph, catalog: &Catalog) -> Vec<FileHash> {
    let mut models = Vec::new();
    for node in &graph.nodes {
        for (param, value) in node.node_type(catalog).params.iter().zip(&node.params) {
            if let (ParamKind::Path { must_exist: true, .. }, ParamValue::Path(file)) = (&param.kind, value)
                && !file.as_os_str().is_empty()
            {
                models.push(hash(&format!("{}.{}", node.id, param.name), file));
            }
        }
    }
    models
}

/// Makes the head of a recording of a graph. Its text holds all parts, arguments and overlays, so that the recording
/// needs no other file.
pub fn head(ready: &Ready) -> Head {
    let Ready { text, graph, catalog, loader, .. } = ready;
    let whole = std::path::absolute(text.path()).unwrap_or_else(|_| text.path().to_owned());
    Head {
        format: FORMAT,
        version: env!("CARGO_PKG_VERSION").to_owned(),
        graph_path: whole.display().to_string(),
        text: text.flattened(catalog).into_owned(),
        settings: text.settings(),
        graph: graph.clone(),
        plugins: plugin_hashes(graph, loader),
        models: model_hashes(graph, catalog),
        machine: Machine::here(std::thread::available_parallelism().map_or(1, usize::from)),
        unix_ms: unix_ms(),
        all_ports: false,
    }
}
