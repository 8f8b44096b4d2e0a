//! `panoscope check` opens models, each in a separate process, see [`panoscope_host::loader::trial`].

use std::path::Path;

use panoscope_graph::{Diagnostics, GraphText, Severity};
use panoscope_host::loader::graph_file::Ready;
use panoscope_host::loader::trial::{is_model, try_node};

/// Start of the message of a node that found no ONNX Runtime.
const NO_RUNTIME: &str = "ONNX Runtime's shared library";

/// Opens the nodes of a checked graph that read a network from a file.
pub fn check(path: &Path, text: &GraphText, ready: &Ready) -> Diagnostics {
    let mut all = Diagnostics::default();
    let folder = path.parent().unwrap_or(Path::new(""));
    for (index, node) in ready.graph.nodes.iter().enumerate() {
        let params = node.node_type(&ready.catalog).params.iter().zip(&node.params);
        let mut models = params.filter(|(param, value)| is_model(&param.name, value));
        let Some((param, _)) = models.next() else { continue };
        let refused = match try_node(&ready.graph, index, &ready.catalog, &ready.loader, folder) {
            Ok(()) => continue,
            Err(refused) => refused.to_string(),
        };
        // The graph may be right where the library is.
        let (severity, code) = match refused.starts_with(NO_RUNTIME) {
            true => (Severity::Warning, "model-unchecked"),
            false => (Severity::Error, "model-refused"),
        };
        let message = format!("`{}` of `{}` ({}) cannot be used: {refused}", param.name, node.id, node.type_name);
        let help = if severity == Severity::Error {
            "name a model that this node reads; see `panoscope describe`"
        } else {
            "the model was not looked at"
        };
        all.extend(text.about_param(severity, code, (&node.id, &param.name), message, help));
    }
    all
}
