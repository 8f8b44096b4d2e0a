//! Reads a checked graph for its plan: which outputs are cameras, views, a stereo pair or a surface.

use panoscope_editor_model::texts::phrase;
use panoscope_graph::{Catalog, Edge, Graph, Node, NodeType, Param, ParamKind, ParamValue, PresetView, listening};
use panoscope_imaging::stereo::length::Noise;

use super::plan::{EMERGENCY_STOP, Listens, Pane, Plan, RESET, RigSource, Setting, Stop, Written, title};
use panoscope_editor_model::observe::Output;

/// Maximum number of views when the preset names none.
const MAX_DEFAULT_VIEWS: usize = 4;

impl Plan {
    /// The plan for a checked graph.
    pub fn of(graph: &Graph, catalog: &Catalog) -> Self {
        let wiring = Wiring { graph, catalog };
        let sources = wiring.sources();
        let cameras = wiring.cameras(&sources);
        let raw = cameras.first().cloned().or_else(|| wiring.unread_camera(&sources));
        let views = wiring.views(raw.as_ref());
        let pair = wiring.pair(&sources);
        let cloud = wiring.cloud(&views);
        let shown = views.iter().chain(&cameras).map(|pane| &pane.output).chain(&cloud).chain(pair.iter().flatten());
        let mut outputs: Vec<&Output> = shown.collect();
        outputs.sort_unstable();
        outputs.dedup();
        let cameras_of =
            outputs.into_iter().map(|output| (output.clone(), wiring.cameras_of(&cameras, output))).collect();
        let listening = listening(graph, catalog).into_iter().map(|one| {
            let what = phrase!("listens-node", node = one.type_name, address = one.at);
            Listens { what, is_public: one.is_public }
        });
        Self {
            name: graph.name.clone(),
            camera_sources: cameras.iter().map(|camera| wiring.camera_source(camera)).collect(),
            cameras_of,
            rig: cloud.as_ref().and_then(|cloud| wiring.rig(cloud)),
            confidence: cloud.as_ref().and_then(|cloud| wiring.read_by(&cloud.node, "confidence")),
            settings: wiring.settings(),
            stops: (0..graph.nodes.len()).filter_map(|n| wiring.stop(n)).collect(),
            listening: listening.collect(),
            written: graph.nodes.iter().flat_map(|node| written(node, catalog)).collect(),
            sources: sources.into_iter().map(|n| graph.nodes[n].id.clone()).collect(),
            views,
            raw,
            cameras,
            pair,
            cloud,
        }
    }
}

/// A checked graph; nodes and ports are indices.
#[derive(Clone, Copy)]
struct Wiring<'a> {
    graph: &'a Graph,
    catalog: &'a Catalog,
}

