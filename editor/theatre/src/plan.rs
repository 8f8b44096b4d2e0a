//! What the theatre shows of a graph: its views, the raw view for failures, the pinned settings, the nodes that stop an arm.

use std::path::PathBuf;

use panoscope_editor_model::texts::{Phrase, text};
use panoscope_graph::Param;
use panoscope_graph::edit::{EditError, GraphEdit};
use panoscope_imaging::stereo::length::Noise;
use serde::{Deserialize, Serialize};

use panoscope_editor_model::observe::Output;

/// Parameter of every arm driver; true stops the arm.
pub const EMERGENCY_STOP: &str = "emergency_stop";
/// Parameter of drivers that stay stopped until it changes: a new number releases the arm.
pub const RESET: &str = "reset";
/// A view of the theatre.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Pane {
    /// The output.
    pub output: Output,
    /// Type of its packets.
    pub packet: String,
    /// Its name in English, which names it also inside of the window.
    pub label: String,
    /// The name of the camera whose own image it is, such as `Left`; empty where the graph has one camera only.
    pub camera: Option<String>,
}

impl Pane {
    /// Its title in the language of the window. Names that a graph gives stay as they are.
    pub fn title(&self) -> String {
        match self.camera.as_deref() {
            None => self.label.clone(),
            Some("") => text!("camera-only-name").to_owned(),
            Some(name) => text!("camera-name", name = name),
        }
    }
}

/// A setting that the preset pins.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Setting {
    /// The node.
    pub node: String,
    /// The declaration of its parameter.
    pub param: Param,
    /// Index of the parameter in its node.
    pub index: usize,
    /// Its title.
    pub label: String,
    /// Lowest and highest value offered; `None` for parameters that are not numbers.
    pub range: Option<(f64, f64)>,
}

/// A node that the emergency stop stops.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stop {
    /// The node.
    pub node: String,
    /// Index of [`RESET`] among its parameters; `None` when it has none.
    pub reset: Option<usize>,
}

/// A file that a node writes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Written {
    /// The node.
    pub node: String,
    /// Its file, absolute; may have place holders.
    pub path: PathBuf,
}

/// A node that listens for other programs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Listens {
    /// Its type and where, in words: `stream at 127.0.0.1:8554`.
    pub what: Phrase,
    /// Whether other machines can reach it.
    pub is_public: bool,
}

/// The source of the stereo geometry, for the errors of distances.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RigSource {
    /// The output with the calibration of the points.
    pub calibration: Output,
    /// The uncertainty of the geometry: from a measuring node of the graph, else the usual values.
    #[serde(with = "noise")]
    pub noise: Noise,
}

/// [`Noise`] as numbers: its crate knows no format.
mod noise {
    use panoscope_imaging::stereo::length::Noise;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub fn serialize<S: Serializer>(noise: &Noise, to: S) -> Result<S::Ok, S::Error> {
        let Noise { disparity_px, offset_px, baseline_mm, focal_percent } = *noise;
        [disparity_px, offset_px, baseline_mm, focal_percent].serialize(to)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Noise, D::Error> {
        let [disparity_px, offset_px, baseline_mm, focal_percent] = Deserialize::deserialize(from)?;
        Ok(Noise { disparity_px, offset_px, baseline_mm, focal_percent })
    }
}

/// What the theatre shows of a graph.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// Name of the graph.
    pub name: String,
    /// Views, the most important one first; at least one if the graph has an image.
    pub views: Vec<Pane>,
    /// The raw image of a camera.
    pub raw: Option<Pane>,
    /// The images of all cameras that the graph reads, to detect lost cameras.
    pub cameras: Vec<Pane>,
    /// What the parameters of their sources name as each of the cameras, such as an address; empty where they name none.
    pub camera_sources: Vec<String>,
    /// The outputs that are made of images of cameras, and which of [`Self::cameras`] these are.
    pub cameras_of: Vec<(Output, Vec<usize>)>,
    /// The images of the left and the right eye: of a rectified pair if there is one, else of the cameras.
    pub pair: Option<[Output; 2]>,
    /// The point cloud to measure in.
    pub cloud: Option<Output>,
    /// The confidence of its disparities, where the node that makes it reads one.
    pub confidence: Option<Output>,
    /// The stereo geometry of the cloud.
    pub rig: Option<RigSource>,
    /// Pinned settings.
    pub settings: Vec<Setting>,
    /// Nodes that the emergency stop stops.
    pub stops: Vec<Stop>,
    /// Nodes that listen for other programs.
    pub listening: Vec<Listens>,
    /// Files that nodes write, with place holders such as `{seq}`.
    pub written: Vec<Written>,
    /// Names of sources.
    pub(super) sources: Vec<String>,
}

