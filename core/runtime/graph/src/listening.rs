//! Nodes that listen for other programs, and who can reach them.
//!
//! Plugins declare it by the names of parameters, as they declare an emergency stop: a node with `address` and `port`
//! listens there, unless `serve` is false or `role` is `client`; a node with `networks` uses the loopback device, or
//! all networks.

use std::net::IpAddr;

use crate::catalog::{Catalog, NodeType};
use crate::checked::{Graph, Node};
use crate::param::{ParamKind, ParamValue};

/// An option of a command that lets it listen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Listener {
    /// The command with the option.
    pub option: &'static str,
    /// Protocol and purpose.
    pub what: &'static str,
    /// Where it listens when only a port is given, or what an address must be.
    pub default_address: &'static str,
    /// Rights of other programs.
    pub access: &'static str,
}

/// A node that listens.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Listening {
    /// Its name.
    pub node: String,
    /// Name of its type.
    pub type_name: String,
    /// Address `ADDRESS:PORT` on which it listens, or the networks.
    pub at: String,
    /// Whether other machines can reach it.
    pub is_public: bool,
}

impl Listening {
    /// Who can reach it, as text.
    pub fn reach(&self) -> &'static str {
        if self.is_public { "other machines can reach it" } else { "this machine only" }
    }
}

/// Whether an address is one of this machine alone. Names other than `localhost` count as public.
fn is_loopback(address: &str) -> bool {
    address == "localhost" || address.parse::<IpAddr>().is_ok_and(|address| address.is_loopback())
}

fn has(node_type: &NodeType, name: &str, fits: impl Fn(&ParamKind) -> bool) -> bool {
    node_type.params.iter().any(|param| param.name == name && fits(&param.kind))
}

/// Whether nodes of a type can listen.
pub fn can_listen(node_type: &NodeType) -> bool {
    let address = has(node_type, "address", |kind| matches!(kind, ParamKind::Text { .. }));
    let port = has(node_type, "port", |kind| matches!(kind, ParamKind::Int { .. }));
    (address && port) || has(node_type, "networks", |kind| matches!(kind, ParamKind::Choice { .. }))
}

fn listens(node: &Node, node_type: &NodeType) -> Option<Listening> {
    if !can_listen(node_type) {
        return None;
    }
    let value = |name: &str| node.params.get(node_type.param(name)?);
    let is_client = matches!(value("role"), Some(ParamValue::Choice { name, .. }) if name == "client");
    if is_client || matches!(value("serve"), Some(ParamValue::Bool(false))) {
        return None;
    }
    let (at, is_public) = match (value("address"), value("port"), value("networks")) {
        (Some(ParamValue::Text(address)), Some(ParamValue::Int(port)), _) => {
            let at = if address.contains(':') { format!("[{address}]:{port}") } else { format!("{address}:{port}") };
            (at, !is_loopback(address))
        }
        (_, _, Some(ParamValue::Choice { name, .. })) => (format!("{name} networks"), name != "loopback"),
        _ => return None,
    };
    Some(Listening { node: node.id.clone(), type_name: node.type_name.clone(), at, is_public })
}

/// The nodes of a graph that listen, in file order. `catalog` is the one that the graph was checked against.
pub fn listening(graph: &Graph, catalog: &Catalog) -> Vec<Listening> {
    graph.nodes.iter().filter_map(|node| listens(node, node.node_type(catalog))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::param::{Param, Pick};
    use crate::{GraphText, check};

    fn param(name: &str, kind: ParamKind) -> Param {
        Param {
            name: name.to_owned(),
            doc: String::new(),
            unit: String::new(),
            kind,
            reopen: true,
            pick: Pick::None,
            writes: false,
            shipped: false,
        }
    }

    fn choice(name: &str, default: &str, choices: [&str; 2]) -> Param {
        let choices = choices.map(str::to_owned).to_vec();
        param(name, ParamKind::Choice { default: default.to_owned(), choices })
    }

    fn node_type(name: &str, params: Vec<Param>) -> NodeType {
        NodeType { name: name.to_owned(), plugin: "p".to_owned(), source: true, params, ..NodeType::default() }
    }

    #[test]
    fn what_listens_is_found_by_the_names_of_parameters() {
        let address = || param("address", ParamKind::Text { default: "127.0.0.1".to_owned() });
        let port = || param("port", ParamKind::Int { default: 8554, min: None, max: None, step: None });
        let serve = param("serve", ParamKind::Bool { default: true });
        let node_types = vec![
            node_type("stream", vec![address(), port(), serve]),
            node_type("igtl", vec![choice("role", "server", ["server", "client"]), address(), port()]),
            node_type("dds", vec![choice("networks", "loopback", ["loopback", "all"])]),
            node_type("file", vec![address()]),
        ];
        assert_eq!(node_types.iter().map(can_listen).collect::<Vec<_>>(), [true, true, true, false]);
        let catalog = Catalog { plugins: vec!["p".to_owned()], node_types, ..Catalog::default() };
        let text = r#"plugins = ["p"]
[nodes.quiet]
type = "stream"
params = { serve = false }
[nodes.home]
type = "stream"
[nodes.far]
type = "stream"
params = { address = "0.0.0.0", port = 9000 }
[nodes.six]
type = "igtl"
params = { address = "::1" }
[nodes.calls]
type = "igtl"
params = { role = "client", address = "192.0.2.1" }
[nodes.topics]
type = "dds"
[nodes.open_topics]
type = "dds"
params = { networks = "all" }
[nodes.file]
type = "file"
"#;
        let (graph, _) = check(&GraphText::parse("g.toml".as_ref(), text), &catalog).into_result().expect("a graph");
        let found = listening(&graph, &catalog);
        let found: Vec<(&str, &str, bool)> =
            found.iter().map(|one| (one.node.as_str(), one.at.as_str(), one.is_public)).collect();
        let expected = [
            ("home", "127.0.0.1:8554", false),
            ("far", "0.0.0.0:9000", true),
            ("six", "[::1]:8554", false),
            ("topics", "loopback networks", false),
            ("open_topics", "all networks", true),
        ];
        assert_eq!(found, expected);
    }
}
