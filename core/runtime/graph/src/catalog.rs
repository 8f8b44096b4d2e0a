//! Catalog of the plugins, as plain data: the graph checker, the JSON Schema, `panoscope list` and the editor all read
//! this. The runtime fills it from loaded plugins; tests write it by hand.

use crate::packet::PacketType;
use crate::param::Param;
use crate::validate::Validator;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Every node type known on this machine, with the plugins that could not be used and why.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Catalog {
    /// Names of the plugins that can be used, with or without node types in them.
    pub plugins: Vec<String>,
    /// Node types of all usable plugins. Two plugins may offer the same name; a graph then writes `plugin/type`.
    pub node_types: Vec<NodeType>,
    /// Plugins that were found (or named) but cannot be used. Reported at the `plugins` entry that names them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub problems: Vec<PluginProblem>,
    /// Files and folders of the search path that another file of a plugin replaces, and folders that are not there; the
    /// plugin's name is empty for a folder. Reported as warnings.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub passed_over: Vec<PluginProblem>,
    /// Node types of plugins that were found and not loaded, by name only, to find the plugin that a graph forgot to
    /// list.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub offers: Vec<Offer>,
}

/// Offer of a plugin that is not loaded.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Offer {
    /// Name of the plugin.
    pub plugin: String,
    /// Names of its node types.
    pub node_types: Vec<String>,
}

impl Catalog {
    /// Whether `plugin` can be used.
    pub fn has_plugin(&self, plugin: &str) -> bool {
        self.plugins.iter().any(|p| p == plugin) || self.node_types.iter().any(|t| t.plugin == plugin)
    }

    /// Plugins that offer a node type called `name` (a bare name, or `plugin/type`) and are not loaded.
    pub fn offering(&self, name: &str) -> Vec<&str> {
        let (plugin, name) = match name.split_once('/') {
            Some((plugin, name)) => (Some(plugin), name),
            None => (None, name),
        };
        let offers = self.offers.iter().filter(|o| plugin.is_none_or(|p| o.plugin == p));
        offers.filter(|o| o.node_types.iter().any(|t| t == name)).map(|o| o.plugin.as_str()).collect()
    }

    /// The problem of `plugin`, if it has one.
    pub fn problem(&self, plugin: &str) -> Option<&PluginProblem> {
        self.problems.iter().find(|p| p.plugin == plugin)
    }

    /// Indices of all node types called `name` (a bare name, or `plugin/type`).
    pub fn find(&self, name: &str) -> Vec<usize> {
        let (plugin, name) = match name.split_once('/') {
            Some((plugin, name)) => (Some(plugin), name),
            None => (None, name),
        };
        let fits = |t: &NodeType| t.name == name && plugin.is_none_or(|p| t.plugin == p);
        (0..self.node_types.len()).filter(|&i| fits(&self.node_types[i])).collect()
    }
}

/// A plugin that cannot be used: another ABI, a missing or unreadable file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PluginProblem {
    /// Name of the plugin as a graph would write it.
    pub plugin: String,
    /// File that was refused, or empty when none was found.
    #[serde(default)]
    pub file: String,
    /// What is wrong, in one sentence; for another ABI it names both numbers.
    pub message: String,
    /// What to do about it; may be empty.
    #[serde(default)]
    pub help: String,
}

/// Scheduling of a node.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum NodeKind {
    /// Runs inline or on the pool; never waits.
    #[default]
    Compute,
    /// May wait (grab, inference, encode): owns a thread.
    Blocking,
    /// Control: owns a thread with real-time priority where allowed.
    Realtime,
}

/// One node type as its plugin describes it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct NodeType {
    /// Name used as `type` in a graph, such as `stereo_bm`.
    pub name: String,
    /// Plugin that offers it.
    pub plugin: String,
    /// Group shown by the editor and by `list`.
    #[serde(default)]
    pub family: String,
    /// Documentation, first line first.
    #[serde(default)]
    pub doc: String,
    /// Its scheduling.
    #[serde(default)]
    pub kind: NodeKind,
    /// Starts ticks; may still have inputs.
    #[serde(default)]
    pub source: bool,
    /// Owns a device, so two instances cannot be open at once.
    #[serde(default)]
    pub exclusive: bool,
    /// Acts on the world (files, motors, windows), so it is used even if nobody reads its outputs.
    #[serde(default)]
    pub side_effects: bool,
    /// Inputs in declaration order.
    #[serde(default)]
    pub inputs: Vec<Port>,
    /// Outputs in declaration order.
    #[serde(default)]
    pub outputs: Vec<Port>,
    /// Parameters in declaration order.
    #[serde(default)]
    pub params: Vec<Param>,
    /// Folder of the files that come with its plugin; empty when it is not known.
    #[serde(default, skip_serializing_if = "is_empty_path")]
    pub shipped_dir: PathBuf,
    /// Program that runs it, if not the one that runs the graph, such as a Python interpreter: its nodes run in a
    /// separate process.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub interpreter: Option<PathBuf>,
    /// The node's own check of its parameters and wiring; not serialized.
    #[serde(skip)]
    pub validator: Option<Validator>,
}

fn is_empty_path(path: &std::path::Path) -> bool {
    path.as_os_str().is_empty()
}

impl NodeType {
    /// Index of the input called `name`.
    pub fn input(&self, name: &str) -> Option<usize> {
        self.inputs.iter().position(|p| p.name == name)
    }

    /// Index of the output called `name`.
    pub fn output(&self, name: &str) -> Option<usize> {
        self.outputs.iter().position(|p| p.name == name)
    }

    /// Index of the parameter called `name`.
    pub fn param(&self, name: &str) -> Option<usize> {
        self.params.iter().position(|p| p.name == name)
    }
}

/// An input or output of a node type.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Port {
    /// Name used in references such as `scope.left`.
    pub name: String,
    /// Documentation.
    #[serde(default)]
    pub doc: String,
    /// Type of its packets.
    pub packet: PacketType,
    /// Input that may stay unconnected (`Option` in Rust). Meaningless for outputs.
    #[serde(default)]
    pub optional: bool,
    /// Input that takes several connections. Meaningless for outputs.
    #[serde(default)]
    pub list: bool,
}
