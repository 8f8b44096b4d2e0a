//! What plugins offer, as plain data: the graph checker, the JSON Schema, `panoscope list` and the editor all read this.
//! The runtime fills it from loaded plugins; tests write it by hand.

use crate::check::{Fit, fit};
use crate::validate::Validator;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Every node type known on this machine, with the plugins that could not be used and why.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Catalog {
    /// Names of the plugins that can be used, with or without node types of their own.
    pub plugins: Vec<String>,
    /// Node types of all usable plugins. Two plugins may offer the same name; a graph then writes `plugin/type`.
    pub node_types: Vec<NodeType>,
    /// Plugins that were found (or named) but cannot be used. Reported at the `plugins` entry that names them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub problems: Vec<PluginProblem>,
    /// Node types of plugins that were found and not loaded, by name only: they tell which plugin a graph forgot to list.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub offers: Vec<Offer>,
}

/// What a plugin that is not loaded offers.
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

/// Why a plugin cannot be used: another ABI, a missing or unreadable file.
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

/// How the scheduler runs a node.
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
    /// How it is scheduled.
    #[serde(default)]
    pub kind: NodeKind,
    /// Makes ticks of its own; may still have inputs.
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
    /// What the node itself checks about its parameters and wiring; it is not written out.
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
    /// What flows through it.
    pub packet: PacketType,
    /// Input that may stay unconnected (`Option` in Rust). Meaningless for outputs.
    #[serde(default)]
    pub optional: bool,
    /// Input that takes several connections. Meaningless for outputs.
    #[serde(default)]
    pub list: bool,
}

/// Type of a packet.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PacketType {
    /// `image`, `disparity`, ... or the name of a plugin's own type. An input called `any` accepts every packet.
    pub name: String,
    /// Pixel formats that an input accepts or an output may send (`gray8`, `bgr8`, `rgba8`, `gray16`, `f32`);
    /// empty means any. Used for images only.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub formats: Vec<String>,
    /// Hash of the memory layout; compared when an edge is wired. 0 means "not stated" and is not compared.
    #[serde(default)]
    pub layout_hash: u64,
}

impl PacketType {
    /// An input of this packet name accepts every packet (previews, recorders).
    pub const ANY: &'static str = "any";

    /// Whether an output of this type may be wired to an input of type `input`; if not, the error says why, in one sentence.
    pub fn fits(&self, input: &PacketType) -> Result<(), String> {
        match fit(self, input) {
            Fit::Yes | Fit::Convert => Ok(()),
            Fit::Type => Err(format!("this input takes {}, that is {}", input.name, self.name)),
            Fit::Format => {
                let (sent, taken) = (self.formats.join(", "), input.formats.join(" or "));
                Err(format!("this input takes {} as {taken}, that is {sent}", input.name))
            }
            Fit::Layout => Err(format!("both are {}, laid out differently: rebuild one of the plugins", self.name)),
        }
    }
}

/// A parameter of a node type.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Param {
    /// Name used under `params`.
    pub name: String,
    /// Documentation.
    #[serde(default)]
    pub doc: String,
    /// Unit such as `px`, `mm`, `ms`; empty for none.
    #[serde(default)]
    pub unit: String,
    /// Type, default and limits.
    #[serde(flatten)]
    pub kind: ParamKind,
    /// A change reopens the node instead of being applied between two ticks.
    #[serde(default)]
    pub reopen: bool,
    /// How a person picks the value, besides typing it.
    #[serde(default, skip_serializing_if = "Pick::is_none")]
    pub pick: Pick,
    /// The node writes the file that the path names. The path may hold place holders such as `{seq}`.
    #[serde(default, skip_serializing_if = "is_false")]
    pub writes: bool,
    /// The default of the path is relative to [`NodeType::shipped_dir`] and not to the graph file.
    #[serde(default, skip_serializing_if = "is_false")]
    pub shipped: bool,
}

fn is_false(flag: &bool) -> bool {
    !flag
}

/// How a person picks a value, besides typing it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Pick {
    /// In no way of its own.
    #[default]
    None,
    /// Points of a picture in px: u, v, u, v, ... The picture is the first one that the node reads, or the first one that a source makes.
    Points,
    /// Rectangles of such a picture in px: x, y, width, height, ...
    Rectangles,
    /// A file or folder, relative to the graph file.
    File,
}

impl Pick {
    /// Whether there is no way of its own.
    pub fn is_none(&self) -> bool {
        *self == Self::None
    }

    /// Numbers of one point or rectangle; 0 for the others.
    pub fn stride(self) -> usize {
        match self {
            Self::Points => 2,
            Self::Rectangles => 4,
            Self::None | Self::File => 0,
        }
    }

    /// For `describe` and the schema; empty for [`Self::None`].
    pub fn words(self) -> &'static str {
        match self {
            Self::None => "",
            Self::Points => "points of the picture: u, v, u, v, ...",
            Self::Rectangles => "rectangles of the picture: x, y, width, height, ...",
            Self::File => "may name a file",
        }
    }
}

/// Type, default and limits of a parameter. A missing limit means unbounded on that side.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
pub enum ParamKind {
    /// true or false.
    Bool {
        /// Value when the graph says nothing.
        default: bool,
    },
    /// Whole number; with a step, allowed values are `min + k * step` (`k * step` without a minimum).
    Int {
        /// Value when the graph says nothing.
        default: i64,
        /// Smallest allowed value.
        #[serde(default)]
        min: Option<i64>,
        /// Largest allowed value.
        #[serde(default)]
        max: Option<i64>,
        /// Distance between allowed values.
        #[serde(default)]
        step: Option<i64>,
    },
    /// Finite number. The step is a hint for sliders, not a constraint.
    Float {
        /// Value when the graph says nothing.
        default: f64,
        /// Smallest allowed value.
        #[serde(default)]
        min: Option<f64>,
        /// Largest allowed value.
        #[serde(default)]
        max: Option<f64>,
        /// Slider step.
        #[serde(default)]
        step: Option<f64>,
    },
    /// One of a fixed list of words.
    Choice {
        /// Value when the graph says nothing.
        default: String,
        /// Allowed words.
        choices: Vec<String>,
    },
    /// Free text.
    Text {
        /// Value when the graph says nothing.
        default: String,
    },
    /// File or folder, relative to the graph file. Empty means "not set".
    Path {
        /// Value when the graph says nothing; relative to the graph file too, unless [`Param::shipped`].
        default: String,
        /// It must exist when the graph is checked.
        #[serde(default)]
        must_exist: bool,
    },
    /// List of finite numbers, such as points or a rectangle.
    Floats {
        /// Value when the graph says nothing.
        default: Vec<f64>,
        /// Fewest numbers.
        #[serde(default)]
        min_len: usize,
        /// Most numbers; `None` for no limit.
        #[serde(default)]
        max_len: Option<usize>,
    },
}

impl ParamKind {
    /// The type in words for messages: `a whole number`, `true or false`, ...
    pub fn expected(&self) -> &'static str {
        match self {
            Self::Bool { .. } => "true or false",
            Self::Int { .. } => "a whole number",
            Self::Float { .. } => "a number",
            Self::Choice { .. } => "one of a list of words",
            Self::Text { .. } => "a text in quotes",
            Self::Path { .. } => "a path in quotes",
            Self::Floats { .. } => "a list of numbers",
        }
    }
}
