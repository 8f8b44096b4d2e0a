//! Draws the wires: bundles along lanes and between rows, and the names of those under the pointer.

use eframe::egui::{Painter, Pos2, Rect, Response, Shape as Drawn, Stroke, Ui, Vec2, pos2, vec2};

use super::curve::{bow, distance, flattened, flattened_to, on_curve, rounded};
use super::interaction::Drag;
use super::shape::{HEADER, PICTURES};
use super::{Canvas, Scene};
use panoscope_editor_model::graph_view::{GraphView, Wire};
use panoscope_editor_widgets::theme;

/// Distance between a backward wire and the nodes above it, points at zoom 1.
const BELOW: f32 = 20.0;
/// Distance between the wires of a bundle, and its greatest width.
const BESIDE: f32 = 5.0;
const BUNDLE: f32 = 15.0;
/// Distance from the pointer within which wires are named, in points of the window.
const NEAR: f32 = 6.0;
/// Maximum number of wires that are named at once.
const NAMED: usize = 12;

impl Canvas {
    /// Position of a pin in the window, and its packet type.
    pub(super) fn pin_at(&self, view: &GraphView, node: usize, port: &str, input: bool) -> Option<(Pos2, String)> {
        let shape = self.shapes.get(node)?;
        let position = self.positions.get(view.nodes[node].id())?;
        let (at, packet) = match shape.pin(port, input) {
            Some(pin) => (pin.at, pin.packet.clone()),
            // A port that the type does not have is drawn at the header.
            None => (pos2(if input { 0.0 } else { shape.size.x }, HEADER / 2.0), String::new()),
        };
        Some((self.transform() * (*position + at.to_vec2()), packet))
    }

    /// The curves that a wire consists of.
    pub(super) fn curves(&self, view: &GraphView, wire: &Wire) -> Vec<[Pos2; 4]> {
        let ends = (self.pin_at(view, wire.from, &wire.output, false), self.pin_at(view, wire.to, &wire.input, true));
        let (Some((from, _)), Some((to, _))) = ends else { return Vec::new() };
        let ends = (wire.from, wire.to);
        let Some(lane) = self.lanes.get(&ends) else {
            return match self.routes.get(&ends) {
                Some(corners) => self.routed(wire, from, to, corners),
                None if to.x > from.x => vec![bow(from, to, self.scale())],
                None => self.around(view, wire, from, to),
            };
        };
        let shift = vec2(0.0, self.beside(wire, BESIDE));
        let (transform, mut at, mut curves) = (self.transform(), from, Vec::new());
        for [left, right] in lane {
            let (left, right) = (transform * (*left + shift), transform * (*right + shift));
            curves.push(bow(at, left, self.scale()));
            let third = (right - left) / 3.0;
            curves.push([left, left + third, right - third, right]);
            at = right;
        }
        curves.push(bow(at, to, self.scale()));
        curves
    }

    /// Distance of a wire from the middle of the bundle that the wires of its node form.
    fn beside(&self, wire: &Wire, distance: f32) -> f32 {
        let Some(outputs) = self.outputs.get(wire.from) else { return 0.0 };
        let at = outputs.iter().position(|output| *output == wire.output).unwrap_or(0) as f32;
        let last = outputs.len().saturating_sub(1) as f32;
        (at - last / 2.0) * distance.min(BUNDLE / last.max(1.0))
    }

    /// The path of a wire to another row: along the corners that the layout gives.
    fn routed(&self, wire: &Wire, from: Pos2, to: Pos2, corners: &[Pos2]) -> Vec<[Pos2; 4]> {
        let transform = self.transform();
        let (from, to) = (transform.inverse() * from, transform.inverse() * to);
        let shift = Vec2::splat(self.beside(wire, BESIDE / 2.0));
        let mut path = vec![from];
        if let (Some(first), Some(last)) = (corners.first(), corners.last()) {
            path.push(pos2(first.x + shift.x, from.y));
            path.extend(corners.iter().map(|corner| *corner + shift));
            path.push(pos2(last.x + shift.x, to.y));
        }
        path.push(to);
        rounded(&path).into_iter().map(|curve| curve.map(|at| transform * at)).collect()
    }

    /// The path of a backward wire, below the nodes between its ends.
    fn around(&self, view: &GraphView, wire: &Wire, from: Pos2, to: Pos2) -> Vec<[Pos2; 4]> {
        let transform = self.transform();
        let (from, to) = (transform.inverse() * from, transform.inverse() * to);
        let rects: Vec<Rect> = (view.nodes.iter().zip(&self.shapes))
            .map(|(node, shape)| {
                Rect::from_min_size(self.positions.get(node.id()).copied().unwrap_or_default(), shape.size)
            })
            .collect();
        let bottom = |n: usize| rects.get(n).map_or(f32::MIN, Rect::bottom);
        // Backward wires are drawn beside each other.
        let beside = view.wires.iter().filter(|w| w.delayed).position(|w| w == wire).unwrap_or(0);
        let room = BELOW + (beside % 4) as f32 * 7.0;
        let mut low = bottom(wire.from).max(bottom(wire.to)) + room;
        for _ in 0..rects.len() {
            let between = rects.iter().filter(|r| r.right() > to.x - BELOW && r.left() < from.x + BELOW);
            let met = between.filter(|r| r.top() - BELOW < low && low < r.bottom() + BELOW);
            match met.map(Rect::bottom).reduce(f32::max) {
                Some(bottom) => low = bottom + room,
                None => break,
            }
        }
        // Down and up between the columns.
        let (right, left) = (from.x + room, to.x - room);
        let corners = [from, pos2(right, from.y), pos2(right, low), pos2(left, low), pos2(left, to.y), to];
        rounded(&corners).into_iter().map(|curve| curve.map(|at| transform * at)).collect()
    }

