//! A graph that passed every check: names resolved to indices, defaults filled in, order known. The runtime builds from
//! this.

use crate::catalog::{Catalog, NodeType};
use crate::param::ParamValue;
use crate::validate::{Wiring, port_bit};
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Behaviour if work arrives faster than it is processed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    /// The newest frame wins; whole ticks are dropped and counted.
    #[default]
    Live,
    /// No frame is lost; sources wait.
    Batch,
}

/// Reaction of the host to a fault of a node.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum OnFault {
    /// Open it again, with back-off.
    #[default]
    Restart,
    /// Skip it: its outputs are empty.
    Bypass,
    /// End the run.
    Stop,
}

/// Matching of an input's packets with the other inputs of the node.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Align {
    /// Same tick on all exact inputs.
    #[default]
    Exact,
    /// Newest value; does not wait.
    Latest,
    /// Closest capture time.
    Nearest {
        /// Maximum difference of capture times, and maximum wait, in ms. More than 0.
        tolerance_ms: f64,
    },
}

impl Align {
    /// The word a graph file uses.
    pub fn word(&self) -> &'static str {
        match self {
            Self::Exact => "exact",
            Self::Latest => "latest",
            Self::Nearest { .. } => "nearest",
        }
    }
}

/// A checked graph. Positions in `nodes` are in file order and are what edges and `order` name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Graph {
    /// Name given by the file, or the stem of the file's name.
    pub name: String,
    /// Live or batch.
    pub mode: Mode,
    /// Plugins the file lists, without repetitions.
    pub plugins: Vec<String>,
    /// Those whose nodes all run in separate processes, see [`crate::GraphText::isolated_plugins`].
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub isolated_plugins: Vec<String>,
    /// Nodes in file order.
    pub nodes: Vec<Node>,
    /// Edges, sorted by (`to_node`, `to_port`, `list_index`).
    pub edges: Vec<Edge>,
    /// Node positions such that every edge without delay goes forward; ties in file order.
    pub order: Vec<usize>,
    /// Parts that a surgeon may change.
    pub preset: Preset,
    /// The `[editor]` table as written; the graph never interprets it.
    pub editor: toml::Table,
}

impl Graph {
    /// Isolates all nodes of some plugins, in `group` where the graph names none. No node of their groups may do what
    /// is denied.
    pub fn isolate_plugins(&mut self, plugins: &[String], group: &str, deny: Deny) {
        let mut groups = Vec::new();
        for node in self.nodes.iter_mut().filter(|node| plugins.contains(&node.plugin)) {
            groups.push(node.isolate.get_or_insert_with(|| group.to_owned()).clone());
        }
        for node in self.nodes.iter_mut().filter(|node| node.isolate.as_ref().is_some_and(|g| groups.contains(g))) {
            node.deny.network |= deny.network;
            node.deny.new_files |= deny.new_files;
        }
    }

    /// Position of the node called `id`.
    pub fn node(&self, id: &str) -> Option<usize> {
        self.nodes.iter().position(|n| n.id == id)
    }

    /// Edges into `node`, sorted by port and list position.
    pub fn inputs_of(&self, node: usize) -> &[Edge] {
        let start = self.edges.partition_point(|e| e.to_node < node);
        let end = self.edges.partition_point(|e| e.to_node <= node);
        &self.edges[start..end]
    }

    /// Which ports of `node`, whose type has `inputs` inputs, are connected.
    pub fn wiring(&self, node: usize, inputs: usize) -> Wiring {
        let mut wiring = Wiring { connections: vec![0; inputs], outputs_read: 0 };
        for edge in self.inputs_of(node) {
            if let Some(count) = wiring.connections.get_mut(edge.to_port) {
                *count += 1;
            }
        }
        self.outputs_of(node).for_each(|e| wiring.outputs_read |= port_bit(e.from_port));
        wiring
    }

    /// Edges out of `node`.
    pub fn outputs_of(&self, node: usize) -> impl Iterator<Item = &Edge> {
        self.edges.iter().filter(move |e| e.from_node == node)
    }
}

/// Denied permissions of the process of a group of isolated nodes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(default)]
pub struct Deny {
    /// Sockets of any kind.
    pub network: bool,
    /// Creating, writing and removing files. Devices are not affected.
    pub new_files: bool,
}

impl Deny {
    /// The words of a graph file.
    pub(crate) const WORDS: [(&str, &str); 2] = [("network", "network"), ("new_files", "new_files")];

    /// Whether everything is allowed.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// Denied permission, as in a graph file.
    pub fn words(&self) -> impl Iterator<Item = &'static str> {
        let all = [(self.network, "network"), (self.new_files, "new_files")];
        all.into_iter().filter_map(|(denied, word)| denied.then_some(word))
    }
}

/// Encoding of pixels for another machine.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Pixels {
    /// Uncompressed.
    #[default]
    Raw,
    /// Compressed without loss: the same bytes arrive.
    Lz4,
    /// Colour images as H.264, with loss; all else as [`Self::Lz4`].
    H264,
}

impl Pixels {
    /// The words of a graph file.
    pub(crate) const WORDS: [(&str, Self); 3] = [("raw", Self::Raw), ("lz4", Self::Lz4), ("h264", Self::H264)];

