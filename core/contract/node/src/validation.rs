//! A node's own check of its parameters and wiring, before it is opened.

use std::path::Path;

use crate::abi;
use crate::error::NodeError;
use crate::{Node, Params, Ports};

/// The context of one check: takes the problems that the node reports, and provides what the parameters lack, such as
/// the wiring.
///
/// The check runs when a graph is checked and again when the node is opened; the wiring is known only the first time.
pub struct Validation<'a> {
    node_id: &'a str,
    graph_dir: &'a Path,
    flags: u32,
    /// Connections of each input; `None` when the wiring is not known.
    connections: Option<&'a [u32]>,
    outputs_read: u64,
    names: Names,
    report: &'a mut dyn FnMut(Problem<'_>),
}

/// The declarations of the node type, in which names are looked up.
#[derive(Clone, Copy)]
struct Names {
    params: &'static [abi::Param],
    inputs: &'static [abi::Port],
    outputs: &'static [abi::Port],
}

/// One problem, as it is reported to the host.
pub(crate) struct Problem<'a> {
    pub severity: u32,
    pub param: u32,
    pub message: &'a str,
    pub help: &'a str,
}

impl<'a> Validation<'a> {
    /// A check of node type `N`. `wiring`: number of connections of each input, and a bit set of the outputs that are
    /// read, where known.
    pub(crate) fn new<N: Node>(
        node_id: &'a str,
        graph_dir: &'a Path,
        flags: u32,
        wiring: Option<(&'a [u32], u64)>,
        report: &'a mut dyn FnMut(Problem<'_>),
    ) -> Self {
        let names = Names {
            params: <N::Params as Params>::PARAMS,
            inputs: <N::In<'static> as Ports<'static>>::PORTS,
            outputs: <N::Out<'static> as Ports<'static>>::PORTS,
        };
        let (connections, outputs_read) = (wiring.map(|(inputs, _)| inputs), wiring.map_or(0, |(_, outputs)| outputs));
        Self { node_id, graph_dir, flags, connections, outputs_read, names, report }
    }

    /// The node's name in the graph.
    pub fn node_id(&self) -> &'a str {
        self.node_id
    }

    /// Folder of the graph file. `Path` parameters are resolved already.
    pub fn graph_dir(&self) -> &'a Path {
        self.graph_dir
    }

    /// Whether the graph runs in `batch` mode.
    pub fn is_batch(&self) -> bool {
        self.flags & abi::CALL_BATCH != 0
    }

    /// Number of connections of input `name`; `None` when the wiring is not known.
    ///
    /// # Panics
    /// The node has no such input.
    #[track_caller]
    pub fn connections(&self, name: &str) -> Option<usize> {
        let index = position(self.names.inputs.iter().map(|p| p.name), "input", name);
        self.connections.map(|counts| counts.get(index).map_or(0, |count| *count as usize))
    }

    /// Whether input `name` is connected; `None` when the wiring is not known.
    ///
    /// # Panics
    /// The node has no such input.
    #[track_caller]
    pub fn is_connected(&self, name: &str) -> Option<bool> {
        self.connections(name).map(|count| count > 0)
    }

    /// Whether output `name` has a reader; `None` when the wiring is not known.
    ///
    /// # Panics
    /// The node has no such output.
    #[track_caller]
    pub fn is_read(&self, name: &str) -> Option<bool> {
        let index = position(self.names.outputs.iter().map(|p| p.name), "output", name);
        self.connections.map(|_| index >= 64 || self.outputs_read >> index & 1 == 1)
    }

    /// Reports that the node cannot open, or no tick can succeed, because of parameter `param`. `message` says what is
    /// wrong in one sentence, `help` what to do.
    ///
    /// # Panics
    /// The node has no such parameter.
    #[track_caller]
    pub fn error(&mut self, param: &str, message: impl AsRef<str>, help: impl AsRef<str>) {
        let param = self.position(param);
        self.send(abi::PROBLEM_ERROR, param, message.as_ref(), help.as_ref());
    }

    /// Reports that the node works, but probably not as intended, because of parameter `param`.
    ///
    /// # Panics
    /// The node has no such parameter.
    #[track_caller]
    pub fn warning(&mut self, param: &str, message: impl AsRef<str>, help: impl AsRef<str>) {
        let param = self.position(param);
        self.send(abi::PROBLEM_WARNING, param, message.as_ref(), help.as_ref());
    }

    /// Reports that the node cannot work with this wiring, whatever its parameters are.
    pub fn node_error(&mut self, message: impl AsRef<str>, help: impl AsRef<str>) {
        self.send(abi::PROBLEM_ERROR, abi::NO_PARAM, message.as_ref(), help.as_ref());
    }

    /// Reports that the node works with this wiring, but probably not as intended.
    pub fn node_warning(&mut self, message: impl AsRef<str>, help: impl AsRef<str>) {
        self.send(abi::PROBLEM_WARNING, abi::NO_PARAM, message.as_ref(), help.as_ref());
    }

    /// Whether the node has a parameter of that name.
    pub fn has_param(&self, name: &str) -> bool {
        // SAFETY: the derive makes parameter names from static texts.
        self.names.params.iter().any(|p| unsafe { p.name.bytes() } == name.as_bytes())
    }

    #[track_caller]
    fn position(&self, param: &str) -> u32 {
        position(self.names.params.iter().map(|p| p.name), "parameter", param) as u32
    }

    fn send(&mut self, severity: u32, param: u32, message: &str, help: &str) {
        (self.report)(Problem { severity, param, message, help });
    }
}

#[track_caller]
fn position(mut declared: impl Iterator<Item = abi::Str>, what: &str, name: &str) -> usize {
    // SAFETY: the derives make the names of ports and parameters from static texts.
    let found = declared.position(|declared| unsafe { declared.bytes() } == name.as_bytes());
    found.unwrap_or_else(|| panic!("there is no {what} `{name}`"))
}

/// Runs the node's own check before `open`; its errors become one error.
pub(crate) fn refuse_invalid<N: Node>(
    node_id: &str,
    graph_dir: &Path,
    flags: u32,
    params: &N::Params,
) -> Result<(), NodeError> {
    let mut errors: Vec<String> = Vec::new();
    let mut report = |problem: Problem<'_>| {
        if problem.severity == abi::PROBLEM_ERROR {
            let help = if problem.help.is_empty() { String::new() } else { format!("; {}", problem.help) };
            errors.push(format!("{}{help}", problem.message));
        }
    };
    let mut check = Validation::new::<N>(node_id, graph_dir, flags, None, &mut report);
    N::validate(params, &mut check);
    if errors.is_empty() { Ok(()) } else { Err(NodeError::new(errors.join("\n"))) }
}
