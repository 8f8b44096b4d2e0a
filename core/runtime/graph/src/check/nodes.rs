//! Checks by the nodes themselves, and of the folders in which plugins are searched.

use super::Checker;
use crate::catalog::NodeType;
use crate::checked::Mode;
use crate::diagnostic::Diagnostic;
use crate::file::Supply;
use crate::param::ParamValue;
use crate::validate::{NodeSetup, ParamProblem, Wiring, port_bit};
use std::ops::Range;

impl<'a> Checker<'a> {
    pub(super) fn plugin_paths(&mut self) {
        for path in &self.text.flat.plugin_paths {
            let folder = self.resolve_at(&path.span, &path.value);
            if folder.is_dir() {
                continue;
            }
            let message = match folder.exists() {
                true => format!("`{}` in `plugin_paths` is a file, not a folder", path.value),
                false => format!("`{}` in `plugin_paths` does not exist", path.value),
            };
            self.error("missing-folder", &path.span, message).help(format!(
                "looked for {}; paths are relative to the graph file: correct the entry, or remove it",
                folder.display()
            ));
        }
    }

    /// Asks each node about its values and wiring. Nodes with earlier errors are skipped, because their reports would
    /// only be consequences.
    pub(super) fn nodes(&mut self, params: &[Vec<ParamValue>]) {
        // What cannot be read may be what a node asks for.
        if self.text.incomplete {
            return;
        }
        for (index, params) in params.iter().enumerate() {
            let id = self.id(index);
            // Parameters of a part that is checked alone get their values from its user.
            let open = self.text.is_part() && self.text.flat.params.iter().any(|target| target.node == id);
            if !self.sound[index] || self.doubled.contains(id) || open {
                continue;
            }
            let Some(node_type) = self.type_of(index) else { continue };
            let Some(validator) = &node_type.validator else { continue };
            let wiring = self.wiring(index, node_type);
            let setup = NodeSetup {
                node_id: id,
                params,
                graph_dir: &self.text.sources.first().dir,
                batch: self.text.mode == Mode::Batch,
                wiring: Some(&wiring),
            };
            for problem in validator.problems(&setup) {
                self.node_problem(index, node_type, problem);
            }
        }
    }

    fn wiring(&self, node: usize, node_type: &NodeType) -> Wiring {
        let mut connections = vec![0; node_type.inputs.len()];
        for input in &self.text.flat.nodes[node].inputs {
            if let Some(port) = node_type.input(&input.port.value) {
                // A reference that does not resolve is meant to be a connection all the same.
                let open = usize::from(input.supply == Supply::Open);
                connections[port] = u32::try_from(input.refs.len() + open).unwrap_or(u32::MAX);
            }
        }
        let read = self.links.iter().filter(|l| l.from_node == node).filter_map(|l| l.from_port);
        Wiring { connections, outputs_read: read.fold(0, |bits, port| bits | port_bit(port)) }
    }

    /// Origin of a parameter's value: the last setting of the command line, else the file; `None` when its default
    /// holds.
    pub(super) fn given(&self, node: usize, param: &str) -> Option<&'a Range<usize>> {
        let text = self.text;
        let id = self.id(node);
        let set = text.overrides.iter().rev().find(|o| o.node.value == id && o.param.value == param);
        if let Some(set) = set {
            return Some(&set.value.span);
        }
        let (_, value) = text.flat.nodes[node].params.iter().find(|(key, _)| key.value == param)?;
        Some(&value.span)
    }

    fn node_problem(&mut self, node: usize, node_type: &NodeType, problem: ParamProblem) {
        let name = problem.param.and_then(|p| node_type.params.get(p)).map(|p| p.name.as_str());
        let given = name.and_then(|name| self.given(node, name));
        let span = given.unwrap_or(&self.text.flat.nodes[node].id.span);
        let code = if name.is_some() { "invalid-param" } else { "invalid-node" };
        let mut d = Diagnostic::new(problem.severity, code, self.text.sources.of(span), span, problem.message);
        if let (Some(name), None) = (name, given) {
            d.label(format!("`{name}` has its default"));
        }
        d.help(problem.help);
        self.diagnostics.push(d);
    }
}
