//! A node's own check of its parameters and wiring, before it is opened.
//!
//! This crate knows no plugin: the code that fills a [`Catalog`](crate::Catalog) attaches a [`Validator`] to a node
//! type, and [`check`](crate::check) calls it with the values that the graph gives.

use std::fmt;
use std::path::Path;
use std::sync::Arc;

use crate::diagnostic::Severity;
use crate::param::ParamValue;

/// One node of a graph as its [`Validator`] sees it.
#[derive(Clone, Copy, Debug)]
pub struct NodeSetup<'a> {
    /// Its name in the graph.
    pub node_id: &'a str,
    /// Values in declaration order, defaults filled in; of the declared types and inside their limits.
    pub params: &'a [ParamValue],
    /// Folder of the graph file.
    pub graph_dir: &'a Path,
    /// Whether the graph runs in `batch` mode.
    pub batch: bool,
    /// Its wiring; `None` if unknown.
    pub wiring: Option<&'a Wiring>,
}

/// Which ports of a node are connected.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Wiring {
    /// Number of connections of each input, in declaration order.
    pub connections: Vec<u32>,
    /// Bit `i` is set when output `i` has a reader; outputs above 63 count as read.
    pub outputs_read: u64,
}

/// Bit of an output in [`Wiring::outputs_read`]; 0 for those above 63.
pub(crate) fn port_bit(port: usize) -> u64 {
    u32::try_from(port).ok().and_then(|port| 1_u64.checked_shl(port)).unwrap_or(0)
}

/// A mistake in parameters or wiring that a node reports.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ParamProblem {
    /// Error when the node cannot work at all.
    pub severity: Severity,
    /// The parameter it is about, a position in the type's `params`; `None` for the node as a whole.
    pub param: Option<usize>,
    /// What is wrong, in one sentence.
    pub message: String,
    /// What to do; may be empty.
    pub help: String,
}

type Check = dyn Fn(&NodeSetup<'_>) -> Vec<ParamProblem> + Send + Sync;

/// Checks the parameters and the wiring of a node that is not open.
#[derive(Clone)]
pub struct Validator(Arc<Check>);

impl Validator {
    /// A validator that calls `check`, which opens no device and writes nothing.
    pub fn new(check: impl Fn(&NodeSetup<'_>) -> Vec<ParamProblem> + Send + Sync + 'static) -> Self {
        Self(Arc::new(check))
    }

    /// All mistakes of a node.
    pub fn problems(&self, setup: &NodeSetup<'_>) -> Vec<ParamProblem> {
        (self.0)(setup)
    }

    /// The first error that the values of `setup` have and the values `old` of the running node do not; `None` when the
    /// node may take them.
    pub fn refusal(&self, setup: &NodeSetup<'_>, old: &[ParamValue]) -> Option<String> {
        let errors = |setup: &NodeSetup<'_>| {
            let mut all = self.problems(setup);
            all.retain(|p| p.severity == Severity::Error);
            all
        };
        let new = errors(setup);
        if new.is_empty() {
            return None;
        }
        let known = errors(&NodeSetup { params: old, ..*setup });
        let first = new.into_iter().find(|p| !known.contains(p))?;
        Some(if first.help.is_empty() { first.message } else { format!("{}; {}", first.message, first.help) })
    }
}

impl fmt::Debug for Validator {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Validator")
    }
}

/// Validators are equal, because code is not a part of a node type's description.
impl PartialEq for Validator {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}