/// A name as a title: `left_view` becomes `Left view`.
pub(super) fn title(name: &str) -> String {
    let spaced = name.replace(['_', '-'], " ");
    let mut letters = spaced.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

impl Plan {
    /// Whether other machines can reach a node.
    pub fn is_public(&self) -> bool {
        self.listening.iter().any(|one| one.is_public)
    }

    /// Whether a node is a source.
    pub fn is_source(&self, node: &str) -> bool {
        self.sources.iter().any(|s| s == node)
    }

    /// The graph with only its sources, for a raw view when the whole graph cannot run.
    ///
    /// # Errors
    /// The text is not a graph.
    pub fn raw_only(&self, text: &str) -> Result<String, EditError> {
        let mut edit = GraphEdit::parse(text)?;
        for node in edit.node_names() {
            if !self.is_source(&node) {
                edit.remove_node(&node)?;
            }
        }
        Ok(edit.text())
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use panoscope_graph::{Catalog, GraphText, NodeType, PacketType, ParamKind, Pick, Port, check};

    pub(crate) fn port(text: &str) -> Port {
        let (name, packet) = text.split_once(':').unwrap();
        Port {
            name: name.to_owned(),
            packet: PacketType { name: packet.to_owned(), ..PacketType::default() },
            ..Port::default()
        }
    }

    pub(crate) fn node(name: &str, inputs: &[&str], outputs: &[&str]) -> NodeType {
        NodeType {
            name: name.to_owned(),
            plugin: "p".to_owned(),
            source: inputs.is_empty(),
            side_effects: outputs.is_empty(),
            inputs: inputs.iter().map(|t| Port { optional: true, ..port(t) }).collect(),
            outputs: outputs.iter().map(|t| port(t)).collect(),
            ..NodeType::default()
        }
    }

    fn catalog() -> Catalog {
        let stop = Param {
            name: EMERGENCY_STOP.to_owned(),
            doc: String::new(),
            unit: String::new(),
            kind: ParamKind::Bool { default: false },
            reopen: false,
            pick: Pick::None,
            writes: false,
            shipped: false,
        };
        let reset = ParamKind::Int { default: 0, min: None, max: None, step: None };
        let reset = Param { name: RESET.to_owned(), kind: reset, ..stop.clone() };
        let arm =
            NodeType { params: vec![stop, reset], side_effects: true, ..node("arm", &["pose:pose"], &["camera:pose"]) };
        let node_types = vec![
            node("cam", &[], &["left:image", "right:image", "pose:pose"]),
            node("wide", &["l:image", "r:image"], &["panorama:image"]),
            node("points", &["l:image", "trust:confidence"], &["cloud:cloud", "depth:depth"]),
            node("match", &["l:image"], &["trust:confidence"]),
            node("turn", &["cloud:cloud"], &["image:image"]),
            node("write", &["image:image"], &[]),
            arm,
        ];
        Catalog { plugins: vec!["p".to_owned()], node_types, ..Catalog::default() }
    }

    const TEXT: &str = r#"plugins = ["p"]
[nodes.scope]
type = "cam"
[nodes.wide_view]
type = "wide"
inputs = { l = "scope.left", r = "scope.right" }
[nodes.points]
type = "points"
inputs = { l = "scope.left" }
[nodes.turn]
type = "turn"
inputs = { cloud = "points.cloud" }
[nodes.file]
type = "write"
inputs = { image = "wide_view.panorama" }
[nodes.file_2]
type = "write"
inputs = { image = "turn.image" }
[nodes.arm]
type = "arm"
inputs = { pose = "scope.pose" }
"#;

    fn plan(text: &str) -> Plan {
        let catalog = catalog();
        let (graph, _) = check(&GraphText::parse("g.toml".as_ref(), text), &catalog).into_result().unwrap();
        Plan::of(&graph, &catalog)
    }

    fn names(places: &[Pane]) -> Vec<(String, &str)> {
        places.iter().map(|p| (p.output.to_string(), p.label.as_str())).collect()
    }

    #[test]
    fn sensible_views_are_chosen_where_none_are_named() {
        let plan = plan(TEXT);
        let expected = [
            ("points.cloud".to_owned(), "Points"),
            ("wide_view.panorama".to_owned(), "Wide view"),
            ("turn.image".to_owned(), "Turn"),
            ("scope.left".to_owned(), "Left camera"),
        ];
        let mut found = names(&plan.views);
        found.sort();
        let mut sorted = expected.to_vec();
        sorted.sort();
        assert_eq!(found, sorted);
        assert_eq!(plan.raw.as_ref().unwrap().output.to_string(), "scope.left");
        assert_eq!(names(&plan.cameras).len(), 2);
        let eyes = plan.pair.map(|pair| pair.map(|eye| eye.to_string()));
        assert_eq!(eyes, Some(["scope.left".to_owned(), "scope.right".to_owned()]));
        assert_eq!(plan.cloud.as_ref().unwrap().to_string(), "points.cloud");
        assert_eq!(plan.confidence, None);
        let matched = TEXT.replace("[nodes.points]\ntype = \"points\"\ninputs = {", "[nodes.m]\ntype = \"match\"\ninputs = { l = \"scope.left\" }\n[nodes.points]\ntype = \"points\"\ninputs = { trust = \"m.trust\",");
        assert_eq!(self::plan(&matched).confidence, Some(Output::new("m", "trust")));
        let made_of =
            |output: &str| plan.cameras_of.iter().find(|(o, _)| o.to_string() == output).map(|(_, of)| &of[..]);
        assert_eq!(made_of("wide_view.panorama"), Some(&[0, 1][..]));
        assert_eq!((made_of("turn.image"), made_of("scope.right")), (Some(&[0][..]), Some(&[1][..])));
        assert_eq!(plan.stops, [Stop { node: "arm".to_owned(), reset: Some(1) }]);
    }

    #[test]
    fn cameras_of_several_sources_have_names_of_their_own() {
        let two = TEXT.replace("[nodes.points]", "[nodes.second]\ntype = \"cam\"\n[nodes.points]");
        let two = two.replace("inputs = { l = \"scope.left\" }", "inputs = { l = \"second.left\" }");
        let labels: Vec<String> = plan(&two).cameras.into_iter().map(|c| c.label).collect();
        assert_eq!(labels, ["Scope left camera", "Right camera", "Second left camera"]);
    }

    #[test]
    fn each_camera_has_the_source_that_the_parameters_name() {
        let text = |name: &str| Param {
            name: name.to_owned(),
            doc: String::new(),
            unit: String::new(),
            kind: ParamKind::Text { default: String::new() },
            reopen: true,
            pick: Pick::File,
            writes: false,
            shipped: false,
        };
        let mut catalog = catalog();
        catalog.node_types[0].params = vec![text("left"), text("right"), text("views")];
        let sources = |params: &str| {
            let text = TEXT.replace("type = \"cam\"", &format!("type = \"cam\"\nparams = {{ {params} }}"));
            let (graph, _) = check(&GraphText::parse("g.toml".as_ref(), &text), &catalog).into_result().unwrap();
            Plan::of(&graph, &catalog).camera_sources
        };
        assert_eq!(sources("left = \"udp://a\", right = \"udp://b\""), ["udp://a", "udp://b"]);
        assert_eq!(sources("views = \"0; 2\""), ["0", "2"]);
        assert_eq!(sources("left = \"0\""), ["0", "0"], "one source for both eyes");
        assert_eq!(plan(TEXT).camera_sources, ["", ""]);
    }

    #[test]
    fn files_that_nodes_write_are_known() {
        let mut catalog = catalog();
        let writer = catalog.node_types.iter_mut().find(|node| node.name == "write").unwrap();
        let kind = ParamKind::Path { default: "out/film.mkv".to_owned(), must_exist: false };
        writer.params = vec![Param {
            name: "path".to_owned(),
            doc: String::new(),
            unit: String::new(),
            kind,
            reopen: true,
            pick: Pick::None,
            writes: true,
            shipped: false,
        }];
        let text = TEXT.replace(
            "inputs = { image = \"turn.image\" }",
            "inputs = { image = \"turn.image\" }\nparams = { path = \"x_{seq}.png\" }",
        );
        let (graph, _) = check(&GraphText::parse("/case/g.toml".as_ref(), &text), &catalog).into_result().unwrap();
        let written = Plan::of(&graph, &catalog).written;
        let found: Vec<(&str, &str)> =
            written.iter().map(|one| (one.node.as_str(), one.path.to_str().unwrap())).collect();
        assert_eq!(found, [("file", "/case/out/film.mkv"), ("file_2", "/case/x_{seq}.png")]);
    }

    #[test]
    fn named_views_are_taken_as_they_are() {
        let plan =
            plan(&format!("{TEXT}[preset]\nviews = [\"turn.image\", {{ from = \"scope.right\", label = \"Raw\" }}]\n"));
        assert_eq!(names(&plan.views), [("turn.image".to_owned(), "Turn"), ("scope.right".to_owned(), "Raw")]);
        let eyes = self::plan(&format!("{TEXT}[preset]\nviews = [\"scope.left\", \"scope.right\"]\n")).views;
        let labels: Vec<String> = eyes.into_iter().map(|view| view.label).collect();
        assert_eq!(labels, ["Scope left", "Scope right"]);
    }

    #[test]
    fn the_raw_graph_has_sources_only() {
        let plan = plan(TEXT);
        let text = plan.raw_only(TEXT).unwrap();
        let left = GraphText::parse("g.toml".as_ref(), &text);
        let nodes: Vec<String> = left.outline().into_iter().map(|n| n.id).collect();
        assert_eq!(nodes, ["scope"]);
        assert!(check(&left, &catalog()).graph.is_some());
    }
}
