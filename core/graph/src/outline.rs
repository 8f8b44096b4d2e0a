//! The content of a graph file, right or wrong, for programs that draw it while it is edited.

use crate::catalog::Catalog;
use crate::checked::Align;
use crate::text::GraphText;
use crate::value::plain_table;

/// One node as its table says it; names are not looked up yet.
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
    /// What it is connected to.
    pub from: Vec<Reference>,
}

/// A connection as written.
#[derive(Clone, Debug, PartialEq)]
pub struct Reference {
    /// The producing node.
    pub node: String,
    /// Its output.
    pub port: String,
    /// How it is matched with the other inputs.
    pub align: Align,
    /// 1 for the value of the tick before.
    pub delay: u8,
}

impl GraphText {
    /// The nodes in file order.
    pub fn outline(&self) -> Vec<NodeOutline> {
        let nodes = self.flat.nodes.iter().map(|node| NodeOutline {
            id: node.id.value.clone(),
            type_name: node.type_name.as_ref().map(|t| t.value.clone()).unwrap_or_default(),
            inputs: node
                .inputs
                .iter()
                .map(|input| InputOutline {
                    port: input.port.value.clone(),
                    is_list: input.is_list,
                    from: input
                        .refs
                        .iter()
                        .map(|r| Reference {
                            node: r.node.clone(),
                            port: r.port.clone(),
                            align: r.align,
                            delay: r.delay,
                        })
                        .collect(),
                })
                .collect(),
            params: plain_table(&node.params),
            line: self.sources.line(&node.id.span),
        });
        nodes.collect()
    }

    /// The `[editor]` table as written.
    pub fn editor(&self) -> &toml::Table {
        &self.editor
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