impl<'a> Wiring<'a> {
    fn node_type(self, node: usize) -> &'a NodeType {
        self.graph.nodes[node].node_type(self.catalog)
    }

    fn packet(self, node: usize, port: usize) -> &'a str {
        &self.node_type(node).outputs[port].packet.name
    }

    fn output(self, node: usize, port: usize) -> Output {
        Output::new(&self.graph.nodes[node].id, &self.node_type(node).outputs[port].name)
    }

    fn pane(self, node: usize, port: usize, label: String) -> Pane {
        let packet = self.packet(node, port).to_owned();
        Pane { output: self.output(node, port), packet, label, camera: None }
    }

    /// The nodes that are sources.
    fn sources(self) -> Vec<usize> {
        (0..self.graph.nodes.len()).filter(|&n| self.node_type(n).source).collect()
    }

    /// The images of sources that other nodes read, named after the port; if several sources have the same one, with the source.
    fn cameras(self, sources: &[usize]) -> Vec<Pane> {
        let is_read = |n: usize, port: usize| self.graph.outputs_of(n).any(|e| e.from_port == port);
        let mut cameras: Vec<Pane> = sources
            .iter()
            .flat_map(|&n| (0..self.node_type(n).outputs.len()).map(move |port| (n, port)))
            .filter(|&(n, port)| self.packet(n, port) == "image" && is_read(n, port))
            .map(|(n, port)| self.pane(n, port, self.node_type(n).outputs[port].name.clone()))
            .collect();
        let labels: Vec<String> = cameras.iter().map(|c| c.label.clone()).collect();
        for camera in &mut cameras {
            let alone = labels.iter().filter(|l| **l == camera.label).count() == 1;
            let name = if alone { camera.label.clone() } else { format!("{} {}", camera.output.node, camera.label) };
            camera.label = format!("{} camera", title(&name));
            camera.camera = Some(title(&name));
        }
        cameras
    }

    /// The first image of a source, also if nothing reads it.
    fn unread_camera(self, sources: &[usize]) -> Option<Pane> {
        let first = |n: usize| Some((n, (0..self.node_type(n).outputs.len()).find(|&p| self.packet(n, p) == "image")?));
        let (n, port) = sources.iter().find_map(|n| first(*n))?;
        Some(Pane { camera: Some(String::new()), ..self.pane(n, port, "Camera".to_owned()) })
    }

    /// The views of the preset; without one, surfaces and what sinks read, then the camera `raw`.
    fn views(self, raw: Option<&Pane>) -> Vec<Pane> {
        let preset = self.graph.preset.views.iter();
        let mut views: Vec<Pane> = preset.map(|v| self.pane(v.node, v.port, title(&v.label))).collect();
        // Views of one node that share its name: by their outputs, too.
        let labels: Vec<String> = views.iter().map(|view| view.label.clone()).collect();
        for view in &mut views {
            if labels.iter().filter(|label| **label == view.label).count() > 1 {
                view.label = format!("{} {}", view.label, view.output.port.replace(['_', '-'], " "));
            }
        }
        if !views.is_empty() {
            return views;
        }
        let edges = self.graph.edges.iter().map(|e| (e.from_node, e.from_port, e.to_node));
        let made = edges.filter(|&(from, port, to)| {
            let packet = self.packet(from, port);
            let is_wanted = packet == "cloud" || self.node_type(to).side_effects;
            is_wanted && !self.node_type(from).source && PresetView::PACKETS.contains(&packet)
        });
        for (from, port, _) in made {
            let new = self.pane(from, port, title(&self.graph.nodes[from].id));
            if !views.iter().any(|v| v.output == new.output) && views.len() + 1 < MAX_DEFAULT_VIEWS {
                views.push(new);
            }
        }
        views.extend(raw.filter(|raw| !views.iter().any(|v| v.output == raw.output)).cloned());
        views
    }

    /// The images of both eyes: of the first node that rectifies them, else of a source.
    fn pair(self, sources: &[usize]) -> Option<[Output; 2]> {
        let eye = |n: usize, name: &str| {
            let is_eye =
                |&port: &usize| self.node_type(n).outputs[port].name == name && self.packet(n, port) == "image";
            (0..self.node_type(n).outputs.len()).find(is_eye).map(|port| self.output(n, port))
        };
        let pair_of = |n: usize| Some([eye(n, "left")?, eye(n, "right")?]);
        let rectified = (0..self.graph.nodes.len()).filter(|n| !sources.contains(n)).find_map(pair_of);
        rectified.or_else(|| sources.iter().copied().find_map(pair_of))
    }

    /// The point cloud that is shown, else the first one that is read.
    fn cloud(self, views: &[Pane]) -> Option<Output> {
        let shown = views.iter().find(|v| v.packet == "cloud").map(|v| v.output.clone());
        let read = self.graph.edges.iter().find(|e| self.packet(e.from_node, e.from_port) == "cloud");
        shown.or_else(|| read.map(|e| self.output(e.from_node, e.from_port)))
    }

    /// The calibration behind a point cloud.
    fn rig(self, cloud: &Output) -> Option<RigSource> {
        Some(RigSource { calibration: self.read_by(&cloud.node, "calibration")?, noise: self.noise() })
    }

    /// The output that a node reads as its input of a type.
    fn read_by(self, node: &str, packet: &str) -> Option<Output> {
        let node = self.graph.node(node)?;
        let input = self.node_type(node).inputs.iter().position(|p| p.packet.name == packet)?;
        let wire = self.graph.inputs_of(node).iter().find(|e| e.to_port == input)?;
        Some(self.output(wire.from_node, wire.from_port))
    }

    /// The pinned parameters.
    fn settings(self) -> Vec<Setting> {
        let settings = self.graph.preset.pinned.iter().map(|pin| Setting {
            node: self.graph.nodes[pin.node].id.clone(),
            param: self.node_type(pin.node).params[pin.param].clone(),
            index: pin.param,
            label: title(&pin.label),
            range: pin.range,
        });
        settings.collect()
    }

    /// How a node stops an arm, if it can.
    fn stop(self, node: usize) -> Option<Stop> {
        let params = &self.node_type(node).params;
        let is_stop = |p: &Param| p.name == EMERGENCY_STOP && matches!(p.kind, ParamKind::Bool { .. });
        let is_reset = |p: &Param| p.name == RESET && matches!(p.kind, ParamKind::Int { .. });
        let stop = || Stop { node: self.graph.nodes[node].id.clone(), reset: params.iter().position(is_reset) };
        params.iter().any(is_stop).then(stop)
    }

    /// What the parameters of its source name as a camera; empty without one.
    fn camera_source(self, camera: &Pane) -> String {
        let node = self.graph.nodes.iter().find(|node| node.id == camera.output.node);
        node.and_then(|node| source_of(node, &camera.output.port, self.catalog)).unwrap_or_default()
    }

    /// Indices of the cameras that an output is made of.
    fn cameras_of(self, cameras: &[Pane], output: &Output) -> Vec<usize> {
        let (mut made_of, mut nodes, mut next) = (vec![output.clone()], Vec::new(), 0);
        nodes.extend(self.graph.node(&output.node));
        while let Some(&node) = nodes.get(next) {
            next += 1;
            for Edge { from_node, from_port, .. } in self.graph.inputs_of(node) {
                made_of.push(self.output(*from_node, *from_port));
                if !nodes.contains(from_node) {
                    nodes.push(*from_node);
                }
            }
        }
        (0..cameras.len()).filter(|k| made_of.contains(&cameras[*k].output)).collect()
    }

    /// The uncertainty of the stereo geometry from the parameters of a measuring node; the usual values without one.
    fn noise(self) -> Noise {
        let noise = |n: &Node| {
            let value = |name: &str| match n.params.get(n.node_type(self.catalog).param(name)?)? {
                ParamValue::Float(value) => Some(*value),
                _ => None,
            };
            Some(Noise {
                disparity_px: value("disparity_noise_px")?,
                offset_px: value("disparity_offset_px")?,
                baseline_mm: value("baseline_error_mm")?,
                focal_percent: value("focal_error_percent")?,
            })
        };
        self.graph.nodes.iter().find_map(noise).unwrap_or(Noise::USUAL)
    }
}

