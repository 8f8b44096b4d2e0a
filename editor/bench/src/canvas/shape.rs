//! The layout of a node's parts, in points at zoom 1 from the node's upper left corner.

use std::collections::HashSet;

use eframe::egui::{Pos2, Rect, Vec2, pos2, vec2};

use panoscope_editor_model::graph_view::{GraphView, NodeView};
use panoscope_editor_model::observe::Output;
use panoscope_editor_model::picture::is_pictorial;

/// Below this zoom a node shows no names of ports, whose rows would be lower than the text.
pub const PORTS: f32 = 0.7;
/// Below this zoom it shows no ports.
pub const DETAIL: f32 = 0.38;
/// Below this zoom it shows no picture either.
pub const PICTURES: f32 = 0.2;
/// Width of every node.
pub const WIDTH: f32 = 208.0;
/// Height of the header with name and type.
pub const HEADER: f32 = 36.0;
/// Width of the button that opens a part.
pub const OPEN: f32 = 48.0;
const PICTURE: f32 = 120.0;
const WORDS: f32 = 52.0;
const ROW: f32 = 20.0;
const FOOTER: f32 = 28.0;
/// Distance between the parts of a node and its edge.
pub const PAD: f32 = 8.0;
/// Maximum number of unconnected optional inputs, and of unread outputs, that are shown.
const MAX_UNCONNECTED: usize = 3;

/// The pin of a port.
#[derive(Clone, Debug, PartialEq)]
pub struct Pin {
    /// The port's name.
    pub name: String,
    /// Type of its packets; empty when it is not known.
    pub packet: String,
    /// Whether it is an input (left) or an output (right).
    pub input: bool,
    /// Whether it takes several wires.
    pub list: bool,
    /// Whether it must be connected and is not.
    pub missing: bool,
    /// Its centre.
    pub at: Pos2,
}

/// The layout of a node.
#[derive(Clone, Debug)]
pub struct Shape {
    /// Width and height.
    pub size: Vec2,
    /// Rectangle of the preview of [`Self::output`].
    pub picture: Option<Rect>,
    /// The output that is shown, and its packet type.
    pub output: Option<(Output, String)>,
    /// The image on which the boxes of [`Self::output`] are drawn.
    pub backdrop: Option<(Output, String)>,
    /// Inputs, then outputs.
    pub pins: Vec<Pin>,
    /// Number of hidden ports.
    pub folded: usize,
    /// Rectangle of the button that shows or hides ports.
    pub fold: Option<Rect>,
    /// Rectangle of times and rates.
    pub footer: Rect,
}

/// The output that a node shows: the chosen one, else its first image that is read, else another output; for a sink, its input.
pub fn shown_output(view: &GraphView, node: usize, chosen: Option<&str>) -> Option<(Output, String)> {
    let this = &view.nodes[node];
    let of = |node: &NodeView, port: &str| {
        let packet = node.output(port).map(|p| p.packet.name.clone())?;
        Some((view.running_output(node.id(), port), packet))
    };
    if let Some(found) = chosen.and_then(|port| of(this, port)) {
        return Some(found);
    }
    let node_type = this.node_type.as_ref()?;
    let read = |port: &&panoscope_graph::Port| view.wires.iter().any(|w| w.from == node && w.output == port.name);
    let picture = |port: &&panoscope_graph::Port| is_pictorial(&port.packet.name);
    let port = (node_type.outputs.iter().filter(picture).find(read))
        .or_else(|| node_type.outputs.iter().find(read))
        .or_else(|| node_type.outputs.iter().find(picture))
        .or_else(|| node_type.outputs.first());
    if let Some(port) = port {
        return of(this, &port.name);
    }
    let wire = view.wires.iter().find(|w| w.to == node)?;
    of(&view.nodes[wire.from], &wire.output)
}

/// The image that was searched: the image input of a node that shows boxes.
fn backdrop(view: &GraphView, node: usize, packet: &str) -> Option<(Output, String)> {
    if !matches!(packet, "detections" | "instances") {
        return None;
    }
    let wires = view.wires.iter().filter(|w| w.to == node);
    wires.into_iter().find_map(|w| {
        let packet = view.packet(w.from, &w.output).filter(|p| p.name == "image")?;
        Some((view.running_output(view.nodes[w.from].id(), &w.output), packet.name.clone()))
    })
}

