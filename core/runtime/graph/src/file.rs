//! One graph file as parsed, before names are resolved.

use crate::checked::{Align, Deny, Machine, Mode, OnFault};
use crate::diagnostic::Diagnostics;
use crate::value::{Spanned, Table};
use std::ops::Range;

/// Content of one file.
#[derive(Clone, Debug, Default)]
pub(crate) struct FileText {
    pub(crate) name: Option<Spanned<String>>,
    pub(crate) mode: Mode,
    pub(crate) plugins: Vec<Spanned<String>>,
    pub(crate) plugin_paths: Vec<Spanned<String>>,
    /// Plugins and the groups of their nodes.
    pub(crate) isolate: Vec<(Spanned<String>, Spanned<String>)>,
    /// Groups and what their nodes may not do.
    pub(crate) deny: Vec<(Spanned<String>, Deny)>,
    /// Other machines that nodes run on.
    pub(crate) machines: Vec<MachineText>,
    pub(crate) nodes: Vec<NodeText>,
    pub(crate) pins: Vec<PinText>,
    pub(crate) views: Vec<ViewText>,
    pub(crate) editor: toml::Table,
    /// The `[part]` table of a part.
    pub(crate) part: Option<PartText>,
    pub(crate) diagnostics: Diagnostics,
    /// Parts of the file could not be read, so what seems missing may only be unreadable.
    pub(crate) incomplete: bool,
}

/// Relation of a file to the graph.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Role {
    Graph,
    Part,
    Overlay,
}

/// The `[part]` table: what a graph may connect and set. References are `node.port` or `node.param` of the part's own
/// nodes.
#[derive(Clone, Debug, Default)]
pub(crate) struct PartText {
    pub(crate) inputs: Vec<Export>,
    pub(crate) outputs: Vec<Export>,
    pub(crate) params: Vec<Export>,
}

/// A name of a part and what it stands for.
#[derive(Clone, Debug)]
pub(crate) struct Export {
    pub(crate) name: Spanned<String>,
    /// Node and port or parameter; one for an output.
    pub(crate) targets: Vec<(String, Spanned<String>)>,
}

/// An entry of `[machines]`.
#[derive(Clone, Debug)]
pub(crate) struct MachineText {
    pub(crate) name: Spanned<String>,
    /// Its settings; the address is empty where the file gives none.
    pub(crate) machine: Machine,
}

#[derive(Clone, Debug)]
pub(crate) struct NodeText {
    /// Its name in the flattened graph: `depth/match` for node `match` of part `depth`.
    pub(crate) id: Spanned<String>,
    /// Its name in its own file.
    pub(crate) local: String,
    /// The graph file that stands for a node that is a part.
    pub(crate) part: Option<Spanned<String>>,
    pub(crate) type_name: Option<Spanned<String>>,
    /// `type` was given, though not as a text.
    pub(crate) type_broken: bool,
    pub(crate) inputs: Vec<InputText>,
    pub(crate) params: Table,
    pub(crate) on_fault: OnFault,
    pub(crate) budget_ms: Option<f64>,
    pub(crate) max_rate_hz: Option<f64>,
    pub(crate) cpu: Option<u32>,
    /// The group whose process it runs in.
    pub(crate) isolate: Option<Spanned<String>>,
    /// The machine that it runs on.
    pub(crate) on: Option<Spanned<String>>,
}

impl NodeText {
    /// Whether it runs in another process.
    pub(crate) fn is_elsewhere(&self) -> bool {
        self.isolate.is_some() || self.on.is_some()
    }

    pub(crate) fn new(id: &Spanned<String>) -> Self {
        Self {
            id: id.clone(),
            local: id.value.clone(),
            part: None,
            type_name: None,
            type_broken: false,
            inputs: Vec::new(),
            params: Table::new(),
            on_fault: OnFault::default(),
            budget_ms: None,
            max_rate_hz: None,
            cpu: None,
            isolate: None,
            on: None,
        }
    }
}

#[derive(Clone, Debug)]
pub(crate) struct InputText {
    pub(crate) port: Spanned<String>,
    pub(crate) refs: Vec<RefText>,
    /// Bytes of the value, and whether it was written as a list.
    pub(crate) span: Range<usize>,
    pub(crate) is_list: bool,
    /// Part of it could not be read.
    pub(crate) broken: bool,
    pub(crate) supply: Supply,
}

/// Origin of the connections of an input.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Supply {
    /// A file gives them.
    Given,
    /// The input belongs to a part, and the graph does not connect it.
    Unconnected {
        /// Bytes of the part's name in the graph.
        span: Range<usize>,
        part: String,
        input: String,
    },
    /// The input belongs to a part that is checked alone: it counts as connected.
    Open,
}

#[derive(Clone, Debug)]
pub(crate) struct RefText {
    pub(crate) node: String,
    pub(crate) port: String,
    /// Bytes inside the quotes.
    pub(crate) span: Range<usize>,
    pub(crate) align: Align,
    pub(crate) max_age_ms: Option<f64>,
    pub(crate) guide: bool,
    pub(crate) queue: Option<u32>,
    pub(crate) delay: u8,
    pub(crate) trigger: Option<Range<usize>>,
    /// The file names an output of a part; whether that exists is checked where the part names it.
    pub(crate) through_part: bool,
    /// Left out where an overlay replaced the producer and the new one has no such output.
    pub(crate) optional: bool,
    /// The part that an overlay put in the producer's place has no such output.
    pub(crate) absent: bool,
    /// Part and output that the file names, of a reference through a part.
    pub(crate) written: Option<(String, String)>,
}

#[derive(Clone, Debug)]
pub(crate) struct PinText {
    pub(crate) param: Spanned<String>,
    pub(crate) range: Option<(Spanned<f64>, Spanned<f64>)>,
    pub(crate) label: Option<String>,
    /// As [`RefText::optional`].
    pub(crate) optional: bool,
    /// As [`RefText::absent`].
    pub(crate) absent: bool,
}

/// An entry of `views`.
#[derive(Clone, Debug)]
pub(crate) struct ViewText {
    pub(crate) from: RefText,
    pub(crate) label: Option<String>,
}
