//! The content of a graph file, valid or not, for programs that draw it while it is edited.

use crate::catalog::Catalog;
use crate::checked::Align;
use crate::file::InputText;
use crate::parts::Target;
use crate::source::tidy;
use crate::text::{FileKind, GraphText};
use crate::value::plain_table;
use std::path::{Path, PathBuf};

/// One node as written in its table; names are not resolved yet.
#[derive(Clone, Debug, PartialEq)]
pub struct NodeOutline {
    /// Its name.
    pub id: String,
    /// Its `type` as written; empty when there is none.
    pub type_name: String,
    /// Inputs that are given, in file order.
    pub inputs: Vec<InputOutline>,
    /// Parameters that are given.
    pub params: toml::Table,
    /// Line of its name, from 1.
    pub line: usize,
}

impl NodeOutline {
    /// Position of its type in the catalog's node types, if there is exactly one of that name.
    pub fn type_index(&self, catalog: &Catalog) -> Option<usize> {
        match catalog.find(&self.type_name)[..] {
            [only] => Some(only),
            _ => None,
        }
    }
}

/// One input of a node as written.
#[derive(Clone, Debug, PartialEq)]
pub struct InputOutline {
    /// The input.
    pub port: String,
    /// Written as a list.
    pub is_list: bool,
    /// Its connections.
    pub from: Vec<Reference>,
}

/// A connection as written.
#[derive(Clone, Debug, PartialEq)]
pub struct Reference {
    /// The producing node.
    pub node: String,
    /// Its output.
    pub port: String,
    /// Matching with the other inputs.
    pub align: Align,
    /// 1 for the value of the tick before.
    pub delay: u8,
    /// Part and output that the file names, where the reference goes through a part.
    pub written: Option<(String, String)>,
}

/// A node that is a graph file, and what that file offers.
#[derive(Clone, Debug, PartialEq)]
pub struct PartOutline {
    /// Its name in the flattened graph: `depth/eyes` for part `eyes` of part `depth`.
    pub id: String,
    /// Its file as written.
    pub file: String,
    /// Absolute path of its file; `None` when the file could not be used.
    pub path: Option<PathBuf>,
    /// Inputs that it offers.
    pub inputs: Vec<PartPort>,
    /// Outputs that it offers.
    pub outputs: Vec<PartPort>,
    /// Parameters that it offers.
    pub params: Vec<PartPort>,
    /// Inputs that its user gives; a reference names a node or a part, and not what it stands for.
    pub given: Vec<InputOutline>,
    /// Parameters that its user gives.
    pub given_params: toml::Table,
    /// Line of its name in its user's file, from 1.
    pub line: usize,
}

/// An input, output or parameter of a part.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PartPort {
    /// Its name.
    pub name: String,
    /// Its targets: nodes, or parts of the part, by whole names, with their ports.
    pub targets: Vec<(String, String)>,
}

impl PartOutline {
    /// An input, output or parameter by name.
    pub fn find<'p>(ports: &'p [PartPort], name: &str) -> Option<&'p PartPort> {
        ports.iter().find(|port| port.name == name)
    }
}

/// The entry of a node in a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodeHome {
    /// Absolute path of the file.
    pub file: PathBuf,
    /// Whether the file is the graph file, a part or an overlay.
    pub kind: FileKind,
    /// The node's name in the file.
    pub local: String,
    /// Line of its name, from 1.
    pub line: usize,
}

impl GraphText {
    /// The nodes in file order.
    pub fn outline(&self) -> Vec<NodeOutline> {
        let nodes = self.flat.nodes.iter().map(|node| NodeOutline {
            id: node.id.value.clone(),
            type_name: node.type_name.as_ref().map(|t| t.value.clone()).unwrap_or_default(),
            inputs: node.inputs.iter().map(input).collect(),
            params: plain_table(&node.params),
            line: self.sources.line(&node.id.span),
        });
        nodes.collect()
    }

    /// The parts, those inside a part before it.
    pub fn parts(&self) -> Vec<PartOutline> {
        let ports = |entries: &[(String, Vec<Target>)]| {
            let port = |(name, targets): &(String, Vec<Target>)| PartPort {
                name: name.clone(),
                targets: targets.iter().map(|t| (t.node.clone(), t.port.value.clone())).collect(),
            };
            entries.iter().map(port).collect::<Vec<_>>()
        };
        let parts = self.flat.parts.iter().map(|part| {
            let interface = part.interface.clone().unwrap_or_default();
            PartOutline {
                id: part.node.id.value.clone(),
                file: part.node.part.as_ref().map(|file| file.value.clone()).unwrap_or_default(),
                path: part.interface.as_ref().map(|i| tidy(Path::new(&i.file))),
                inputs: ports(&interface.inputs),
                outputs: ports(&interface.outputs),
                params: ports(&interface.params),
                given: part.node.inputs.iter().map(input).collect(),
                given_params: plain_table(&part.node.params),
                line: self.sources.line(&part.node.id.span),
            }
        });
        parts.collect()
    }

    /// The nodes that use a part's file, given by its absolute path.
    pub fn part_users(&self, file: &Path) -> Vec<String> {
        let parts = self.flat.parts.iter();
        let uses = parts.filter(|p| p.interface.as_ref().is_some_and(|i| tidy(Path::new(&i.file)) == file));
        uses.map(|p| p.node.id.value.clone()).collect()
    }

    /// Where the entry of a node or part is written.
    pub fn node_home(&self, id: &str) -> Option<NodeHome> {
        let node = self.flat.nodes.iter().find(|n| n.id.value == id);
        let node = node.or_else(|| self.flat.part(id).map(|part| &part.node))?;
        let index = self.sources.index(node.id.span.start);
        let kind = match index {
            0 => FileKind::Graph,
            _ if self.overlays.contains(&index) => FileKind::Overlay,
            _ => FileKind::Part,
        };
        let file = tidy(Path::new(&self.sources.of(&node.id.span).name));
        Some(NodeHome { file, kind, local: node.local.clone(), line: self.sources.line(&node.id.span) })
    }

    /// The `[editor]` table as written.
    pub fn editor(&self) -> &toml::Table {
        &self.editor
    }
}

fn input(input: &InputText) -> InputOutline {
    let reference = |r: &crate::file::RefText| Reference {
        node: r.node.clone(),
        port: r.port.clone(),
        align: r.align,
        delay: r.delay,
        written: r.written.clone(),
    };
    InputOutline {
        port: input.port.value.clone(),
        is_list: input.is_list,
        from: input.refs.iter().map(reference).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wrong_file_has_an_outline_too() {
        let text = "[nodes.a]\ntype = \"nothing\"\nparams = { x = 1 }\n\n[nodes.b]\ninputs = { p = \"a.q\", l = [\"c.r\"] }\n[editor]\na = { x = 1, y = 2 }\n";
        let text = GraphText::parse("g.toml".as_ref(), text);
        let nodes = text.outline();
        assert_eq!((nodes[0].id.as_str(), nodes[0].type_name.as_str(), nodes[0].line), ("a", "nothing", 1));
        assert_eq!(nodes[0].params["x"].as_integer(), Some(1));
        assert_eq!((nodes[1].type_name.as_str(), nodes[1].line), ("", 5));
        assert_eq!(nodes[1].inputs[0].from[0].node, "a");
        assert!(nodes[1].inputs[1].is_list && nodes[1].inputs[1].from[0].port == "r");
        assert!(text.editor().contains_key("a"));
        assert_eq!(nodes[0].type_index(&Catalog::default()), None);
    }
}