    /// The value that a word names.
    pub fn named(word: &str) -> Option<Self> {
        Self::WORDS.into_iter().find_map(|(known, pixels)| (known == word).then_some(pixels))
    }

    /// Whether pixels may change on the way.
    pub fn is_lossy(self) -> bool {
        self == Self::H264
    }

    /// The word that a graph file uses.
    pub fn word(self) -> &'static str {
        match self {
            Self::Raw => "raw",
            Self::Lz4 => "lz4",
            Self::H264 => "h264",
        }
    }
}

/// Another machine that nodes run on: an entry of `[machines]`.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Machine {
    /// Name in the graph, and that with which `panoscope serve --name` runs there.
    pub name: String,
    /// Where it listens: `tls/HOST:PORT`, or `tcp/HOST:PORT` without encryption.
    pub address: String,
    /// Encoding of pixels.
    pub pixels: Pixels,
    /// Silence after which the machine counts as lost, ms.
    pub timeout_ms: u32,
    /// Whether addresses without encryption may lead to another machine.
    pub plaintext: bool,
}

impl Machine {
    /// A machine with the default settings and no address.
    pub(crate) fn new(name: &str) -> Self {
        let (name, address) = (name.to_owned(), String::new());
        Self { name, address, pixels: Pixels::default(), timeout_ms: 1000, plaintext: false }
    }
}

/// One node of a checked graph.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Node {
    /// Its name in the file.
    pub id: String,
    /// Position in [`Catalog::node_types`] of the catalog it was checked against.
    pub type_index: usize,
    /// Name of its type, without the plugin.
    pub type_name: String,
    /// Plugin that offers the type.
    pub plugin: String,
    /// Values in the type's declaration order, defaults filled in.
    pub params: Vec<ParamValue>,
    /// Reaction of the host to its faults.
    pub on_fault: OnFault,
    /// Time budget per tick, ms.
    pub budget_ms: Option<f64>,
    /// Maximum rate at which it fires, Hz.
    pub max_rate_hz: Option<f64>,
    /// Core its thread is pinned to.
    pub cpu: Option<u32>,
    /// The group in whose process it runs; `None` for the process of the graph.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub isolate: Option<String>,
    /// Denied permissions of the process of that group.
    #[serde(default, skip_serializing_if = "Deny::is_empty")]
    pub deny: Deny,
    /// The machine that the group runs on, if it is another one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub machine: Option<Machine>,
    /// Bytes of its id in the text.
    pub span: Range<usize>,
    /// Line of its id, from 1.
    pub line: usize,
}

impl Node {
    /// The node's type. The catalog must be the one the graph was checked against.
    pub fn node_type<'c>(&self, catalog: &'c Catalog) -> &'c NodeType {
        &catalog.node_types[self.type_index]
    }
}

/// One connection of a checked graph.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Edge {
    /// Producing node, a position in [`Graph::nodes`].
    pub from_node: usize,
    /// Output, a position in the producer's [`NodeType::outputs`].
    pub from_port: usize,
    /// Consuming node.
    pub to_node: usize,
    /// Input, a position in the consumer's [`NodeType::inputs`].
    pub to_port: usize,
    /// Position in a list input; 0 for others.
    pub list_index: usize,
    /// Matching with the consumer's other inputs.
    pub align: Align,
    /// Maximum age of a packet's oldest light, ms; an older packet counts as absent. Not for `exact`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_age_ms: Option<f64>,
    /// The input only guides a search: its age does not count for the consumer's outputs.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub guide: bool,
    /// Packets that may wait on the edge, at least 1; `None` leaves it to the scheduler.
    pub queue: Option<u32>,
    /// 0, or 1 for the producer's value of the consumer's previous tick.
    pub delay: u8,
    /// The consumer (with only `latest` inputs) fires on this one only.
    pub trigger: bool,
    /// The producer may send bgr8 where the consumer wants gray8: the host converts once per output.
    pub convert: bool,
    /// Bytes of the reference in the text.
    pub span: Range<usize>,
}

/// The `[preset]` table.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Preset {
    /// Settings that stay reachable in the theatre.
    pub pinned: Vec<Pin>,
    /// Outputs that the theatre shows, the most important one first; empty leaves the choice to it.
    pub views: Vec<PresetView>,
}

/// One output that the theatre shows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PresetView {
    /// Node, a position in [`Graph::nodes`].
    pub node: usize,
    /// Output, a position in the type's `outputs`. Its packets can be drawn, see [`PresetView::PACKETS`].
    pub port: usize,
    /// Text shown next to it; the node's name when the file gives none.
    pub label: String,
}

impl PresetView {
    /// Packet types that can be drawn.
    pub const PACKETS: [&str; 6] = ["image", "mask", "disparity", "depth", "confidence", "cloud"];
}

/// One setting a surgeon may touch.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pin {
    /// Node, a position in [`Graph::nodes`].
    pub node: usize,
    /// Parameter, a position in the type's `params`.
    pub param: usize,
    /// Allowed range, inside the parameter's own; `None` for parameters without numbers.
    pub range: Option<(f64, f64)>,
    /// Text shown next to it; the parameter's name when the file gives none.
    pub label: String,
}
