//! Node help with example graphs, and the source of nodes written in Python.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use eframe::egui::Ui;
use panoscope_editor_model::docks::Panel;
use panoscope_editor_model::texts::text;
use panoscope_graph::NodeType;

use super::App;
use crate::panels::node_help::{self, NodeHelpRequest};
use crate::panels::source::{self, SourceFile, SourceRequest};
use panoscope_editor_model::examples;

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
            return self.notify(text!("learn-select"), true);
        };
        let path = self.document.path();
        let examples = examples::of_type(&node_type.name, &examples::folders(path), path);
        self.node_help = Some(NodeHelp { node_type, examples });
        self.docks.open(Panel::Help);
    }

    /// Shows the help of the selected node, or closes it.
    pub(super) fn toggle_node_help(&mut self) {
        let node_type = self.selected().and_then(|node| self.type_of(&node));
        let same = |help: &NodeHelp| node_type.as_ref().is_none_or(|t| t.name == help.node_type.name);
        if self.docks.is_shown(Panel::Help) && self.node_help.as_ref().is_some_and(same) {
            self.node_help = None;
        } else {
            self.show_node_help(self.selected().as_deref());
        }
    }

    /// The help follows the selection.
    pub(super) fn follow_selection(&mut self) {
        let Some(help) = &self.node_help else { return };
        let selected = self.selected();
        let node_type = selected.as_ref().and_then(|node| self.type_of(node));
        if node_type.is_some_and(|node_type| node_type.name != help.node_type.name) {
            self.show_node_help(selected.as_deref());
        }
    }

    /// Draws the help.
    pub(super) fn help_panel(&mut self, ui: &mut Ui) {
        let Some(help) = &self.node_help else { return };
        if let Some(NodeHelpRequest::Open(graph)) = node_help::show(ui, &help.node_type, &help.examples) {
            self.open_graph(&graph);
        }
    }

    /// Opens a graph in a window of its own.
    pub(super) fn open_graph(&mut self, graph: &Path) {
        let program = self.opener.clone().map_or_else(std::env::current_exe, Ok);
        let opened = program.and_then(|program| std::process::Command::new(program).arg(graph).spawn());
        match opened {
            Ok(_) => self.notify(text!("learn-opens", file = graph.display().to_string()), false),
            Err(error) => self.notify(
                text!("learn-not-opened", file = graph.display().to_string(), reason = error.to_string()),
                true,
            ),
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
            let words = text!("learn-source-elsewhere", machine = machine);
            return self.notify(words, true);
        }
        let Some(file) = node.and_then(|node| self.python_file(node)) else {
            return self.notify(text!("learn-no-source"), true);
        };
        match SourceFile::open(&file) {
            Ok(source) => {
                self.source = Some(source);
                self.docks.open(Panel::Source);
            }
            Err(error) => self.notify(error.to_string(), true),
        }
    }

    /// The opened source file.
    pub fn source_file(&self) -> Option<&SourceFile> {
        self.source.as_ref()
    }

    /// Draws the panel of the source.
    pub(super) fn source_panel(&mut self, ui: &mut Ui) {
        let Some(source) = &mut self.source else { return };
        let problem = self.session.status().problem.map(|problem| problem.message);
        match source::show(ui, source, problem.as_deref()) {
            Some(SourceRequest::Save) => match source.save() {
                Ok(()) => {
                    let path = source.path.display().to_string();
                    self.session.reload_plugins();
                    self.notify(text!("learn-source-swapped", file = path), false);
                }
                Err(error) => self.notify(error.to_string(), true),
            },
            Some(SourceRequest::Close) => self.close_source(),
            None => {}
        }
    }

    /// Closes the source; with changes that are not saved only when asked twice.
    pub(super) fn close_source(&mut self) {
        if self.source.as_ref().is_some_and(SourceFile::is_changed) && !self.discards_source {
            self.discards_source = true;
            return self.notify(text!("learn-source-unsaved"), true);
        }
        self.discards_source = false;
        self.source = None;
    }
}
