//! Node help with example graphs, and the source of nodes written in Python.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use eframe::egui::{Context, Frame, Margin, Panel, Ui};
use panoscope_graph::NodeType;

use super::App;
use crate::panels::node_help::{self, NodeHelpRequest};
use crate::panels::source::{self, SourceFile, SourceRequest};
use panoscope_editor_model::examples;
use panoscope_editor_widgets::theme;

/// The shown help.
pub(super) struct NodeHelp {
    node_type: Arc<NodeType>,
    examples: Vec<PathBuf>,
}

impl App {
    /// The node type of a node.
    fn type_of(&self, node: &str) -> Option<Arc<NodeType>> {
        let view = self.document.view();
        view.node(node).and_then(|n| view.nodes[n].node_type.clone())
    }

    /// Shows the help of a node's type.
    pub(super) fn show_node_help(&mut self, node: Option<&str>) {
        let Some(node_type) = node.and_then(|node| self.type_of(node)) else {
            return self.notify("select one node of a known type for its help", true);
        };
        let path = self.document.path();
        let examples = examples::of_type(&node_type.name, &examples::folders(path), path);
        self.node_help = Some(NodeHelp { node_type, examples });
    }

    /// Draws the help, if it is open.
    pub(super) fn node_help_dialog(&mut self, ctx: &Context) {
        let Some(help) = &self.node_help else { return };
        match node_help::show(ctx, &help.node_type, &help.examples) {
            Some(NodeHelpRequest::Open(graph)) => self.open_graph(&graph),
            Some(NodeHelpRequest::Close) => self.node_help = None,
            None => {}
        }
    }

    /// Opens a graph in a window of its own.
    pub(super) fn open_graph(&mut self, graph: &Path) {
        let program = self.opener.clone().map_or_else(std::env::current_exe, Ok);
        let opened = program.and_then(|program| std::process::Command::new(program).arg(graph).spawn());
        match opened {
            Ok(_) => self.notify(format!("{} opens in its own window", graph.display()), false),
            Err(error) => self.notify(format!("{} could not be opened: {error}", graph.display()), true),
        }
    }

    /// The Python file that a node's type comes from.
    pub(super) fn python_file(&self, node: &str) -> Option<PathBuf> {
        if self.is_attached() {
            return None;
        }
        let plugin = self.type_of(node)?.plugin.clone();
        let loader = self.session.loader();
        let found = loader.found().find(|found| found.note.name == plugin)?;
        found.file.extension().is_some_and(|e| e == "py").then(|| found.file.clone())
    }

    /// Opens the source of a node written in Python beside the graph.
    pub(super) fn open_source(&mut self, node: Option<&str>) {
        if let Some(machine) = self.session.attachment().map(|machine| machine.target().name.clone()) {
            let words = format!("the source of nodes is on `{machine}`, where the graph runs: edit it there");
            return self.notify(words, true);
        }
        let Some(file) = node.and_then(|node| self.python_file(node)) else {
            return self.notify("select one node that is written in Python to see its source", true);
        };
        match SourceFile::open(&file) {
            Ok(source) => self.source = Some(source),
            Err(reason) => self.notify(reason, true),
        }
    }

    /// The opened source file.
    pub fn source_file(&self) -> Option<&SourceFile> {
        self.source.as_ref()
    }

    /// Draws the panel of the source, if it is open.
    pub(super) fn source_panel(&mut self, ui: &mut Ui) {
        let Some(mut source) = self.source.take() else { return };
        let frame = Frame::new().fill(theme::panel()).inner_margin(Margin::symmetric(16, 12));
        let panel = Panel::left("source").frame(frame).default_size(520.0).size_range(260.0..=1100.0);
        let problem = self.session.status().problem.map(|problem| problem.message);
        let request = panel.show(ui, |ui| source::show(ui, &mut source, problem.as_deref())).inner;
        match request {
            Some(SourceRequest::Save) => match source.save() {
                Ok(()) => {
                    self.session.reload_plugins();
                    self.notify(format!("{} is saved and swapped in", source.path.display()), false);
                }
                Err(reason) => self.notify(reason, true),
            },
            Some(SourceRequest::Close) if source.is_changed() && !self.discards_source => {
                self.discards_source = true;
                self.notify("the source is not saved: close it once more to lose the changes", true);
            }
            Some(SourceRequest::Close) => {
                self.discards_source = false;
                return;
            }
            None => {}
        }
        self.source = Some(source);
    }
}