    /// The bounding rectangles of backward wires that the layout gives no path, in points of the graph.
    pub(super) fn backward(&self, view: &GraphView) -> Vec<Rect> {
        let has_path = |ends: &(usize, usize)| self.lanes.contains_key(ends) || self.routes.contains_key(ends);
        let to_graph = self.transform().inverse();
        let path = |wire: &Wire| {
            let (from, _) = self.pin_at(view, wire.from, &wire.output, false)?;
            let (to, _) = self.pin_at(view, wire.to, &wire.input, true)?;
            let points = if to.x > from.x { Vec::new() } else { self.around(view, wire, from, to).into_flattened() };
            (!points.is_empty()).then(|| to_graph * Rect::from_points(&points))
        };
        view.wires.iter().filter(|wire| !has_path(&(wire.from, wire.to))).filter_map(path).collect()
    }

    pub(super) fn paint_wires(&self, painter: &Painter, scene: &Scene<'_>) {
        let view = scene.view;
        let pulled = match &self.drag {
            Drag::Wire { moved: Some((input, index)), .. } => Some((input, *index)),
            _ => None,
        };
        // Of hundreds of nodes wires are thin and short.
        let tolerance = if self.scale() < PICTURES { 1.0 } else { 0.25 };
        for wire in &view.wires {
            let to = view.nodes[wire.to].id();
            let is_pulled = pulled
                .is_some_and(|(input, index)| input.node == to && input.port == wire.input && index == wire.index);
            if is_pulled {
                continue;
            }
            let curves = self.curves(view, wire);
            let packet = view.packet(wire.from, &wire.output).map_or("", |p| p.name.as_str());
            let selected =
                self.selected_wire.as_ref().is_some_and(|w| w.0 == to && w.1 == wire.input && w.2 == wire.index);
            let near = self.selected.contains(to) || self.selected.contains(view.nodes[wire.from].id());
            let (color, width) = match (selected, near) {
                (true, _) => (theme::accent(), 3.0),
                (_, true) => (theme::packet(packet), 2.5),
                _ if wire.delayed => (theme::packet(packet).gamma_multiply(0.45), 1.5),
                _ => (theme::packet(packet).gamma_multiply(0.6), 2.0),
            };
            let stroke = Stroke::new((width * self.scale()).max(1.0), color);
            for curve in curves.into_iter().filter(|c| Rect::from_points(c).expand(8.0).intersects(self.rect)) {
                if wire.delayed {
                    let points: Vec<Pos2> = (0..=32).map(|i| on_curve(&curve, i as f32 / 32.0)).collect();
                    painter.extend(Drawn::dashed_line(&points, stroke, 8.0 * self.scale(), 5.0 * self.scale()));
                } else {
                    match &flattened_to(&curve, tolerance)[..] {
                        [from, to] => painter.line_segment([*from, *to], stroke),
                        points => painter.line(points.to_vec(), stroke),
                    };
                }
            }
        }
    }

    /// Names the wires under the pointer, all of a bundle.
    pub(super) fn name_wires(&self, ui: &Ui, ground: &Response, scene: &Scene<'_>) {
        let pointer = ui.input(|i| i.pointer.hover_pos());
        let Some(at) = pointer.filter(|_| ground.hovered() && matches!(self.drag, Drag::None)) else { return };
        let names = self.wires_near(scene.view, at);
        if names.is_empty() {
            return;
        }
        let more = names.len().saturating_sub(NAMED);
        let mut text = names[..names.len() - more].join("\n");
        if more > 0 {
            text += &format!("\nand {more} more");
        }
        ground.clone().on_hover_text_at_pointer(text);
    }

    /// Names of the wires near a point of the window, such as `scope.left to register.left`.
    fn wires_near(&self, view: &GraphView, at: Pos2) -> Vec<String> {
        let is_near = |wire: &&Wire| {
            let curves = self.curves(view, wire);
            curves.iter().any(|curve| {
                Rect::from_points(curve).expand(NEAR).contains(at)
                    && flattened(curve).windows(2).any(|ends| distance(at, ends[0], ends[1]) < NEAR)
            })
        };
        let name = |wire: &Wire| {
            let (from, to) = (view.nodes[wire.from].id(), view.nodes[wire.to].id());
            let packet = view.packet(wire.from, &wire.output).map_or_else(String::new, |p| format!("  ({})", p.name));
            let delayed = if wire.delayed { ", previous value" } else { "" };
            format!("{from}.{} to {to}.{}{packet}{delayed}", wire.output, wire.input)
        };
        view.wires.iter().filter(is_near).map(name).collect()
    }
}
