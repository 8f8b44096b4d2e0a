//! Which packet type each recorded port has. Packets store their format, not their type: the plugins of the recorded
//! graph name it.

use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use panoscope_graph::{Catalog, Graph, GraphText};
use panoscope_host::loader::Loader;

use crate::format::{Event, Head};
use crate::recording::Recording;

/// A port whose type is not known.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PortTypeError {
    /// No graph of the recording has the node.
    #[error("the recorded graph has no node `{node}`; record again")]
    Node {
        /// The node.
        node: String,
    },
    /// The plugin of the node cannot be used here.
    #[error("plugin `{plugin}` names the type of packets of `{port}`, and cannot be used here: {reason}")]
    Plugin {
        /// The plugin.
        plugin: String,
        /// The port.
        port: String,
        /// Reason.
        reason: String,
    },
    /// The plugin is of another version.
    #[error("type `{node_type}` has no output `{output}` here; use the plugins of the recording")]
    Output {
        /// The node type.
        node_type: String,
        /// The output.
        output: String,
    },
}

/// The folders with plugins that the recorded graph names. Loading one of these plugins runs its code.
pub fn own_folders(head: &Head) -> Vec<PathBuf> {
    GraphText::parse(Path::new(&head.graph_path), &head.text).plugin_paths()
}

/// The packet types of the ports of a recording. Plugins are loaded with the first request.
pub struct PortTypes {
    recording: Arc<Recording>,
    loader: Loader,
    /// Catalogues of [`Self::graphs`].
    catalogs: Vec<OnceLock<Catalog>>,
}

impl PortTypes {
    /// The types by the plugins of `loader`.
    pub fn new(recording: Arc<Recording>, loader: Loader) -> Self {
        let catalogs = graphs(&recording).map(|_| OnceLock::new()).collect();
        Self { recording, loader, catalogs }
    }

    /// The recording.
    pub fn recording(&self) -> &Recording {
        &self.recording
    }

    /// Name of the packet type of `port`, which is `node.output`.
    ///
    /// # Errors
    /// The recording has no such node, or its plugin is missing or differs.
    pub fn packet(&self, port: &str) -> Result<&str, PortTypeError> {
        let (node, output) = port.rsplit_once('.').unwrap_or((port, ""));
        let mut result = Err(PortTypeError::Node { node: node.to_owned() });
        // Nodes of several types may have had the name, one after the other.
        for (graph, catalog) in graphs(&self.recording).zip(&self.catalogs) {
            if let (Err(_), Some(index)) = (&result, graph.node(node)) {
                result = self.packet_of(port, output, graph, catalog, index);
            }
        }
        result
    }

    /// As [`Self::packet`], for node `index` of one of the graphs.
    fn packet_of<'t>(
        &'t self,
        port: &str,
        output: &str,
        graph: &Graph,
        catalog: &'t OnceLock<Catalog>,
        index: usize,
    ) -> Result<&'t str, PortTypeError> {
        let catalog = catalog.get_or_init(|| self.loader.catalog_of_graph(graph));
        let plugin = &graph.nodes[index].plugin;
        let node_type = format!("{plugin}/{}", graph.nodes[index].type_name);
        let [only] = catalog.find(&node_type)[..] else {
            let reason = catalog.problem(plugin).map_or_else(
                || "it was not found; install it, or name its folder in PANOSCOPE_PLUGIN_PATH".to_owned(),
                |problem| {
                    [&problem.message[..], &problem.help]
                        .into_iter()
                        .filter(|words| !words.is_empty())
                        .collect::<Vec<_>>()
                        .join("; ")
                },
            );
            return Err(PortTypeError::Plugin { plugin: plugin.clone(), port: port.to_owned(), reason });
        };
        let outputs = &catalog.node_types[only];
        match outputs.output(output) {
            Some(at) => Ok(&outputs.outputs[at].packet.name),
            None => Err(PortTypeError::Output { node_type, output: output.to_owned() }),
        }
    }
}

/// The recorded graph and its changed versions.
fn graphs(recording: &Recording) -> impl Iterator<Item = &Graph> {
    let changed = recording.events.iter().filter_map(|event| match event {
        Event::Edit { graph, .. } => Some(graph.as_ref()),
        _ => None,
    });
    std::iter::once(&recording.head.graph).chain(changed)
}
