//! One file of a graph as read, before any name in it is looked up.

use crate::checked::{Align, Mode, OnFault};
use crate::diagnostic::Diagnostics;
use crate::value::{Spanned, Table};
use std::ops::Range;

/// What one file says.
#[derive(Clone, Debug, Default)]
pub(crate) struct FileText {
    pub(crate) name: Option<Spanned<String>>,
    pub(crate) mode: Mode,
    pub(crate) plugins: Vec<Spanned<String>>,
    pub(crate) plugin_paths: Vec<Spanned<String>>,
    pub(crate) nodes: Vec<NodeText>,
    pub(crate) pins: Vec<PinText>,
    pub(crate) views: Vec<ViewText>,
    pub(crate) editor: toml::Table,
    pub(crate) diagnostics: Diagnostics,
    /// Parts of the file could not be read, so what seems missing may only be unreadable.
    pub(crate) incomplete: bool,
}

#[derive(Clone, Debug)]
pub(crate) struct NodeText {
    pub(crate) id: Spanned<String>,
    pub(crate) type_name: Option<Spanned<String>>,
    /// `type` was given, though not as a text.
    pub(crate) type_broken: bool,
    pub(crate) inputs: Vec<InputText>,
    pub(crate) params: Table,
    pub(crate) on_fault: OnFault,
    pub(crate) budget_ms: Option<f64>,
    pub(crate) max_rate_hz: Option<f64>,
    pub(crate) cpu: Option<u32>,
}

impl NodeText {
    pub(crate) fn new(id: &Spanned<String>) -> Self {
        Self {
            id: id.clone(),
            type_name: None,
            type_broken: false,
            inputs: Vec::new(),
            params: Table::new(),
            on_fault: OnFault::default(),
            budget_ms: None,
            max_rate_hz: None,
            cpu: None,
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
}

#[derive(Clone, Debug)]
pub(crate) struct RefText {
    pub(crate) node: String,
    pub(crate) port: String,
    /// Bytes inside the quotes.
    pub(crate) span: Range<usize>,
    pub(crate) align: Align,
    pub(crate) queue: Option<u32>,
    pub(crate) delay: u8,
    pub(crate) trigger: Option<Range<usize>>,
}

#[derive(Clone, Debug)]
pub(crate) struct PinText {
    pub(crate) param: Spanned<String>,
    pub(crate) range: Option<(Spanned<f64>, Spanned<f64>)>,
    pub(crate) label: Option<String>,
}

/// An entry of `views`.
#[derive(Clone, Debug)]
pub(crate) struct ViewText {
    pub(crate) from: RefText,
    pub(crate) label: Option<String>,
}