impl Shape {
    /// Lays a node out. `unfolded` names nodes that show all their ports.
    pub fn of(view: &GraphView, node: usize, unfolded: &HashSet<String>, chosen: Option<&str>) -> Self {
        let this = &view.nodes[node];
        let output = shown_output(view, node, chosen);
        let backdrop = output.as_ref().and_then(|(_, packet)| backdrop(view, node, packet));
        let mut y = HEADER;
        let picture = output.as_ref().map(|(_, packet)| {
            let height = if is_pictorial(packet) || backdrop.is_some() { PICTURE } else { WORDS };
            let rect = Rect::from_min_size(pos2(PAD, y), vec2(WIDTH - 2.0 * PAD, height));
            y += height + PAD;
            rect
        });
        let (inputs, outputs, folded) = ports(view, node, unfolded.contains(this.id()));
        let mut pins = Vec::with_capacity(inputs.len() + outputs.len());
        for (side, column) in [(true, inputs), (false, outputs)] {
            for (row, mut pin) in column.into_iter().enumerate() {
                pin.at = pos2(if side { 0.0 } else { WIDTH }, y + ROW * (row as f32 + 0.5));
                pins.push(pin);
            }
        }
        let (left, right) = (pins.iter().filter(|p| p.input).count(), pins.iter().filter(|p| !p.input).count());
        let can_fold = folded > 0 || unfolded.contains(this.id());
        let fold =
            can_fold.then(|| Rect::from_min_size(pos2(WIDTH - 96.0 - PAD, y + ROW * right as f32), vec2(96.0, ROW)));
        y += ROW * left.max(right + usize::from(can_fold)) as f32 + PAD / 2.0;
        let footer = Rect::from_min_size(pos2(PAD + 4.0, y), vec2(WIDTH - 2.0 * PAD - 8.0, FOOTER));
        Self { size: vec2(WIDTH, y + FOOTER), picture, output, backdrop, pins, folded, fold, footer }
    }

    /// A pin by name.
    pub fn pin(&self, name: &str, input: bool) -> Option<&Pin> {
        self.pins.iter().find(|p| p.input == input && p.name == name)
    }
}

/// The visible pins of a node: inputs, outputs, and the number of hidden ports.
fn ports(view: &GraphView, node: usize, unfolded: bool) -> (Vec<Pin>, Vec<Pin>, usize) {
    let this = &view.nodes[node];
    let pin = |name: &str, packet: &str, input: bool| Pin {
        name: name.to_owned(),
        packet: packet.to_owned(),
        input,
        list: false,
        missing: false,
        at: Pos2::ZERO,
    };
    let Some(node_type) = &this.node_type else {
        // The node type is not known: show the connected ports.
        let mut outputs: Vec<Pin> = Vec::new();
        for wire in view.wires.iter().filter(|w| w.from == node) {
            if !outputs.iter().any(|p| p.name == wire.output) {
                outputs.push(pin(&wire.output, "", false));
            }
        }
        return (this.outline.inputs.iter().map(|i| pin(&i.port, "", true)).collect(), outputs, 0);
    };
    let is_connected = |name: &str| this.outline.inputs.iter().any(|i| i.port == name && !i.from.is_empty());
    let mut spare = MAX_UNCONNECTED;
    let seen = node_type.inputs.iter().filter(|port| {
        let needed = unfolded || !port.optional || is_connected(&port.name);
        let shown = needed || spare > 0;
        spare -= usize::from(!needed && shown);
        shown
    });
    let inputs: Vec<Pin> = seen
        .map(|port| {
            let connected = is_connected(&port.name);
            let (list, missing) = (port.list, !port.optional && !connected);
            Pin { list, missing, ..pin(&port.name, &port.packet.name, true) }
        })
        .collect();
    let read = |name: &str| view.wires.iter().any(|w| w.from == node && w.output == name);
    let mut free = MAX_UNCONNECTED.saturating_sub(node_type.outputs.iter().filter(|p| read(&p.name)).count());
    let mut outputs = Vec::new();
    for port in &node_type.outputs {
        let shown = unfolded || read(&port.name) || free > 0;
        if shown {
            if !read(&port.name) {
                free = free.saturating_sub(1);
            }
            outputs.push(pin(&port.name, &port.packet.name, false));
        }
    }
    let folded = node_type.outputs.len() - outputs.len() + node_type.inputs.len() - inputs.len();
    (inputs, outputs, folded)
}