/// The files that a node writes.
fn written(node: &Node, catalog: &Catalog) -> Vec<Written> {
    let params = node.node_type(catalog).params.iter().zip(&node.params);
    let paths = params.filter(|(declared, _)| declared.writes).filter_map(|(_, value)| match value {
        ParamValue::Path(path) if !path.as_os_str().is_empty() => Some(path),
        _ => None,
    });
    paths.map(|path| Written { node: node.id.clone(), path: path.clone() }).collect()
}

/// What the parameters of a source name as the camera of an output: its own part of `views`, or the parameter of the output's name. One source that
/// is split serves both eyes.
fn source_of(node: &Node, port: &str, catalog: &Catalog) -> Option<String> {
    let text = |name: &str| match node.params.get(node.node_type(catalog).param(name)?)? {
        ParamValue::Text(text) => Some(text.trim()).filter(|text| !text.is_empty()),
        _ => None,
    };
    let (view, eye) = match port {
        "left" | "view0" => (0, "left"),
        "right" | "view1" => (1, "right"),
        "view2" => (2, ""),
        "view3" => (3, ""),
        _ => return None,
    };
    let listed =
        text("views").and_then(|views| views.split([';', '\n']).map(str::trim).filter(|t| !t.is_empty()).nth(view));
    listed.or_else(|| text(eye)).or_else(|| text("left").filter(|_| view == 1)).map(str::to_owned)
}
